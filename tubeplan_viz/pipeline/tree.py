"""The lumen made ready for planning: flat ends, Voronoi graph, end points, branches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.caps import mark_flat_ends
from segmentation.mesh import Surface
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


def endpoint_details(tip: Endpoint, name: str | None = None) -> dict[str, Any]:
    """One end point for result.json and ``tubeplan endpoints --json``, with the name of its part where that is known."""
    return {
        "label": tip.label,
        "point_mm": tip.point.tolist(),
        "radius_mm": tip.radius,
        "branch_length_mm": tip.branch_length,
        "confidence": tip.confidence,
        "cap": tip.cap,
        "name": name,
    }
