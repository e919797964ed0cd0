"""A rapidly exploring random tree of needle poses with bang-bang steering: the planner that the swarm is compared with.

# Strategy: samples are drawn in the corridor of entry and target. Each goes to the nearest pose that could reach it
# with one arc of allowed curvature (the reachability guide of Patil and Alterovitz), which is extended towards it: the
# bevel is turned to the sample and the needle pushed one step, either always bending or, with duty cycle, bending fully
# or not at all. From a pose that sees the target along one clear arc, short zigzags close the rest exactly.

Source: Patil, S. and Alterovitz, R. (2010). Interactive motion planning for steerable needles in 3D environments with
obstacles. IEEE BioRob, 893-899. Written from its description.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.needle.kinematics import Arcs, Controls, Pose, bend_from, cross, frame_of, joined
from tubeplan_viz.needle.path import NeedlePath, measured
from tubeplan_viz.needle.polish import closed
from tubeplan_viz.needle.spatial import SpatialProblem, bounded
from tubeplan_viz.needle.zigzag import best_starts

NODES = 4000  # poses at most
BATCH = 32  # samples per round
STEPS = 12  # of the straight way: one step is this part of it
BIAS = 0.1  # of the samples are the target
WIDTH = 0.4  # of the corridor to either side, in parts of the straight way
ROOTS = 48  # where entry or direction are free
LAST_PIECES = 4  # that close the rest
SAMPLED_MARGIN = 0.05  # mm beyond the safety distance where an obstacle has no closed formula


class _Tree:
    """Poses with the arc that led to each."""

    def __init__(self, positions: FloatArray, tangents: FloatArray, normals: FloatArray) -> None:
        self.roots = len(positions)
        self.positions, self.tangents, self.normals = positions, tangents, normals
        self.parents: IntArray = np.full(self.roots, -1)
        self.turns, self.lengths, self.curvatures = np.zeros((3, self.roots))

    def __len__(self) -> int:
        return len(self.parents)

    def add(self, parents: IntArray, turns: FloatArray, arcs: Arcs) -> None:
        self.positions = np.vstack([self.positions, arcs.ends[:, -1]])
        self.tangents = np.vstack([self.tangents, arcs.end_tangents[:, -1]])
        self.normals = np.vstack([self.normals, arcs.end_normals[:, -1]])
        self.parents = np.concatenate([self.parents, parents])
        self.turns = np.concatenate([self.turns, turns])
        self.lengths = np.concatenate([self.lengths, arcs.lengths[:, 0]])
        self.curvatures = np.concatenate([self.curvatures, arcs.curvatures[:, 0]])

    def pose(self, node: int) -> Pose:
        return Pose(self.positions[node], frame_of(self.tangents[node], self.normals[node]))

    def way(self, node: int) -> list[int]:
        """The root and the nodes after it, to `node`."""
        made = [node]
        while self.parents[made[-1]] >= 0:
            made.append(int(self.parents[made[-1]]))
        return made[::-1]

    def seen(self, nodes: IntArray | slice, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of places (k, 3) from nodes (m,): distance and curvature of the arc that leads there, (k, m); infinite behind."""
        ahead = places[:, None] - self.positions[nodes]
        z = (ahead * self.tangents[nodes]).sum(axis=-1)
        square = (ahead * ahead).sum(axis=-1)
        across = np.sqrt(np.maximum(square - z * z, 0.0))
        return np.sqrt(square), np.where(z > 0.0, 2.0 * across / np.maximum(square, 1e-12), np.inf)


def plan_rrt(
    problem: SpatialProblem,
    *,
    rng: np.random.Generator,
    time_budget: float | None = None,
    watch: Callable[[int, int], None] | None = None,
) -> NeedlePath:
    """The first path that the tree finds; with a time budget the shortest that it finds in it.

    Parameters
    ----------
    problem : SpatialProblem
    rng : Generator
        All randomness; the same one gives the same path (without a time budget).
    time_budget : float, s, optional
    watch : callable, optional
        Told the poses of the tree and how many there may be.

    Returns
    -------
    NeedlePath
        Without rounds or front.
    """
    begun = time.perf_counter()
    tree = rooted(problem, rng)
    new: IntArray = np.arange(tree.roots)
    best: NeedlePath | None = None
    while True:
        found = finished(problem, tree, new)
        if found is not None and (best is None or found.length < best.length):
            best = found
        over = time_budget is not None and time.perf_counter() - begun > time_budget
        if over or len(tree) >= NODES or (best is not None and time_budget is None):
            break
        new = grown(problem, tree, rng)
        if watch is not None:
            watch(len(tree), NODES)
    if best is not None:
        return replace(best, nodes=len(tree))
    reason = f"no path was found: a tree of {len(tree)} poses does not see the target along an arc that keeps its distance"
    return NeedlePath(nodes=len(tree), reason=reason)


