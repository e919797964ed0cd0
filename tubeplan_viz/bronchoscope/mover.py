"""What moves the robot while a plan grows: kinematics alone, or a simulator. A planner sees no difference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from segmentation.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class Command:
    """One order: bend and bending plane of each active section, and how far to push.

    Attributes
    ----------
    phi_proximal, phi_distal : float
        Bend, radian, 0 to the robot's largest.
    theta_proximal, theta_distal : float
        Angle of the bending plane about the section's own base axis, radian. Sections bend without twist: the frame at a
        section's end is its base's turned by phi about the plane's normal (`kinematics.section_transform`).
    push : float
        How far the shaft is pushed in, mm; negative pulls back.
    """

    phi_proximal: float
    theta_proximal: float
    phi_distal: float
    theta_distal: float
    push: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Step:
    """The robot after a command.

    Attributes
    ----------
    state : Any
        What the mover needs to go on from here; opaque, never changed, so a tree of steps can branch from any of them.
    command : Command or None
        The order that led here; None at the start.
    base : (4, 4) float array
        Pose of the proximal section's base in the lumen's frame, mm; the third column runs along the axis, and the bending
        plane's angle theta_proximal counts from the first column about it.
    tip : (4, 4) float array
        Pose of the distal front disc in the lumen's frame, mm; the third column is the direction of view.
    track : (k, 3) float array
        Places of the tip on the way from the step before, this step's tip last, mm, at most 1 mm apart; only the tip at the
        start.
    body : (m, 3) float array
        Places along the robot's axis from the entrance to the tip, mm, at most 1 mm apart.
    disc_clearance : float
        Least signed distance of the distal front disc's rim to the wall on the way from the step before, mm; below 0 it
        cuts the wall.
    body_clearance : float
        Least signed distance of the axis to the wall less the robot's radius on that way, mm; with contacts about 0.
    contacts : (k, 3) float array
        Places of contact with the wall, mm; (0, 3) where the mover has no contact.
    forces : (k,) float array
        Their normal forces, N.
    halted : bool
        The mover ended before the command was carried out, so as not to press the robot through the wall.
    """

    state: Any
    command: Command | None
    base: FloatArray
    tip: FloatArray
    track: FloatArray
    body: FloatArray
    disc_clearance: float
    body_clearance: float
    contacts: FloatArray
    forces: FloatArray
    halted: bool = False


class Mover(Protocol):
    """Moves the robot in one lumen.

    A mover is made with the wall's surface, the robot and the entrance: a pose (4, 4) in the lumen's frame in the
    middle of the trachea's upper end, its third column into the lumen (`kinematics.pose_along`).
    """

    def start(self) -> Step:
        """The robot at rest: straight, the proximal section's base at the entrance, both active sections inside."""
        ...

    def move(self, step: Step, command: Command) -> Step:
        """The robot after `command`, begun from `step`; the same step and command always give the same outcome."""
        ...
