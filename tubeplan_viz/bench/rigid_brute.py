"""Brute force for rigid instruments: every straight push, and every path with one bend on a grid of nodes.

The last push must lead out through the entry region, or the shaft does not: so the grid of nodes is made of lines from the
goal to the starts and of depths along them. A grid of cubes holds hardly a node from which the goal can be reached.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import BoolArray, FloatArray
from tubeplan_viz.rigid import Problem, RigidPath
from tubeplan_viz.rigid.instrument import unit

BATCH = 4000


@dataclass(frozen=True, eq=False)
class BruteForce:
    """Every feasible start, the paths of all, and what it took.

    Attributes
    ----------
    feasible : (n,) bool array
    paths : tuple of RigidPath
        All straight ones and all with one bend.
    evaluations : int
        Counted as the search counts them; the push from a node to the goal is evaluated once for all starts.
    """

    feasible: BoolArray
    paths: tuple[RigidPath, ...]
    evaluations: int


def brute_force(problem: Problem, rolls: FloatArray, *, depths: int) -> BruteForce:
    """Try everything.

    Parameters
    ----------
    problem : Problem
    rolls : (k,) float array, radian
    depths : int
        Nodes on each line, evenly between goal and start.
    """
    judge, starts, goal = problem.judge(), problem.starts, problem.goal
    feasible, paths = np.zeros(len(starts), dtype=bool), []
    shares = (np.arange(depths) + 1.0) / (depths + 1.0)
    grid = (goal + shares[None, :, None] * (starts - goal)[:, None]).reshape(-1, 3)
    for roll in rolls:
        label, _ = judge.push(starts, np.broadcast_to(goal, starts.shape), np.full(len(starts), roll))
        for row in np.flatnonzero(label < 0):
            feasible[row] = True
            paths.append(RigidPath(np.array([starts[row], goal]), float(roll), int(row)))
        label, _ = judge.push(grid, np.broadcast_to(goal, grid.shape), np.full(len(grid), roll))
        nodes = grid[label < 0]
        pairs = np.stack(np.meshgrid(np.arange(len(starts)), np.arange(len(nodes)), indexing="ij"), axis=-1).reshape(-1, 2)
        for part in np.array_split(pairs, max(1, len(pairs) // BATCH)):
            first, second = starts[part[:, 0]], nodes[part[:, 1]]
            label, _ = judge.push(first, second, np.full(len(part), roll))
            live = np.flatnonzero(label < 0)
            before, after = unit(second[live] - first[live]), unit(goal - second[live])
            free = judge.turn(second[live], before, after, np.full(len(live), roll))
            for row, node in part[live[free]]:
                feasible[row] = True
                paths.append(RigidPath(np.array([starts[row], nodes[node], goal]), float(roll), int(row)))
    return BruteForce(feasible, tuple(paths), judge.evaluations)
