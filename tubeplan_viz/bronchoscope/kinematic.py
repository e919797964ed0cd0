"""A mover without forces: the base goes on along the proximal section's bend, the passive section lies where the base went."""

# Strategy: while the shaft is pushed, the proximal section's base follows the section's own curve, as the text's
# figure 1 has it ("the whole follows the front"). So the passive section lies on the base's trail, a chain
# of arcs no sharper than the proximal section's bends. What is assumed: the wall, wherever it must, holds the
# passive section on that trail; which forces that takes is not computed, so a plan counts as free only if no part of the
# robot, trail included, meets the wall at all.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.bronchoscope.kinematics import arc_points, section_transform
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.geometry import WallDistance

# Places on the front disc's rim. Between two of them the rim bulges by r (1 - cos(pi / 16)), 0.03 mm.
RIM = 16
SPACING = 1.0
BEND_STEP = 0.12  # rad of bend between two places of a move that are looked at
FIRST_MEASURED, NEXT_MEASURED = 13, 24
FAR = 1.0  # mm from the robot's surface; clearances above it need no more than a lower bound
NO_FORCE = np.zeros(0)
NO_CONTACT = np.zeros((0, 3))


@dataclass(frozen=True, eq=False, kw_only=True)
class Shaft:
    """State of the kinematic robot.

    Attributes
    ----------
    arcs : tuple of (length mm, phi rad, theta rad)
        The base's trail from the entrance, each arc in the frame where the one before ended.
    bends : (2, 2) float array, rad
        Bend vectors ``phi [cos(theta), sin(theta)]`` of the proximal and the distal section.
    """

    arcs: tuple[tuple[float, float, float], ...]
    bends: FloatArray


def bend_vectors(command: Command) -> FloatArray:
    """Bend vectors of a command, (2, 2) rad; they change continuously where phi passes 0 and theta turns over."""
    phi = np.array([command.phi_proximal, command.phi_distal])
    theta = np.array([command.theta_proximal, command.theta_distal])
    return np.column_stack([phi * np.cos(theta), phi * np.sin(theta)])


def polar(bend: FloatArray) -> tuple[float, float]:
    """Phi and theta of a bend vector, rad."""
    return float(np.hypot(bend[0], bend[1])), float(np.arctan2(bend[1], bend[0]))


