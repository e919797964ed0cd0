"""Plain RRT for comparison: no route, no sub-goals, samples in the whole box of the lumen (LaValle 1998)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.bronchoscope.mover import Mover, Step
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.steering import advanced, aimed, bends_of, command_of, limited

PUSH = 4.0
TURN_MAX = 0.35
GOAL_SHARE = 0.05  # of the samples that are the goal itself, as usual


@dataclass(frozen=True, kw_only=True)
class PlainOutcome:
    """How a plain RRT ended.

    Attributes
    ----------
    reached : bool
    pushes : int
    poses : int
        In the tree.
    nearest : float, mm
        Least distance of any tip to the goal.
    """

    reached: bool
    pushes: int
    poses: int
    nearest: float


def plan_plain(
    mover: Mover,
    robot: Robot,
    box: FloatArray,
    goal: FloatArray,
    *,
    pushes: int,
    tolerance: float,
    body_margin: float = 0.0,
    rng: np.random.Generator,
) -> PlainOutcome:
    """Grow a plain RRT until the tip comes near the goal or the pushes are used up.

    From the pose whose tip is nearest to a sample both sections are pointed at it, and the shaft is pushed on.

    Parameters
    ----------
    mover : Mover
    robot : Robot
    box : (2, 3) float array, mm
        Corners of the box from which samples are drawn.
    goal : (3,) float array, mm
    pushes : int
        Budget of moves.
    tolerance : float, mm
        Tip error at which the goal counts as reached.
    body_margin : float, mm
        As in `PlannerSettings`.
    rng : numpy.random.Generator
    """
    steps: list[Step] = [mover.start()]
    tips = [steps[0].tip[:3, 3]]
    nearest = float(np.linalg.norm(tips[0] - goal))
    for used in range(1, pushes + 1):
        place = goal if rng.uniform() < GOAL_SHARE else rng.uniform(box[0], box[1])
        origin = steps[int(np.argmin(np.linalg.norm(np.array(tips) - place, axis=1)))]
        first = bends_of(origin)
        wanted = aimed(advanced(origin.base, robot, first, first, PUSH), robot, place, place)
        change = wanted - first
        size = float(np.linalg.norm(change, axis=1).max())
        bends = limited(first + change * min(1.0, TURN_MAX / max(size, 1e-12)), robot.bend_max)
        step = mover.move(origin, command_of(bends, PUSH))
        if step.disc_clearance < 0.0 or step.body_clearance < body_margin:
            continue
        steps.append(step)
        tips.append(step.tip[:3, 3])
        nearest = min(nearest, float(np.linalg.norm(tips[-1] - goal)))
        if nearest <= tolerance:
            return PlainOutcome(reached=True, pushes=used, poses=len(steps), nearest=nearest)
    return PlainOutcome(reached=False, pushes=pushes, poses=len(steps), nearest=nearest)
