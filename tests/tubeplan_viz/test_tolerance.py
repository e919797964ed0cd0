"""Errors of pose: closed forms in a straight tube, and laws."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.cases.tube import make_case
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.plan import PathProfile
from tubeplan_viz.profile import measure_path
from tubeplan_viz.tolerance import (
    PRESET_SIZES,
    PRESETS,
    SIZES,
    Tolerance,
    ToleranceSettings,
    path_tolerance,
    preset_tolerances,
    wilson,
)

RADIUS, LIMIT = 3.0, 1.0  # mm


@pytest.fixture(scope="module")
def straight(phantoms: ModuleType) -> tuple[PathProfile, WallDistance]:
    """A straight tube of radius 3 mm along +y, and a path on 20 mm of its axis."""
    wall = WallDistance(phantoms.straight_tube(40.0, RADIUS).surface)
    knots = np.concatenate([np.zeros(4), np.ones(4)])
    curve = SplineCurve(3, knots, np.array([[0.0, y, 0.0] for y in (10.0, 50.0 / 3.0, 70.0 / 3.0, 30.0)]))
    return measure_path(curve, wall), wall


def drawn(case: tuple[PathProfile, WallDistance], *, limit: float = LIMIT, seed: int = 4, **settings: Any) -> Tolerance:
    profile, wall = case
    return path_tolerance(profile, wall, limit, ToleranceSettings(**settings), rng=np.random.default_rng(seed))


def test_a_pure_shift_of_a_straight_tube_has_the_probability_of_a_rayleigh_distance(straight: Any) -> None:
    # Components across the axis have variance t^2 / 3 each: P(shift across <= g) = 1 - exp(-g^2 / (2 t^2 / 3)), g = 3 - 1 mm.
    size = 2.0
    expected = 1.0 - np.exp(-((RADIUS - LIMIT) ** 2) / (2.0 * size**2 / 3.0))
    found = drawn(straight, translation=size, rotation=0.0, samples=4000)
    # Four standard errors, and 0.01 for the mesh inside the tube.
    assert found.probability == pytest.approx(expected, abs=4.0 * np.sqrt(expected * (1 - expected) / 4000) + 0.01)
    # A shift alone moves all places alike.
    assert np.ptp(found.clear) < 0.02


def test_no_error_gives_the_plans_own_verdict(straight: Any) -> None:
    profile, _ = straight
    least = float(profile.clearance.min())
    for limit, expected in ((least, 1.0), (least + 1e-9, 0.0), (0.5 * least, 1.0)):
        found = drawn(straight, limit=limit, translation=0.0, rotation=0.0, samples=20)
        assert found.probability == expected
        assert (found.first is None) == (expected == 1.0)


def test_more_error_is_never_more_probable_to_stay_clear(straight: Any) -> None:
    chances = [
        drawn(straight, translation=size, rotation=size, samples=300).probability for size in (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)
    ]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] == 1.0
    assert chances[-1] < 0.5


def test_the_first_breach_of_a_turn_about_the_start_is_where_the_path_has_swung_to_the_wall(straight: Any) -> None:
    profile, _ = straight
    # Across the axis the turn has two components of variance t^2 / 3, so its sine c is Rayleigh distributed; a place at s swings
    # out by c s and meets the limit at s = (3 - 1) / c. Of the turns that reach it on the path's 20 mm, c > 0.1, the median has
    # c^2 = 0.1^2 + 2 ln(2) t^2 / 3.
    turn = np.radians(12.0)
    expected = (RADIUS - LIMIT) / np.sqrt(0.1**2 + 2.0 * np.log(2.0) * turn**2 / 3.0)
    found = drawn(straight, translation=0.0, rotation=12.0, samples=4000, pivot=tuple(profile.points[0]))
    # Places are 1 mm apart and the one after the breach is named; the median of 2800 turns is known to 0.1 mm.
    assert expected - 0.3 <= found.first <= expected + 1.3


def test_a_turn_about_the_middle_fails_first_at_the_ends(straight: Any) -> None:
    profile, _ = straight
    found = drawn(straight, translation=0.0, rotation=12.0, samples=600)
    middle = int(np.argmin(np.abs(found.arc_length - 0.5 * profile.length)))
    assert found.clear[middle] == 1.0
    assert min(found.weakest, profile.length - found.weakest) < 1.0
    # A turn by w about a pivot 10 mm away moves an end by 10 sin(w); both components across the axis move it.
    spread = np.radians(12.0) / np.sqrt(3.0)
    expected = 1.0 - np.exp(-(np.arcsin((RADIUS - LIMIT) / 10.0) ** 2) / (2.0 * spread**2))
    assert found.probability == pytest.approx(expected, abs=0.06)  # 2.5 standard errors, and small angles


def test_a_pivot_at_the_goal_leaves_the_goal_clear(straight: Any) -> None:
    profile, _ = straight
    x, y, z = (float(v) for v in profile.points[-1])
    found = drawn(straight, translation=0.0, rotation=8.0, samples=200, pivot=(x, y, z))
    assert found.clear[-1] == 1.0
    assert found.weakest < 1.0


def test_presets_are_one_to_five_mm_and_degrees_together_and_each_alone(straight: Any) -> None:
    profile, wall = straight
    found = preset_tolerances(profile, wall, LIMIT, seed=4)
    assert [(one.translation, one.rotation) for one in found] == list(PRESET_SIZES)
    assert {size for size, _ in PRESET_SIZES} == {0.0, *SIZES} == {0.0, 1.0, 2.0, 3.0, 4.0, 5.0}
    both, shift, turn = (found[k * len(SIZES) : (k + 1) * len(SIZES)] for k in range(3))
    for series in (both, shift, turn):
        chances = [one.probability for one in series]
        assert chances == sorted(chances, reverse=True)
    # Shifts across the axis are Rayleigh distances of variance size^2 / 3 (four standard errors and 0.01 for the mesh).
    for one in shift:
        expected = 1.0 - np.exp(-((RADIUS - LIMIT) ** 2) / (2.0 * one.translation**2 / 3.0))
        assert one.probability == pytest.approx(expected, abs=4.0 * np.sqrt(expected * (1 - expected) / one.samples) + 0.01)
    # 5 degrees about a pivot 10 mm away move an end by 0.9 mm root mean square: 2 mm are four standard deviations.
    assert turn[-1].probability > 0.98
    # The same draws: a preset is what its size gives by itself.
    alone = path_tolerance(
        profile,
        wall,
        LIMIT,
        ToleranceSettings(translation=3.0, rotation=3.0, samples=both[2].samples),
        rng=np.random.default_rng(4),
    )
    assert np.array_equal(alone.clear, both[2].clear)


def test_the_same_seed_gives_the_same_numbers_and_the_interval_holds_the_share(straight: Any) -> None:
    one, same, other = (drawn(straight, seed=seed, translation=2.0, rotation=2.0, samples=200) for seed in (7, 7, 8))
    assert one.details()["probability"] == same.details()["probability"]
    assert np.array_equal(one.clear, same.clear)
    assert not np.array_equal(one.clear, other.clear)
    assert one.low <= one.probability <= one.high


def test_the_interval_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    hits = [low <= 0.8 <= high for low, high in (wilson(int(k), 100) for k in rng.binomial(100, 0.8, 2000))]
    assert np.mean(hits) == pytest.approx(0.95, abs=0.02)  # Wilson's coverage oscillates by about 0.01


def test_leaving_through_a_cap_is_no_breach(phantoms: ModuleType) -> None:
    wall = WallDistance(phantoms.straight_tube(40.0, RADIUS).surface)
    knots = np.concatenate([np.zeros(4), np.ones(4)])
    curve = SplineCurve(3, knots, np.array([[0.0, y, 0.0] for y in (0.5, 2.0, 4.0, 6.0)]))
    profile = measure_path(curve, wall)
    found = path_tolerance(
        profile, wall, 0.5, ToleranceSettings(translation=1.0, rotation=0.0, samples=300), rng=np.random.default_rng(2)
    )
    # Shifts along the axis by more than 0.5 mm are frequent; across, 2.5 mm is four standard deviations.
    assert found.probability > 0.98


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"translation": -1.0, "rotation": 0.0}, "shift is -1 mm, expected 0 to 100"),
        ({"translation": 1.0, "rotation": 100.0}, "turn is 100 degrees, expected 0 to 90"),
        ({"translation": 1.0, "rotation": 1.0, "samples": 0}, "has 0 samples"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        ToleranceSettings(**settings)


def test_the_case_reads_the_error_as_text_or_list_and_refuses_others() -> None:
    table = {"input": {"mesh": "tube.stl"}}
    assert make_case({**table, "planner": {"tolerance": " Presets"}}).planner.tolerance == PRESETS
    for value in ("2,3", [2.0, 3.0]):
        assert make_case({**table, "planner": {"tolerance": value}}).planner.tolerance == (2.0, 3.0)
    for value, message in (
        ("2", "expected a shift in mm"),
        ("a,b", "expected a shift in mm"),
        ([1.0, 99.0], "turn is 99 degrees"),
    ):
        with pytest.raises(CaseError, match=message):
            make_case({**table, "planner": {"tolerance": value}})
