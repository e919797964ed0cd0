"""Proposals for start and goal: the tips of the lumen's tree, labelled E1, E2, ..."""

# Strategy: a shortest-path tree with cost 1/R grows from a root through the Voronoi graph.
# The node farthest beyond what is covered becomes a tip; the branch back to the covered
# part is covered with everything that its inscribed spheres hold; and so on until the
# next branch would be no longer than the lumen is wide there.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray, frozen_array
from tubeplan_viz.centerline.trace import CenterlineSettings, walk_back
from tubeplan_viz.centerline.voronoi import VoronoiGraph
from tubeplan_viz.geometry import WallDistance

# Depth in mm at which a cap's centre is tried when it does not lie inside itself.
HAIR = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class Endpoint:
    """One tip of the lumen.

    Attributes
    ----------
    label : str
        ``E1`` is the root, the others follow by falling branch length.
    point : (3,) float array, mm
    radius : float, mm
        Largest inscribed sphere there; on a cap the distance to the wall beside it.
    branch_length : float, mm
        From the tip to the branch that was there before it (for the root: to the farthest tip).
    confidence : float
        0 to 1: how sure it is that this is a branch and not a bulge of the wall. A branch
        as long as the lumen is wide at its foot has 0, one three times as long 0.86.
    cap : str or None
        Label of the cap on whose centre the tip was put.
    """

    label: str
    point: FloatArray
    radius: float
    branch_length: float
    confidence: float
    cap: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen_array(self.point, (3,), "endpoint"))


def find_endpoints(
    graph: VoronoiGraph, wall: WallDistance, *, root: ArrayLike | None = None, settings: CenterlineSettings | None = None
) -> tuple[Endpoint, ...]:
    """Tips of the lumen's tree.

    Parameters
    ----------
    graph : VoronoiGraph
    wall : WallDistance
    root : (3,) array_like, mm, optional
        Where the tree begins; by default the largest cap, otherwise the wider end of the longest
        way through: airways and vessels narrow from the root to the tips.
    """
    settings = settings or CenterlineSettings()
    caps = wall.surface.caps
    matrix = graph.matrix(graph.edge_costs(settings.omega))
    first = nearest_node(graph, caps[0].center if root is None and caps else root)
    part = connected_components(matrix, directed=False)[1]
    members = part == part[first]
    if root is None and not caps:
        first = wide_end(graph, graph.matrix(graph.lengths), first, members)
    cost, previous = dijkstra(matrix, directed=False, indices=first, return_predecessors=True)
    length = path_lengths(graph, previous)
    covered = ~members | ~np.isfinite(cost)
    covered[first] = True
    tips: list[tuple[int, float, float]] = []
    while True:
        beyond = lengths_beyond(previous, length, covered)
        tip = int(np.argmax(beyond))
        foot = tip
        branch = [tip]
        while not covered[foot]:
            foot = int(previous[foot])
            branch.append(foot)
        width = 2.0 * float(graph.radii[foot])
        if len(branch) < 2 or (tips and beyond[tip] < max(width, 3.0 * settings.step)):
            break
        tips.append((tip, float(beyond[tip]), width))
        spread = thinned(graph, branch)
        cover(graph, covered, graph.nodes[spread], 1.5 * graph.radii[spread] + settings.step)
    found = [(root_end(graph, previous, tips, first), max((b for _, b, _ in tips), default=0.0), 0.0)]
    own = own_lengths(previous, length, tips)
    ends = [(retreat(graph, wall, previous, tip, o), branch, w) for (tip, branch, w), o in zip(tips, own, strict=True)]
    found += sorted(ends, key=lambda end: -end[1])
    return tuple(label_tips(graph, wall, found))


