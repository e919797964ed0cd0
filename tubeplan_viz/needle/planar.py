"""Planar paths of lines and arcs: every form up to four pieces, each at its global optimum.

Source: Zhao et al. (2013), China Mechanical Engineering 24(1), tables 1-2; it solves each form locally to 0.1 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.needle.kinematics import Controls, Pose, planar_pose, push
from tubeplan_viz.needle.obstacles import danger
from tubeplan_viz.needle.planar_search import (
    ROUNDS,
    SCOUT_ROUNDS,
    cheapest,
    gathered,
    grid,
    joined,
    promising,
    refine,
    sharpened,
    spacing,
)
from tubeplan_viz.needle.planar_shapes import FORMS, PlanarProblem, PlanarSettings, Shapes, close, sides_of, turns_of, weigh

__all__ = ["FORMS", "PlanarPath", "PlanarProblem", "PlanarSettings", "best", "plan_planar"]

SHARPENED = {1: 0, 2: 0, 3: 0, 4: 1}  # shapes of each form that get the smooth finish, by control degree


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanarPath:
    """The best path of one form, or why there is none.

    Attributes
    ----------
    form : str
        Pieces in order, L (line) or R (arc).
    sides : tuple of int
        Of each piece: 0 for a line, 1 for an arc as inserted, -1 for one with the bevel turned by 180 degrees.
    pose : Pose or None
        At the entry, turned by `angle`.
    controls : Controls or None
    angle : float, radian
        Insertion angle about x.
    clearances : (m,) float array, mm
        Lower bound of the distance to each obstacle, along the whole path.
    score : float
        F of the source.
    reason : str or None
        Why there is no path.
    tried : int
        Paths of this form that reach the target and were weighed.
    """

    form: str
    sides: tuple[int, ...] = ()
    pose: Pose | None = None
    controls: Controls | None = None
    angle: float = 0.0
    clearances: FloatArray | None = None
    danger: float = 0.0
    score: float = np.inf
    tip_error: float = 0.0
    reason: str | None = None
    tried: int = 0

    @property
    def degree(self) -> int:
        """Number of pieces."""
        return len(self.form)

    @property
    def feasible(self) -> bool:
        """Whether there is a path."""
        return self.controls is not None

    @property
    def length(self) -> float:
        """Length, mm; infinite without a path."""
        return self.controls.length if self.controls is not None else np.inf


def plan_planar(
    problem: PlanarProblem, *, rng: np.random.Generator | None = None, progress: Callable[[int, int], None] | None = None
) -> tuple[PlanarPath, ...]:
    """The best path of every form, in the order of `FORMS`.

    Parameters
    ----------
    problem : PlanarProblem
    rng : Generator, optional
        For the refinement; a fixed one by default.
    progress : callable, optional
        Told how many of how many control degrees are done.
    """
    rng = rng or np.random.default_rng(0)
    degrees = range(1, problem.settings.degree_max + 1)
    found: list[PlanarPath] = []
    for degree in degrees:
        found.extend(best_of_degree(problem, degree, rng))
        if progress is not None:
            progress(degree, len(degrees))
    return tuple(found)


def best(paths: tuple[PlanarPath, ...], degree: int | None = None) -> PlanarPath | None:
    """The path of least F, of one degree or of all; None if none is feasible."""
    able = [path for path in paths if path.feasible and degree in (None, path.degree)]
    return min(able, key=lambda path: (path.score, path.degree, path.form)) if able else None


def best_of_degree(problem: PlanarProblem, degree: int, rng: np.random.Generator) -> list[PlanarPath]:
    """The best path of each form of one control degree."""
    cases = [(form, np.array(sides, dtype=float)) for form in FORMS[degree] for sides in sides_of(form)]
    starts: list[tuple[int, Shapes]] = []
    scouts: list[tuple[int, Shapes]] = []
    tried = dict.fromkeys(FORMS[degree], 0)
    for index, (form, sides) in enumerate(cases):
        free = np.zeros((1, 0)) if degree == 1 else grid(problem, sides[:-1])
        shapes = close(problem, free, sides)
        shapes = shapes.take(np.flatnonzero(np.isfinite(shapes.costs)))
        tried[form] += len(shapes.costs)
        for found, group in zip(cheapest(problem, shapes, degree), (starts, scouts), strict=True):
            group.append((index, found))
    pool, owner = gathered(problem, starts)
    if degree == 1:
        costs, spare = weigh(problem, pool)
    else:
        ahead, scout_owner = gathered(problem, scouts)
        ahead, *_ = refine(problem, ahead, rng, rounds=SCOUT_ROUNDS, step=0.5 * spacing(problem, degree))
        pool, owner = joined(pool, ahead), np.concatenate([owner, scout_owner])
        pool, owner = promising(problem, pool, owner)
        pool, costs, spare = refine(problem, pool, rng, rounds=ROUNDS[degree], step=0.06 * problem.distance)
    result = []
    for form in FORMS[degree]:
        mine = [row for row, k in enumerate(owner) if cases[k][0] == form]
        if not mine:
            result.append(PlanarPath(form=form, reason=unreachable(problem, form), tried=0))
            continue
        ranked = sorted(mine, key=lambda k: (costs[k], -spare[k]))
        able = [pool.take(np.array([row])) for row in ranked[: SHARPENED[degree]] if np.isfinite(costs[row])]
        made = [pool.take(np.array([ranked[0]])), *(sharpened(problem, shape) for shape in able)]
        made.sort(key=lambda shape: float(weigh(problem, shape)[0][0]))
        result.append(finished(problem, form, made[0], tried[form]))
    return result


def unreachable(problem: PlanarProblem, form: str) -> str:
    """Why no path of a form ends at the target."""
    s = problem.settings
    if form == "R" and problem.distance > 2.0 * s.radius:
        return f"the target is {problem.distance:.1f} mm away, more than the diameter {2 * s.radius:g} mm of the arc"
    limits = f"insertion angle up to {np.degrees(s.angle_max):.0f} degrees, pieces of at least {s.piece_min:g} mm"
    return f"no path of this form ends at the target with an {limits} and arcs up to {np.degrees(s.turn_max):.0f} degrees"


def finished(problem: PlanarProblem, form: str, shape: Shapes, tried: int) -> PlanarPath:
    """One shape as a path with its own measures, or with the reason why it is none."""
    s = problem.settings
    sides, lengths = shape.sides.reshape(-1), shape.lengths[0]
    pose = planar_pose(problem.entry, float(shape.angles[0]))
    controls = Controls(turns_of(sides), lengths, np.abs(sides) / s.radius)
    arcs = push(pose, controls)
    gaps = problem.scene.least_distance(arcs)
    if len(gaps) and gaps.min() < s.safety - 1e-9:
        worst = int(gaps.argmin())
        return PlanarPath(
            form=form,
            tried=tried,
            reason=f"every path of this form that ends at the target ({tried} tried) comes nearer than {s.safety:g} mm to an "
            f"obstacle; the best comes to {gaps[worst]:.2f} mm from obstacle {worst + 1} ({problem.scene.obstacles[worst].kind})",
        )
    risk = float(danger(gaps, s.safety)) if len(gaps) else 0.0
    risk = risk if np.isfinite(risk) else float(danger(np.maximum(gaps, s.safety), s.safety))
    return PlanarPath(
        form=form,
        sides=tuple(int(side) for side in sides),
        pose=pose,
        controls=controls,
        angle=float(shape.angles[0]),
        clearances=gaps,
        danger=risk,
        score=s.weight_length * controls.length + s.weight_danger * risk + s.weight_degree * len(form),
        tip_error=float(np.linalg.norm(arcs.tips - np.array([0.0, *problem.target]))),
        tried=tried,
    )
