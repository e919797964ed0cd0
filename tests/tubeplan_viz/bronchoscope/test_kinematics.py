"""Constant curvature, its inverse, the chain of links, and the mover without forces, against closed forms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from segmentation.errors import CaseError, GeometryError
from tubeplan_viz.bench.models import straight_tube, torus_piece
from tubeplan_viz.bronchoscope.kinematic import KinematicMover, least_clearance
from tubeplan_viz.bronchoscope.kinematics import (
    bend_towards,
    chain_deviation,
    chain_transform,
    pose_along,
    section_transform,
)
from tubeplan_viz.bronchoscope.mover import Command
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.geometry import WallDistance

bends = st.floats(1e-3, np.pi / 2)
planes = st.floats(-np.pi, np.pi)


def command(phi: float = 0.0, theta: float = 0.0, push: float = 0.0, distal: float = 0.0) -> Command:
    return Command(phi_proximal=phi, theta_proximal=theta, phi_distal=distal, theta_distal=theta, push=push)


@given(bends, planes)
def test_a_section_is_an_arc_of_its_length(phi: float, theta: float) -> None:
    end = section_transform(13.0, phi, theta)
    # The chord of an arc of length L that turns by phi is 2 L / phi sin(phi / 2); its end looks phi away from its base.
    assert np.linalg.norm(end[:3, 3]) == pytest.approx(26.0 / phi * np.sin(0.5 * phi))
    assert end[2, 2] == pytest.approx(np.cos(phi))
    assert end[:3, :3].T @ end[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)
    half = section_transform(6.5, 0.5 * phi, theta)
    assert half @ half == pytest.approx(end, abs=1e-9)


@given(bends, planes)
def test_bend_towards_inverts_the_end_of_a_section(phi: float, theta: float) -> None:
    found = bend_towards(section_transform(13.0, phi, theta)[:3, 3], np.pi / 2)
    assert found[0] == pytest.approx(phi, abs=1e-9)
    assert np.cos(found[1] - theta) == pytest.approx(1.0, abs=1e-9)


@given(bends, st.integers(2, 40))
def test_the_chain_deviates_as_its_closed_form_says(phi: float, links: int) -> None:
    chain, arc = chain_transform(13.0, phi, 0.7, links), section_transform(13.0, phi, 0.7)
    assert np.linalg.norm(chain[:3, 3] - arc[:3, 3]) == pytest.approx(chain_deviation(13.0, phi, links), abs=1e-9)
    assert chain[:3, :3] == pytest.approx(arc[:3, :3])


def test_the_chain_of_the_text_stays_close_and_converges() -> None:
    robot = Robot()
    curve = [chain_deviation(robot.distal_length, np.radians(d), robot.links) for d in range(0, 91, 5)]
    assert curve[0] == 0.0
    assert all(a < b for a, b in pairwise(curve))
    # Chain less arc over L is about phi^2 / (12 n) for many links: 0.017 at 90 degrees, n = 12.
    assert curve[-1] / robot.distal_length == pytest.approx((np.pi / 2) ** 2 / (12 * 12), rel=0.1)
    finer = chain_deviation(robot.distal_length, np.pi / 2, 24)
    assert curve[-1] / finer == pytest.approx(2.0, rel=0.1)  # first order in 1 / n


def test_the_section_length_is_that_of_the_texts_figure() -> None:
    robot = Robot()
    assert robot.proximal_length == robot.links * 1.0 + 1.0  # L1 = n L2 + L3, L2 = L3 = 1
    assert robot.curvature_max == pytest.approx((np.pi / 2) / 13.0)


def test_a_pose_without_direction_is_refused() -> None:
    with pytest.raises(GeometryError, match="has no length"):
        pose_along([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def tube() -> WallDistance:
    return WallDistance(straight_tube(80.0, 9.0).surface)


@pytest.fixture(scope="module")
def mover(tube: WallDistance) -> KinematicMover:
    return KinematicMover(tube, Robot(), pose_along([0.0, 0.5, 0.0], [0.0, 1.0, 0.0]), far=np.inf)


def test_the_straight_robot_lies_on_the_axis(mover: KinematicMover) -> None:
    start = mover.start()
    assert start.tip[:3, 3] == pytest.approx([0.0, 26.5, 0.0])
    # The mesh's facets lie inside the cylinder by up to 9 (1 - cos(pi / n)), a hundredth of a millimetre.
    assert start.body_clearance == pytest.approx(9.0 - 1.75, abs=0.05)
    assert start.disc_clearance == pytest.approx(9.0 - 1.75, abs=0.05)


def test_the_base_follows_the_proximal_bend(mover: KinematicMover) -> None:
    phi = 0.5
    bent = mover.move(mover.start(), command(phi, 0.3))
    pushed = mover.move(bent, command(phi, 0.3, push=6.5))
    # With a steady bend the base goes along its own section: half a section turns it by half the bend.
    assert bent.base @ section_transform(6.5, 0.5 * phi, 0.3) == pytest.approx(pushed.base, abs=1e-9)
    assert pushed.track[-1] == pytest.approx(pushed.tip[:3, 3])
    assert np.linalg.norm(np.diff(pushed.body, axis=0), axis=1).max() <= 1.0 + 1e-9


def test_drawing_back_undoes_a_push(mover: KinematicMover) -> None:
    start = mover.start()
    there = mover.move(mover.move(start, command(0.4, 1.0)), command(0.4, 1.0, push=9.3))
    back = mover.move(there, command(0.4, 1.0, push=-9.3))
    assert back.base == pytest.approx(start.base, abs=1e-9)
    assert len(back.body) == len(start.body)


@pytest.mark.parametrize("back", [0.4, 4.65, 8.9])
def test_drawing_back_a_part_leaves_the_rest_of_the_way(mover: KinematicMover, back: float) -> None:
    phi, push, length = 0.4, 9.3, Robot().proximal_length
    bent = mover.move(mover.start(), command(phi, 1.0))
    part = mover.move(mover.move(bent, command(phi, 1.0, push=push)), command(phi, 1.0, push=-back))
    # The base goes back on its own arc, wherever on a stored piece of it that ends; and then on to where it began.
    left = push - back
    assert part.base == pytest.approx(bent.base @ section_transform(left, phi * left / length, 1.0), abs=1e-9)
    assert mover.move(part, command(phi, 1.0, push=-left)).base == pytest.approx(bent.base, abs=1e-9)


def test_the_same_command_gives_the_same_step(mover: KinematicMover) -> None:
    one, two = (mover.move(mover.start(), command(0.4, 1.0, push=5.0, distal=0.8)) for _ in range(2))
    assert one.tip.tolist() == two.tip.tolist()
    assert one.body_clearance == two.body_clearance


def test_a_bend_beyond_the_robots_is_refused(mover: KinematicMover) -> None:
    with pytest.raises(CaseError, match=r"bends a section by 100\.0 degrees, expected at most 90\.0"):
        mover.move(mover.start(), command(np.radians(100.0)))


def test_a_robot_bent_like_its_tube_touches_nowhere() -> None:
    # A torus of bend radius R: sections of the same curvature lie on its axis, wherever they are.
    bend_radius, robot = 20.0, Robot()
    wall = WallDistance(torus_piece(bend_radius, np.pi / 2 * 1.2, 3.0).surface)
    # The model runs from the origin along +y and turns left, towards -x.
    entrance = np.eye(4)
    entrance[:3, :3] = np.column_stack([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    phi = robot.proximal_length / bend_radius
    mover = KinematicMover(wall, robot, entrance, far=np.inf)
    step = mover.move(mover.start(), command(phi, 0.0, distal=phi))
    step = mover.move(step, command(phi, 0.0, push=8.0, distal=phi))
    away = np.abs(np.linalg.norm(step.body - [-bend_radius, 0.0, 0.0], axis=1) - bend_radius)
    assert away.max() < 1e-9
    assert step.body_clearance == pytest.approx(3.0 - robot.radius, abs=0.05)


@given(st.integers(0, 2**32 - 1))
def test_the_least_clearance_is_that_of_all_points(tube: WallDistance, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.uniform(-0.6, 1.0, (60, 3)), axis=0) * [0.3, 1.0, 0.3] + [0.0, 1.0, 0.0]
    every = float(tube.clearance(points).min())
    assert least_clearance(tube, points, np.inf) == pytest.approx(every, abs=1e-12)
    quick = least_clearance(tube, points, 2.0)
    assert quick <= every + 1e-12
    assert quick == pytest.approx(every, abs=1e-12) or quick >= 2.0
