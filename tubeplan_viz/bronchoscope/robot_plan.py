"""What the robot's planners are asked and what they give: settings, poses of the tree, the plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.bronchoscope.mover import Step
from tubeplan_viz.bronchoscope.route import Stage


@dataclass(frozen=True, kw_only=True)
class PlannerSettings:
    """How the tree grows.

    Attributes
    ----------
    push_max, push_min : float, mm
        Of one command.
    turn_max : float, rad
        Change of a section's bend vector in one command.
    goal_tolerance : float, mm
        Tip error at which the goal counts as reached without further correction.
    goal_error_max : float, mm
        Tip error up to which the goal counts as reached at all (the text's mean is 2.817).
    body_margin : float, mm
        Least body clearance of a step: 0 where the mover knows no contact; a mover with contacts presses into the wall a little.
    disc_margin : float, mm
        Least disc clearance of a step on the way: 0 where the mover knows no contact; a soft contact gives way by a few
        hundredths where the disc's rim brushes the wall. At the goal the disc must be clear in any case.
    samples_max : int
        Of all stages together.
    patience : int
        Samples of a stage without success before the one before is entered anew.
    corrections_max : int
        Commands that put the tip onto the goal.
    time_budget : float, s, or None
    """

    push_max: float = 8.0
    push_min: float = 1.0
    turn_max: float = 0.35
    goal_tolerance: float = 0.3
    goal_error_max: float = 2.0
    body_margin: float = 0.0
    disc_margin: float = 0.0
    samples_max: int = 400
    patience: int = 12
    corrections_max: int = 6
    time_budget: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.push_min <= self.push_max:
            raise CaseError(f"push_min is {self.push_min:g} and push_max {self.push_max:g} mm, expected 0 < push_min <= push_max")
        if self.samples_max < 1 or self.patience < 1:
            raise CaseError(f"samples_max is {self.samples_max} and patience {self.patience}, expected at least 1")
        if not 0.0 < self.goal_tolerance <= self.goal_error_max:
            raise CaseError(
                f"goal_tolerance is {self.goal_tolerance:g} and goal_error_max {self.goal_error_max:g} mm, "
                "expected 0 < goal_tolerance <= goal_error_max"
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class Node:
    """One pose of the tree.

    Attributes
    ----------
    step : Step
    parent : int
        -1 for the start.
    stage : int
        In which it was made.
    accepted : bool
        False for a push that collided: kept to be drawn, never gone on from.
    """

    step: Step
    parent: int
    stage: int
    accepted: bool

    @property
    def tip(self) -> FloatArray:
        """The tip's place, (3,) mm."""
        return np.asarray(self.step.tip[:3, 3])


@dataclass(kw_only=True)
class StageTally:
    """What one stage took."""

    samples: int = 0
    pushes: int = 0
    refused: int = 0
    foreseen: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotPlan:
    """The end of a planning run.

    Attributes
    ----------
    steps : tuple of Step
        From the start to the best pose.
    step_stages : tuple of int
        Stage of each step; the start belongs to the first.
    stages : tuple of Stage
    tallies : tuple of StageTally
    nodes : tuple of Node
        The whole tree in the order in which it grew.
    samples : tuple of (stage, (3,) place)
    tip_error : float, mm
    reached : bool
    reason : str or None
        Why the goal was not reached.
    given_up : tuple of (poses, samples)
        Of a tree that was grown before this one and did not reach the goal.
    """

    steps: tuple[Step, ...]
    step_stages: tuple[int, ...]
    stages: tuple[Stage, ...]
    tallies: tuple[StageTally, ...]
    nodes: tuple[Node, ...]
    samples: tuple[tuple[int, FloatArray], ...]
    tip_error: float
    reached: bool
    reason: str | None
    given_up: tuple[int, int] = (0, 0)

    @property
    def subgoal_distances(self) -> tuple[float | None, ...]:
        """How far from each stage's sub-goal the tip was when the stage ended, mm; None for stages that were not reached.

        Their sum is the cost of Guo et al. (2022), section 1.2.
        """
        made: list[float | None] = []
        for number, stage in enumerate(self.stages):
            within = [step for step, at in zip(self.steps, self.step_stages, strict=True) if at <= number]
            met = within and self.step_stages[-1] >= number
            made.append(float(np.linalg.norm(within[-1].tip[:3, 3] - stage.goal)) if met else None)
        return tuple(made)
