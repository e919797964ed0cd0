"""All commands of the last stretch at once: its derivatives, and a way that pushes one by one do not find."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tubeplan_viz.bronchoscope.guide import make_guide
from tubeplan_viz.bronchoscope.kinematic import KinematicMover, active_points
from tubeplan_viz.bronchoscope.planner import plan_segmented
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings, RobotPlan
from tubeplan_viz.bronchoscope.sequence import Problem, plan_at_once, shaken, shapes
from tubeplan_viz.bronchoscope.target import Target
from tubeplan_viz.bronchoscope.way import stages_on

NAME = "right middle lobe"


@pytest.fixture(scope="module")
def narrow(made_airway: Any) -> tuple[Any, ...]:
    """The middle of a branch of 4.5 mm behind a bend of 55 and one of 36 degrees, and few samples towards it."""
    robot, tree = Robot(), made_airway.tree
    number = next(k for k in tree.children[tree.named(NAME)])
    depth = 0.5 * tree.branches[number].length
    target = Target(branch=number, depth=depth, point=tree.place(number, depth))
    entrance = tree.entrance_for(robot)
    guide = make_guide(tree.line_to(number, depth, begin=entrance.offset), robot)
    stages = stages_on(tree, entrance, target, guide, robot)
    mover = KinematicMover(tree.wall, robot, entrance.pose)
    settings = PlannerSettings(samples_max=8)
    plan = plan_segmented(mover, robot, guide, stages, settings, wall=tree.wall, rng=np.random.default_rng(0))
    return tree, robot, guide, mover, settings, plan


def test_shapes_are_those_of_one_robot_at_a_time() -> None:
    rng, robot = np.random.default_rng(0), Robot()
    bends = rng.uniform(-1.0, 1.0, (5, 2, 2))
    bends[0] = 0.0
    bases = np.broadcast_to(np.eye(4), (5, 4, 4))
    for found, bend in zip(shapes(robot, bases, bends), bends, strict=True):
        # A straight section is taken as one that bends by 1e-7 rad: its tip moves by 13 mm times half of that.
        assert np.abs(found - active_points(robot, np.eye(4), bend)[0]).max() < 1e-5


def test_the_derivatives_are_those_of_the_residuals(narrow: Any) -> None:
    tree, robot, guide, _, _, plan = narrow
    start = plan.steps[0]
    at = guide.nearest(start.tip[:3, 3], 0.0, 60.0)
    problem = Problem(start, robot, guide, tree.wall, np.asarray(plan.stages[-1].goal), at)
    knots, length = problem.guess()
    course = problem.course(knots, length)
    residuals, places, outward = problem.residuals(course, knots, 0.25, 0.5)
    slopes = problem.slopes(course, knots, length, places, outward, 0.5)
    assert slopes.shape == (len(residuals), 4 * problem.knots + 1)
    step = 1e-5
    for column in np.random.default_rng(1).integers(0, 4 * problem.knots, 5):
        other = knots.copy()
        other[1:].reshape(-1)[column] += step
        gone = problem.course(other, length).points - course.points
        # The wall is taken as the plane across the way to its nearest point, as the derivatives take it.
        told = np.concatenate([-np.einsum("ki,ki->k", outward, gone[places]), 0.5 * 0.3 * gone[-1, -1]]) / step
        # A bend of 1 rad moves places by tens of millimetres; second order and the middle rule leave a thousandth.
        assert told == pytest.approx(slopes[: len(told), column], abs=5e-3)


def test_bends_beyond_the_robots_and_changes_of_a_bend_are_what_they_cost(narrow: Any) -> None:
    tree, robot, guide, _, _, plan = narrow
    start = plan.steps[0]
    problem = Problem(
        start, robot, guide, tree.wall, np.asarray(plan.stages[-1].goal), guide.nearest(start.tip[:3, 3], 0.0, 60.0)
    )
    knots, length = problem.guess()
    knots = 0.0 * knots
    course = problem.course(knots, length)
    plain = problem.residuals(course, knots, 0.25, 0.5)[0]
    bent = knots.copy()
    bent[3, 1] = (robot.bend_max + 0.2) * np.array([0.6, 0.8])
    # The same course: only what the knots say of themselves differs. 10 per rad too much; 0.5 * 0.02 per rad of each change.
    over = problem.residuals(course, bent, 0.25, 0.5)[0]
    assert float(over @ over - plain @ plain) == pytest.approx((10.0 * 0.2) ** 2 + 2.0 * (0.01 * (robot.bend_max + 0.2)) ** 2)


def test_all_commands_at_once_find_the_way_that_pushes_one_by_one_do_not(narrow: Any) -> None:
    tree, robot, guide, mover, settings, plan = narrow
    assert not plan.reached
    found: RobotPlan = plan_at_once(plan, mover, robot, guide, settings, wall=tree.wall)
    assert found.reached
    assert found.tip_error <= settings.goal_error_max
    step = mover.start()
    for told in found.steps[1:]:
        step = mover.move(step, told.command)
        assert step.body_clearance >= 0.0
        assert step.disc_clearance >= 0.0
    # The plan is a branch of its tree, and the same one every time.
    assert [node.step for node in found.nodes if node.step is found.steps[-1]]
    again = plan_at_once(plan, mover, robot, guide, settings, wall=tree.wall)
    assert [told.command for told in again.steps] == [told.command for told in found.steps]


def test_the_first_attempt_begins_with_the_guess() -> None:
    knots = np.ones((6, 2, 2))
    assert shaken(knots, 0) is knots
    assert shaken(knots, 1)[0] == pytest.approx(knots[0])
    assert np.abs(shaken(knots, 1)[1:] - knots[1:]).max() > 0.01
