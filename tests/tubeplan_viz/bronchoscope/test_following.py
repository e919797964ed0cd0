"""How far the base follows the bend before it, learnt from pushes in closed form, and the second plan that learns it."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeplan_viz.bench.models import straight_tube
from tubeplan_viz.bronchoscope import way as module
from tubeplan_viz.bronchoscope.aiming import following_share
from tubeplan_viz.bronchoscope.kinematic import KinematicMover
from tubeplan_viz.bronchoscope.kinematics import pose_along, section_transform
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import Node, PlannerSettings, RobotPlan
from tubeplan_viz.bronchoscope.target import branch_target
from tubeplan_viz.bronchoscope.way import LEARNING, SHORTER, SPARE, plan_moved, plan_way
from tubeplan_viz.geometry import WallDistance

PHI, THETA, PUSH = 0.8, 0.6, 6.0


@pytest.fixture(scope="module")
def mover() -> KinematicMover:
    return KinematicMover(WallDistance(straight_tube(80.0, 30.0).surface), Robot(), pose_along([0.0, 0.5, 0.0], [0.0, 1.0, 0.0]))


def bent(push: float) -> Command:
    return Command(phi_proximal=PHI, theta_proximal=THETA, phi_distal=0.3, theta_distal=0.1, push=push)


def pushed(mover: KinematicMover, share: float, count: int = 2) -> list[Step]:
    """Pushes with a steady bend during which the base turns by a share of what the section's own arc would."""
    robot = Robot()
    steps = [mover.move(mover.start(), bent(0.0))]
    for _ in range(count):
        arc = section_transform(PUSH, share * PHI * PUSH / robot.proximal_length, THETA)
        steps.append(replace(steps[-1], command=bent(PUSH), base=steps[-1].base @ arc))
    return steps


def test_a_base_on_the_sections_own_arc_follows_fully(mover: KinematicMover) -> None:
    robot = Robot()
    first = mover.move(mover.start(), bent(0.0))
    steps = [first, mover.move(first, bent(PUSH))]
    # The mover's substeps of 1 mm and the aim's of 2 mm are the same arc while the bend is steady.
    assert following_share(steps, robot) == pytest.approx(1.0, abs=1e-9)
    assert following_share(pushed(mover, 1.0), robot) == pytest.approx(1.0, abs=1e-9)


def test_a_base_that_goes_straight_follows_not_at_all(mover: KinematicMover) -> None:
    assert following_share(pushed(mover, 0.0), Robot()) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_a_base_that_turns_by_a_share_of_the_bend_is_found_to_do_so(mover: KinematicMover, share: float) -> None:
    # Places on arcs between the two lie beside the line between their ends by the second order of the turn, 0.37 rad: 0.07 of it.
    assert following_share(pushed(mover, share), Robot()) == pytest.approx(share, abs=0.03)


def test_shares_beyond_both_are_cut_off_and_a_robot_that_has_not_bent_tells_nothing(mover: KinematicMover) -> None:
    robot = Robot()
    assert following_share(pushed(mover, 1.6), robot) == 1.0
    assert following_share(pushed(mover, -0.6), robot) == 0.0
    straight = [mover.start()]
    command = Command(phi_proximal=0.0, theta_proximal=0.0, phi_distal=0.0, theta_distal=0.0, push=PUSH)
    aside = straight[0].base.copy()
    aside[:3, 3] += 2.0
    straight.append(replace(straight[0], command=command, base=aside))
    assert following_share(straight, robot) == 1.0
    assert following_share(straight[:1], robot) == 1.0


def test_the_share_is_the_same_in_any_frame(mover: KinematicMover) -> None:
    turn = np.eye(4)
    turn[:3, :3], turn[:3, 3] = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), [5.0, -80.0, 12.0]
    steps = pushed(mover, 0.4)
    moved = [replace(step, base=turn @ step.base) for step in steps]
    assert following_share(moved, Robot()) == pytest.approx(following_share(steps, Robot()), abs=1e-9)


class Tries:
    """In place of the planner: what each try gives, and with what it was asked: samples, longest push, whether it learns."""

    def __init__(self, mover: KinematicMover, *outcomes: tuple[bool, float]) -> None:
        self.start, self.outcomes = mover.start(), outcomes
        self.asked: list[tuple[int, float, bool]] = []

    def __call__(self, *args: Any, learns: bool = False, watch: Any = None, **named: Any) -> RobotPlan:
        reached, error = self.outcomes[len(self.asked)]
        asked = args[4]
        self.asked.append((asked.samples_max, asked.push_max, learns))
        nodes = tuple(Node(step=self.start, parent=k - 1, stage=0, accepted=True) for k in range(3))
        for number, node in enumerate(nodes):
            watch(node, number)
        return RobotPlan(
            steps=(self.start,),
            step_stages=(0,),
            stages=(),
            tallies=(),
            nodes=nodes,
            samples=((0, np.zeros(3)),) * asked.samples_max,
            tip_error=error,
            reached=reached,
            reason=None if reached else "stuck",
        )


