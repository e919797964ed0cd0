"""Middle lines of lumens with inscribed radii, their branches and their tips."""

from tubeplan_viz.centerline.endpoints import Endpoint, find_endpoints
from tubeplan_viz.centerline.line import Centerline
from tubeplan_viz.centerline.scale import ScaledCurvature, ScaleSettings, curvature_at_scale
from tubeplan_viz.centerline.trace import CenterlineSettings, even_points, trace_centerline
from tubeplan_viz.centerline.tree import Branch, CenterlineTree, centerline_tree
from tubeplan_viz.centerline.voronoi import VoronoiGraph, voronoi_graph

__all__ = [
    "Branch",
    "Centerline",
    "CenterlineSettings",
    "CenterlineTree",
    "Endpoint",
    "ScaleSettings",
    "ScaledCurvature",
    "VoronoiGraph",
    "centerline_tree",
    "curvature_at_scale",
    "even_points",
    "find_endpoints",
    "trace_centerline",
    "voronoi_graph",
]
