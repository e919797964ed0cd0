"""The robot in MuJoCo: determinism, restored states, free bending, pushing, weight, and the lumen's wall."""

from __future__ import annotations

import builtins
import math
import sys
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.bench.axes import planar_axis
from tubeplan_viz.bench.meshing import constant_radius, sweep
from tubeplan_viz.bronchoscope.dynamics import DynamicsSettings, Simulator
from tubeplan_viz.bronchoscope.dynamics.chain import RIM_BALLS, Chain, hinge_angles
from tubeplan_viz.bronchoscope.dynamics.engine import engine
from tubeplan_viz.bronchoscope.dynamics.model import build_model
from tubeplan_viz.bronchoscope.kinematics import chain_transform, pose_along
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.robot import Robot

WEIGHTLESS = (0.0, 0.0, 0.0)
HALF = math.pi / 2


def order(*, proximal: tuple[float, float] = (0.0, 0.0), distal: tuple[float, float] = (0.0, 0.0), push: float = 0.0) -> Command:
    (phi_p, theta_p), (phi_d, theta_d) = proximal, distal
    return Command(phi_proximal=phi_p, theta_proximal=theta_p, phi_distal=phi_d, theta_distal=theta_d, push=push)


def in_the_open(phantoms: ModuleType, settings: DynamicsSettings, robot: Robot | None = None) -> Simulator:
    """In a lumen so wide that nothing is touched; the robot goes in along +y."""
    tube = phantoms.straight_tube(length=150.0, radius=70.0)
    return Simulator(tube.surface, robot or Robot(), pose_along([0.0, 5.0, 0.0], [0.0, 1.0, 0.0]), settings)


@pytest.fixture(scope="module", autouse=True)
def _with_mujoco() -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: the extra [dynamics]")


@pytest.fixture(scope="module")
def heavy(phantoms: ModuleType) -> Simulator:
    """Gravity across the robot."""
    return in_the_open(phantoms, DynamicsSettings(gravity=(0.0, 0.0, -9.81)))


@pytest.fixture(scope="module")
def bent() -> tuple[Simulator, list[Step]]:
    """The robot pushed round a bend of 25 mm in a tube of 5.6 mm, after a straight piece in which it fits."""
    straight, bend = 32.0, 25.0
    axis = planar_axis([(straight, 0.0), (1.6 * bend, 1.0 / bend), (8.0, 0.0)])
    surface = sweep(axis, constant_radius(2.8), edge=0.6, twisted=True, rng=np.random.default_rng(5))
    simulator = Simulator(surface, Robot(), pose_along([0.0, 1.0, 0.0], [0.0, 1.0, 0.0]))
    # The bend turns left from +y: its plane, as the base's own axes see it.
    side = simulator.entrance[:3, :3].T @ np.array([-1.0, 0.0, 0.0])
    theta = math.atan2(side[1], side[0])
    steps, push = [simulator.start()], 6.0
    for number in range(1, 8):
        base = 1.0 + number * push
        proximal, distal = (max(min(base + end - straight, 13.0), 0.0) / bend for end in (13.0, 26.0))
        steps.append(simulator.move(steps[-1], order(proximal=(proximal, theta), distal=(distal, theta), push=push)))
    return simulator, steps


def test_hinge_angles_give_the_chain_of_the_text_in_any_plane() -> None:
    robot, rng = Robot(), np.random.default_rng(1)
    for _ in range(10):
        (p, d), (a, b) = rng.uniform(0.0, HALF, 2), rng.uniform(-math.pi, math.pi, 2)
        pose, number = np.eye(4), 0
        angles = hinge_angles(robot, order(proximal=(p, a), distal=(d, b)))
        for length in (robot.proximal_length, robot.distal_length):
            piece = np.eye(4)
            piece[2, 3] = length / (robot.links + 1)
            pose = pose @ piece
            for _ in range(robot.links):
                first, second = angles[number]
                x, y = (first, second) if number % 2 == 0 else (second, first)
                turn_x, turn_y = np.eye(4), np.eye(4)
                turn_x[1:3, 1:3] = [[math.cos(x), -math.sin(x)], [math.sin(x), math.cos(x)]]
                turn_y[0, 0], turn_y[0, 2], turn_y[2, 0], turn_y[2, 2] = math.cos(y), math.sin(y), -math.sin(y), math.cos(y)
                pose = pose @ (turn_x @ turn_y if number % 2 == 0 else turn_y @ turn_x) @ piece
                number += 1
        wanted = chain_transform(robot.proximal_length, p, a, robot.links) @ chain_transform(
            robot.distal_length, d, b, robot.links
        )
        # Places and the direction of view are exact; about that direction universal joints leave a twist, small as the axes swap.
        np.testing.assert_allclose(pose[:3, 2:], wanted[:3, 2:], atol=1e-9)
        assert pose[:3, 0] @ wanted[:3, 0] > math.cos(math.radians(2.0))