def own_lengths(previous: IntArray, length: FloatArray, tips: Sequence[tuple[int, float, float]]) -> list[float]:
    """Length of the lumen that is each tip's own, mm: its branch.

    The first tip's branch is the whole way from the root, through the trunk; its own is what no other tip's way shares.
    """
    if not tips:
        return []
    shared = np.zeros(len(previous), dtype=bool)
    for tip, _, _ in tips[1:]:
        shared[walk_up(previous, tip)] = True
    chain = walk_up(previous, tips[0][0])
    fork = max((float(length[node]) for node in chain if shared[node]), default=0.0)
    return [float(length[chain[0]]) - fork, *(branch for _, branch, _ in tips[1:])]


def walk_up(previous: IntArray, node: int) -> list[int]:
    """The tree path from a node to the root."""
    chain = [node]
    while previous[chain[-1]] >= 0:
        chain.append(int(previous[chain[-1]]))
    return chain


def nearest_node(graph: VoronoiGraph, point: ArrayLike | None) -> int:
    """The widest Voronoi vertex whose sphere holds the point, else the nearest; without a point the widest of all."""
    if point is None:
        return int(np.argmax(graph.radii))
    gap = np.linalg.norm(graph.nodes - np.asarray(point, dtype=float), axis=1)
    holding = np.flatnonzero(gap <= graph.radii)
    return int(holding[np.argmax(graph.radii[holding])]) if len(holding) else int(np.argmin(gap))


