"""A small local search around the best paths: nodes moved by fractions of a millimetre, entry voxels changed for neighbours.

# Strategy: the search is content with one path for every start. The best of them in each goal is taken as the beginning of a
# pattern search [1]_: its bends are moved along and across the last segment, its start is changed for the voxels around it;
# what is free and better becomes the new beginning, and where nothing is, the steps are halved. Every path that is kept has
# been put to the same collision tests as all others.

References
----------
.. [1] Hooke, R. and Jeeves, T. A. (1961). Direct search solution of numerical and statistical problems. J. ACM 8, 212-229.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.judge import Judge
from tubeplan_viz.rigid.ranking import GOALS, LARGER_IS_BETTER, Weights, rank
from tubeplan_viz.rigid.search_state import RigidPath

STEPS_MM = (4.0, 2.0, 1.0, 0.5)  # of the bends
ROUNDS = 6  # at each step, at most
STARTS = 14  # entry voxels around the present start
MEASURED = 24  # free neighbours whose goals are measured in a round
LEAST_LEG_MM = 2.0
Goals = Callable[[Sequence[RigidPath]], FloatArray]


def polish(
    judge: Judge, starts: FloatArray, paths: Sequence[RigidPath], goals: FloatArray, weights: Weights, measure: Goals
) -> tuple[tuple[RigidPath, ...], FloatArray]:
    """Paths that are better than the best of some in one of the named goals, and their goals.

    Parameters
    ----------
    judge : Judge
    starts : (n, 3) float array, LPS mm
        Voxels of the entry region.
    paths : sequence of RigidPath
        At least one.
    goals : (k, 6) float array
        Of the paths, columns as in `ranking.GOALS`.
    weights : Weights
    measure : callable
        Goals of paths, (m, 6).

    Returns
    -------
    paths : tuple of RigidPath
        One for each goal of `ranking.BEST` that could be improved.
    goals : (m, 6) float array
    """
    tree = cKDTree(starts)
    ranking = rank(goals, weights)
    better: list[RigidPath] = []
    found: list[FloatArray] = []
    for name, index in ranking.best.items():
        path, own = paths[index], goals[index]
        for step in STEPS_MM if len(path.nodes) > 2 else STEPS_MM[-1:]:
            for _ in range(ROUNDS):
                near = _neighbours(path, starts, tree, step)
                if name == "length":
                    near = sorted((p for p in near if p.length < path.length - 1e-6), key=lambda p: p.length)
                near = _free(judge, near)[:MEASURED]
                if not near:
                    break
                rows = measure(near)
                value = _value(name, np.vstack([goals, own[None], rows]), weights)[len(goals) :]
                best = int(np.argmin(value))
                if not value[best] < value[0] - 1e-9:
                    break
                path, own = near[best - 1], rows[best - 1]
        if path is not paths[index]:
            better.append(path)
            found.append(own)
    return tuple(better), np.array(found).reshape(-1, len(GOALS))


def _value(name: str, goals: FloatArray, weights: Weights) -> FloatArray:
    """What is made small: the goal itself, or the weighted sum over all rows, (n,)."""
    if name == "overall":
        return rank(goals, weights).score
    column = goals[:, GOALS.index(name)]
    return np.asarray(-column if name in LARGER_IS_BETTER else column)


def _neighbours(path: RigidPath, starts: FloatArray, tree: cKDTree, step: float) -> list[RigidPath]:
    """Paths that differ in one node or in the start; a bend is left out too."""
    made: list[RigidPath] = []
    _, rows = tree.query(path.nodes[0], k=min(STARTS + 1, len(starts)))
    for row in np.atleast_1d(rows).tolist():
        if row != path.start:
            made.append(RigidPath(np.vstack([starts[row], path.nodes[1:]]), path.roll, row))
    for k in range(1, len(path.nodes) - 1):
        made.append(RigidPath(np.delete(path.nodes, k, axis=0), path.roll, path.start))
        ahead = unit(path.nodes[k + 1] - path.nodes[k])
        across = unit(np.cross(ahead, np.eye(3)[int(np.argmin(np.abs(ahead)))]))
        third = np.cross(ahead, across)
        for way in (ahead, -ahead, across, -across, third, -third):
            nodes = path.nodes.copy()
            nodes[k] = nodes[k] + step * way
            made.append(RigidPath(nodes, path.roll, path.start))
            # With the start beside the new place, a bend near the start moves together with it.
            _, row = tree.query(path.nodes[0] + step * way)
            if int(row) != path.start:
                made.append(RigidPath(np.vstack([starts[int(row)], nodes[1:]]), path.roll, int(row)))
    return [p for p in made if np.linalg.norm(np.diff(p.nodes, axis=0), axis=1).min() > 1e-3 and _leg(p) >= LEAST_LEG_MM]


def _leg(path: RigidPath) -> float:
    return float(np.linalg.norm(path.nodes[-1] - path.nodes[-2]))


def _free(judge: Judge, paths: Sequence[RigidPath]) -> list[RigidPath]:
    """Those paths whose pushes and turns are all free."""
    if not paths:
        return []
    count = np.array([len(path.nodes) - 1 for path in paths])
    owner = np.repeat(np.arange(len(paths)), count)
    roll = np.array([path.roll for path in paths])
    label, _ = judge.push(
        np.vstack([path.nodes[:-1] for path in paths]), np.vstack([path.nodes[1:] for path in paths]), roll[owner]
    )
    free: BoolArray = np.ones(len(paths), dtype=bool)
    free[owner[label >= 0]] = False
    turns = [(k, j) for k in np.flatnonzero(free).tolist() for j in range(1, len(paths[k].nodes) - 1)]
    if turns:
        who = np.array([k for k, _ in turns])
        corner = np.array([paths[k].nodes[j - 1 : j + 2] for k, j in turns])  # (m, 3, 3)
        way = unit(np.diff(corner, axis=1))
        free[who[~judge.turn(corner[:, 1], way[:, 0], way[:, 1], roll[who])]] = False
    return [paths[k] for k in np.flatnonzero(free).tolist()]
