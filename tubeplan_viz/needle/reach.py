"""What no path of a needle reaches, whatever it passes: places beside its tip and behind it.

# Strategy: let a curve of curvature at most kappa and length s <= pi / kappa start along a direction and end at a place P, the
# chord at an angle b to that direction. Its tangent turns by at most kappa mm for mm. So across the chord it goes on by at least
# the integral of sin(b - kappa t), which is above 0 until s = 2 b / kappa: the curve is at least that long. And along its own
# tangent half way it goes on by at least 2 / kappa sin(kappa s / 2) (Schur's chord theorem), no less than 2 / kappa sin(b) then.
# With |P| under that, or b beyond a right angle, there is no such curve: P would take a single arc of more than kappa.
"""

from __future__ import annotations

import numpy as np

from tubeplan_viz.needle.spatial import SpatialProblem

ROUNDING = 1e-9


def unreachable(problem: SpatialProblem) -> str | None:
    """Why no path of a problem can end on its target, one sentence; None where that is not certain.

    Certain are only paths that cannot be longer than half a circle of the needle, from a pose that is not free.
    """
    s, n = problem.settings, problem.settings.pieces
    if problem.free[1] or problem.free[2] or n * float(problem.bounds[1][n]) > np.pi / s.kappa:
        return None
    way = problem.target - problem.pose.position
    ahead = float(way @ problem.pose.tangent)
    aside = float(np.linalg.norm(way - ahead * problem.pose.tangent))
    if ahead < 0.0:
        return f"no path exists: the target lies {-ahead:.1f} mm behind the tip, {aside:.1f} mm aside"
    needed = 2.0 * aside / problem.distance**2
    if needed <= s.kappa * (1.0 + ROUNDING):
        return None
    return (
        f"no path exists: the target lies {ahead:.1f} mm ahead of the tip and {aside:.1f} mm aside, where the straightest way "
        f"bends with a radius of {1.0 / needed:.1f} mm; the needle bends with {1.0 / s.kappa:.1f} mm"
    )
