"""The bound by a bend: never below what a path keeps, close to it where the truth is known, and the facts it rests on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from segmentation.arrays import FloatArray
from tubeplan_viz.bench.infeasible import clearance_at_bend
from tubeplan_viz.bench.models import torus_piece, variant_2
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube import TubeProblem, TubeSettings, pose_problem
from tubeplan_viz.tube.bend import STEP, bend_bound, excluded, excluding_bend, resampled, sharpest_windows
from tubeplan_viz.tube.cells import first_cells
from tubeplan_viz.tube.gates import Gate, ball_radius, passing

BEND, TUBE = 8.0, 2.5


@pytest.fixture(scope="module")
def quarter() -> TubeProblem:
    model = torus_piece(bend_radius=BEND, radius=TUBE)
    return pose_problem(model.surface, model.start, model.goal, Limits(curvature_max=0.1, clearance_min=2.0), TubeSettings())


@pytest.mark.parametrize("path_bend", [8.5, 10.0, 13.0, 40.0])
def test_in_a_quarter_bend_the_bound_is_what_the_arc_keeps(quarter: TubeProblem, path_bend: float) -> None:
    truth = clearance_at_bend(path_bend, bend=BEND, radius=TUBE)
    found = bend_bound(quarter.wall, quarter.centerline, curvature=1.0 / path_bend, ceiling=TUBE, limit=0.99 * TUBE)
    assert found is not None
    # The facets' chords lie within the wall by a thousandth of its radius at most; the bound is closed to 0.3 % of the ceiling.
    assert truth - 0.001 * TUBE <= found.bound <= truth + 0.008 * TUBE
    # The quarter's middle, where the arc comes nearest to the wall.
    middle = np.array([-BEND * (1.0 - np.sqrt(0.5)), BEND * np.sqrt(0.5), 0.0])
    assert np.linalg.norm(found.place - middle) < 1.5


@pytest.mark.parametrize("share", [0.995, 0.97, 0.8, 0.3])
def test_what_is_possible_in_a_quarter_bend_is_never_excluded(quarter: TubeProblem, share: float) -> None:
    for path_bend in (8.2, 10.0, 20.0):
        way = resampled(quarter.centerline, STEP * path_bend)
        clearance = share * clearance_at_bend(path_bend, bend=BEND, radius=TUBE)
        assert excluding_bend(first_cells(quarter.wall, clearance), way, 1.0 / path_bend, clearance) is None


def test_bound_of_two_bends_lies_above_the_planar_optimum_and_below_what_the_ends_keep() -> None:
    model = variant_2()
    problem = pose_problem(model.surface, model.start, model.goal, Limits(curvature_max=0.1, clearance_min=2.7), TubeSettings())
    found = bend_bound(problem.wall, problem.centerline, curvature=0.1, ceiling=3.0, limit=2.7)
    assert found is not None
    # The planar optimum (30 control points) is 2.585; three cross-sections see one of both bends and exclude 2.7 all the same.
    assert 2.585 <= found.bound <= 2.7


def test_no_clearance_that_a_path_keeps_is_ever_excluded(kept_paths: Callable[[int, int, float], Iterator[Any]]) -> None:
    windows_tried = 0
    for kept in kept_paths(11, 10, 0.03):
        wall, way, clearance, curvature = kept.wall, kept.way, kept.clearance, kept.curvature
        cells = first_cells(wall, clearance)
        assert excluding_bend(cells, way, curvature, clearance) is None
        # Windows that do not even look too sharp, too.
        for window in sharpest_windows(way, curvature, clearance)[:8]:
            bend = passing(cells, way, (window.first, window.middle, window.last), clearance=clearance, curvature=curvature)
            if bend is not None:
                windows_tried += 1
                assert not excluded(wall, bend, curvature, clearance)
                assert_crossed_in_order(kept.path(np.linspace(0.0, 1.0, 4001)), bend.gates)
    assert windows_tried >= 8


def assert_crossed_in_order(points: FloatArray, gates: tuple[Gate, Gate, Gate]) -> None:
    """Some crossing of each gate's plane within its radius, in the order of the gates."""
    at = -1
    for gate in gates:
        height = (points - gate.origin) @ gate.normal
        crossed = np.flatnonzero((height[:-1] <= 1e-9) & (height[1:] >= -1e-9))
        near = crossed[np.linalg.norm(points[crossed] - gate.origin, axis=1) <= gate.radius + 0.05]
        later = near[near >= at]
        assert len(later)
        at = int(later[0])


def test_any_three_points_of_a_curve_in_a_small_ball_lie_on_a_circle_no_smaller_than_the_limit() -> None:
    rng = np.random.default_rng(5)
    for _ in range(40):
        points = bending_curve(rng, pieces=5, length=0.95 * np.pi)
        s = np.linspace(0.0, 0.95 * np.pi, len(points))
        one, two, three = np.sort(rng.integers(0, len(points), (4000, 3)), axis=1).T
        apart = (two - one > 5) & (three - two > 5)
        one, two, three = one[apart], two[apart], three[apart]
        u, v = points[two] - points[one], points[three] - points[two]
        turn = np.arccos(np.clip((u * v).sum(1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1), -1.0, 1.0))
        chord = np.linalg.norm(points[three] - points[one], axis=1)
        # Fact 2, Schur: no longer than the unit arc over the chord; and fact 3 with it. Rounding of the steps' sum alone is left.
        assert np.all(s[three] - s[one] <= 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)) + 1e-6)
        assert np.all(turn <= 0.5 * (s[three] - s[one]) + 1e-6)


def test_a_curve_is_no_longer_in_a_ball_than_the_arc_across_it() -> None:
    rng = np.random.default_rng(6)
    for _ in range(40):
        points = bending_curve(rng, pieces=5, length=0.95 * np.pi)
        step = 0.95 * np.pi / (len(points) - 1)
        for radius in (0.3, 0.6, 0.9):
            center = points[rng.integers(len(points))] + rng.normal(0.0, 0.3 * radius, 3)
            inside = np.linalg.norm(points - center, axis=1) <= radius
            edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
            runs = edges[1::2] - edges[::2] - 1
            assert np.all(runs * step <= 2.0 * np.arcsin(radius) + 1e-9)


def bending_curve(rng: np.random.Generator, *, pieces: int, length: float, count: int = 600) -> FloatArray:
    """Points along arcs of curvature 1, each about another side, exactly joined."""
    point, tangent = np.zeros(3), np.array([1.0, 0.0, 0.0])
    made = [point]
    step = length / count
    for _ in range(pieces):
        normal = np.cross(tangent, rng.normal(size=3))
        normal /= np.linalg.norm(normal)
        angle = step * np.arange(1, count // pieces + 1)[:, None]
        made.extend(point + np.sin(angle) * tangent + (1.0 - np.cos(angle)) * normal)
        point = made[-1]
        turn = float(angle[-1, 0])
        tangent = np.cos(turn) * tangent + np.sin(turn) * normal
    return np.array(made)


def test_ball_holds_all_points_and_is_little_larger_than_the_smallest() -> None:
    rng = np.random.default_rng(4)
    on_sphere = rng.normal(size=(500, 3))
    on_sphere /= np.linalg.norm(on_sphere, axis=1, keepdims=True)
    # The smallest ball about many points all over a unit sphere is nearly that sphere.
    assert 0.98 <= ball_radius(3.0 * on_sphere) / 3.0 <= 1.05
