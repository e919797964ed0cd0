"""The pieces of a needle's path against integration, the matrix exponential and the printed formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from segmentation.errors import CaseError
from tubeplan_viz.needle.kinematics import (
    Controls,
    Pose,
    bend,
    cycled,
    duty_cycle,
    helix,
    insertion_pose,
    planar_pose,
    poses_along,
    push,
    twist,
)

ORIGIN = Pose(np.zeros(3), np.eye(3))


def spun(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def matrix(pose: Pose) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = pose.frame, pose.position
    return made


@given(st.floats(0.0, 0.2), st.floats(-3.0, 3.0), st.floats(0.0, 150.0))
@settings(max_examples=60, deadline=None)
def test_a_screw_is_the_exponential_of_its_twist(curvature: float, spin: float, length: float) -> None:
    made = helix(ORIGIN, length, curvature, spin)
    # 1e-9 of 150 mm is what double precision keeps through an exponential of norm 450.
    assert np.abs(matrix(made) - expm(length * twist(curvature, spin))).max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_a_path_is_the_product_of_the_exponentials_of_its_pieces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns, lengths, curvatures = rng.uniform(-3, 3, 5), rng.uniform(1, 50, 5), rng.uniform(0, 0.05, 5)
    curvatures[2] = 0.0
    expected = matrix(ORIGIN)
    for turn, length, curvature in zip(turns, lengths, curvatures, strict=True):
        bevel = np.eye(4)
        bevel[:3, :3] = spun(turn)
        expected = expected @ bevel @ expm(length * twist(curvature, 0.0))
    assert np.abs(matrix(push(ORIGIN, Controls(turns, lengths, curvatures)).end_pose()) - expected).max() < 1e-9


@pytest.mark.parametrize("spin", [0.0, 0.07])
def test_closed_forms_equal_the_integrated_rate_model(spin: float) -> None:
    """Huo et al. (2015), eq. 3: Euler angles about x, y, z; spin 0 is an arc, otherwise a helix."""
    kappa, start, length = 0.02, np.array([0.0, 0.0, 0.0, 0.3, -0.4, 0.9]), 80.0

    def rate(_: float, q: np.ndarray) -> np.ndarray:
        _, _, _, a, b, g = q
        return np.array(
            [
                np.sin(b),
                -np.cos(b) * np.sin(a),
                np.cos(b) * np.cos(a),
                kappa * np.cos(g) / np.cos(b),
                kappa * np.sin(g),
                -kappa * np.cos(g) * np.tan(b) + spin,
            ]
        )

    end = solve_ivp(rate, (0.0, length), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    made = helix(Pose(start[:3], euler(*start[3:])), length, kappa, spin)
    assert np.abs(made.position - end[:3]).max() < 1e-9
    assert np.abs(made.frame - euler(*end[3:])).max() < 1e-9


def euler(a: float, b: float, g: float) -> np.ndarray:
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return np.asarray(x @ y @ spun(g))


@pytest.mark.parametrize("turn", [0.0, 1.1, np.pi])
def test_the_tip_follows_the_printed_recursion(turn: float) -> None:
    """Huo et al. (2015), eq. 7: the tip from the arc's start, centre and tangent."""
    kappa, length = 0.02, 37.0
    arcs = push(ORIGIN, Controls(np.array([turn]), np.array([length]), np.array([kappa])))
    angle, center = kappa * length, arcs.normals[0] / kappa
    expected = (1.0 - np.cos(angle)) * center + np.array([0.0, 0.0, 1.0]) * np.sin(angle) / kappa
    assert np.allclose(arcs.tips, expected, atol=1e-12)
    # The normal is -y turned about the tangent by Rodrigues' formula (eq. 9).
    assert np.allclose(arcs.normals[0], spun(turn) @ np.array([0.0, -1.0, 0.0]), atol=1e-15)


def test_a_whole_population_is_bent_as_each_of_its_paths() -> None:
    rng = np.random.default_rng(3)
    turns, lengths, curvatures = rng.uniform(-3, 3, (7, 4)), rng.uniform(1, 40, (7, 4)), rng.uniform(0, 0.03, (7, 4))
    pose = insertion_pose([1.0, 2.0, 3.0], [0.3, -0.2, 0.9])
    tips = bend(pose, turns, lengths, curvatures).tips
    for k in range(7):
        assert np.allclose(tips[k], push(pose, Controls(turns[k], lengths[k], curvatures[k])).tips, atol=1e-12)


def test_points_along_a_piece_are_as_far_along_as_asked() -> None:
    arcs = push(ORIGIN, Controls(np.array([0.4]), np.array([60.0]), np.array([0.02])))
    places = np.linspace(0.0, 60.0, 6001)
    points = arcs.points(places[None])[0]
    # A chord of 0.01 mm is shorter than its arc by kappa^2 h^3 / 24, in all 6000 of them under 1e-8 mm.
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(60.0, abs=1e-7)
    assert np.allclose(points[-1], arcs.tips, atol=1e-12)


