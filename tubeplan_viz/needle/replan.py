"""The rest of a path planned anew from where the needle has come to.

# Strategy: the present controls mended are the least change. Where the scene has changed, short paths of other
# shapes are tried too, and a short swarm comes last.

Source: Huo et al. (2015), Robot 37(4), section 4.2, which replans from the pose reached.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.needle.kinematics import Controls, Pose, push
from tubeplan_viz.needle.polish import polish_clear
from tubeplan_viz.needle.reach import unreachable
from tubeplan_viz.needle.spatial import SpatialProblem
from tubeplan_viz.needle.swarm import SwarmSettings, cost_of, plan_spatial
from tubeplan_viz.needle.zigzag import best_starts

LAST_MM = 3.0  # nothing is mended over the last stretch: a needle of usual curvature cannot be moved aside there


def first_part(rest: Controls, ahead: float) -> Controls:
    """The first `ahead` mm of controls."""
    ends = np.cumsum(rest.lengths)
    count = min(int(np.searchsorted(ends, ahead - 1e-12)) + 1, len(rest))
    lengths = rest.lengths[:count].copy()
    lengths[-1] -= max(ends[count - 1] - ahead, 0.0)
    return Controls(rest.turns[:count], lengths, rest.curvatures[:count])


def bent(controls: Controls, ratio: float) -> Controls:
    """Controls with curvatures as the tissue gives them."""
    return Controls(controls.turns, controls.lengths, controls.curvatures * ratio)


def misses(problem: SpatialProblem, here: Pose, rest: Controls, ratio: float) -> float:
    """By how much the rest would miss the target, mm."""
    return float(np.linalg.norm(push(here, bent(rest, ratio)).tips - problem.target))


def still_fine(problem: SpatialProblem, here: Pose, rest: Controls, ratio: float) -> bool:
    """Whether the rest keeps its distance, wherever it ends."""
    if not len(problem.scene):
        return True
    return bool(problem.scene.least_distance(push(here, bent(rest, ratio))).min() >= problem.settings.safety)


def renewed(problem: SpatialProblem, here: Pose, rest: Controls, ratio: float, *, changed: bool) -> Controls | None:
    """The rest mended, or planned anew, in controls of the model; None if there is no path.

    The needle that is planned for is the one believed in: curvature times `ratio`. `changed` says that an obstacle or the
    target has moved.
    """
    settings = replace(problem.settings, kappa=problem.settings.kappa * ratio)
    left = replace(problem, pose=here, settings=settings, under_way=True)
    if left.distance < LAST_MM or unreachable(left) is not None:
        return None
    # The present controls mended are the least change; where the scene has changed, other ways may be shorter now.
    x = mended(left, [padded(left, bent(rest, ratio)), *(best_starts(left, 1) if changed else [])])
    if x is None:
        x = mended(left, best_starts(left, 3))
    if x is not None:
        controls = left.controls(x)[1]
    else:
        found = plan_spatial(left, SwarmSettings(restarts=2, rounds=300), rng=np.random.default_rng(0), front=False)
        if found.controls is None:
            return None
        controls = found.controls
    return Controls(controls.turns, controls.lengths, np.minimum(controls.curvatures / ratio, problem.settings.kappa))


def mended(problem: SpatialProblem, starts: list[FloatArray]) -> FloatArray | None:
    """The cheapest path that the polish makes of some starts and that keeps its distance everywhere, or None."""
    made = [x for start in starts if (x := polish_clear(problem, start)) is not None]
    return min(made, key=lambda row: cost_of(problem, row)) if made else None


def padded(problem: SpatialProblem, rest: Controls) -> FloatArray:
    """Unknowns of the rest: its last pieces, the longest split until there are as many as asked."""
    turns, lengths, curvatures = (list(v) for v in (rest.turns, rest.lengths, rest.curvatures))
    n = problem.settings.pieces
    while len(lengths) > n:
        k = int(np.argmin(lengths[:-1])) if len(lengths) > 1 else 0
        lengths[k + 1] += lengths.pop(k)
        turns[k + 1] += turns.pop(k)
        curvatures.pop(k)
    while len(lengths) < n:
        k = int(np.argmax(lengths))
        lengths[k] *= 0.5
        lengths.insert(k, lengths[k])
        turns.insert(k + 1, 0.0)
        curvatures.insert(k, curvatures[k])
    low, high = problem.bounds
    x = np.array(turns + lengths + (curvatures if problem.free[0] else []))
    x[:n] = np.mod(x[:n] + np.pi, 2.0 * np.pi) - np.pi
    return np.clip(x, low, high)
