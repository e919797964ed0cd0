"""What changes while a needle is pushed: an obstacle or the target moves, or the curvature is not that of the model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.bodies import Capsule, Obstacle, Sphere
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.spatial import SpatialProblem


@dataclass(frozen=True, eq=False, kw_only=True)
class Event:
    """Something that changes when the needle has been pushed `at` mm: one of the others is given.

    Attributes
    ----------
    at : float, mm
    obstacle, place : int and (3,) array, mm
        The obstacle, counted from 0, whose centre (first point) moves to `place`.
    target : (3,) array, mm
    kappa : float, 1/mm
        The true curvature of the needle that does not spin, from here on.
    """

    at: float
    obstacle: int | None = None
    place: FloatArray | None = None
    target: FloatArray | None = None
    kappa: float | None = None

    def __post_init__(self) -> None:
        told = [self.obstacle is not None and self.place is not None, self.target is not None, self.kappa is not None]
        if sum(told) != 1:
            raise CaseError("an event needs at_mm and exactly one of: obstacle with center, target, kappa")
        if not self.at >= 0.0:
            raise CaseError(f"an event is at_mm {self.at:g}, expected 0 or more")
        if self.kappa is not None and not 0.0 < self.kappa <= 10.0:
            raise CaseError(f"an event has kappa {self.kappa:g} 1/mm, expected more than 0 and at most 10")

    @property
    def cause(self) -> str:
        """In words."""
        if self.obstacle is not None:
            return f"obstacle {self.obstacle + 1} has moved"
        return "the target has moved" if self.target is not None else "the curvature is not that of the model"


def moved(scene: Scene, index: int, place: FloatArray) -> Scene:
    """The scene with one obstacle moved: its centre, or first point, to `place`.

    Raises
    ------
    CaseError
        If there is no such obstacle, or it is a mesh, polygon or mask.
    """
    if not 0 <= index < len(scene):
        raise CaseError(f"an event moves obstacle {index + 1}, the case has {len(scene)}")
    body = scene.obstacles[index]
    new: Obstacle
    if isinstance(body, Sphere):
        new = replace(body, center=np.asarray(place, dtype=float))
    elif isinstance(body, Capsule):
        new = replace(body, points=body.points + (np.asarray(place, dtype=float) - body.points[0]))
    else:
        raise CaseError(f"an event moves obstacle {index + 1}, a {body.kind}; only spheres and capsules can move")
    bodies = [new if k == index else other for k, other in enumerate(scene.obstacles)]
    return Scene(tuple(bodies), spacing=scene.spacing)


def applied(problem: SpatialProblem, event: Event) -> SpatialProblem:
    """The problem after an event that moves an obstacle or the target."""
    if event.target is not None:
        return replace(problem, target=np.asarray(event.target, dtype=float))
    assert event.obstacle is not None
    assert event.place is not None
    return replace(problem, scene=moved(problem.scene, event.obstacle, event.place))
