"""From a swarm's winner to a path that ends on the target: the shortest and safest one nearby.

# Strategy: sequential quadratic programming over the same unknowns, with the tip on the target as three equations
# and the distance of every piece to every obstacle as inequalities; all derivatives come from one vectorised
# evaluation of 2 d + 1 neighbours. Unknowns are scaled to steps of like effect on the tip. A few Gauss-Newton steps then
# close the tip to rounding.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from segmentation.arrays import FloatArray
from tubeplan_viz.needle.spatial import SpatialProblem

STEP = 1e-6
MARGIN = 1e-6  # mm kept beyond the safety distance, so that closing the tip does not break it
SAMPLED_MARGIN = 0.05  # the same where an obstacle has no closed formula and is sampled
MOST_GAPS = 80
TIGHTENED = 4  # times that the distance is raised where samples missed the nearest place
CLOSED = 1e-9  # mm
ASKED = 0.98  # of an allowed tip error: SLSQP ends a little beyond an inequality
COST, TIP, GAPS = slice(0, 1), slice(1, 4), slice(4, None)


class _Outputs:
    """Objective, tip and distances of a path with their derivatives, computed once per place; unknowns in units of `scale`."""

    def __init__(self, problem: SpatialProblem, safety: float) -> None:
        self.problem, self.safety = problem, safety
        self.scale = scales(problem)
        self.by_piece = len(problem.scene) * problem.settings.pieces <= MOST_GAPS
        self._key = b""
        self._value: FloatArray = np.empty(0)
        self._slope: FloatArray = np.empty(0)

    def rows(self, x: FloatArray) -> FloatArray:
        """(k, 1 + 3 + gaps): length and danger, tip less target, distances less the safety distance."""
        problem = self.problem
        arcs = problem.arcs(x)
        cost = arcs.lengths.sum(axis=-1)
        columns = [arcs.tips - problem.target]
        if len(problem.scene):
            gaps = problem.scene.piece_distances(arcs)
            near = gaps.min(axis=-2)
            floor = max(0.5 * problem.settings.safety, 1e-3)
            cost = cost + problem.settings.weight_danger * (problem.settings.safety / np.maximum(near, floor)).sum(axis=-1)
            columns.append((gaps.reshape(len(x), -1) if self.by_piece else near) - self.safety)
        return np.column_stack([cost, *columns])

    def value(self, y: FloatArray, part: slice) -> FloatArray:
        """A part of the values at scaled unknowns, as a copy: SLSQP writes into what it is given."""
        return self.at(y * self.scale)[0][part].copy()

    def slope(self, y: FloatArray, part: slice) -> FloatArray:
        """The same part's derivatives by scaled unknowns, as a copy in C order: SLSQP takes any array for one."""
        return np.ascontiguousarray(self.at(y * self.scale)[1][part] * self.scale)

    def at(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values (q,) and derivatives (q, d); not to be written to."""
        key = x.tobytes()
        if key != self._key:
            steps = STEP * np.eye(len(x))
            rows = self.rows(np.vstack([x, x + steps, x - steps]))
            self._key, self._value = key, rows[0]
            self._slope = ((rows[1 : 1 + len(x)] - rows[1 + len(x) :]) / (2.0 * STEP)).T
        return self._value, self._slope


def scales(problem: SpatialProblem) -> FloatArray:
    """Steps of the unknowns that move the tip about as far: 0.3 rad of turn, 5 mm of push and the like, (d,)."""
    n, s = problem.settings.pieces, problem.settings
    curvature, entry, tilt = problem.free
    return np.concatenate(
        [
            np.full(n, 0.3),
            np.full(n, 5.0),
            np.full(n * curvature, 0.3 * s.kappa),
            np.full(2 * entry, 5.0),
            np.full(2 * tilt, 0.05),
        ]
    )


def polish(problem: SpatialProblem, start: FloatArray, *, safety: float | None = None, error: float = 0.0) -> FloatArray | None:
    """The best path near `start` that reaches the target and keeps its distance, or None.

    Parameters
    ----------
    problem : SpatialProblem
    start : (d,) array
    safety : float, mm, optional
        Distance to keep, at least that of the settings (the default).
    error : float, mm
        How far from the target the tip may end; 0 closes it to rounding.

    Returns
    -------
    (d,) array or None
        Tip error at most 1e-9 mm (or `error`), no sampled distance under the safety distance.
    """
    margin = MARGIN if problem.scene.exact else SAMPLED_MARGIN
    keep = (problem.settings.safety if safety is None else safety) + margin
    outputs = _Outputs(problem, keep)
    low, high = problem.bounds
    low, high = low.copy(), high.copy()
    n = problem.settings.pieces
    low[:n], high[:n] = -np.inf, np.inf
    if error > 0.0:
        tip = {
            "type": "ineq",
            "fun": lambda y: np.array([(ASKED * error) ** 2 - (outputs.value(y, TIP) ** 2).sum()]),
            "jac": lambda y: -2.0 * (outputs.value(y, TIP) @ outputs.slope(y, TIP))[None],
        }
    else:
        tip = {"type": "eq", "fun": lambda y: outputs.value(y, TIP), "jac": lambda y: outputs.slope(y, TIP)}
    limits = [tip]
    if len(problem.scene):
        limits.append({"type": "ineq", "fun": lambda y: outputs.value(y, GAPS), "jac": lambda y: outputs.slope(y, GAPS)})
    found = minimize(
        lambda y: float(outputs.value(y, COST)[0]),
        np.clip(start, low, high) / outputs.scale,
        jac=lambda y: outputs.slope(y, COST)[0],
        bounds=list(zip(low / outputs.scale, high / outputs.scale, strict=True)),
        constraints=limits,
        method="SLSQP",
        options={"maxiter": 20, "ftol": 1e-4},
    )
    x = np.clip(found.x * outputs.scale, low, high)
    if not np.isfinite(x).all():
        return None
    if error == 0.0:
        closed = close_tip(problem, outputs, x, low, high)
        if closed is None:
            return None
        x = closed
    values = outputs.rows(x[None])[0]
    slack = 0.9 * margin
    if len(problem.scene) and values[4:].min() < -slack:
        return None
    return x if np.linalg.norm(values[1:4]) <= max(error, CLOSED) * (1.0 + 1e-6) else None


def polish_clear(problem: SpatialProblem, start: FloatArray) -> FloatArray | None:
    """The best path near `start` that keeps its distance at every point of it, not at samples alone; None without one.

    Where the samples of a body without a formula missed its nearest place, the polish goes on with that much more distance.
    """
    safety = problem.settings.safety
    more = 0.0
    for _ in range(TIGHTENED):
        made = polish(problem, start, safety=safety + more)
        if made is None or not len(problem.scene):
            return made
        short = safety - float(problem.scene.least_distance(problem.arcs(made)).min())
        if short <= 0.0:
            return made
        more, start = more + short + MARGIN, made
    return None


def closed(problem: SpatialProblem, x: FloatArray) -> FloatArray | None:
    """The nearest unknowns whose tip is the target to rounding, whatever they come near to; None if there are none."""
    low, high = problem.bounds
    low, high = low.copy(), high.copy()
    n = problem.settings.pieces
    low[:n], high[:n] = -np.inf, np.inf
    return close_tip(problem, _Outputs(problem, 0.0), np.clip(x, low, high), low, high)


def close_tip(problem: SpatialProblem, outputs: _Outputs, x: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray | None:
    """The nearest unknowns whose tip is the target to rounding, or None: Gauss-Newton, least steps within the bounds."""
    for _ in range(25):
        values, slopes = outputs.at(x)
        if np.linalg.norm(values[1:4]) <= CLOSED:
            return x
        able = ((x > low) | (slopes[1:4].T @ values[1:4] < 0)) & ((x < high) | (slopes[1:4].T @ values[1:4] > 0))
        step = np.zeros(len(x))
        step[able] = np.linalg.lstsq(slopes[1:4][:, able], -values[1:4], rcond=None)[0]
        x = np.clip(x + step, low, high)
    return None
