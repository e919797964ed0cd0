"""The upper layer: the route through the tree and its stages with sub-goals (Guo et al. 2022, section 1.2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from tubeplan_viz.bronchoscope.guide import Guide
from tubeplan_viz.bronchoscope.robot import Robot

# A turn into a branch that is sharper has a stage of its own; on the text's route (30, 60 and 90 degrees) that gives its six.
OWN_STAGE = np.radians(45.0)
# A stage into a branch ends this many of the branch's diameters past the junction.
PAST_JUNCTION = 1.0
# Radius of the sphere of samples as a share of the lumen's radius at the sub-goal.
SPHERE = 0.8


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage:
    """One stretch of the route with its sub-goal.

    Attributes
    ----------
    name : str
    begin, end : float, mm
        Arc lengths on the guide.
    goal : (3,) float array, mm
    radius : float, mm
        Of the sphere in which samples are drawn.
    """

    name: str
    begin: float
    end: float
    goal: FloatArray
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "goal", frozen_array(self.goal, (3,), "sub-goal"))


@dataclass(frozen=True, kw_only=True)
class Passage:
    """One branch on the route.

    Attributes
    ----------
    name : str
    begin, end : float, mm
        Arc lengths of its line on the guide.
    turn : float, rad
        By which it turns away from the branch before.
    radius : float, mm
        Of the branch.
    """

    name: str
    begin: float
    end: float
    turn: float
    radius: float


def make_stages(guide: Guide, passages: Sequence[Passage], goal: FloatArray, robot: Robot) -> tuple[Stage, ...]:
    """Stages along the guide: one along each branch, before it one into it where the turn is sharp.

    Parameters
    ----------
    guide : Guide
    passages : sequence of Passage
        From the trachea on, without gaps.
    goal : (3,) float array, mm
        Sub-goal of the last stage.
    robot : Robot
    """
    rows: list[tuple[str, float]] = []
    for number, passage in enumerate(passages):
        into = passage.begin + PAST_JUNCTION * 2.0 * passage.radius
        if number > 0 and passage.turn > OWN_STAGE and into < passage.end - 2.0:
            rows.append((f"into {passage.name}", into))
        rows.append((f"along {passage.name}", passage.end))
    stages: list[Stage] = []
    begin = 0.0
    for number, (name, end) in enumerate(rows):
        # The start lies a robot's active length inside; a stage that it has passed already is none.
        if end <= robot.active_length and number < len(rows) - 1:
            continue
        width = float(guide.radius(end))
        room = max(width - robot.radius, 0.3)
        place = goal if number == len(rows) - 1 else guide.at(end)
        stages.append(Stage(name=name, begin=begin, end=end, goal=place, radius=min(SPHERE * width, room)))
        begin = end
    return tuple(stages)
