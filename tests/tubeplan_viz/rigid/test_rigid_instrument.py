"""The coupled instrument: its lengths, its pose, and the closed forms of its distances."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.rigid import Bodies, CoupledInstrument, pose_angles, posed, swept, up_of


def cylinder(*, round_front: bool = False) -> Bodies:
    """From the origin 10 mm along y, radius 2."""
    return Bodies(np.zeros((1, 3)), np.array([[0.0, 10.0, 0.0]]), np.array([2.0]), np.array([round_front]))


def test_the_setback_is_the_other_leg_of_the_working_distance() -> None:
    assert CoupledInstrument(working_distance=10.0, offset=6.0).setback == pytest.approx(8.0, abs=1e-12)


def test_an_offset_that_lets_the_shafts_overlap_is_refused() -> None:
    with pytest.raises(CaseError, match=r"expected between 3\.45"):
        CoupledInstrument(offset=3.4)


@pytest.mark.parametrize(
    ("point", "gap"),
    [
        ((5.0, 5.0, 0.0), 3.0),  # d_a > r between the ends: d_a - r
        ((5.0, 14.0, 0.0), 5.0),  # d_a > r, 4 mm beyond an end: sqrt(3^2 + 4^2)
        ((1.0, 13.0, 0.0), 3.0),  # d_a <= r beyond an end: h
        ((1.0, 5.0, 0.0), 0.0),  # inside
    ],
)
def test_the_distance_to_a_flat_cylinder_is_the_formula_of_the_text(point: tuple[float, float, float], gap: float) -> None:
    assert cylinder().gap(np.array([point]))[0] == pytest.approx(gap, abs=1e-12)


def test_ahead_of_a_round_front_the_distance_is_to_the_ball() -> None:
    assert cylinder(round_front=True).gap(np.array([[3.0, 14.0, 0.0]]))[0] == pytest.approx(5.0 - 2.0, abs=1e-12)


def test_the_endoscope_lies_above_the_shaver_and_behind_its_tip() -> None:
    tip, way = np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 1.0, 0.0]])
    bodies = posed(CoupledInstrument(), tip, way, 0.0)
    # Shaver: the tip is the foremost point of its ball of 1.45 mm.
    assert bodies.front[0] == pytest.approx([1.0, 2.0 - 1.45, 3.0], abs=1e-12)
    assert bodies.front[1] == pytest.approx([1.0, 2.0 - 8.0, 3.0 + 6.0], abs=1e-12)
    rolled = posed(CoupledInstrument(), tip, way, np.pi / 2)
    # Right-hand rule about +y: z goes to x.
    assert rolled.front[1] == pytest.approx([1.0 + 6.0, 2.0 - 8.0, 3.0], abs=1e-12)


def test_the_axis_lies_along_the_segment_in_the_angles_of_the_text() -> None:
    way = np.array([0.3, 0.8, 0.5]) / np.linalg.norm([0.3, 0.8, 0.5])
    alpha, gamma = pose_angles(way)
    turned = np.arctan(np.tan(gamma) * np.cos(alpha))
    z = np.array([[np.cos(alpha), -np.sin(alpha), 0.0], [np.sin(alpha), np.cos(alpha), 0.0], [0.0, 0.0, 1.0]])
    x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(turned), -np.sin(turned)], [0.0, np.sin(turned), np.cos(turned)]])
    assert z @ x @ [0.0, 1.0, 0.0] == pytest.approx(way, abs=1e-12)
    assert z @ x @ [0.0, 0.0, 1.0] == pytest.approx(up_of(way[None], 0.0)[0], abs=1e-12)


def test_a_push_sweeps_the_union_of_its_poses() -> None:
    rng = np.random.default_rng(3)
    start, end = np.array([[0.0, 0.0, 0.0]]), np.array([[3.0, 30.0, 12.0]])
    way = (end - start) / np.linalg.norm(end - start)
    push = swept(CoupledInstrument(), start, end, 0.2)
    points = rng.uniform([-10.0, -40.0, -20.0], [15.0, 45.0, 35.0], (300, 3))
    every = np.stack(
        [
            body.take(np.full(300, part)).gap(points)
            for share in np.linspace(0.0, 1.0, 161)
            for body in [posed(CoupledInstrument(), start + share * (end - start), way, 0.2)]
            for part in range(2)
        ]
    ).min(axis=0)
    whole = np.minimum(push.take(np.zeros(300, int)).gap(points), push.take(np.ones(300, int)).gap(points))
    # Poses are 0.2 mm apart: at most half of that is missed between them.
    assert np.all(whole <= every + 1e-9)
    assert np.all(every <= whole + 0.11)


def test_grown_bodies_hold_all_points_within_the_growth() -> None:
    points = np.random.default_rng(1).uniform(-6.0, 16.0, (2000, 3))
    for round_front in (False, True):
        body = cylinder(round_front=round_front)
        rows = np.zeros(len(points), int)
        near = body.take(rows).gap(points) <= 1.5
        assert near.any()
        assert np.all(body.grown(1.5).take(rows[near]).gap(points[near]) <= 1e-12)
