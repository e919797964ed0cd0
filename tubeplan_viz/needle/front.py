"""The Pareto front of tip error, length and danger."""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.needle.path import SwarmRound, Tradeoff
from tubeplan_viz.needle.polish import polish
from tubeplan_viz.needle.spatial import SpatialProblem, worth
from tubeplan_viz.needle.zigzag import best_starts

TIGHTER = (0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0)  # mm of distance beyond the safety distance
OTHERS = 2  # ways besides the best one and the swarm's
LOOSER = (0.5, 2.0)  # mm of tip error
FRONT_SHOWN = 40


def pareto_front(problem: SpatialProblem, best: FloatArray, rounds: list[SwarmRound]) -> tuple[Tradeoff, ...]:
    """Paths that are not worse than another in error, length and danger at once.

    Polished ones at larger distances and at allowed tip errors, and the swarm's own populations.
    """
    safety = problem.settings.safety
    exact = [(best, safety)]
    others = [rounds[-1].best, *best_starts(problem, OTHERS)]
    for more in TIGHTER if len(problem.scene) else ():
        made = [x for start in (exact[-1][0], *others) if (x := polish(problem, start, safety=safety + more)) is not None]
        exact += [(x, safety + more) for x in made]
    loose = [polish(problem, x, safety=keep, error=error) for x, keep in exact for error in LOOSER]
    polished = [x for x, _ in exact] + [x for x in loose if x is not None]
    clouds = [state.cloud for state in rounds if state.cloud is not None]
    leads = [state.best[None] for state in rounds[:: max(1, len(rounds) // 200)]]
    pool = np.vstack([np.array(polished), *clouds[-30:], *leads])
    found = worth(problem, pool)
    goals = np.column_stack([np.where(found.error < 1e-6, 0.0, found.error), found.length, found.danger])
    near = np.flatnonzero(np.isfinite(goals).all(axis=1) & (goals[:, 0] <= 5.0))
    front = near[undominated(goals[near])]
    front = front[np.argsort(goals[front] @ [1e3, 1.0, 0.0], kind="stable")][:FRONT_SHOWN]
    made_front = []
    for row in front:
        pose, controls = problem.controls(pool[row])
        gaps = problem.scene.piece_distances(problem.arcs(pool[row]))
        least = float(gaps.min()) if gaps.size else np.inf
        made_front.append(Tradeoff(pose, controls, float(goals[row, 0]), float(goals[row, 1]), float(goals[row, 2]), least))
    return tuple(made_front)


def undominated(goals: FloatArray) -> IntArray:
    """Rows of (k, 3) goals that no other row beats in one and equals or beats in all: their numbers."""
    order = np.lexsort(goals.T[::-1])
    kept: list[int] = []
    for row in order:
        if not any((goals[other] <= goals[row]).all() for other in kept):
            kept.append(int(row))
    return np.array(kept, dtype=int)
