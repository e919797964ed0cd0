"""Planar forms: exact cases by hand, limits kept on dense samples, optima against a grid."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from segmentation.errors import CaseError
from tubeplan_viz.bench.needle_grid import shortest_path
from tubeplan_viz.needle.bodies import Polygon, Sphere
from tubeplan_viz.needle.kinematics import push
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.planar import FORMS, PlanarPath, PlanarProblem, PlanarSettings, best, plan_planar
from tubeplan_viz.needle.planar_shapes import sides_of


def circle(y: float, z: float, radius: float) -> Sphere:
    return Sphere(np.array([0.0, y, z]), radius, "circle")


PRINTED = Scene((circle(0, 40, 10), circle(-40, 30, 15), circle(30, 50, 8)))


def problem(scene: Scene, target: tuple[float, float], **asked: float) -> PlanarProblem:
    return PlanarProblem(np.zeros(2), np.array(target, dtype=float), scene, PlanarSettings(**asked))  # type: ignore[arg-type]


def dense(path: PlanarPath) -> np.ndarray:
    assert path.pose is not None
    assert path.controls is not None
    arcs = push(path.pose, path.controls)
    return arcs.points(arcs.lengths[:, None] * np.linspace(0.0, 1.0, 4001)).reshape(-1, 3)


def test_without_obstacles_the_best_path_is_the_straight_line() -> None:
    """Zhao et al. (2013) print -18.4378 degrees and 94.7683 mm; the line is 94.8683 mm long."""
    line = best(plan_planar(problem(Scene(()), (30.0, 90.0))))
    assert line is not None
    assert line.form == "L"
    assert np.degrees(line.angle) == pytest.approx(-np.degrees(np.arctan2(30, 90)), abs=1e-12)
    assert line.length == pytest.approx(np.hypot(30, 90), abs=1e-12)


def test_a_single_arc_is_the_circle_through_both_ends() -> None:
    arc = next(p for p in plan_planar(problem(Scene(()), (0.0, 60.0), degree_max=1)) if p.form == "R")
    half = np.arcsin(30.0 / 50.0)
    assert arc.length == pytest.approx(2.0 * 50.0 * half, abs=1e-9)
    assert abs(arc.angle) == pytest.approx(half, abs=1e-12)


def test_a_single_arc_cannot_reach_beyond_its_diameter() -> None:
    arc = next(p for p in plan_planar(problem(Scene(()), (0.0, 101.0), degree_max=1)) if p.form == "R")
    assert not arc.feasible
    assert arc.reason is not None
    assert "101.0 mm away, more than the diameter 100 mm" in arc.reason


def test_forms_and_bend_sides() -> None:
    assert [len(FORMS[n]) for n in (1, 2, 3, 4)] == [2, 3, 5, 8]
    assert sides_of("RLR") == [(1, 0, 1), (1, 0, -1), (-1, 0, 1), (-1, 0, -1)]
    assert sides_of("RR") == [(1, -1), (-1, 1)]


def test_the_printed_case_is_solved_in_every_form_of_two_pieces_and_more() -> None:
    case = problem(PRINTED, (0.0, 90.0))
    begun = time.process_time()
    paths = plan_planar(case)
    spent = time.process_time() - begun
    # One second is what the whole case may take on an idle core; the tests may share theirs.
    assert spent < 3.0
    assert [p.form for p in paths if not p.feasible] == ["L", "R"]
    assert all(p.reason is not None and "obstacle" in p.reason for p in paths if not p.feasible)
    for path in paths:
        if path.feasible:
            points = dense(path)
            assert np.linalg.norm(points[-1] - [0.0, 0.0, 90.0]) < 1e-6
            assert np.linalg.norm(points[0]) == 0.0
            for body in PRINTED.obstacles:
                assert body.distance(points).min() >= -1e-9
    two, three, whole = best(paths, 2), best(paths, 3), best(paths)
    assert two is not None
    assert three is not None
    assert (two.form, three.form) == ("RL", "LRL")  # as printed
    assert whole is two
    assert two.length < 93.72  # printed, with a path that misses the target by 6.8 mm
    assert three.length < 92.79


@pytest.mark.parametrize(("seed", "radius"), [(0, 50.0), (1, 50.0), (2, 20.0), (3, 8.0)])
def test_every_form_is_at_its_optimum_against_brute_force(seed: int, radius: float) -> None:
    """Up to three pieces, where the grid is fine; `tubeplan bench needle2d` holds four pieces against it in 200 scenes."""
    rng = np.random.default_rng(seed)
    scene = Scene(tuple(circle(rng.uniform(-30, 30), rng.uniform(25, 70), rng.uniform(4, 11)) for _ in range(4)))
    case = problem(scene, (float(rng.uniform(-15, 15)), 95.0), safety=1.5, degree_max=3, radius=radius)
    for path in plan_planar(case):
        least = shortest_path(case, path.form, 1.01 * path.length, rng)
        assert path.length <= least * 1.001
        assert path.feasible or np.isinf(least)


def test_no_path_of_the_printed_case_is_shorter_than_its_bound_by_brute_force_and_all_are_near_theirs() -> None:
    case = problem(PRINTED, (0.0, 90.0))
    for path in plan_planar(case):
        if path.feasible:
            bound = path.bound - path.degree * case.settings.weight_degree
            assert 0.999 * path.length <= bound <= path.length
            assert shortest_path(case, path.form, bound, np.random.default_rng(3)) == np.inf
        else:
            assert path.bound == np.inf  # certain that there is none


def test_a_piece_more_costs_no_more_than_its_least_length() -> None:
    """A form holds every form with a piece less, but for a piece of the least length: 0.001 mm here, and 0.1 % allowed."""
    paths = {path.form: path for path in plan_planar(problem(PRINTED, (0.0, 90.0), piece_min=1e-3))}
    compared = 0
    for form, path in paths.items():
        for k in range(len(form)):
            simpler = paths.get(form[:k] + form[k + 1 :])
            if simpler is not None and simpler.feasible:
                assert path.length <= 1.001 * simpler.length
                compared += 1
    assert compared >= 30


def test_brute_force_knows_the_line_and_the_arc() -> None:
    free = problem(Scene(()), (30.0, 90.0))
    rng = np.random.default_rng(0)
    assert shortest_path(free, "L", np.inf, rng) == pytest.approx(np.hypot(30, 90), abs=1e-12)
    assert shortest_path(free, "R", np.inf, rng) == pytest.approx(100.0 * np.arcsin(np.hypot(30, 90) / 100.0), abs=1e-12)
    # An arc of 1 mm before the tangent: the arc turns by 1 / 50, so the chord bends by half of that over 94 mm of line.
    short = shortest_path(free, "RL", np.inf, rng)
    assert np.hypot(30, 90) < short < np.hypot(30, 90) + 1e-3


def test_brute_force_refuses_what_it_is_not_written_for() -> None:
    wall = Polygon(np.array([[-40.0, 45], [6, 45], [6, 50]]))
    with pytest.raises(TypeError, match="written for circles only"):
        shortest_path(problem(Scene((wall,)), (-5.0, 95.0)), "LR", np.inf, np.random.default_rng(0))


def test_brute_force_finds_a_path_that_is_not_the_shortest() -> None:
    """A planner that gave a path 0.5 % too long would not pass: the grid finds the shorter one."""
    case = problem(PRINTED, (0.0, 90.0))
    for path in plan_planar(case):
        if path.degree == 4:
            assert shortest_path(case, path.form, 1.005 * path.length, np.random.default_rng(0)) < 1.003 * path.length


@given(st.floats(0.0, 2.0 * np.pi), st.integers(0, 3))
@settings(max_examples=6, deadline=None)
def test_mirroring_the_scene_mirrors_the_plan(shift: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = rng.uniform([-25, 30], [25, 65], (3, 2))
    both = []
    for sign in (1.0, -1.0):
        scene = Scene(tuple(circle(sign * y, z, 6.0) for y, z in at))
        chosen = best(plan_planar(problem(scene, (sign * 8.0 * np.sin(shift), 90.0), safety=1.0, degree_max=2)))
        assert chosen is not None
        both.append(chosen)
    # Ways to either side of an obstacle may be as long as each other to within what two free lengths are searched to.
    assert both[0].length == pytest.approx(both[1].length, rel=1e-5)


def test_polygons_are_kept_clear_of() -> None:
    wall = Polygon(np.array([[-40.0, 45], [6, 45], [6, 50], [-40, 50]]))
    chosen = best(plan_planar(problem(Scene((wall,)), (-5.0, 95.0), safety=2.0, degree_max=3)))
    assert chosen is not None
    assert wall.distance(dense(chosen)).min() >= 2.0
    assert wall.distance(dense(chosen)).min() < 2.1  # no farther than it must: the shortest path passes close


@pytest.mark.parametrize(
    ("corners", "simple"),
    [
        ([[-60.0, 46.0], [60.0, 46.0], [60.0, 46.5], [-60.0, 46.5]], []),  # thinner than any spacing of samples
        ([[0.0, 40.0], [10.0, 50.0], [0.0, 60.0], [-10.0, 50.0]], ["R"]),  # the line meets two corners exactly
        ([[20.0, 60.0], [40.0, 60.0], [40.0, 80.0]], ["L", "R"]),  # one arc cuts a corner off, the other does not
    ],
    ids=["thin wall", "through corners", "cut corner"],
)
def test_without_a_safety_distance_no_form_goes_through_a_polygon(corners: list[list[float]], simple: list[str]) -> None:
    body = Polygon(np.array(corners))
    feasible = [p for p in plan_planar(problem(Scene((body,)), (0.0, 90.0), degree_max=3)) if p.feasible]
    for path in feasible:
        # 4000 steps over at most 180 mm; a chord of 0.045 mm leaves an arc of radius 50 mm by 5e-6 mm.
        assert body.distance(dense(path)).min() > -5e-6, path.form
    assert [path.form for path in feasible if path.degree == 1] == simple


def test_danger_weighs_against_length() -> None:
    short = best(plan_planar(problem(PRINTED, (0.0, 90.0), safety=1.0, degree_max=2)))
    wary = best(plan_planar(problem(PRINTED, (0.0, 90.0), safety=1.0, degree_max=2, weight_danger=20.0)))
    assert short is not None
    assert wary is not None
    assert wary.length > short.length
    assert wary.danger < short.danger


def test_a_blocked_target_has_no_path_and_every_form_says_why() -> None:
    ring = tuple(circle(18 * np.sin(a), 80 + 18 * np.cos(a), 8.0) for a in np.arange(8) * np.pi / 4)
    paths = plan_planar(problem(Scene(ring), (0.0, 80.0), safety=1.0, degree_max=3))
    assert best(paths) is None
    assert all(path.reason for path in paths)


def test_places_within_obstacles_are_refused() -> None:
    with pytest.raises(CaseError, match=r"the target \(0, 90\) mm is -5\.00 mm from obstacle 1"):
        problem(Scene((circle(0, 90, 5),)), (0.0, 90.0))
    with pytest.raises(CaseError, match=r"the entry .* expected at least safety_mm = 3"):
        problem(Scene((circle(0, -7, 5),)), (0.0, 90.0), safety=3.0)


def test_the_same_case_gives_the_same_plan() -> None:
    first, second = (best(plan_planar(problem(PRINTED, (0.0, 90.0), degree_max=3))) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.controls is not None
    assert second.controls is not None
    assert (first.controls.lengths == second.controls.lengths).all()
