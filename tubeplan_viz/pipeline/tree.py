"""The lumen made ready for planning: flat ends, Voronoi graph, end points, branches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
    """The lumen made ready for planning: flat ends found, Voronoi graph, end points.

    Attributes
    ----------
    surface : Surface
    wall : WallDistance
    graph : VoronoiGraph
    endpoints : tuple of Endpoint
    settings : CenterlineSettings
        Of the end points and of all centerlines in it.
    """

    surface: Surface
    wall: WallDistance
    graph: VoronoiGraph
    endpoints: tuple[Endpoint, ...]
    settings: CenterlineSettings
    # Walk, names and measures ask for the same centerlines, by label of their root; a changed tree begins anew.
    grown: dict[str, Branching] = field(default_factory=dict, init=False, repr=False)


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
    settings = settings or CenterlineSettings()
    wall = WallDistance(surface, closed_ends=closed_ends)
    graph = voronoi_graph(surface, wall)
    tips = find_endpoints(graph, wall, settings=settings)
    return Tree(surface=surface, wall=wall, graph=graph, endpoints=tips, settings=settings)


def first_end(tree: Tree, label: str) -> Tree:
    """The same tree with another end point as E1; the others keep their order."""
    tips = sorted(tree.endpoints, key=lambda tip: tip.label != label)
    return replace(tree, endpoints=tuple(replace(tip, label=f"E{number + 1}") for number, tip in enumerate(tips)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Branching:
    """Centerlines from one place of the lumen to its end points.

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


GOAL = "goal"
# Nearer to an end point than this a place is the end point itself, mm.
SAME = 1e-6


def branches_from_end(tree: Tree, root: str) -> Branching:
    """Centerlines from one end point to all others, grown once for all that ask."""
    if root not in tree.grown:
        start = next(tip.point for tip in tree.endpoints if tip.label == root)
        others = [tip for tip in tree.endpoints if tip.label != root]
        tree.grown[root] = grown_from(tree, start, root, [tip.label for tip in others], [tip.point for tip in others])
    return tree.grown[root]


def end_label(tree: Tree, place: FloatArray) -> str | None:
    """Label of the end point at a place; None where there is none."""
    return next((tip.label for tip in tree.endpoints if np.linalg.norm(tip.point - place) <= SAME), None)


def branches_on_way(tree: Tree, start: FloatArray, goal: FloatArray) -> tuple[Branching, int]:
    """Centerlines from a path's start to every other end of the lumen and to its goal; the goal's number among the targets."""
    root, end = end_label(tree, start), end_label(tree, goal)
    if root is not None and end is not None and root != end:
        found = branches_from_end(tree, root)
        return found, found.labels.index(end)
    # A start beside an end point, but not on it, stands for that end.
    near = {tip.label for tip in tree.endpoints if np.linalg.norm(tip.point - start) <= tip.radius}
    others = [tip for tip in tree.endpoints if tip.label not in ({root} if root is not None else near)]
    labels, points = [tip.label for tip in others], [tip.point for tip in others]
    target = end if end is not None and end in labels else GOAL
    if target == GOAL:
        labels, points = [*labels, GOAL], [*points, goal]
    return grown_from(tree, start, root, labels, points), labels.index(target)


def grown_from(tree: Tree, start: FloatArray, root: str | None, labels: Sequence[str], points: Sequence[FloatArray]) -> Branching:
    """The centerlines themselves."""
    branches = centerline_tree(tree.graph, tree.wall, start, np.array(points), tree.settings)
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
