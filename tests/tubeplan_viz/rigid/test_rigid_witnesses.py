"""Witnesses: what stopped an instrument before stops it again, and nothing else does."""

from __future__ import annotations

import numpy as np

from tubeplan_viz.rigid import Bodies, CoupledInstrument, posed
from tubeplan_viz.rigid.witnesses import KEPT, Witnesses, held

TOOL = CoupledInstrument()


def instruments(tips: list[list[float]]) -> Bodies:
    """Instruments along +y, two bodies each."""
    return posed(TOOL, np.array(tips), np.tile([0.0, 1.0, 0.0], (len(tips), 1)), 0.0)


def test_a_point_is_held_where_the_closed_form_distance_is_zero_and_the_front_is_flat() -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform([-4.0, -60.0, -4.0], [4.0, 4.0, 10.0], (4000, 3))
    bodies = instruments([[0.0, 0.0, 0.0]])
    inside = held(bodies, points)
    for k in range(2):
        gap = bodies.take(np.full(len(points), k)).gap(points)
        assert inside[k].any()
        # Never more than the body; a round front's ball and a skin of a micrometre are left out.
        # The nearest point of a body to one inside is that point, up to rounding of its coordinates.
        assert gap[inside[k]].max() < 1e-12
        missed = (gap < 1e-12) & ~inside[k]
        beyond_front = points[:, 1] > bodies.front[k, 1]
        radial = np.hypot(points[:, 0] - bodies.front[k, 0], points[:, 2] - bodies.front[k, 2])
        assert np.all(beyond_front[missed] | (radial[missed] > bodies.radius[k] - 1e-5))


def test_a_witness_stops_either_body_and_tells_its_structure_and_place() -> None:
    witnesses = Witnesses()
    on_shaver, on_scope = [0.0, -20.0, 0.5], [0.0, -20.0, TOOL.offset]
    witnesses.add(np.array([3, 5, -1]), np.array([on_shaver, on_scope, [np.nan] * 3]))
    assert len(witnesses) == 2
    # Third instrument: 30 mm aside, holds neither.
    label, place = witnesses.stopping(instruments([[0.0, 0.0, 0.0], [0.0, 0.0, TOOL.offset], [30.0, 0.0, 0.0]]))
    assert label[0] in (3, 5)
    assert label[1] == 5  # raised by the offset its shaver lies where the endoscope's axis was
    assert place[1].tolist() == on_scope
    assert label[2] == -1
    assert np.isnan(place[2]).all()


def test_nothing_is_stopped_without_witnesses_and_hits_beside_each_other_are_one() -> None:
    witnesses = Witnesses()
    label, _ = witnesses.stopping(instruments([[0.0, 0.0, 0.0]]))
    assert label.tolist() == [-1]
    witnesses.add(np.array([-1]), np.full((1, 3), np.nan))
    assert len(witnesses) == 0
    witnesses.add(np.array([1, 1, 2]), np.array([[0.1, 0.1, 0.1], [0.2, 0.2, 0.2], [0.2, 0.2, 0.2]]))
    assert len(witnesses) == 2  # the same place of another structure is another witness


def test_those_that_stopped_most_are_kept() -> None:
    witnesses = Witnesses()
    many = np.column_stack([np.arange(2 * KEPT) * 5.0, np.full(2 * KEPT, -20.0), np.zeros(2 * KEPT)])
    favourite = many[-1:]
    for _ in range(3):
        witnesses.add(np.array([0]), favourite)
    witnesses.add(np.zeros(len(many), dtype=np.int64), many)
    assert len(witnesses) == KEPT
    label, place = witnesses.stopping(instruments([[float(favourite[0, 0]), 0.0, 0.0]]))
    assert label.tolist() == [0]
    assert place[0].tolist() == favourite[0].tolist()
