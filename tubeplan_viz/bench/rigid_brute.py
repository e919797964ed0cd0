"""Brute force for rigid instruments: every straight push, and every path with one bend on a grid of nodes.

# Strategy: the last push must lead out through the entry region, or the shaft does not; so the grid of nodes is made of
# lines from the goal through the entry region, evenly spaced there, and of depths along them. (A grid of cubes holds hardly
# a node from which the goal can be reached.) Halving both steps again and again shows what a coarser grid missed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from segmentation.arrays import BoolArray, FloatArray
from tubeplan_viz.rigid import Problem, RigidPath
from tubeplan_viz.rigid.instrument import UP, unit
from tubeplan_viz.rigid.witnesses import Witnesses

FIRST_BATCH, BATCH = 8, 64  # nodes put to all starts at a time; few first, since most starts need few
TURNS = 200  # turns judged at a time, when the first free path of a start is enough
LEAST_LEG_MM = 3.0


@dataclass(frozen=True, eq=False)
class BruteForce:
    """Every feasible start, the paths, and what it took.

    Attributes
    ----------
    feasible : (n,) bool array
    paths : tuple of RigidPath
        All straight ones, and with one bend all of the grid or the first of every start.
    tests : int
        Poses and pushes put to a test, counted as the search counts them; the push from a node to the goal is tested once
        for all starts and depths.
    """

    feasible: BoolArray
    paths: tuple[RigidPath, ...]
    tests: int


def brute_force(
    problem: Problem,
    *,
    line_mm: float,
    step_mm: float,
    every: bool,
    known: Sequence[RigidPath] = (),
    only: BoolArray | None = None,
) -> BruteForce:
    """Try everything without roll.

    Parameters
    ----------
    problem : Problem
    line_mm : float
        Between lines, at the distance of the entry region.
    step_mm : float
        Between nodes on a line.
    every : bool
        Find all paths of the grid; otherwise a start is done with its first.
    known : sequence of RigidPath
        Paths of a coarser grid; their starts are done, unless every path is asked for.
    only : (n,) bool array, optional
        Starts to try; by default all.
    """
    # What a witness decides is counted all the same: it makes brute force faster, not cheaper in tests.
    judge = replace(problem.judge(), witnesses=Witnesses())
    starts, goal = problem.starts, problem.goal
    feasible, paths = np.zeros(len(starts), dtype=bool), list(known)
    feasible[[path.start for path in known]] = True
    tried = np.ones(len(starts), dtype=bool) if only is None else only
    label, _ = judge.push(starts, np.broadcast_to(goal, starts.shape), np.zeros(len(starts)))
    for row in np.flatnonzero((label < 0) & tried & ~feasible):
        feasible[row] = True
        paths.append(RigidPath(np.array([starts[row], goal]), 0.0, int(row)))
    lines, reach = fan(problem, line_mm)
    label, _ = judge.push(goal + reach * lines, np.broadcast_to(goal, lines.shape), np.zeros(len(lines)))
    depths = np.arange(step_mm, reach - LEAST_LEG_MM, step_mm)
    nodes = (goal + depths[:, None, None] * lines[label < 0][None]).reshape(-1, 3)
    nodes = np.random.default_rng(0).permutation(nodes)
    done, batch = 0, FIRST_BATCH
    while done < len(nodes):
        rows = np.flatnonzero(tried if every else tried & ~feasible)
        some = nodes[done : done + batch]
        who, first = np.repeat(rows, len(some)), np.tile(some, (len(rows), 1))
        label, _ = judge.push(starts[who], first, np.zeros(len(who)))
        who, first = who[label < 0], first[label < 0]
        for part in np.array_split(np.arange(len(who)), max(1, len(who) // TURNS)):
            live = part if every else part[~feasible[who[part]]]
            before, after = unit(first[live] - starts[who[live]]), unit(goal - first[live])
            for k in live[judge.turn(first[live], before, after, np.zeros(len(live)))]:
                if every or not feasible[who[k]]:
                    feasible[who[k]] = True
                    paths.append(RigidPath(np.array([starts[who[k]], first[k], goal]), 0.0, int(who[k])))
        done, batch = done + len(some), min(2 * batch, BATCH)
    return BruteForce(feasible, tuple(paths), judge.tests)


def fan(problem: Problem, line_mm: float) -> tuple[FloatArray, float]:
    """Unit vectors from the goal over the cone of the entry region, (k, 3), and the distance of the farthest start."""
    offset = problem.starts - problem.goal
    ahead = unit(offset.mean(axis=0))
    across = unit(np.cross(ahead, UP))
    axes = np.stack([across, np.cross(ahead, across)])
    away = float((offset @ ahead).mean())
    seen = offset @ axes.T * (away / (offset @ ahead))[:, None]
    low, high = np.floor(seen.min(axis=0) / line_mm) * line_mm, seen.max(axis=0) + line_mm
    grid = np.stack(np.meshgrid(*(np.arange(a, b, line_mm) for a, b in zip(low, high, strict=True))), axis=-1).reshape(-1, 2)
    return unit(away * ahead + grid @ axes), float(np.linalg.norm(offset, axis=1).max())