def rooted(problem: SpatialProblem, rng: np.random.Generator) -> _Tree:
    """The pose at the entry, and others within region and cone where they are free."""
    low, high = problem.bounds
    x = np.zeros((1, len(low)))
    if problem.free[1] or problem.free[2]:
        x = np.vstack([x, rng.uniform(low, high, (ROOTS - 1, len(low)))])
    *_, position, tangent, normal = problem.split(x)
    shape = (len(x), 3)
    return _Tree(*(np.array(np.broadcast_to(v, shape)) for v in (position, tangent, normal)))


def grown(problem: SpatialProblem, tree: _Tree, rng: np.random.Generator) -> IntArray:
    """One round of samples; the numbers of the new nodes."""
    s = problem.settings
    way = problem.target - problem.pose.position
    length = problem.distance
    frame = frame_of(way / length, across(way))
    share = rng.uniform([-WIDTH, -WIDTH, 0.0], [WIDTH, WIDTH, 1.0], (BATCH, 3))
    places = problem.pose.position + length * share @ frame.T
    places[rng.random(BATCH) < BIAS] = problem.target
    distance, curvature = tree.seen(slice(None), places)
    distance = np.where(curvature <= s.kappa, distance, np.inf)
    nearest = distance.argmin(axis=1)
    rows = np.flatnonzero(np.isfinite(distance[np.arange(BATCH), nearest]))
    nodes, places = nearest[rows], places[rows]
    ahead = places - tree.positions[nodes]
    normals = tree.normals[nodes]
    side = cross(tree.tangents[nodes], normals)
    turns = np.arctan2((ahead * side).sum(axis=1), (ahead * normals).sum(axis=1))
    steps = np.clip(distance[rows, nodes], s.piece_min, length / STEPS)
    bends = np.full(len(rows), s.kappa)
    if s.duty_cycle:
        bends = np.where(curvature[rows, nodes] > 0.5 * s.kappa, s.kappa, 0.0)
    arcs = bend_from(tree.positions[nodes], tree.tangents[nodes], normals, turns[:, None], steps[:, None], bends[:, None])
    clear = np.flatnonzero(kept_clear(problem, arcs))
    first = len(tree)
    tree.add(nodes[clear], turns[clear], Arcs(*(getattr(arcs, name)[clear] for name in Arcs.__dataclass_fields__)))
    return np.arange(first, len(tree))


def across(way: FloatArray) -> FloatArray:
    """Some direction at right angles to a way."""
    return cross(way, np.eye(3)[int(np.abs(way).argmin())])


def kept_clear(problem: SpatialProblem, arcs: Arcs) -> FloatArray:
    """Whether each of k paths keeps its distance, (k,)."""
    if not len(problem.scene):
        return np.ones(len(arcs.lengths), bool)
    margin = 0.0 if problem.scene.exact else SAMPLED_MARGIN
    return np.asarray(problem.scene.piece_distances(arcs).min(axis=(1, 2)) >= problem.settings.safety + margin)


def finished(problem: SpatialProblem, tree: _Tree, nodes: IntArray) -> NeedlePath | None:
    """The shortest path over one of the nodes that closes on the target, or None."""
    if not len(nodes):
        return None
    distance, curvature = (v[0] for v in tree.seen(nodes, problem.target[None]))
    half = np.arcsin(np.clip(0.5 * distance * curvature, 0.0, 1.0))
    length = np.where(curvature > 1e-12, 2.0 * half / np.maximum(curvature, 1e-12), distance)
    able = np.flatnonzero((curvature <= problem.settings.kappa) & (distance > LAST_PIECES * problem.settings.piece_min))
    if not len(able):
        return None
    near = nodes[able]
    ahead, normals = problem.target - tree.positions[near], tree.normals[near]
    side = cross(tree.tangents[near], normals)
    turns = np.arctan2((ahead * side).sum(axis=1), (ahead * normals).sum(axis=1))
    seen = bend_from(
        tree.positions[near], tree.tangents[near], normals, turns[:, None], length[able, None], curvature[able, None]
    )
    made = [path for node in near[kept_clear(problem, seen)] if (path := closing(problem, tree, int(node))) is not None]
    return min(made, key=lambda path: path.length) if made else None


def closing(problem: SpatialProblem, tree: _Tree, node: int) -> NeedlePath | None:
    """The path over a node with short zigzags that end on the target, or None."""
    settings = replace(problem.settings, pieces=LAST_PIECES)
    left = replace(problem, pose=tree.pose(node), settings=settings, under_way=True)
    way = tree.way(node)
    for start in best_starts(left, 2):
        x = closed(left, start)
        if x is None or not bounded(left, x):
            continue
        rest = left.controls(x)[1]
        branch = Controls(tree.turns[way[1:]], tree.lengths[way[1:]], tree.curvatures[way[1:]])
        controls = joined([branch, rest])
        found = measured(problem, tree.pose(way[0]), controls)
        if found.feasible:
            return found
    return None
