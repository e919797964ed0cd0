"""The best path: as good as it can be, inside its proof, and where it should be."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from segmentation.errors import CaseError
from segmentation.mesh import Surface
from tubeplan_viz.bench.infeasible import clearance_at_bend
from tubeplan_viz.bench.models import Model, bent_cylinder_1, straight_tube, torus_piece, variant_2
from tubeplan_viz.cases.tube import case_table, make_case
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import SplineCurve
from tubeplan_viz.plan import Limits, PlanStatus
from tubeplan_viz.profile import certify
from tubeplan_viz.tube import OptimalSettings, TubeProblem, TubeSettings, conclude, pose_problem, tube_rounds, tube_steps

# Largest least clearance of variant 2 (tube radius 3 mm) at 0.100 1/mm, computed once in its plane with 30 control points.
BEST_VARIANT_2 = 2.585


def posed(model: Model, limits: Limits, **settings: object) -> TubeProblem:
    optimal = OptimalSettings(**settings)  # type: ignore[arg-type]
    return pose_problem(model.surface, model.start, model.goal, limits, TubeSettings(method="optimal", optimal=optimal))


def answer(problem: TubeProblem) -> SplineCurve:
    return deque(tube_rounds(problem), maxlen=1)[0].curve


@pytest.fixture(scope="module")
def tight_bends() -> TubeProblem:
    """Variant 2, whose first bend of 8 mm is sharper than the limit of 10 mm."""
    return posed(variant_2(), Limits(curvature_max=0.1, clearance_min=1.5))


@pytest.fixture(scope="module")
def best(tight_bends: TubeProblem) -> SplineCurve:
    return answer(tight_bends)


def test_variant_2_comes_within_one_percent_of_its_optimum_and_is_proved(tight_bends: TubeProblem, best: SplineCurve) -> None:
    certificate = certify(best, tight_bends.wall, tight_bends.limits)
    assert certificate.holds
    assert certificate.clearance_lower_bound >= 0.99 * BEST_VARIANT_2
    # The optimum is that of the smooth tube; a proof of more than it would be a false proof.
    assert certificate.clearance_lower_bound <= 1.005 * BEST_VARIANT_2


def test_dense_samples_keep_within_the_proof(tight_bends: TubeProblem, best: SplineCurve) -> None:
    certificate = certify(best, tight_bends.wall, tight_bends.limits)
    u = np.linspace(0.0, 1.0, 5001)
    assert tight_bends.wall.clearance(best(u)).min() >= certificate.clearance_lower_bound
    assert best.curvature(u).max() <= certificate.curvature_upper_bound


def test_path_goes_from_start_to_goal(tight_bends: TubeProblem, best: SplineCurve) -> None:
    np.testing.assert_allclose(best([0.0, 1.0]), [tight_bends.start, tight_bends.goal], atol=1e-9)


def test_noise_of_the_line_begun_from_costs_under_half_a_percent(tight_bends: TubeProblem, best: SplineCurve) -> None:
    points = np.array(tight_bends.centerline.points)
    points[1:-1] += np.random.default_rng(4).normal(0.0, 0.2, points[1:-1].shape)
    shaken = replace(tight_bends, centerline=Centerline(points, tight_bends.wall.distance(points)))
    clean = certify(best, tight_bends.wall, tight_bends.limits)
    noisy = certify(answer(shaken), tight_bends.wall, tight_bends.limits)
    assert noisy.holds
    assert noisy.clearance_lower_bound >= 0.995 * clean.clearance_lower_bound


def test_answer_moves_with_the_anatomy(tight_bends: TubeProblem, best: SplineCurve) -> None:
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    shift = np.array([12.0, -30.0, 7.0])
    surface = tight_bends.surface
    moved = Surface(surface.vertices @ turn.T + shift, surface.faces, surface.face_cap, surface.caps, surface.frame)
    problem = pose_problem(
        moved, turn @ tight_bends.start + shift, turn @ tight_bends.goal + shift, tight_bends.limits, tight_bends.settings
    )
    there = certify(answer(problem), problem.wall, problem.limits)
    here = certify(best, tight_bends.wall, tight_bends.limits)
    # Half a percent: the jitter of the Voronoi diagram does not turn along, so the lines begun from differ.
    assert there.holds
    assert there.clearance_lower_bound == pytest.approx(here.clearance_lower_bound, rel=0.005)


def test_straight_tube_is_passed_along_its_axis() -> None:
    model = straight_tube()
    problem = posed(model, Limits(curvature_max=0.1, clearance_min=2.0))
    certificate = certify(answer(problem), problem.wall, problem.limits)
    # No path keeps more than the facets' inscribed circle about the axis.
    inscribed = problem.wall.distance(model.axis_points).min()
    assert 0.995 * inscribed <= certificate.clearance_lower_bound <= inscribed + 0.01


@pytest.mark.parametrize("bend", [13.0, 21.0])
def test_clearance_is_given_for_a_bend_as_far_as_the_closed_form_asks(bend: float) -> None:
    # A quarter bend of 8 mm: a stiffer path must leave the axis, at 21 mm by more than half of the tube's radius.
    problem = posed(torus_piece(bend_radius=8.0, radius=2.5), Limits(curvature_max=1.0 / bend, clearance_min=0.5))
    certificate = certify(answer(problem), problem.wall, problem.limits)
    assert certificate.holds
    # Within 2 %: the facets lie inside the tube, and the proof falls short of the path by 0.002 mm.
    assert certificate.clearance_lower_bound == pytest.approx(clearance_at_bend(bend), rel=0.02)


def test_optimal_is_no_worse_than_feature_iteration_under_the_same_curvature_limit() -> None:
    model, limits = bent_cylinder_1(), Limits(curvature_max=0.1, clearance_min=1.5)
    problem = posed(model, limits)
    local = replace(problem, settings=replace(problem.settings, method="feature_iteration"))
    ours, theirs = (certify(answer(p), problem.wall, limits) for p in (problem, local))
    assert ours.holds
    assert ours.clearance_lower_bound >= theirs.clearance_lower_bound
    # What 30 control points allow in the plane.
    assert ours.clearance_lower_bound >= 0.99 * 2.998


def test_second_aim_shortens_or_straightens_to_the_closed_form() -> None:
    # A quarter bend of 20 mm in a tube of 3 mm: with 1 mm of clearance the path keeps 18 to 22 mm from the bend's centre.
    bend, inner = 20.0, 18.0
    model, limits = torus_piece(bend_radius=bend, radius=3.0), Limits(curvature_max=0.1, clearance_min=1.0)
    short, straight = (posed(model, limits, objective=name) for name in ("length", "curvature"))
    curves = {name: answer(p) for name, p in (("short", short), ("straight", straight))}
    proofs = {name: certify(curve, short.wall, limits) for name, curve in curves.items()}
    assert all(proof.holds for proof in proofs.values())
    # The shortest way between both ends is a thread about the inner circle: tangent, arc, tangent.
    thread = 2.0 * np.sqrt(bend**2 - inner**2) + inner * (0.5 * np.pi - 2.0 * np.arccos(inner / bend))
    # No shorter, but for the facets' clearance; the spline rounds off where the thread's curvature jumps.
    assert 0.999 * thread < curves["short"].length < 1.001 * thread
    # The straightest is one arc through both ends that just reaches the inner circle at its middle.
    rise = inner - bend / np.sqrt(2.0)
    arc = 2.0 * rise / (rise**2 + 0.5 * bend**2)
    assert 0.99 * arc < proofs["straight"].curvature_upper_bound < 1.02 * arc
    # The shortest bends as sharply as the inner circle, or more where it rounds off.
    assert proofs["short"].curvature_upper_bound > 1.0 / inner


@pytest.mark.parametrize("objective", ["length", "curvature"])
def test_in_a_straight_tube_the_shortest_and_the_straightest_path_is_the_chord(objective: str) -> None:
    tube = straight_tube()
    # From 1 mm on one side of the axis to 1 mm on the other: the chord keeps 2 mm throughout.
    aside = np.array([1.0, 0.0, 0.0])
    start, goal = tube.start + aside, tube.goal - aside
    settings = TubeSettings(method="optimal", optimal=OptimalSettings(objective=objective))
    problem = pose_problem(tube.surface, start, goal, Limits(curvature_max=0.1, clearance_min=1.5), settings)
    curve = answer(problem)
    assert certify(curve, problem.wall, problem.limits).holds
    # A path that strays by h from a chord of length c is longer by no less than 2 h^2 / c: 0.01 % here is 0.3 mm of straying.
    chord = float(np.linalg.norm(goal - start))
    assert chord <= curve.length + 1e-9
    assert curve.length <= 1.0001 * chord
    if objective == "curvature":
        assert curve.curvature(np.linspace(0.0, 1.0, 400)).max() < 0.002


def test_directions_at_the_ends_are_kept() -> None:
    model = torus_piece()
    first, last = (0.25, 1.0, 0.1), (-1.0, 0.1, -0.1)
    problem = posed(model, Limits(curvature_max=0.12, clearance_min=1.0), start_direction=first, goal_direction=last)
    curve = answer(problem)
    for tangent, wanted in zip(curve.tangent([0.0, 1.0]), (first, last), strict=True):
        np.testing.assert_allclose(tangent, np.array(wanted) / np.linalg.norm(wanted), atol=1e-4)
    assert certify(curve, problem.wall, problem.limits).holds


def test_every_round_is_a_step_with_words_and_the_last_is_the_plan(tight_bends: TubeProblem) -> None:
    problem = posed(torus_piece(), Limits(curvature_max=0.1, clearance_min=2.0))
    steps = list(tube_steps(problem))
    assert [step.index for step in steps] == list(range(len(steps)))
    assert len(steps) > 2
    assert all(step.decisions for step in steps)
    plan = conclude(problem, steps)
    assert plan.status is PlanStatus.OK
    assert plan.reason is None
    assert plan.certificate.holds
    assert plan.curve is steps[-1].curve


def test_the_same_problem_gives_the_same_path(tight_bends: TubeProblem, best: SplineCurve) -> None:
    np.testing.assert_array_equal(answer(tight_bends).control_points, best.control_points)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"objective": "speed"}, "objective is 'speed', expected clearance, length, curvature"),
        ({"control_spacing": 0.1}, "control_spacing is 0.1 mm"),
        ({"keep": 0.5}, "keep is 0.5"),
        ({"start_direction": (0.0, 0.0, 0.0)}, "not all zero"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        OptimalSettings(**settings)  # type: ignore[arg-type]


def test_case_file_carries_the_settings() -> None:
    tube = {"objective": "length", "control_spacing_mm": 3.0, "start_direction": [0.0, 1.0, 0.5]}
    table = {"input": {"mesh": "tube.stl"}, "planner": {"method": "optimal"}, "tube": tube}
    case = make_case(table)
    settings = case.tube_settings.optimal
    assert (settings.objective, settings.control_spacing, settings.start_direction) == ("length", 3.0, (0.0, 1.0, 0.5))
    assert case_table(case)["tube"].items() >= tube.items()
    with pytest.raises(CaseError, match="start_direction"):
        make_case({**table, "tube": {"start_direction": [1.0, 2.0]}})
