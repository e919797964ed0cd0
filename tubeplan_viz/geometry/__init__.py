"""Curves, their curvature, and the gap between a curve and the wall."""

from tubeplan_viz.geometry.bounds import Bound, clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.geometry.curvature import circumcenter, menger_curvature
from tubeplan_viz.geometry.curve import SplineCurve
from tubeplan_viz.geometry.distance import WallDistance
from tubeplan_viz.geometry.frames import across, moving_frames

__all__ = [
    "Bound",
    "SplineCurve",
    "WallDistance",
    "across",
    "circumcenter",
    "clearance_lower_bound",
    "curvature_upper_bound",
    "menger_curvature",
    "moving_frames",
]
