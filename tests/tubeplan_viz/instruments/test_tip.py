"""The rigid tip as a chord, against closed forms on arcs."""

from __future__ import annotations

from itertools import pairwise
from types import ModuleType

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from segmentation.errors import GeometryError
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.instruments import tip_clearance

TUBE, BEND = 3.0, 20.0  # mm


@pytest.fixture(scope="module")
def arc(phantoms: ModuleType) -> tuple[SplineCurve, WallDistance]:
    """A quarter of a torus and a spline along its axis, which leaves the circle by under a micrometre."""
    model = phantoms.torus_piece(BEND, 0.5 * np.pi, TUBE)
    points = model.axis_points[:: max(len(model.axis_points) // 60, 1)]
    made = make_interp_spline(np.linspace(0.0, 1.0, len(points)), points, k=3)
    return SplineCurve(3, made.t, made.c), WallDistance(model.surface)


@pytest.mark.parametrize("length", [4.0, 8.0, 12.0])
def test_a_chord_in_a_torus_loses_its_sagitta(arc: tuple[SplineCurve, WallDistance], length: float) -> None:
    curve, wall = arc
    sagitta = BEND - np.sqrt(BEND**2 - 0.25 * length**2)
    found = tip_clearance(curve, wall, length, tolerance=0.2)
    # The tube's mesh lies up to 0.02 mm inside the torus, and chords are sampled every 0.25 mm.
    assert found.sampled == pytest.approx(TUBE - sagitta, abs=0.06)
    assert found.deviation == pytest.approx(sagitta, rel=0.02)
    assert found.sampled - 0.2 <= found.bound <= found.sampled


def test_the_bound_holds_for_chords_drawn_at_random(arc: tuple[SplineCurve, WallDistance]) -> None:
    curve, wall = arc
    rng = np.random.default_rng(1)
    length = 9.0
    bound = tip_clearance(curve, wall, length, tolerance=0.2).bound
    turn = 2.0 * np.arcsin(0.5 * length / BEND) * BEND  # arc length under the chord
    front = rng.uniform(turn, curve.length, 200)
    share = rng.uniform(0.0, 1.0, (200, 1))
    points = share * curve(curve.parameter(front)) + (1.0 - share) * curve(curve.parameter(front - turn))
    assert wall.distance(points).min() >= bound - 1e-6


def test_a_longer_tip_never_has_more_room_on_an_arc(arc: tuple[SplineCurve, WallDistance]) -> None:
    curve, wall = arc
    found = [tip_clearance(curve, wall, length, limit=0.0).sampled for length in (2.0, 5.0, 9.0, 14.0)]
    assert all(after <= before + 0.06 for before, after in pairwise(found))  # half a step


def test_on_a_straight_path_the_tip_has_the_clearance_of_the_path(phantoms: ModuleType) -> None:
    wall = WallDistance(phantoms.straight_tube(30.0, TUBE).surface)  # along +y from the origin
    knots = np.concatenate([np.zeros(4), np.ones(4)])
    curve = SplineCurve(3, knots, np.array([[0.3, y, 0.0] for y in (5.0, 12.0, 18.0, 25.0)]))
    found = tip_clearance(curve, wall, 6.0, limit=1.0)
    assert found.deviation == pytest.approx(0.0, abs=1e-9)
    assert found.sampled == pytest.approx(float(wall.distance(curve(np.linspace(0.0, 1.0, 200))).min()), abs=0.02)


def test_a_tip_without_length_is_refused(arc: tuple[SplineCurve, WallDistance]) -> None:
    with pytest.raises(GeometryError, match="0 mm long, expected more than 0"):
        tip_clearance(*arc, 0.0)