def wide_end(graph: VoronoiGraph, matrix: csr_matrix, node: int, members: BoolArray) -> int:
    """The end of the longest way through on whose quarter the lumen is wider on average."""
    one, _ = farthest(matrix, node, members)
    other, previous = farthest(matrix, one, members)
    chain = walk_back(previous, other)
    if chain is None:
        return one
    radii = graph.radii[chain]
    quarter = max(len(radii) // 4, 1)
    return one if radii[:quarter].mean() >= radii[-quarter:].mean() else other


def farthest(matrix: csr_matrix, node: int, members: BoolArray) -> tuple[int, IntArray]:
    """The reachable node farthest from `node`, and the shortest-path tree from `node`."""
    distance, previous = dijkstra(matrix, directed=False, indices=node, return_predecessors=True)
    return int(np.argmax(np.where(members & np.isfinite(distance), distance, -1.0))), previous


def path_lengths(graph: VoronoiGraph, previous: IntArray) -> FloatArray:
    """Length of the tree path from the root to every node, mm; zero for nodes that the tree does not reach."""
    own = np.arange(len(graph.nodes))
    ancestor = np.where(previous >= 0, previous, own)
    length = np.linalg.norm(graph.nodes - graph.nodes[ancestor], axis=1)
    # Doubling: after k rounds `length` is that of the last 2^k edges, and `ancestor` lies at their beginning.
    while True:
        further = ancestor[ancestor]
        if np.array_equal(further, ancestor):
            return np.asarray(length)
        length = length + length[ancestor]
        ancestor = further


def lengths_beyond(previous: IntArray, length: FloatArray, covered: BoolArray) -> FloatArray:
    """For every node the length of its tree path outside the covered part, mm."""
    beyond = np.zeros(len(covered))
    nodes = np.flatnonzero(~covered & (previous >= 0))
    place = np.full(len(covered), -1)
    place[nodes] = np.arange(len(nodes))
    # `foot` is a place among the uncovered nodes until it has left them; doubling as in `path_lengths`.
    parent = previous[nodes]
    above = place[parent]
    top = np.where(above < 0, np.arange(len(nodes)), above)
    while True:
        further = top[top]
        if np.array_equal(further, top):
            beyond[nodes] = length[nodes] - length[parent[top]]
            return beyond
        top = further


def cover(graph: VoronoiGraph, covered: BoolArray, centers: FloatArray, radii: FloatArray) -> None:
    """Mark the nodes that lie in any of the balls; `covered` is changed."""
    widest = float(radii.max())
    free = np.flatnonzero(~covered)
    low, high = centers.min(axis=0) - widest, centers.max(axis=0) + widest
    free = free[np.all((graph.nodes[free] >= low) & (graph.nodes[free] <= high), axis=1)]
    # |x - c|^2 <= r^2 for some ball, as one nearest neighbour: each centre gets a fourth
    # coordinate whose square is what its radius falls short of the widest.
    # A scalar's square may round below the array's of the same number.
    lifted = cKDTree(np.column_stack([centers, np.sqrt(np.maximum(widest**2 - radii**2, 0.0))]))
    sites = np.column_stack([graph.nodes[free], np.zeros(len(free))])
    covered[free[np.isfinite(lifted.query(sites, distance_upper_bound=widest * (1.0 + 1e-12))[0])]] = True


def thinned(graph: VoronoiGraph, branch: list[int]) -> list[int]:
    """Nodes of a branch at least a quarter of the lumen's radius apart; their spheres cover what all of them cover."""
    kept = [branch[0]]
    for node in branch[1:]:
        if np.linalg.norm(graph.nodes[node] - graph.nodes[kept[-1]]) >= 0.25 * graph.radii[kept[-1]]:
            kept.append(node)
    return kept


def retreat(graph: VoronoiGraph, wall: WallDistance, previous: IntArray, tip: int, branch_length: float) -> int:
    """Walk back from a tip, at most a third of its branch, until the lumen is half as wide as the branch is.

    The very tip lies in a corner of the wall; an instrument's end belongs where there is room. The branch must not reach
    into a trunk: half as wide as a trachea is where a bronchus begins.
    """
    chain, gone = [tip], 0.0
    while gone < branch_length and previous[chain[-1]] >= 0:
        node = int(previous[chain[-1]])
        gone += float(np.linalg.norm(graph.nodes[node] - graph.nodes[chain[-1]]))
        chain.append(node)
    radii = wall.distance(graph.nodes[chain])
    enough = 0.5 * float(np.median(radii))
    gone = 0.0
    for k, node in enumerate(chain):
        if radii[k] >= enough or gone > branch_length / 3.0:
            return node
        if k + 1 < len(chain):
            gone += float(np.linalg.norm(graph.nodes[chain[k + 1]] - graph.nodes[node]))
    return chain[0]


def root_end(graph: VoronoiGraph, previous: IntArray, tips: list[tuple[int, float, float]], first: int) -> int:
    """The root itself, moved along the longest branch to where the lumen has half its usual width."""
    if not tips:
        return first
    chain = walk_up(previous, tips[0][0])[::-1]
    enough = 0.5 * float(np.median(graph.radii[chain]))
    for node in chain[: max(len(chain) // 3, 1)]:
        if graph.radii[node] >= enough:
            return node
    return first


def label_tips(graph: VoronoiGraph, wall: WallDistance, found: list[tuple[int, float, float]]) -> list[Endpoint]:
    """Endpoints with labels; a tip beside a cap is put on the cap's centre, where no wall is in the way."""
    tips: list[Endpoint] = []
    for node, branch, width in found:
        point, cap = graph.nodes[node], None
        for candidate in wall.surface.caps:
            reach = np.sqrt(candidate.area / np.pi)
            center = candidate.center
            if not wall.inside(center)[0]:
                # Mesh files hold single precision, which may leave the centre a hair outside.
                center = center - HAIR * candidate.normal
            if wall.inside(center)[0] and np.linalg.norm(center - point) < 2.0 * reach + 1.0:
                point, cap = center, candidate.label
                break
        if any(np.linalg.norm(point - tip.point) < 1.0 for tip in tips):
            continue
        confidence = 1.0 if width == 0.0 or cap else float(1.0 - np.exp(-max(branch / width - 1.0, 0.0)))
        tips.append(
            Endpoint(
                label=f"E{len(tips) + 1}",
                point=point,
                radius=float(wall.distance(point)[0]),
                branch_length=branch,
                confidence=round(confidence, 3),
                cap=cap,
            )
        )
    return tips
