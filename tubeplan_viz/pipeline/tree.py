"""The lumen made ready for planning: flat ends, Voronoi graph, end points, start and goal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from segmentation.caps import mark_flat_ends
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from tubeplan_viz.cases.fields import Place
from tubeplan_viz.cases.tube import Case
from tubeplan_viz.centerline import (
    CenterlineSettings,
    CenterlineTree,
    Endpoint,
    VoronoiGraph,
    centerline_tree,
    find_endpoints,
    voronoi_graph,
)
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.pipeline.lumen import Lumen
from tubeplan_viz.tube import TubeProblem, pose_problem


@dataclass(frozen=True, eq=False, kw_only=True)
class Tree:
    """The lumen made ready for planning: flat ends found, Voronoi graph, end points."""

    surface: Surface
    wall: WallDistance
    graph: VoronoiGraph
    endpoints: tuple[Endpoint, ...]


def grow_tree(surface: Surface, *, closed_ends: bool = False, settings: CenterlineSettings | None = None) -> Tree:
    """End points of the lumen with their labels; the same surface always gives the same labels.

    Flat discs at the tips are recognised as caps first, since they move the tips onto
    their centres.
    """
    tree = tips_of(surface, closed_ends=closed_ends, settings=settings)
    if closed_ends:
        return tree
    marked = mark_flat_ends(surface, np.array([tip.point for tip in tree.endpoints]))
    return tree if len(marked.caps) == len(surface.caps) else tips_of(marked, closed_ends=False, settings=settings)


def tips_of(surface: Surface, *, closed_ends: bool, settings: CenterlineSettings | None) -> Tree:
    """Wall, graph and end points of a surface as it is."""
    wall = WallDistance(surface, closed_ends=closed_ends)
    graph = voronoi_graph(surface, wall)
    return Tree(surface=surface, wall=wall, graph=graph, endpoints=find_endpoints(graph, wall, settings=settings))


def resolve_end(name: str, given: Place | None, endpoints: tuple[Endpoint, ...]) -> np.ndarray:
    """Coordinates of a start or goal given as coordinates or as a label.

    Raises
    ------
    CaseError
        If nothing was given or there is no such label.
    """
    listing = "; ".join("{} ({:.1f}, {:.1f}, {:.1f})".format(tip.label, *tip.point) for tip in endpoints)
    if given is None:
        raise CaseError(f"no {name} was given; give --{name} X,Y,Z in mm or one of the lumen's end points: {listing}")
    if not isinstance(given, str):
        return np.array(given, dtype=float)
    for tip in endpoints:
        if tip.label == given:
            return np.array(tip.point)
    raise CaseError(f"the lumen has no end point {given}; it has {listing}")


def pose_case(case: Case, lumen: Lumen) -> tuple[TubeProblem, Tree]:
    """Start and goal on the wall made ready, and the centerline between them."""
    settings = case.tube_settings
    tree = grow_tree(lumen.surface, closed_ends=settings.closed_ends, settings=settings.centerline)
    start, goal = (resolve_end(name, getattr(case.planner, name), tree.endpoints) for name in ("start", "goal"))
    if not settings.closed_ends:
        marked = mark_flat_ends(tree.surface, np.array([start, goal]))
        if len(marked.caps) != len(tree.surface.caps):
            wall = WallDistance(marked)
            tree = replace(tree, surface=marked, wall=wall, graph=voronoi_graph(marked, wall))
    problem = pose_problem(tree.surface, start, goal, case.limits, settings, wall=tree.wall, graph=tree.graph)
    return problem, tree


def branches_from(
    tree: Tree, start: np.ndarray, goal: np.ndarray, *, settings: CenterlineSettings | None = None
) -> CenterlineTree:
    """Centerlines from the start to every other end of the lumen and, as the last target, to the goal."""
    tips = [tip.point for tip in tree.endpoints if np.linalg.norm(tip.point - start) > tip.radius]
    others = [point for point in tips if np.linalg.norm(point - goal) > 1e-6]
    return centerline_tree(tree.graph, tree.wall, start, np.array([*others, goal]), settings)


def endpoint_details(tip: Endpoint) -> dict[str, Any]:
    """One end point for result.json and ``tubeplan endpoints --json``."""
    return {
        "label": tip.label,
        "point_mm": tip.point.tolist(),
        "radius_mm": tip.radius,
        "branch_length_mm": tip.branch_length,
        "confidence": tip.confidence,
        "cap": tip.cap,
    }
