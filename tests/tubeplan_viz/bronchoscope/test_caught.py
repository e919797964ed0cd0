"""Pushes that the wall stops, or that catch the tip on it, are not gone on from: a mover that does so, before a straight tube."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from tubeplan_viz.bench.models import straight_tube
from tubeplan_viz.bronchoscope.aiming import Aim
from tubeplan_viz.bronchoscope.guide import Guide
from tubeplan_viz.bronchoscope.kinematic import KinematicMover
from tubeplan_viz.bronchoscope.kinematics import pose_along
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.planner import CAUGHT, CAUGHT_PUSH, plan_segmented
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings, RobotPlan
from tubeplan_viz.bronchoscope.route import Stage
from tubeplan_viz.geometry import WallDistance

LENGTH, RADIUS, SNAG = 90.0, 6.0, 50.0  # mm; the snag lies across the tube, and only a push of at most 4 mm passes it
SHORT = 4.0


@dataclass(frozen=True)
class Snagged:
    """The mover without forces in a tube with a snag, at which `outcome` says what becomes of a push.

    `brush` is the clearance that is told of the front disc after every move, where it is given. A mover that creeps brings the
    tip on by a tenth of what it should beyond the snag, however short the push.
    """

    mover: KinematicMover
    outcome: Callable[[Step, Step], Step]
    brush: float | None = None
    creeps: bool = False

    def start(self) -> Step:
        return self.mover.start()

    def move(self, step: Step, command: Command) -> Step:
        made = self.mover.move(step, command)
        if self.brush is not None:
            made = replace(made, disc_clearance=self.brush)
        if self.creeps and made.tip[1, 3] > SNAG:
            return hung(step, made, share=0.1)
        long = step.tip[1, 3] < SNAG < made.tip[1, 3] and command.push > SHORT
        return self.outcome(step, made) if long else made


def stopped(before: Step, made: Step) -> Step:
    """The robot halts near the end of its way, before it is pressed through the wall."""
    return replace(made, halted=True)


def hung(before: Step, made: Step, *, share: float = 0.2) -> Step:
    """The command is carried out, but the tip hangs on the wall and the shaft bends out behind it: a fifth of the way is left."""
    tip = before.tip.copy()
    tip[:3, 3] += share * (made.tip[:3, 3] - before.tip[:3, 3])
    return replace(before, command=made.command, tip=tip)


@pytest.fixture(scope="module")
def wall() -> WallDistance:
    return WallDistance(straight_tube(LENGTH, RADIUS).surface)


def planned(
    wall: WallDistance, outcome: Callable[[Step, Step], Step], *, brush: float | None = None, creeps: bool = False, **asked: Any
) -> RobotPlan:
    robot = Robot()
    points = np.column_stack([np.zeros(161), np.linspace(0.5, 80.5, 161), np.zeros(161)])
    guide = Guide(points, np.full(161, RADIUS))
    goal = np.array([0.0, 76.0, 0.0])
    stages = (
        Stage(name="before", begin=0.0, end=40.0, goal=np.array([0.0, 40.5, 0.0]), radius=3.0),
        Stage(name="beyond", begin=40.0, end=75.5, goal=goal, radius=3.0),
    )
    mover = Snagged(KinematicMover(wall, robot, pose_along([0.0, 0.5, 0.0], [0.0, 1.0, 0.0])), outcome, brush, creeps)
    settings = PlannerSettings(**asked)
    return plan_segmented(mover, robot, guide, stages, settings, wall=wall, rng=np.random.default_rng(0))


@pytest.mark.parametrize("outcome", [stopped, hung])
def test_a_shorter_push_passes_where_a_long_one_is_stopped(wall: WallDistance, outcome: Callable[[Step, Step], Step]) -> None:
    plan = planned(wall, outcome)
    assert plan.reached
    assert plan.tip_error < 0.5
    assert not any(node.step.halted for node in plan.nodes if node.accepted)
    refused = [node for node in plan.nodes if not node.accepted]
    assert len(refused) >= 1  # the snag was met, and the pose after it is kept to be drawn
    assert sum(tally.refused for tally in plan.tallies) == len(refused)
    # One by one: 50 mm of tip at 8 mm a push, and no more than a handful of tries at the snag.
    assert sum(tally.pushes for tally in plan.tallies) < 20


def test_a_robot_that_is_always_stopped_gives_up_after_few_pushes_a_sample(wall: WallDistance) -> None:
    always = planned(wall, lambda before, made: replace(before, command=made.command, halted=True), samples_max=5, push_min=5)
    assert not always.reached
    assert always.reason is not None
    assert "'beyond'" in always.reason
    # A push of 8 mm is tried at 8 and 5 mm only; at most two more lead from a sample's pose to the snag.
    assert sum(tally.pushes for tally in always.tallies) <= 5 * 4


def test_short_pushes_that_hardly_bring_the_tip_on_count_together(wall: WallDistance) -> None:
    """Each is too short to tell by itself; two of 1.5 mm are not, and a sample does not creep on for two hundred of them."""
    plan = planned(wall, lambda before, made: made, creeps=True, push_max=1.5, samples_max=4)
    assert not plan.reached
    beyond = [number for number, node in enumerate(plan.nodes) if node.accepted and node.tip[1] > SNAG - 1.5]
    assert 1 <= len(beyond) <= 4 * 3
    # From 26.5 to 50 mm at 1.5 mm a push, and at the snag a few for each sample.
    assert sum(tally.pushes for tally in plan.tallies) < 23.5 / 1.5 + 4 * 6


def test_a_tip_counts_as_caught_by_its_way_along_the_guide(wall: WallDistance) -> None:
    def moved(share: float) -> Callable[[Step, Step], Step]:
        def outcome(before: Step, made: Step) -> Step:
            tip = before.tip.copy()
            tip[:3, 3] += share * (made.tip[:3, 3] - before.tip[:3, 3])
            return replace(made, tip=tip)

        return outcome

    assert CAUGHT_PUSH < SHORT
    # Along a straight guide the share of the way is the share of the push, to the 0.5 mm between the guide's points.
    assert any(not node.accepted for node in planned(wall, moved(CAUGHT - 0.1)).nodes)
    assert all(node.accepted for node in planned(wall, moved(CAUGHT + 0.1)).nodes)


def test_samples_are_drawn_in_the_whole_sphere_about_the_sub_goal_as_the_text_draws_them(wall: WallDistance) -> None:
    plan = planned(wall, lambda before, made: replace(before, command=made.command, halted=True), samples_max=120, push_min=5.0)
    offsets = np.array([place - plan.stages[number].goal for number, place in plan.samples])
    radii = np.array([plan.stages[number].radius for number, _ in plan.samples])
    distance = np.linalg.norm(offsets, axis=1)
    drawn = distance > 0.0  # the first sample of a stage is its sub-goal
    assert np.count_nonzero(~drawn) >= 2
    share, up = distance[drawn] / radii[drawn], offsets[drawn, 2] / distance[drawn]
    count = np.count_nonzero(drawn)
    assert count > 80
    assert share.max() <= 1.0
    # Distance and elevation are even: means of 1/2 and, for |sin|, of 2 / pi, with deviations of 0.29 and 0.31; four of them.
    assert share.mean() == pytest.approx(0.5, abs=4.0 * 0.29 / np.sqrt(count))
    assert np.abs(up).mean() == pytest.approx(2.0 / np.pi, abs=4.0 * 0.31 / np.sqrt(count))
    assert abs(offsets[drawn].mean(axis=0)).max() < 4.0 * radii.max() * 0.4 / np.sqrt(count)


def test_a_disc_that_brushes_the_wall_may_pass_but_not_end_there(wall: WallDistance) -> None:
    free, cut = (planned(wall, lambda before, made: made, brush=gap, disc_margin=-0.05, samples_max=30) for gap in (0.01, -0.02))
    assert free.reached
    assert not cut.reached
    # It did come there: brushing by less than the margin does not stop a push.
    assert min(float(np.linalg.norm(node.tip - cut.stages[-1].goal)) for node in cut.nodes) < 0.5


def test_a_command_leads_away_from_a_wall_that_the_guide_runs_too_near_to() -> None:
    robot, radius, aside = Robot(), 2.4, 0.6
    narrow = WallDistance(straight_tube(LENGTH, radius).surface)
    points = np.column_stack([np.full(161, aside), np.linspace(0.5, 80.5, 161), np.zeros(161)])
    guide = Guide(points, np.full(161, radius - aside))
    last = Stage(name="along", begin=0.0, end=79.0, goal=points[-3], radius=0.3)
    mover = KinematicMover(narrow, robot, pose_along([aside, 0.5, 0.0], [0.0, 1.0, 0.0]), far=np.inf)
    start = mover.start()
    # The straight robot on that guide has 2.4 - 0.6 - 1.75 mm of room, and 0.15 are asked for.
    assert start.body_clearance == pytest.approx(0.05, abs=0.01)
    aim = Aim(robot=robot, guide=guide, wall=narrow, last=last)
    made = mover.move(start, aim.command(start, 26.0, 4.0, np.zeros(3), last))
    assert made.tip[0, 3] < aside - 0.05
    away = np.linalg.norm(made.body[-13:, ::2], axis=1)  # of the distal section, across the tube
    assert away.max() < aside
