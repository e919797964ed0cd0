"""The robot as a chain of rigid links: where its hinges and contact balls sit, and the hinge angles of a bend."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.bronchoscope.dynamics.settings import DynamicsSettings
from tubeplan_viz.bronchoscope.kinematics import bend_rotation
from tubeplan_viz.bronchoscope.mover import Command
from tubeplan_viz.bronchoscope.robot import Robot

# The front disc's rim is rounded by this radius, mm, and touches the wall with as many balls, which leave 0.08 mm between them.
RIM_ROUNDING = 0.3
RIM_BALLS = 24
# Passive hinges come into the model in groups, so that few models are built.
GROUP = 4


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Places along the robot, measured backwards from its front disc, mm.

    An active section of n links is a base piece and n pieces of the same length with n hinges between them
    (`kinematics.chain_transform`). The passive section's links are short behind the active sections, which
    they follow round every bend, and longer further back, where only wide tubes lie.
    """

    robot: Robot
    settings: DynamicsSettings

    @cached_property
    def active_hinges(self) -> FloatArray:
        """Distance of each active hinge from the front disc, tip first, (2 n,) mm."""
        robot = self.robot
        steps = np.arange(1, robot.links + 1)
        distal = robot.distal_length / (robot.links + 1) * steps
        proximal = robot.distal_length + robot.proximal_length / (robot.links + 1) * steps
        return np.concatenate([distal, proximal])

    @cached_property
    def passive_hinges(self) -> FloatArray:
        """Distance of each passive hinge from the front disc, tip first, (p,) mm."""
        made, end = [self.robot.active_length], self.robot.active_length + self.robot.passive_length
        while made[-1] < end:
            fine = made[-1] < self.robot.active_length + self.settings.fine_length
            made.append(made[-1] + (self.settings.fine_link if fine else self.settings.coarse_link))
        return np.array(made)

    @cached_property
    def hinges(self) -> FloatArray:
        """All hinges, tip first, mm."""
        return np.concatenate([self.active_hinges, self.passive_hinges])

    @cached_property
    def balls(self) -> FloatArray:
        """Centres of the balls that fill the robot, tip first, mm behind the front disc.

        At most 1.25 mm apart: balls of 1.75 mm leave gaps of 0.12 mm at most to the cylinder around them.
        """
        radius, end = self.robot.radius, float(self.hinges[-1])
        spacing = min(1.25, 5.0 / 7.0 * radius)
        return np.asarray(radius + spacing * np.arange(int((end - radius) / spacing) + 1))

    def passive_for(self, inserted: float) -> int:
        """Passive hinges of the model for a base `inserted` mm behind the entrance: those outside and the next ones."""
        places = self.passive_hinges - self.robot.active_length
        out = int(np.searchsorted(places, inserted + self.settings.coarse_link))
        return min(-(-(out + 1) // GROUP) * GROUP, len(places))

    @cached_property
    def stiffness(self) -> FloatArray:
        """Moment over angle of each passive hinge, N mm/rad, (p,): EI over the length between the middles of its links."""
        places = np.concatenate([[self.active_hinges[-1]], self.passive_hinges])
        ahead = np.diff(places)
        behind = np.append(ahead[1:], ahead[-1])
        return np.asarray(self.settings.stiffness / (0.5 * (ahead + behind)))

    @cached_property
    def active_stiffness(self) -> FloatArray:
        """Moment over angle of each active hinge, N mm/rad, (2 n,)."""
        robot = self.robot
        pieces = np.repeat([robot.distal_length, robot.proximal_length], robot.links) / (robot.links + 1)
        return np.asarray(self.settings.active_stiffness / pieces)

    @cached_property
    def mass_per_length(self) -> float:
        """kg/mm."""
        return 1e-6 * self.settings.density * np.pi * self.robot.radius**2


def hinge_angles(robot: Robot, command: Command) -> FloatArray:
    """Angles of the active hinges at which the chain has the commanded shape, base first, (2 n, 2) rad.

    A hinge is a universal joint: a turn about its first axis, then one about the second; the axes swap
    from hinge to hinge. A universal joint that tilts twists a little; the recursion carries that
    twist along, so that every link points where the section without twist asks.
    """
    made, twist, number = [], 0.0, 0
    for phi, theta in ((command.phi_proximal, command.theta_proximal), (command.phi_distal, command.theta_distal)):
        step = phi / robot.links
        wanted = bend_rotation(step, theta)
        for _ in range(robot.links):
            ahead = _about_axis(-twist) @ wanted[:, 2]
            if number % 2 == 0:
                first, second = float(np.arctan2(-ahead[1], ahead[2])), float(np.arcsin(np.clip(ahead[0], -1.0, 1.0)))
                turn = _about_x(first) @ _about_y(second)
            else:
                first, second = float(np.arctan2(ahead[0], ahead[2])), float(np.arcsin(np.clip(-ahead[1], -1.0, 1.0)))
                turn = _about_y(first) @ _about_x(second)
            left = wanted.T @ _about_axis(twist) @ turn
            twist = float(np.arctan2(left[1, 0], left[0, 0]))
            made.append((first, second))
            number += 1
    return np.array(made)


def _about_x(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_y(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _about_axis(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