def test_weightless_the_bent_robot_is_the_chain_of_constant_curvature(phantoms: ModuleType) -> None:
    simulator = in_the_open(phantoms, DynamicsSettings(gravity=WEIGHTLESS))
    step = simulator.move(simulator.start(), order(proximal=(1.2, 0.4), distal=(0.8, -2.0), push=5.0))
    made = np.linalg.inv(step.base) @ step.tip
    wanted = chain_transform(13.0, 1.2, 0.4, 12) @ chain_transform(13.0, 0.8, -2.0, 12)
    # The step ends when nothing moves faster than 1 mm/s; what is left of the motors' lag is below 0.1 mm.
    np.testing.assert_allclose(made[:3, 3], wanted[:3, 3], atol=0.1)


def test_both_sections_bend_by_at_least_171_of_180_degrees_under_gravity(heavy: Simulator) -> None:
    step = heavy.move(heavy.start(), order(proximal=(HALF, 0.7), distal=(HALF, 0.7), push=15.0))
    assert math.degrees(math.acos(float(np.clip(step.base[:3, 2] @ step.tip[:3, 2], -1.0, 1.0)))) >= 171.0


def test_the_straight_robot_sags_like_a_heavy_cantilever(phantoms: ModuleType) -> None:
    settings = DynamicsSettings(
        gravity=(0.0, 0.0, -9.81), active_stiffness=40.0, integral_share=0.0, settle_speed=0.05, settle_time=2.0
    )
    simulator = in_the_open(phantoms, settings)
    start = simulator.start()
    line, weight = Chain(robot=simulator.robot, settings=settings), 9.81
    # Hinges of the moments that their weight puts on them: each turns by M / k, and drops the tip by that times its distance.
    load = line.mass_per_length * weight  # N / mm
    places = np.append(line.active_hinges, line.passive_hinges[0])
    stiffness = np.append(line.active_stiffness, line.stiffness[0])
    sag = float(np.sum(0.5 * load * places**2 / stiffness * places))
    drop = float(start.tip[2, 3])
    # Small angles: 2 %; the last creep at 0.05 mm/s and relaxation of 20 ms: 0.001 mm.
    assert -drop == pytest.approx(sag, rel=0.02, abs=0.002)


