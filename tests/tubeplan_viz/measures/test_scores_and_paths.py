"""Scores against rows worked by hand; measures of paths and structures against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.volume import Volume
from tubeplan_viz.measures import DEFINITIONS, Measure, StoneFacts, path_measures, rirs, russ, structure_measures
from tubeplan_viz.measures.structures import mask_distance

# burden, density, calyces, lower pole, angle, length, abnormal; points of RUSS and of R.I.R.S. read off the papers' tables.
HAND_WORKED = [
    ((8.0, 600.0, 1, False, None, 20.0, False), (0, 0, 0, 0), (1, 1, 1, 1)),
    ((21.0, 1001.0, 2, True, 44.9, 25.1, True), (1, 1, 1, 1), (2, 2, 2, 3)),
    ((20.0, 1000.0, 1, True, 45.0, 25.0, False), (0, 0, 0, 0), (1, 2, 1, 2)),
    ((10.0, 1200.0, 1, True, 30.0, 30.0, False), (0, 1, 0, 0), (2, 3, 2, 1)),
    ((10.1, 900.0, 3, True, 30.1, 12.0, True), (0, 1, 1, 1), (1, 2, 1, 2)),
    ((35.0, 1500.0, 4, False, 20.0, 40.0, False), (1, 0, 1, 0), (2, 1, 2, 3)),
    # Each limit from both sides, alone: 20 mm and 20.1, 45 and 44.9 degrees, one calyx and two, 1000 and 1001 HU,
    # 25 and 25.1 mm, 30 and 30.1 degrees, 10 and 10.1 mm.
    ((20.1, 1000.0, 1, False, None, 25.0, False), (1, 0, 0, 0), (1, 1, 1, 3)),
    ((10.0, 1001.0, 1, False, None, 25.0, False), (0, 0, 0, 0), (2, 1, 1, 1)),
    ((10.0, 1000.0, 2, False, None, 25.0, False), (0, 0, 1, 0), (1, 1, 1, 1)),
    ((10.0, 1000.0, 1, False, None, 25.1, True), (0, 0, 0, 1), (1, 1, 2, 1)),
    ((10.0, 1000.0, 1, True, 44.9, 25.0, False), (0, 1, 0, 0), (1, 2, 1, 1)),
    ((10.1, 1000.0, 1, True, 30.1, 25.0, False), (0, 1, 0, 0), (1, 2, 1, 2)),
    ((20.0, 1000.0, 0, True, 29.9, 25.0, False), (0, 1, 0, 0), (1, 3, 1, 2)),
    # The least and the largest totals: 0 and 4, 4 and 10.
    ((1.0, 100.0, 1, False, None, 1.0, False), (0, 0, 0, 0), (1, 1, 1, 1)),
    ((60.0, 2000.0, 5, True, 10.0, 60.0, True), (1, 1, 1, 1), (2, 3, 2, 3)),
]


@pytest.mark.parametrize(("given", "of_russ", "of_rirs"), HAND_WORKED)
def test_scores_are_those_worked_by_hand(given: tuple, of_russ: tuple[int, ...], of_rirs: tuple[int, ...]) -> None:
    names = ("burden", "density", "calyces", "lower_pole", "angle", "length", "abnormal")
    facts = StoneFacts(**dict(zip(names, given, strict=True)))
    for score, points in ((russ(facts), of_russ), (rirs(facts), of_rirs)):
        assert tuple(part.points for part in score.parts) == points
        assert score.details()["total"] == sum(points) == score.low == score.high


def test_a_score_without_its_inputs_is_a_range_that_says_what_is_lacking() -> None:
    told = rirs(StoneFacts(burden=12.0, density=1100.0)).details()
    # 2 for density, 2 for burden; the other two give 1 to 3 and 1 to 2.
    assert (told["total"], told["low"], told["high"]) == (None, 6, 9)
    assert [part["points"] for part in told["parts"]] == [2, None, None, 2]
    assert "not known" in told["parts"][1]["given"]
    assert (russ(StoneFacts()).low, russ(StoneFacts()).high) == (0, 4)
    assert (rirs(StoneFacts()).low, rirs(StoneFacts()).high) == (4, 10)


def test_path_measures_of_a_half_circle_are_those_of_its_formula() -> None:
    angle = np.linspace(0.0, np.pi, 2001)
    points = 20.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    curvature = np.full(len(angle), 1.0 / 20.0)
    found = {m.key: m.value for m in path_measures(20.0 * angle, points, curvature, 1.0 / 20.0)}
    assert found["tortuosity"] == pytest.approx(np.pi / 2.0, rel=1e-12)
    assert found["total_bending_deg"] == pytest.approx(180.0, rel=1e-12)
    assert found["bend_radius_min_mm"] == pytest.approx(20.0)


def test_a_straight_closed_path_says_why_two_measures_are_lacking() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found = {m.key: m for m in path_measures(np.array([0.0, 1.0, 2.0]), points, np.zeros(3), 0.0)}
    assert found["tortuosity"].reason == "the path ends where it starts"
    assert found["bend_radius_min_mm"].reason == "the path is straight"
    assert found["total_bending_deg"].value == 0.0


def test_distance_to_a_mask_is_that_to_its_voxels_as_boxes() -> None:
    voxels = np.zeros((5, 6, 7), dtype=np.int16)
    voxels[2, 3, 4] = 1
    turn = np.array([[0.0, 0.0, 0.8], [0.0, 0.6, 0.0], [1.5, 0.0, 0.0]])  # slices along z, rows y, columns x
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, (10.0, -4.0, 7.0)
    mask = Volume(voxels, matrix)
    center = mask.to_lps([2, 3, 4])
    half = np.array([0.4, 0.3, 0.75])
    rng = np.random.default_rng(3)
    points = center + rng.uniform(-6.0, 6.0, (200, 3))
    expected = np.linalg.norm(np.maximum(np.abs(points - center) - half, 0.0), axis=1)
    np.testing.assert_allclose(mask_distance(mask, points), expected, atol=1e-9)


def test_a_structure_beside_a_straight_path_is_as_far_as_it_was_put() -> None:
    voxels = np.zeros((41, 5, 5), dtype=np.int16)
    voxels[18:23] = 1  # slices of 1 mm around z = 20
    matrix = np.eye(4)[:, [2, 1, 0, 3]]
    s = np.linspace(0.0, 40.0, 161)
    points = np.column_stack([np.full(161, 10.0), np.full(161, 2.0), s])
    least, where, mean = (m.value for m in structure_measures("vessel", Volume(voxels, matrix), s, points))
    assert least == pytest.approx(10.0 - 4.5)  # columns 0 to 4 end at x = 4.5
    assert where is not None
    assert 17.5 <= where <= 22.5
    assert mean is not None
    assert mean > least
    empty = structure_measures("none", Volume(np.zeros_like(voxels), matrix), s, points)
    assert {m.reason for m in empty} == {"the mask is empty"}


def test_the_mean_distance_to_a_structure_goes_by_length_however_the_path_is_sampled() -> None:
    voxels = np.zeros((5, 5, 5), dtype=np.int16)
    voxels[:, :, 4] = 1  # x from 3.5 to 4.5 mm
    s = np.array([0.0, 1.0, 10.0])
    points = np.column_stack([5.5 + s, np.full(3, 2.0), np.full(3, 2.0)])  # straight away from it: 1 mm at first, 11 at last
    least, where, mean = (m.value for m in structure_measures("vessel", Volume(voxels, np.eye(4)[:, [2, 1, 0, 3]]), s, points))
    assert (least, where) == (pytest.approx(1.0), 0.0)
    assert mean == pytest.approx(6.0)  # of the three samples it would be 4.7


def test_a_measure_has_a_value_or_a_reason() -> None:
    for wrong in ({"value": 1.0, "reason": "both"}, {}):
        with pytest.raises(ValueError, match="either a value or a reason"):
            Measure(key="tortuosity", **wrong)
    assert all(one.text.endswith(".") and one.source for one in DEFINITIONS.values())
