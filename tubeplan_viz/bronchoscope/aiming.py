"""The command of one push: both sections laid on the line ahead, away from the wall; the tip put onto the goal at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.bronchoscope.guide import Guide
from tubeplan_viz.bronchoscope.kinematic import active_points
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.route import Stage
from tubeplan_viz.bronchoscope.steering import AIM_ROUNDS, active_shares, advanced, bends_of, command_of, fitted, predicted_tip
from tubeplan_viz.geometry import WallDistance

AWAY_ROUNDS, AWAY_MARGIN = 4, 0.15
SAG_NOTICED = 0.1  # mm; interpolation between the body's places is off by less
AT_GOAL = 0.03  # mm
ROOM_MIN = 0.3  # mm; beside the guide, for its weight where the lumen is hardly wider than the robot


@dataclass(frozen=True, eq=False, kw_only=True)
class Aim:
    """What commands are chosen by.

    Attributes
    ----------
    robot : Robot
    guide : Guide
        From the entrance to the goal.
    wall : WallDistance
        Sections that would meet it are laid a little away from it.
    last : Stage
        The stage whose sub-goal is the goal.
    """

    robot: Robot
    guide: Guide
    wall: WallDistance
    last: Stage

    def command(
        self, step: Step, tip_at: float, push: float, offset: FloatArray, stage: Stage, *, follows: float = 1.0
    ) -> Command:
        """The command after which the active sections lie best on the line, given where the push takes the base.

        Parameters
        ----------
        step : Step
            Before the push.
        tip_at : float, mm
            Arc length of the guide beside the tip.
        push : float, mm
        offset : (3,) float array, mm
            From the stage's sub-goal to the sample: the line passes through the sample.
        stage : Stage
        follows : float
            Share of the proximal section's bend that its base is expected to follow (`following_share`).
        """
        robot, bends = self.robot, bends_of(step)
        ahead = tip_at + push
        places = ahead - robot.active_length * (1.0 - active_shares(robot))
        line = bent_line(self.guide, places, offset, stage)
        room = np.maximum(self.guide.radius(places) - robot.radius, ROOM_MIN)
        if stage is self.last and ahead > stage.end - 1.0:
            room[-1] = AT_GOAL  # the tip itself must end on the goal
        direction = line[-1] - line[-3]
        direction = direction / np.linalg.norm(direction)
        # Weight, contact and slack hinges move the real sections off their ideal arcs: as much is expected after the push.
        sag = sagged(step, robot)
        line = line - sag
        wanted, base = bends, step.base
        for _ in range(AIM_ROUNDS):
            base = advanced(step.base, robot, follows * bends, follows * wanted, push)
            wanted = fitted(base, robot, wanted, line, room, direction)
        for _ in range(AWAY_ROUNDS):
            points = active_points(robot, base, wanted)[0] + sag
            gap, _, foot = self.wall.nearest(points)
            short = robot.radius + AWAY_MARGIN - gap
            if short.max() <= 0.0:
                break
            # The line goes away from the wall where the robot would meet it, and the sections are laid on it anew.
            line = line + (np.maximum(short, 0.0) / np.maximum(gap, 1e-6))[:, None] * (points - foot)
            wanted = fitted(base, robot, wanted, line, room, direction)
            base = advanced(step.base, robot, follows * bends, follows * wanted, push)
        return command_of(wanted, push)

    def correction(self, step: Step, error: FloatArray) -> Command:
        """Least change of push and distal bend that moves the tip by `error`, (3,) mm, by the kinematic model's derivatives."""
        robot, bends = self.robot, bends_of(step)
        # In units of about one millimetre of tip each, so that least squares weighs them alike.
        scale = np.array([1.0, 1.5 / robot.distal_length, 1.5 / robot.distal_length])

        def tip(x: FloatArray) -> FloatArray:
            changed = bends.copy()
            changed[1] += scale[1:] * x[1:]
            return predicted_tip(advanced(step.base, robot, bends, changed, float(x[0])), robot, changed)[:3, 3]

        zero = tip(np.zeros(3))
        slopes = np.column_stack([(tip(0.05 * unit) - zero) / 0.05 for unit in np.eye(3)])
        x = np.linalg.solve(slopes.T @ slopes + 1e-3 * np.eye(3), slopes.T @ error)
        x *= min(1.0, 3.0 / max(float(np.abs(x).max()), 1e-12))
        changed = bends.copy()
        changed[1] += scale[1:] * x[1:]
        size = float(np.linalg.norm(changed[1]))
        changed[1] *= min(1.0, robot.bend_max / max(size, 1e-12))
        return command_of(changed, float(x[0]))


def following_share(steps: Sequence[Step], robot: Robot) -> float:
    """Share of the proximal section's bend that its base has followed over some steps, 0 to 1.

    Where the wall holds the shaft the base goes along the section's own arc: 1. In a wide lumen a shaft with weight goes straight
    on, however the section before it is bent: 0. The share is that of least squares of where the base, and the place that lies
    straight before it by the active length, have come.

    Parameters
    ----------
    steps : sequence of Step
        One after the other.
    robot : Robot
    """
    places = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, robot.active_length, 1.0]]).T
    strayed = between = 0.0
    for before, after in pairwise(steps):
        push = 0.0 if after.command is None else after.command.push
        first, last = bends_of(before), bends_of(after)
        along, straight = (advanced(before.base, robot, k * first, k * last, push) @ places for k in (1.0, 0.0))
        apart = (straight - along)[:3]
        strayed += float(np.sum((after.base @ places - along)[:3] * apart))
        between += float(np.sum(apart * apart))
    return 1.0 - float(np.clip(strayed / between, 0.0, 1.0)) if between > SAG_NOTICED**2 else 1.0


def bent_line(guide: Guide, s: FloatArray, offset: FloatArray, stage: Stage) -> FloatArray:
    """The guide bent towards the sample: fully at the sub-goal, fading out over the stage before and beyond it; (n, 3) mm."""
    fade = np.clip(1.0 - np.abs(s - stage.end) / max(stage.end - stage.begin, 1.0), 0.0, 1.0)
    return np.asarray(guide.at(s) + (fade * fade * (3.0 - 2.0 * fade))[:, None] * offset)


def sagged(step: Step, robot: Robot) -> FloatArray:
    """How far the active sections' places lie from those of ideal arcs at the same base and bends, (m, 3) mm."""
    body = step.body
    left = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(body[::-1], axis=0), axis=1))])
    wanted = robot.active_length * (1.0 - active_shares(robot))
    real = np.column_stack([np.interp(wanted, left, column) for column in body[::-1].T])
    ideal = active_points(robot, step.base, bends_of(step))[0]
    off = real - ideal
    return np.asarray(off) if float(np.linalg.norm(off, axis=1).max()) > SAG_NOTICED else np.zeros_like(off)
