"""The lumen made ready for planning: flat ends, Voronoi graph, end points, start and goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Branching:
    """Centerlines from one place of the lumen to its end points, grown once for all that ask for this root.

    Attributes
    ----------
    root : str or None
        Label of the end point that it grows from; None from another place.
    labels : tuple of str
        Of the targets: the other end points in their order. A goal that is none of them comes last, as "goal".
    branches : CenterlineTree
    """

    root: str | None
    labels: tuple[str, ...]
    branches: CenterlineTree

    @property
    def joins_ends(self) -> bool:
        """Whether it leads from an end point to the others and nowhere else."""
        return self.root is not None and GOAL not in self.labels


GOAL = "goal"
# Nearer to an end point than this a place is the end point itself, mm.
SAME = 1e-6


def branches_from_end(tree: Tree, root: str, *, settings: CenterlineSettings | None = None) -> Branching:
    """Centerlines from one end point to all others."""
    start = next(tip.point for tip in tree.endpoints if tip.label == root)
    others = [tip for tip in tree.endpoints if tip.label != root]
    return grown_from(tree, start, root, [tip.label for tip in others], [tip.point for tip in others], settings)


def end_label(tree: Tree, place: FloatArray) -> str | None:
    """Label of the end point at a place; None where there is none."""
    return next((tip.label for tip in tree.endpoints if np.linalg.norm(tip.point - place) <= SAME), None)


def branches_on_way(
    tree: Tree, start: FloatArray, goal: FloatArray, *, settings: CenterlineSettings | None = None
) -> tuple[Branching, int]:
    """Centerlines from a path's start to every other end of the lumen and to its goal; the goal's number among the targets."""
    root = end_label(tree, start)
    # A start beside an end point, but not on it, stands for that end.
    near = {tip.label for tip in tree.endpoints if np.linalg.norm(tip.point - start) <= tip.radius}
    others = [tip for tip in tree.endpoints if tip.label not in ({root} if root is not None else near)]
    labels, points = [tip.label for tip in others], [tip.point for tip in others]
    at_goal = next((k for k, point in enumerate(points) if np.linalg.norm(point - goal) <= SAME), None)
    if at_goal is None:
        labels, points = [*labels, GOAL], [*points, goal]
    found = grown_from(tree, start, root, labels, points, settings)
    return found, len(points) - 1 if at_goal is None else at_goal


def grown_from(
    tree: Tree,
    start: FloatArray,
    root: str | None,
    labels: Sequence[str],
    points: Sequence[FloatArray],
    settings: CenterlineSettings | None,
) -> Branching:
    """The centerlines themselves."""
    branches = centerline_tree(tree.graph, tree.wall, start, np.array(points), settings)
    return Branching(root=root, labels=tuple(labels), branches=branches)


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