def active_points(robot: Robot, base: FloatArray, bends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places on the active sections' axis from the base to the tip at most 1 mm apart, (m, 3) mm, and the tip's pose."""
    parts, pose = [base[None, :3, 3]], base
    for length, bend in zip((robot.proximal_length, robot.distal_length), bends, strict=True):
        phi, theta = polar(bend)
        count = int(np.ceil(length / SPACING))
        local = arc_points(length, phi, theta, np.arange(1, count + 1) / count)
        parts.append(pose[:3, 3] + local @ pose[:3, :3].T)
        pose = pose @ section_transform(length, phi, theta)
    return np.concatenate(parts), pose


def rim_points(robot: Robot, tip: FloatArray) -> FloatArray:
    """Places on the rim of the front disc, (16, 3) mm."""
    turn = 2.0 * np.pi * np.arange(RIM) / RIM
    return np.asarray(tip[:3, 3] + robot.radius * (np.cos(turn)[:, None] * tip[:3, 0] + np.sin(turn)[:, None] * tip[:3, 1]))


class KinematicMover:
    """Moves the robot by kinematics alone; the bends change evenly along the push.

    Clearances of its steps are exact where they are small and lower bounds from `far` on.

    Parameters
    ----------
    wall : WallDistance
    robot : Robot
    entrance : (4, 4) float array
        Pose in the middle of the trachea's upper end, third column into the lumen.
    far : float, mm
        Clearances of the robot's surface from here on are lower bounds.
    """

    def __init__(self, wall: WallDistance, robot: Robot, entrance: FloatArray, *, far: float = FAR) -> None:
        self._wall, self._robot, self._entrance, self._far = wall, robot, entrance, robot.radius + far

    def start(self) -> Step:
        """The robot straight, its proximal section's base at the entrance."""
        shaft = Shaft(arcs=(), bends=np.zeros((2, 2)))
        body, tip = active_points(self._robot, self._entrance, shaft.bends)
        return self._step(
            shaft, None, self._entrance, tip, tip[None, :3, 3], self._entrance[None, :3, 3], body[1:], [body], [tip]
        )

    def move(self, step: Step, command: Command) -> Step:
        """The robot after `command`, begun from `step`.

        Raises
        ------
        CaseError
            If a bend is larger than the robot can.
        """
        largest = max(command.phi_proximal, command.phi_distal)
        if largest > self._robot.bend_max * (1.0 + 1e-9):
            limit, found = np.degrees(self._robot.bend_max), np.degrees(largest)
            raise CaseError(
                f"a command bends a section by {found:.1f} degrees, expected at most {limit:.1f} (robot {self._robot.name})"
            )
        shaft: Shaft = step.state
        first, last = shaft.bends, bend_vectors(command)
        turned = float(np.abs(last - first).max())
        count = max(int(np.ceil(abs(command.push) / SPACING)), int(np.ceil(turned / BEND_STEP)), 1)
        base, arcs = step.base, list(shaft.arcs)
        trail = step.body[: len(step.body) - self._active_count]
        new: list[FloatArray] = []
        bodies, tips = [], []
        for k in range(count):
            bends = first + (k + 1.0) / count * (last - first)
            ahead = command.push / count
            if ahead >= 0.0:
                phi, theta = polar(first[0] + (k + 0.5) / count * (last[0] - first[0]))
                if ahead > 0.0:
                    arc = (ahead, phi * ahead / self._robot.proximal_length, theta)
                    base = base @ section_transform(*arc)
                    arcs.append(arc)
                    new.append(base[:3, 3])
            else:
                base, arcs = drawn_back(base, arcs, -ahead)
            body, tip = active_points(self._robot, base, bends)
            bodies.append(body)
            tips.append(tip)
        shaft = Shaft(arcs=tuple(arcs), bends=last)
        trail = np.vstack([trail, *new]) if command.push >= 0.0 else self._trail(arcs)
        track = np.array([tip[:3, 3] for tip in tips])
        return self._step(shaft, command, base, tips[-1], track, trail, bodies[-1][1:], bodies, tips)

    @property
    def _active_count(self) -> int:
        robot = self._robot
        return int(np.ceil(robot.proximal_length / SPACING)) + int(np.ceil(robot.distal_length / SPACING))

    def _trail(self, arcs: list[tuple[float, float, float]]) -> FloatArray:
        pose, points = self._entrance, [self._entrance[:3, 3]]
        for arc in arcs:
            pose = pose @ section_transform(*arc)
            points.append(pose[:3, 3])
        return np.array(points)

    def _step(
        self,
        shaft: Shaft,
        command: Command | None,
        base: FloatArray,
        tip: FloatArray,
        track: FloatArray,
        trail: FloatArray,
        active: FloatArray,
        bodies: list[FloatArray],
        tips: list[FloatArray],
    ) -> Step:
        """A step with its clearances: the trail does not move, so only the active sections and the base are measured."""
        rims = np.concatenate([rim_points(self._robot, pose) for pose in tips])
        return Step(
            state=shaft,
            command=command,
            base=base,
            tip=tip,
            track=track,
            body=np.concatenate([trail, active]),
            disc_clearance=least_clearance(self._wall, rims, self._far),
            body_clearance=least_clearance(self._wall, np.concatenate(bodies), self._far) - self._robot.radius,
            contacts=NO_CONTACT,
            forces=NO_FORCE,
        )


def least_clearance(wall: WallDistance, points: FloatArray, far: float) -> float:
    """Least signed distance to the wall of a cloud of points, mm: exact below `far`, else a lower bound not below it.

    The distance falls by no more than the way walked inside a ball that holds no surface, so a few measured points
    bound the others from below, and only those that could be the least are measured too.
    """
    measured = np.zeros(len(points), dtype=bool)
    least = np.inf
    lower = np.full(len(points), -np.inf)
    new = np.arange(0, len(points), FIRST_MEASURED)
    while len(new):
        measured[new] = True
        clearance = wall.clearance(points[new])
        least = min(least, float(clearance.min()))
        free = np.minimum(clearance, wall.cap_distance(points[new]))
        away = np.sqrt(np.square(points[:, None] - points[new]).sum(axis=2))
        lower = np.maximum(lower, np.where(away < free, clearance - away, -np.inf).max(axis=1))
        lower[new] = clearance
        able = np.flatnonzero(~measured & (lower < min(least, far)))
        new = able[np.argsort(lower[able], kind="stable")][: max(NEXT_MEASURED, len(able) // 3)]
    return min(least, float(lower.min())) if least > far else least


def drawn_back(
    base: FloatArray, arcs: list[tuple[float, float, float]], length: float
) -> tuple[FloatArray, list[tuple[float, float, float]]]:
    """The base and the trail after drawing the shaft back along its own trail, at most to the entrance."""
    left = length
    kept = list(arcs)
    while left > 1e-12 and kept:
        arc_length, phi, theta = kept.pop()
        part = min(left, arc_length)
        base = base @ np.linalg.inv(section_transform(part, phi * part / arc_length, theta))
        if part < arc_length:
            rest = arc_length - part
            kept.append((rest, phi * rest / arc_length, theta))
        left -= part
    return base, kept