def tried(monkeypatch: pytest.MonkeyPatch, tries: Tries, **asked: Any) -> tuple[RobotPlan, list[int]]:
    monkeypatch.setattr(module, "plan_segmented", tries)
    numbers: list[int] = []
    none: Any = None
    plan = plan_moved(
        none,
        Robot(),
        none,
        (none,) * 6,
        PlannerSettings(**asked),
        wall=none,
        rng=np.random.default_rng(0),
        watch=lambda node, number: numbers.append(number),
    )
    return plan, numbers


FEW = 6 + SPARE  # one sample for each of six stages, and some


def test_what_the_first_samples_reach_is_the_plan(mover: KinematicMover, monkeypatch: pytest.MonkeyPatch) -> None:
    tries = Tries(mover, (True, 0.2))
    plan, numbers = tried(monkeypatch, tries)
    assert plan.tip_error == 0.2
    assert plan.given_up == (0, 0)
    assert tries.asked == [(FEW, 8.0, False)]
    assert numbers == [0, 1, 2]


def test_what_they_do_not_reach_is_begun_anew_with_shorter_pushes_by_learning_and_with_all_samples_left(
    mover: KinematicMover, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries = Tries(mover, (False, 9.0), (False, 7.0), (False, 8.0), (True, 0.3))
    plan, numbers = tried(monkeypatch, tries, samples_max=70)
    assert plan.reached
    assert plan.tip_error == 0.3
    assert tries.asked == [
        (FEW, 8.0, False),
        (FEW, 8.0 * SHORTER, False),
        (LEARNING, 8.0, True),
        (70 - 2 * FEW - LEARNING, 8.0, False),
    ]
    assert plan.given_up == (9, 2 * FEW + LEARNING)  # poses and samples of the three trees before
    assert numbers == list(range(12))  # poses of all trees are told apart


@pytest.mark.parametrize("errors", [(9.0, 4.0, 6.0), (4.0, 9.0, 5.0), (8.0, 7.0, 4.0)])
def test_of_plans_that_fall_short_the_nearest_one_is_kept(
    mover: KinematicMover, monkeypatch: pytest.MonkeyPatch, errors: tuple[float, ...]
) -> None:
    tries = Tries(mover, *((False, error) for error in errors))
    plan, _ = tried(monkeypatch, tries, samples_max=2 * FEW + LEARNING)
    assert not plan.reached
    assert plan.tip_error == 4.0
    assert len(tries.asked) == 3
    assert sum(plan.given_up) == 6 + 2 * FEW + LEARNING - len(plan.samples)


def test_few_samples_or_no_time_left_are_for_one_try(mover: KinematicMover, monkeypatch: pytest.MonkeyPatch) -> None:
    few = Tries(mover, (False, 9.0))
    tried(monkeypatch, few, samples_max=5)
    assert few.asked == [(5, 8.0, False)]
    late = Tries(mover, (False, 9.0))
    tried(monkeypatch, late, time_budget=0.0)
    assert len(late.asked) == 1


def test_pushes_are_not_made_shorter_than_the_least(mover: KinematicMover, monkeypatch: pytest.MonkeyPatch) -> None:
    tries = Tries(mover, (False, 9.0), (True, 0.1))
    tried(monkeypatch, tries, push_max=8.0, push_min=7.0)
    assert [push for _, push, _ in tries.asked] == [8.0, 7.0]


def test_all_tries_of_a_plan_share_one_time_budget(made_airway: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, tree = Robot(), made_airway.tree
    given: list[float] = []

    def none_found(*args: Any, **named: Any) -> RobotPlan:
        given.append(args[4].time_budget)
        time.sleep(0.1)
        start = args[0].start()
        return RobotPlan(
            steps=(start,),
            step_stages=(0,),
            stages=args[3],
            tallies=(),
            nodes=(),
            samples=(),
            tip_error=9.0,
            reached=False,
            reason="stuck",
        )

    monkeypatch.setattr(module, "plan_segmented", none_found)
    monkeypatch.setattr(module, "plan_at_once", lambda plan, *args, **named: plan)
    target = branch_target(tree, "right upper lobe", robot)
    entrance = tree.entrance_for(robot)
    simulator = KinematicMover(tree.wall, robot, entrance.pose)
    asked = PlannerSettings(time_budget=30.0)
    plan_way(tree, entrance, target, robot, asked, rng=np.random.default_rng(0), simulator=simulator)
    # By kinematics with few samples and with all, then in the simulator, until no sample is left; each takes a tenth of a second.
    assert len(given) == 2 + 4
    assert given[0] <= 30.0
    assert all(later <= earlier - 0.1 for earlier, later in pairwise(given))
