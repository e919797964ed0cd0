"""Scans against sequences small enough to be worked by hand; equation numbers are those of Dai et al. (2024)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.plan import FeatureKind
from tubeplan_viz.tube import FeatureSettings
from tubeplan_viz.tube.features import (
    extrema,
    inflections,
    local_mean,
    over_dense,
    scan_features,
    segment_points,
    wide_range_nodes,
)

START, GOAL, EXTREMUM, SEGMENT = FeatureKind.START, FeatureKind.GOAL, FeatureKind.EXTREMUM, FeatureKind.SEGMENT


def bent(curvature: np.ndarray) -> np.ndarray:
    """A plane polyline with steps of 1 mm that turns by `curvature` at each vertex."""
    heading = np.concatenate([[0.0], np.cumsum(curvature)])
    steps = np.column_stack([np.cos(heading), np.sin(heading), 0.0 * heading])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def test_local_mean_is_the_arithmetic_mean_of_the_neighbourhood() -> None:
    # Eq. 5 prints 1/J before 2J + 1 terms: (1 + 1 + 5 + 1 + 1) / 2 = 4.5. The mean is 9 / 5.
    c = np.array([1.0, 1.0, 1.0, 1.0, 5.0, 1.0, 1.0, 1.0, 1.0])
    assert local_mean(c, 4, 2) == pytest.approx(1.8)


def test_an_extremum_tops_its_neighbourhood_and_t1_times_its_mean() -> None:
    # Eq. 3-5 with J = 2: 5 > 1.9 * 9/5 = 3.42, but 2 < 1.9 * 6/5 = 2.28.
    settings = FeatureSettings(neighbourhood=2, scans=("extrema",))
    flat = np.ones(9)
    for peak, expected in ((5.0, [4]), (2.0, [])):
        c = flat.copy()
        c[4] = peak
        assert extrema(c, settings) == expected
    # A larger one within J hides it: of 5 and 6 two points apart only 6 stands, 6 > 1.9 * 14/5.
    c = np.array([1.0, 1.0, 1.0, 5.0, 1.0, 6.0, 1.0, 1.0, 1.0])
    assert extrema(c, settings) == [5]


def test_extrema_need_a_whole_neighbourhood() -> None:
    settings = FeatureSettings(neighbourhood=2, scans=("extrema",))
    assert extrema(np.array([1.0, 9.0, 1.0, 1.0, 1.0, 1.0, 9.0, 1.0]), settings) == []


def test_the_end_of_a_bend_is_where_curvature_has_fallen_and_stays() -> None:
    # Eq. 6-8, J = 2, at i = 3: both before are above 1; dminus = min(7 - 0.9, 8 - 0.9) = 6.1,
    # dplus = max(1 - 0.9, 0.95 - 0.9) = 0.1, mplus = (0.1 + 0.05) / 2 = 0.075 < 3 * (8 + 7 + 1 + 0.9 + 1) / 5.
    # At i = 2: dminus = min(8 - 1, 9 - 1) = 7, dplus = max(0.9 - 1, 1 - 1) = 0, mplus = 0.1: the last point of the bend too.
    # At i = 4: dminus = min(1 - 1, 7 - 1) = 0 is not above 5 dplus = 0.
    c = np.array([9.0, 8.0, 7.0, 1.0, 0.9, 1.0, 0.95, 1.0])
    settings = FeatureSettings(neighbourhood=2, scans=("segments",))
    assert segment_points(c, settings) == [2, 3]
    # Eq. 9-11 are the mirror image: a bend begins.
    assert segment_points(c[::-1], settings) == [4, 5]


def test_a_fall_that_rises_again_or_stays_rough_is_no_end_of_a_bend() -> None:
    settings = FeatureSettings(neighbourhood=2, scans=("segments",))
    # At 3: dplus = 3 - 0.9 = 2.1 and 6.1 < 5 * 2.1; at 2: dplus = 3 - 1 = 2 and 7 < 5 * 2.
    assert segment_points(np.array([9.0, 8.0, 7.0, 1.0, 0.9, 3.0, 3.0, 1.0]), settings) == []
    # At 3: mplus = (0.6 + 0.6) / 2 = 0.6 against T3 cbar = T3 * 17.2 / 5: above for T3 = 0.1, below for T3 = 3.
    rough = np.array([9.0, 8.0, 7.0, 1.0, 0.9, 0.3, 0.9, 1.0])
    assert 3 not in segment_points(rough, FeatureSettings(neighbourhood=2, t3=0.1, scans=("segments",)))
    assert 3 in segment_points(rough, settings)


def inflection_curvature(right: float) -> np.ndarray:
    """Peaks of 20 at 2 and of `right` at 12, 0.5 elsewhere, nothing at 7."""
    c = np.full(15, 0.5)
    c[[2, 7, 12]] = 20.0, 0.0, right
    return c


def test_an_inflection_is_the_lowest_point_between_two_peaks() -> None:
    # Eq. 12-14, J = 5: both rises are 20 and cbar = (20 + 20 + 8 * 0.5) / 11 = 4, so 20 > 3 * 4.
    features = {0: START, 2: EXTREMUM, 12: EXTREMUM, 14: GOAL}
    assert inflections(inflection_curvature(20.0), features, FeatureSettings()) == [7]
    both_segments = {0: START, 2: SEGMENT, 12: SEGMENT, 14: GOAL}
    assert inflections(inflection_curvature(20.0), both_segments, FeatureSettings()) == [7]


def test_an_inflection_needs_a_rise_on_both_sides() -> None:
    # With the printed maximum of eq. 12 the one peak of 20 would do: 20 > 3 * 25 / 11. The minimum, 1, does not.
    features = {0: START, 2: EXTREMUM, 12: EXTREMUM, 14: GOAL}
    assert inflections(inflection_curvature(1.0), features, FeatureSettings()) == []


def test_there_is_no_inflection_between_different_kinds() -> None:
    features = {0: START, 2: EXTREMUM, 12: SEGMENT, 14: GOAL}
    assert inflections(inflection_curvature(20.0), features, FeatureSettings()) == []


def test_a_bare_pair_of_127_points_takes_ten_nodes_each_the_most_curved_of_its_part() -> None:
    # Eq. 15: floor((126 - 20) / 10) = 10 equal parts of 1 .. 126, 12.5 points each; a peak is set into each.
    c = np.full(127, 0.1)
    peaks = [int(12.5 * k) + 5 for k in range(10)]
    c[peaks] = np.linspace(1.0, 2.0, 10)
    assert wide_range_nodes(c, {0: START, 126: GOAL}, FeatureSettings()) == peaks


@pytest.mark.parametrize(("last", "count"), [(20, 0), (29, 0), (30, 1), (39, 1), (40, 2)])
def test_the_number_of_nodes_is_the_floor_of_eq_15(last: int, count: int) -> None:
    nodes = wide_range_nodes(np.full(last + 1, 0.1), {0: START, last: GOAL}, FeatureSettings())
    assert len(nodes) == count
    assert all(0 < node < last for node in nodes)


def test_wide_range_nodes_go_only_between_features_of_one_sort() -> None:
    c = np.linspace(0.1, 0.2, 61)
    settings = FeatureSettings()
    # Three that are no extrema: floor((60 - 20) / 10) = 4; one extremum among them: none.
    assert len(wide_range_nodes(c, {0: START, 30: SEGMENT, 60: GOAL}, settings)) == 4
    assert wide_range_nodes(c, {0: START, 30: EXTREMUM, 60: GOAL}, settings) == []
    assert len(wide_range_nodes(c, {0: EXTREMUM, 30: EXTREMUM, 60: EXTREMUM}, settings)) == 4


def test_an_extremum_between_close_extrema_is_dropped() -> None:
    # [10, 16] spans 6 < 7 points and 13 has an extremum beside it; [0, 13] and [10, 40] are wide enough.
    features = {0: START, 10: EXTREMUM, 13: EXTREMUM, 16: EXTREMUM, 40: GOAL}
    assert over_dense(features, FeatureSettings()) == [13]
    assert over_dense(features, FeatureSettings(t7=6)) == []
    lonely = {0: START, 10: SEGMENT, 13: EXTREMUM, 16: SEGMENT, 40: GOAL}
    assert over_dense(lonely, FeatureSettings()) == []


def test_all_scans_together_name_each_kind_and_keep_start_and_goal() -> None:
    curvature = np.full(100, 0.002)
    curvature[20:40] = 0.05
    curvature[60] = 0.3
    everything = FeatureSettings(scans=("extrema", "segments", "inflections", "nodes", "dense"))
    found = scan_features(bent(curvature), everything)
    indices = [i for i, _ in found]
    kinds = dict(found)
    assert indices == sorted(set(indices))
    assert kinds[0] is START
    assert kinds[101] is GOAL
    assert kinds[61] is EXTREMUM
    assert SEGMENT in kinds.values()


def test_cylinder_1_has_the_papers_twelve_features_at_its_spacing(cylinder_1: Any) -> None:
    # The printed 127 points are 0.8 mm apart; start + goal + floor((126 - 20) / 10).
    found = scan_features(cylinder_1.centerline.points, FeatureSettings())
    assert len(cylinder_1.centerline.points) == pytest.approx(127, abs=3)
    assert len(found) == 12
    assert {kind for _, kind in found[1:-1]} == {FeatureKind.NODE}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"scans": ("nodes", "peaks")}, "unknown feature scan 'peaks'; expected some of extrema, segments"),
        ({"neighbourhood": 0}, "expected at least 1"),
        ({"t6": 0}, "expected at least 1"),
    ],
)
def test_settings_that_cannot_be_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        FeatureSettings(**given)
