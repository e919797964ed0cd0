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
from tubeplan_viz.needle.planar_bodies import FlatScene
from tubeplan_viz.needle.planar_finish import Candidate
from tubeplan_viz.needle.planar_motion import posed
from tubeplan_viz.needle.planar_search import Found, search_form
from tubeplan_viz.needle.planar_shapes import FORMS, PlanarProblem, PlanarSettings, turns_of

__all__ = ["FORMS", "PlanarPath", "PlanarProblem", "PlanarSettings", "best", "plan_planar"]


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
        Cells of piece lengths searched.
    bound : float
        No path of this form has a smaller F; infinite where it is certain that there is none.
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
    bound: float = 0.0

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


def plan_planar(problem: PlanarProblem, *, progress: Callable[[int, int], None] | None = None) -> tuple[PlanarPath, ...]:
    """The best path of every form, in the order of `FORMS`.

    Parameters
    ----------
    problem : PlanarProblem
    progress : callable, optional
        Told how many of how many control degrees are done.

    Raises
    ------
    CaseError
        If an obstacle is neither a circle nor a polygon of the plane.
    """
    scene = FlatScene(problem)
    degrees = range(1, problem.settings.degree_max + 1)
    paths: list[PlanarPath] = []
    simpler: tuple[Candidate, ...] = ()
    for degree in degrees:
        found = [search_form(problem, scene, form, simpler) for form in FORMS[degree]]
        simpler = tuple(one.best for one in found if one.best is not None)
        paths.extend(finished(problem, form, one) for form, one in zip(FORMS[degree], found, strict=True))
        if progress is not None:
            progress(degree, len(degrees))
    return tuple(paths)


def best(paths: tuple[PlanarPath, ...], degree: int | None = None) -> PlanarPath | None:
    """The path of least F, of one degree or of all; None if none is feasible."""
    able = [path for path in paths if path.feasible and degree in (None, path.degree)]
    return min(able, key=lambda path: (path.score, path.degree, path.form)) if able else None


def unreachable(problem: PlanarProblem, form: str) -> str:
    """Why no path of a form ends at the target."""
    s = problem.settings
    if form == "R" and problem.distance > 2.0 * s.radius:
        return f"the target is {problem.distance:.1f} mm away, more than the diameter {2 * s.radius:g} mm of the arc"
    limits = f"insertion angle up to {np.degrees(s.angle_max):.0f} degrees, pieces of at least {s.piece_min:g} mm"
    return f"no path of this form ends at the target with an {limits} and arcs up to {np.degrees(s.turn_max):.0f} degrees"


def finished(problem: PlanarProblem, form: str, found: Found) -> PlanarPath:
    """What was found of one form as a path with its own measures, or with the reason why there is none."""
    s = problem.settings
    bound = found.bound + s.weight_degree * len(form)
    shown = found.best or found.nearest
    if shown is None:
        return PlanarPath(form=form, reason=unreachable(problem, form), tried=found.weighed, bound=bound)
    whole = posed(problem, shown.free[None], shown.sides[None], np.array([shown.root]))
    lengths, angle = whole.lengths[0], float(whole.angle[0])
    pose = planar_pose(problem.entry, angle)
    controls = Controls(turns_of(shown.sides), lengths, np.abs(shown.sides) / s.radius)
    arcs = push(pose, controls)
    gaps = problem.scene.least_distance(arcs)
    if found.best is None:
        return PlanarPath(form=form, reason=blocked(problem, form, found, gaps), tried=found.weighed, bound=bound)
    risk = float(danger(np.maximum(gaps, s.safety), s.safety)) if len(gaps) else 0.0
    return PlanarPath(
        form=form,
        sides=tuple(int(side) for side in shown.sides),
        pose=pose,
        controls=controls,
        angle=angle,
        clearances=gaps,
        danger=risk,
        score=s.weight_length * controls.length + s.weight_danger * risk + s.weight_degree * len(form),
        tip_error=float(np.linalg.norm(arcs.tips - np.array([0.0, *problem.target]))),
        tried=found.weighed,
        bound=bound,
    )


def blocked(problem: PlanarProblem, form: str, found: Found, gaps: FloatArray) -> str:
    """Why no path of a form that ends at the target is clear; `gaps` are those of the one that lacks least."""
    if not len(gaps) or gaps.min() >= problem.settings.safety:
        return unreachable(problem, form)
    worst = int(gaps.argmin())
    said = "every path" if np.isinf(found.bound) else f"every path found ({found.weighed} cells of lengths searched)"
    return (
        f"{said} of this form that ends at the target comes nearer than {problem.settings.safety:g} mm to an obstacle; the best "
        f"comes to {gaps[worst]:.2f} mm from obstacle {worst + 1} ({problem.scene.obstacles[worst].kind})"
    )
