"""One needle case in space: what may be chosen, and what a choice of it is worth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import CaseError
from tubeplan_viz.needle.kinematics import Arcs, Controls, Pose, bend_from, frame_of
from tubeplan_viz.needle.obstacles import Scene, danger
from tubeplan_viz.needle.skin import Skin


@dataclass(frozen=True, kw_only=True)
class NeedleSettings:
    """What the needle can do and what is asked of its path.

    Attributes
    ----------
    kappa : float, 1/mm
        Curvature of the needle in the tissue; 0.02 in Huo et al. (2015).
    safety : float, mm
        Least distance to any obstacle: a hard limit. The source's D, not printed.
    pieces : int
        Turns and pushes of the path.
    duty_cycle : bool
        Allow any curvature from 0 to kappa by spinning a part of the time; the source's needle always bends.
    entry_radius : float, mm
        The entry may be chosen within this distance of the one given, across its direction; on the skin, where the
        problem has one.
    cone : float, radian
        The direction may be chosen within this angle of the one given.
    piece_min : float, mm
        Least length of a piece.
    weight_danger : float, mm
        Length that one unit of danger is worth, as in eq. 14.
    """

    kappa: float = 0.02
    safety: float = 1.0
    pieces: int = 5
    duty_cycle: bool = False
    entry_radius: float = 0.0
    cone: float = 0.0
    piece_min: float = 0.5
    weight_danger: float = 0.2

    def __post_init__(self) -> None:
        if not 1e-4 <= self.kappa <= 10.0:
            raise CaseError(f"kappa is {self.kappa:g} 1/mm, expected 0.0001 to 10 (radius_mm is its reciprocal)")
        if not 0.0 <= self.safety <= 100.0:
            raise CaseError(f"safety_mm is {self.safety:g}, expected 0 to 100")
        if not 2 <= self.pieces <= 12:
            raise CaseError(f"pieces is {self.pieces}, expected 2 to 12")
        if not 0.0 <= self.entry_radius <= 500.0:
            raise CaseError(f"entry_radius_mm is {self.entry_radius:g}, expected 0 to 500")
        if not 0.0 <= self.cone <= np.pi / 2:
            raise CaseError(f"cone_deg is {np.degrees(self.cone):g}, expected 0 to 90")
        if not 1e-3 <= self.piece_min <= 50.0:
            raise CaseError(f"piece_min_mm is {self.piece_min:g}, expected 0.001 to 50")
        if not 0.0 <= self.weight_danger <= 1e6:
            raise CaseError(f"weight_danger is {self.weight_danger:g}, expected 0 to 1000000")


@dataclass(frozen=True, eq=False)
class SpatialProblem:
    """From which pose, to where, past what.

    Attributes
    ----------
    pose : Pose
        At the entry, or where the needle has come to.
    target : (3,) float array, mm
    scene : Scene
    settings : NeedleSettings
    skin : Skin or None
        Where the needle can go in; without one the plane through the pose, across its direction.
    under_way : bool
        The needle is in the tissue already: entry and direction are no longer free.
    """

    pose: Pose
    target: FloatArray
    scene: Scene
    settings: NeedleSettings
    skin: Skin | None = None
    under_way: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", frozen_array(self.target, (3,), "target"))
        if self.distance < 1e-3:
            raise CaseError("the needle's target is where its tip is; expected two places apart")

    def check_places(self) -> None:
        """Refuse an entry or a target nearer to an obstacle than the safety distance.

        Raises
        ------
        CaseError
            Naming the place, the obstacle and the distance.
        """
        for name, place in (("entry", self.pose.position), ("target", self.target)):
            if name == "entry" and self.settings.entry_radius > 0.0:
                continue
            for k, body in enumerate(self.scene.obstacles):
                gap = float(body.distance(place[None])[0])
                if gap < self.settings.safety:
                    raise CaseError(
                        f"the {name} ({place[0]:g}, {place[1]:g}, {place[2]:g}) mm is {gap:.2f} mm from obstacle {k + 1} "
                        f"({body.kind}), expected at least safety_mm = {self.settings.safety:g}"
                    )

    @property
    def distance(self) -> float:
        """From the tip to the target, mm."""
        return float(np.linalg.norm(self.target - self.pose.position))

    @cached_property
    def free(self) -> tuple[bool, bool, bool]:
        """Whether curvature, entry and direction are free."""
        s = self.settings
        return s.duty_cycle, s.entry_radius > 0.0 and not self.under_way, s.cone > 0.0 and not self.under_way

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest value of each unknown, (d,) each: turns, lengths, then curvatures, offsets and tilts if free."""
        s, n = self.settings, self.settings.pieces
        longest = min(1.5 * self.distance, np.pi / s.kappa)
        low, high = [-np.pi] * n + [s.piece_min] * n, [np.pi] * n + [max(longest, 2.0 * s.piece_min)] * n
        for able, limit, count, floor in zip(
            self.free, (s.kappa, s.entry_radius, s.cone), (n, 2, 2), (0.0, -s.entry_radius, -s.cone), strict=True
        ):
            low += [floor] * count * able
            high += [limit] * count * able
        return np.array(low), np.array(high)

    def split(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Turns, lengths and curvatures (..., n), then position, tangent and normal (..., 3), of unknowns (..., d)."""
        n, s = self.settings.pieces, self.settings
        turns, lengths, rest = x[..., :n], x[..., n : 2 * n], x[..., 2 * n :]
        curvatures = np.full(lengths.shape, s.kappa)
        position, frame = self.pose.position, self.pose.frame
        tangent, normal = frame[:, 2], -frame[:, 1]
        if self.free[0]:
            curvatures, rest = rest[..., :n], rest[..., n:]
        if self.free[1]:
            offset, rest = rest[..., :2], rest[..., 2:]
            size = np.linalg.norm(offset, axis=-1, keepdims=True)
            offset = offset * np.minimum(1.0, s.entry_radius / np.maximum(size, 1e-12))
            position = position + offset @ frame[:, :2].T
            if self.skin is not None:
                position = position + self.skin.depth(offset)[..., None] * frame[:, 2]
        if self.free[2]:
            size = np.linalg.norm(rest, axis=-1, keepdims=True)
            angle = np.minimum(size, s.cone)
            aside = (rest / np.maximum(size, 1e-12)) @ frame[:, :2].T
            base_t, base_n = tangent, normal
            tangent = np.cos(angle) * base_t + np.sin(angle) * aside
            normal = base_n - (base_n * tangent).sum(-1, keepdims=True) / (1.0 + (base_t * tangent).sum(-1, keepdims=True)) * (
                base_t + tangent
            )
        return turns, lengths, curvatures, position, tangent, normal

    def arcs(self, x: FloatArray) -> Arcs:
        """Pieces of the paths with unknowns (..., d)."""
        turns, lengths, curvatures, position, tangent, normal = self.split(x)
        return bend_from(position, tangent, normal, turns, lengths, curvatures)

    def controls(self, x: FloatArray) -> tuple[Pose, Controls]:
        """Pose at the entry and controls of one path, (d,); turns within half a turn to either side."""
        turns, lengths, curvatures, position, tangent, normal = self.split(x)
        turns = np.mod(turns + np.pi, 2.0 * np.pi) - np.pi
        return Pose(np.array(position), frame_of(np.array(tangent), np.array(normal))), Controls(turns, lengths, curvatures)


@dataclass(frozen=True, eq=False)
class Worth:
    """The goals of paths of a population (Huo 2015, eq. 4-13): `error` and `length` mm, `danger`, all (k,)."""

    error: FloatArray
    length: FloatArray
    danger: FloatArray


def worth(problem: SpatialProblem, x: FloatArray) -> Worth:
    """The three goals of paths with unknowns (k, d); danger is infinite within the safety distance."""
    arcs = problem.arcs(x)
    error = np.linalg.norm(arcs.tips - problem.target, axis=-1)
    risk = np.zeros(len(error))
    if len(problem.scene):
        risk = danger(problem.scene.piece_distances(arcs).min(axis=-2), problem.settings.safety)
    return Worth(error, arcs.lengths.sum(axis=-1), risk)


def bounded(problem: SpatialProblem, x: FloatArray) -> bool:
    """Whether the path keeps its distance at every point of it."""
    return not len(problem.scene) or bool(problem.scene.least_distance(problem.arcs(x)).min() >= problem.settings.safety)
