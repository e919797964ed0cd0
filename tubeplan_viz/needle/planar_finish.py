"""One planar path brought to the least cost near it, by sequential quadratic programming with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from segmentation.arrays import FloatArray
from tubeplan_viz.needle.planar_bodies import FlatScene
from tubeplan_viz.needle.planar_motion import Posed, along, contacts, last_is_line, motions, posed
from tubeplan_viz.needle.planar_shapes import PlanarProblem

STEPS = 15  # rounds of the quadratic programming; five to ten are usual
EXACT = 1e-8  # mm, of its end
EDGE = 1e-9  # mm kept beyond a limit, so that rounding does not break it
RETURNS = 6  # steps back into the limits that it leaves by `EXACT`


@dataclass(frozen=True, eq=False)
class Candidate:
    """One path of a form: free lengths (n - 1,) mm, bend sides (n,), root 1 or -1, and cost, infinite if it breaks a limit."""

    free: FloatArray
    sides: FloatArray
    root: float
    cost: float = np.inf


@dataclass(frozen=True, eq=False)
class Valued:
    """Cost of one path and its room under each limit (j,), with derivatives by the free lengths, (n - 1,) and (j, n - 1)."""

    cost: float
    slope: FloatArray
    rooms: FloatArray
    room_slopes: FloatArray
    exists: bool


def valued(problem: PlanarProblem, scene: FlatScene, free: FloatArray, start: Candidate) -> Valued:
    """Cost and limits of one path, with derivatives."""
    s = problem.settings
    path = posed(problem, free[None], start.sides[None], np.array([start.root]))
    cost, slope = s.weight_length * path.lengths.sum(), s.weight_length * (1.0 + path.lengthening[0])
    rooms, slopes = own_limits(problem, path)
    if len(scene):
        near = contacts(scene, path)
        order = np.arange(near.gap.size).reshape(1, -1) // len(scene)
        gaps, by_length = near.gap[0], along(motions(path, near, order), near.normal)[0]
        if s.weight_danger > 0.0 and s.safety > 0.0:
            nearest = gaps.reshape(-1, len(scene)).argmin(axis=0) * len(scene) + np.arange(len(scene))
            least = np.maximum(gaps[nearest], s.safety)
            cost += s.weight_danger * (s.safety / least).sum()
            slope = slope - s.weight_danger * (s.safety / least**2) @ by_length[nearest]
        rooms = np.concatenate([rooms, gaps - s.safety - EDGE])
        slopes = np.vstack([slopes, by_length])
    # In C order: SLSQP reads a transposed array as if it were not.
    return Valued(float(cost), slope, rooms, np.ascontiguousarray(slopes), bool(path.room[0] >= 0.0))


def own_limits(problem: PlanarProblem, path: Posed) -> tuple[FloatArray, FloatArray]:
    """Room of one path's last piece (mm) and insertion angle (radian) under their limits, (j,), and derivatives, (j, n - 1)."""
    s = problem.settings
    final, angle = path.lengths[0, -1], path.angle[0]
    longer, turning = path.lengthening[0], path.turning[0]
    rooms, slopes = [final - s.piece_min, s.angle_max - angle, s.angle_max + angle], [longer, -turning, turning]
    if not last_is_line(path.curvatures):
        rooms.append(s.turn_max * s.radius - final)
        slopes.append(-longer)
    return np.array(rooms) - EDGE, np.vstack(slopes)


def polished(problem: PlanarProblem, scene: FlatScene, start: Candidate) -> Candidate:
    """The path of least cost near one; its cost is infinite if none was found that keeps all limits."""
    s = problem.settings
    lowest = np.full(len(start.free), s.piece_min)
    highest = np.where(start.sides[:-1] == 0.0, np.inf, s.turn_max * s.radius)
    last: dict[bytes, Valued] = {}

    def at(free: FloatArray) -> Valued:
        key = free.tobytes()
        if key not in last:
            last.clear()
            last[key] = valued(problem, scene, free, start)
        return last[key]

    found = minimize(
        lambda x: at(x).cost,
        start.free,
        jac=lambda x: at(x).slope,
        bounds=[(low, high if np.isfinite(high) else None) for low, high in zip(lowest, highest, strict=True)],
        constraints=[{"type": "ineq", "fun": lambda x: at(x).rooms, "jac": lambda x: at(x).room_slopes}],
        method="SLSQP",
        options={"maxiter": STEPS, "ftol": EXACT},
    )
    if not np.isfinite(found.x).all():
        return start
    free = np.clip(found.x, lowest, highest)
    for _ in range(RETURNS):
        here = at(free)
        short = here.rooms < 0.0
        if not here.exists or not short.any():
            break
        step = np.linalg.lstsq(here.room_slopes[short], 0.1 * EDGE - here.rooms[short], rcond=None)[0]
        free = np.clip(free + step, lowest, highest)
    here = at(free)
    kept = here.exists and bool((here.rooms >= -0.9 * EDGE).all())
    return Candidate(free, start.sides, start.root, here.cost if kept else np.inf)