def test_the_shaft_is_pushed_at_15_mm_per_second(heavy: Simulator) -> None:
    moments = heavy.moments(heavy.start(), order(push=6.0))
    speeds = np.array([moment.push_speed for moment in moments[: round(6.0 / 15.0 / heavy.settings.time_step)]])
    assert speeds.max() <= 15.0 * 1.05
    # After the start the speed is held within a hundredth.
    np.testing.assert_allclose(speeds[len(speeds) // 4 :], 15.0, rtol=0.01)
    assert moments[-1].push == pytest.approx(6.0, abs=0.05)


def test_the_same_command_from_the_same_state_has_the_same_outcome(bent: tuple[Simulator, list[Step]]) -> None:
    simulator, steps = bent
    command = steps[-1].command
    assert command is not None
    again = simulator.move(steps[-2], command)
    np.testing.assert_array_equal(again.state.values, steps[-1].state.values)
    np.testing.assert_array_equal(again.tip, steps[-1].tip)
    fresh = Simulator(simulator.wall.exact.surface, simulator.robot, np.array(simulator.entrance))
    np.testing.assert_array_equal(fresh.move(steps[-2], command).state.values, steps[-1].state.values)


def test_half_the_time_step_moves_the_tip_by_less_than_a_fifth_of_a_millimetre(bent: tuple[Simulator, list[Step]]) -> None:
    simulator, steps = bent
    finer = Simulator(
        simulator.wall.exact.surface, simulator.robot, np.array(simulator.entrance), DynamicsSettings(time_step=0.001)
    )
    step = finer.start()
    for made in steps[1:]:
        assert made.command is not None
        step = finer.move(step, made.command)
    assert np.linalg.norm(step.tip[:3, 3] - steps[-1].tip[:3, 3]) < 0.2


def test_no_part_leaves_a_curved_tube_whatever_is_ordered(bent: tuple[Simulator, list[Step]]) -> None:
    simulator, steps = bent
    rng, step = np.random.default_rng(7), steps[-1]
    for _ in range(4):
        command = order(
            proximal=(rng.uniform(0.0, HALF), rng.uniform(-math.pi, math.pi)),
            distal=(rng.uniform(0.0, HALF), rng.uniform(-math.pi, math.pi)),
            push=float(rng.uniform(-4.0, 6.0)),
        )
        step = simulator.move(step, command)
        assert step.body_clearance > -0.3
        axis = np.linalg.norm(step.body - step.body[-1], axis=1) >= simulator.robot.radius
        assert float(simulator.wall.exact.clearance(step.body[axis]).min()) > simulator.robot.radius - 0.3


@pytest.mark.parametrize(("friction", "directions"), [(0.0, 1), (0.1, 3), (0.3, 3)])
def test_every_contact_slides_with_the_stated_friction(friction: float, directions: int) -> None:
    chain = Chain(robot=Robot(), settings=DynamicsSettings(friction=friction))
    model = build_model(chain, pose_along([0.0, 0.0, 0.0], [0.0, 1.0, 0.0]), 4).model
    assert len(model.pair_dim) == 3 * (len(chain.balls[chain.balls < chain.hinges[27]]) + RIM_BALLS)  # three planes a ball
    assert (model.pair_dim == directions).all()  # the normal force alone, or two directions of sliding besides
    assert model.pair_friction[:, :2] == pytest.approx(np.full((len(model.pair_dim), 2), friction))


def test_a_motion_that_the_wall_halts_says_so_and_one_that_is_carried_out_does_not(bent: tuple[Simulator, list[Step]]) -> None:
    simulator, steps = bent
    for before, step in pairwise(steps):
        assert step.command is not None
        assert not step.halted
        assert step.state.inserted == pytest.approx(before.state.inserted + step.command.push, abs=1e-9)
    # Both sections bent by 90 degrees against each other span 26 mm across, in a tube of 5.6 mm.
    jammed = order(proximal=(HALF, 0.0), distal=(HALF, math.pi), push=8.0)
    step = simulator.move(steps[0], jammed)
    assert step.halted
    assert step.state.inserted < steps[0].state.inserted + 8.0 - 1.0
    # It halts before the depth at which motions halt is passed, by the little that is seen between two questions to the wall.
    assert step.body_clearance > -simulator.settings.halt_depth - 0.05


def test_the_wall_pushes_inwards_where_the_robot_touches(bent: tuple[Simulator, list[Step]]) -> None:
    simulator, steps = bent
    touching = [step for step in steps if len(step.forces)]
    assert touching, "nothing in the bend is touched"
    for step in touching:
        assert (step.forces > 0.0).all()
        # Contacts lie on the wall: within the skin and the penetration that the leak test allows.
        assert float(simulator.wall.exact.distance(step.contacts).max()) < 0.3


def test_commands_beyond_the_robot_are_refused_in_one_sentence(heavy: Simulator) -> None:
    start = heavy.start()
    with pytest.raises(CaseError, match=r"base -2.00 mm behind the entrance, expected 0 to 400 mm"):
        heavy.move(start, order(push=-2.0))
    with pytest.raises(CaseError, match=r"bends a section by 114.6 degrees, expected at most 90.0"):
        heavy.move(start, order(distal=(2.0, 0.0)))


def test_without_mujoco_one_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *args: Any, **kwargs: Any) -> ModuleType:
        if name == "mujoco":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", missing)
    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    with pytest.raises(CaseError, match=r'pip install "tubeplan\[dynamics\]"'):
        engine()
