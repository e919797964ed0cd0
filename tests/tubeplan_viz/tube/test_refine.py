"""The feature iteration: what never moves, when it ends, and what each round does."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.geometry import circumcenter
from tubeplan_viz.plan import Feature, FeatureKind, Limits
from tubeplan_viz.tube import FeatureSettings, RefineSettings, TubeProblem, tube_rounds
from tubeplan_viz.tube import refine as refine_module
from tubeplan_viz.tube.refine import Round, features_of_runs, first_features, relax, runs


def rounds_of(problem: TubeProblem, limits: Limits | None = None, **settings: float) -> list[Round]:
    """All rounds, with other limits or numbers of the iteration."""
    refine = replace(problem.settings.refine, **settings)  # type: ignore[arg-type]
    changed = replace(problem, limits=limits or problem.limits, settings=replace(problem.settings, refine=refine))
    return list(tube_rounds(changed))


def node(x: float, y: float, *, moved: int = 0, kind: FeatureKind = FeatureKind.NODE) -> Feature:
    return Feature(kind=kind, point=np.array([x, y, 0.0]), u=0.5, moved=moved)


def test_nothing_above_the_limits_ends_after_the_first_spline(straight: TubeProblem) -> None:
    rounds = rounds_of(straight)
    assert [state.index for state in rounds] == [0]
    assert (rounds[0].moved, rounds[0].added) == (0, 0)


def test_start_and_goal_never_move_and_no_feature_is_lost(variant: TubeProblem) -> None:
    rounds = rounds_of(variant)
    assert len(rounds) > 10
    for state, after in pairwise(rounds):
        np.testing.assert_array_equal(after.features[0].point, variant.start)
        np.testing.assert_array_equal(after.features[-1].point, variant.goal)
        assert len(after.features) == len(state.features) + after.added
        assert after.index == state.index + 1
        assert after.moved + after.added > 0
        u = [feature.u for feature in after.features]
        assert u == sorted(u)
        np.testing.assert_allclose(after.curve(u), [f.point for f in after.features], atol=1e-9)
        still = sum(f.moved for f in after.features) - sum(f.moved for f in state.features)
        assert still == after.moved


def test_the_iteration_brings_the_sharpest_bend_under_the_limit(variant: TubeProblem) -> None:
    rounds = rounds_of(variant)
    u = np.linspace(0.0, 1.0, 4001)
    worst = [float(state.curve.curvature(u).max()) for state in rounds]
    assert worst[0] > 0.12
    assert worst[-1] <= 0.1
    assert rounds[-1].index <= 150
    # While features only move, the bend opens: no round without an insertion makes the worst much worse.
    for before, after, state in zip(worst, worst[1:], rounds[1:], strict=False):
        if state.added == 0:
            assert after < before + 0.002


def test_rounds_end_when_neither_set_nor_curvature_changes(variant: TubeProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refine_module, "relax", lambda features, moving, settings: features)
    # Round 1 finds the set first; in rounds 2, 3 and 4 it is unchanged, and the fourth is not made.
    for unchanged in (1, 3):
        rounds = rounds_of(variant, Limits(curvature_max=0.1, clearance_min=0.0), unchanged_rounds=unchanged)
        assert rounds[-1].index == unchanged


@pytest.mark.parametrize("limit", [0, 1, 5])
def test_no_more_rounds_than_allowed(limit: int, variant: TubeProblem) -> None:
    assert rounds_of(variant, max_rounds=limit)[-1].index == limit


def test_a_short_clearance_adds_the_nearest_centerline_point(cylinder_1: TubeProblem) -> None:
    # Only four nodes: the spline cuts the corners of the bends and comes too near to the wall.
    features = FeatureSettings(t6=40)
    coarse = replace(
        cylinder_1, settings=replace(cylinder_1.settings, features=features), limits=Limits(curvature_max=1.0, clearance_min=2.0)
    )
    rounds = list(tube_rounds(coarse))
    added = [state for state in rounds if state.added]
    assert added
    assert rounds[-1].index < 20
    for feature in rounds[-1].features:
        if feature.kind is FeatureKind.CLEARANCE:
            # With this curvature limit nothing moves, so it still lies on the line.
            assert np.linalg.norm(coarse.centerline.points - feature.point, axis=1).min() < 1e-12
    assert "centerline point added" in " ".join(added[0].decisions)
    before, after = (float(coarse.wall.clearance(state.curve(np.linspace(0, 1, 800))).min()) for state in (rounds[0], rounds[-1]))
    assert before < 2.0 < after


def test_a_feature_moves_towards_the_centre_of_its_circle_by_the_rate_of_eq_25() -> None:
    features = (node(-3.0, 4.0), node(0.0, 5.0, moved=2), node(4.0, 3.0), node(9.0, 9.0))
    settings = RefineSettings(sigma=0.01, sigma_growth=0.1)
    # All three lie on the circle of radius 5 around the origin; the rate is 0.01 (1 + 0.1 * 2).
    moved = relax(features, np.array([1]), settings)
    np.testing.assert_allclose(moved[1].point, [0.0, 5.0 * (1.0 - 0.012), 0.0], atol=1e-12)
    assert moved[1].moved == 3
    for i in (0, 2, 3):
        assert moved[i] is features[i]


def test_extrema_move_at_their_own_rate() -> None:
    features = (node(-3.0, 4.0), node(0.0, 5.0, kind=FeatureKind.EXTREMUM), node(4.0, 3.0))
    moved = relax(features, np.array([1]), RefineSettings(sigma=0.001, sigma_extremum=0.003))
    np.testing.assert_allclose(moved[1].point, [0.0, 5.0 * 0.997, 0.0], atol=1e-12)


def test_moving_flattens_the_circle() -> None:
    features = (node(-3.0, 4.0), node(0.0, 5.0), node(4.0, 3.0))
    moved = relax(features, np.array([1]), RefineSettings(sigma=0.05))
    center = circumcenter(*(f.point for f in moved))
    assert center is not None
    # The text says that the curvature grows; it is the radius that does.
    assert np.linalg.norm(center - moved[1].point) > 5.0


def test_collinear_neighbours_leave_a_feature_where_it_is() -> None:
    features = (node(0.0, 0.0), node(1.0, 1.0), node(3.0, 3.0))
    assert relax(features, np.array([1]), RefineSettings())[1] is features[1]


def test_runs_are_split_where_indices_skip() -> None:
    assert [run.tolist() for run in runs(np.array([2, 3, 4, 7, 9, 10]))] == [[2, 3, 4], [7], [9, 10]]
    assert runs(np.empty(0, dtype=np.int64)) == []


def test_features_inside_a_run_move_or_else_the_two_around_it_but_never_the_ends() -> None:
    u = np.linspace(0.0, 1.0, 101)
    knots = np.array([0.0, 0.3, 0.5, 0.7, 1.0])
    assert features_of_runs(np.arange(25, 56), u, knots).tolist() == [1, 2]
    assert features_of_runs(np.arange(55, 60), u, knots).tolist() == [2, 3]
    assert features_of_runs(np.arange(0, 10), u, knots).tolist() == [1]
    assert features_of_runs(np.arange(90, 101), u, knots).tolist() == [3]
    assert features_of_runs(np.array([4, 97]), u, np.array([0.0, 1.0])).tolist() == []


def test_a_line_too_short_for_any_scan_still_carries_a_cubic(straight: TubeProblem) -> None:
    short = replace(straight.centerline, points=straight.centerline.points[:8], radii=straight.centerline.radii[:8])
    features = first_features(short, FeatureSettings())
    assert [feature.kind for feature in features] == [FeatureKind.START, FeatureKind.NODE, FeatureKind.GOAL]


@pytest.mark.parametrize(
    ("given", "message"),
    [({"sigma": 0.0}, "sigma is 0"), ({"sigma_extremum": 1.5}, "1.5 for extrema"), ({"max_rounds": -1}, "max_rounds is -1")],
)
def test_settings_that_cannot_be_are_refused(given: dict[str, float], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        RefineSettings(**given)  # type: ignore[arg-type]