def test_many_short_duty_cycles_come_to_the_mean_curvature() -> None:
    """Spinning for a share of the push lowers the curvature; the error falls with the length of a cycle."""
    kappa, wanted, length = 0.02, 0.013, 60.0
    share = duty_cycle(wanted, kappa)
    aim = push(ORIGIN, Controls(np.zeros(1), np.array([length]), np.array([wanted]))).tips
    errors = []
    for cycles in (20, 40, 80):
        step = length / cycles
        pose = ORIGIN
        for _ in range(cycles):
            pose = helix(pose, share * step, kappa, 2.0 * np.pi * 2 / (share * step))
            pose = helix(pose, (1.0 - share) * step, kappa, 0.0)
        errors.append(float(np.linalg.norm(pose.position - aim)))
    slope = np.polyfit(np.log([20, 40, 80]), np.log(errors), 1)[0]
    assert slope < -0.9  # first order in the length of a cycle
    # The bent part of each cycle comes last, so the heading lags by half of what it bends while spinning is done.
    assert errors[-1] < 0.5 * wanted * share * (length / 80) * length


def test_a_duty_cycle_beyond_the_needle_is_refused() -> None:
    assert duty_cycle(0.0, 0.02) == 1.0
    assert duty_cycle(0.02, 0.02) == 0.0
    with pytest.raises(CaseError, match=r"0\.03 1/mm is asked of a needle that bends with 0 to 0\.02"):
        duty_cycle(0.03, 0.02)


def test_the_insertion_angle_turns_about_x() -> None:
    """Zhao et al. (2013), eq. 7: at -18.4349 degrees the needle points at (30, 90)."""
    pose = planar_pose([0.0, 0.0], np.radians(-18.434948822922))
    assert np.allclose(pose.tangent * np.hypot(30, 90), [0.0, 30.0, 90.0], atol=1e-9)


@given(st.floats(0.0, 100.0))
@settings(max_examples=40, deadline=None)
def test_what_is_left_of_a_path_ends_where_the_path_ends(pushed: float) -> None:
    controls = Controls(np.array([0.3, 2.0, -1.0]), np.array([30.0, 40.0, 30.0]), np.array([0.02, 0.0, 0.01]))
    ends = np.cumsum(controls.lengths)
    whole = push(ORIGIN, controls)
    piece = min(int(np.searchsorted(ends, pushed, side="right")), 2)
    begun = pushed - (ends[piece] - controls.lengths[piece])
    done = Controls(
        controls.turns[: piece + 1],
        np.append(controls.lengths[:piece], begun),
        controls.curvatures[: piece + 1],
    )
    here = push(ORIGIN, done).end_pose()
    rest = controls.after(pushed)
    tip = push(here, rest).tips if len(rest) else here.position
    if len(rest) and begun == 0.0:  # exactly at a seam the next turn is still to come, and `here` has made it
        return
    assert np.abs(tip - whole.tips).max() < 1e-9


def test_a_frame_that_is_no_rotation_is_refused() -> None:
    with pytest.raises(CaseError, match="is no rotation"):
        Pose(np.zeros(3), np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(CaseError, match="negative length"):
        Controls(np.zeros(1), np.array([-1.0]), np.array([0.02]))


def test_many_short_revolutions_hold_the_mean_curvature_to_first_order() -> None:
    """Screws and arcs in turn, each exact, against one arc of the mean curvature: the error falls with the cycle."""
    controls = Controls(np.array([0.3, 1.0]), np.array([40.0, 60.0]), np.array([0.012, 0.005]))
    end = push(ORIGIN, controls).end_pose()
    cycles = np.array([2.0, 1.0, 0.5, 0.25])
    off = [np.linalg.norm(cycled(ORIGIN, controls, 0.02, cycle=cycle).position - end.position) for cycle in cycles]
    order = np.polyfit(np.log(cycles), np.log(off), 1)[0]
    assert order == pytest.approx(1.0, abs=0.02)
    assert off[-1] < 0.1


def test_a_cycle_that_never_or_always_spins_is_an_arc_or_a_line() -> None:
    arc = Controls(np.array([0.7]), np.array([50.0]), np.array([0.02]))
    assert np.abs(cycled(ORIGIN, arc, 0.02, cycle=1.0).position - push(ORIGIN, arc).tips).max() < 1e-9
    line = Controls(np.array([0.7]), np.array([50.0]), np.array([0.0]))
    # Within one cycle the tip turns aside by no more than kappa times the cycle.
    off = np.linalg.norm(cycled(ORIGIN, line, 0.02, cycle=0.1).position - push(ORIGIN, line).tips)
    assert off < 0.02 * 50.0 * 0.1


def test_poses_along_a_path_are_those_of_its_pieces_whatever_the_ratio() -> None:
    rng = np.random.default_rng(3)
    controls = Controls(rng.uniform(-3, 3, 6), rng.uniform(1, 30, 6), rng.uniform(0, 0.03, 6))
    found = poses_along(ORIGIN, controls, np.array([1.0, 1.1]))
    for k, ratio in enumerate((1.0, 1.1)):
        arcs = push(ORIGIN, Controls(controls.turns, controls.lengths, ratio * controls.curvatures))
        assert np.abs(found[:, k, :3, 3] - arcs.ends).max() < 1e-9
        assert np.abs(found[:, k, :3, 2] - arcs.end_tangents).max() < 1e-9
        assert np.abs(found[:, k, :3, 1] + arcs.end_normals).max() < 1e-9
