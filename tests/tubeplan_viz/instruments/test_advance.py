"""How far an instrument comes along a path that it cannot follow to the end: closed forms, dense samples, monotone."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from tubeplan_viz.bench.models import narrow_neck
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.instruments import Instrument, Matrix, ReachSettings, Verdict, instrument_matrix
from tubeplan_viz.instruments.advance import clear_until, curved_until, shaft_until
from tubeplan_viz.instruments.tip import tip_until
from tubeplan_viz.instruments.track import Track

START = np.array([0.0, 0.0, 2.0])
FINE = 0.01  # mm between samples


def scope(diameter: float, bend: float, tip: float = 0.0, reach: float = 600.0) -> Instrument:
    name = f"{diameter:g} mm, bend {bend:g}, tip {tip:g}, {reach:g} long"
    return Instrument(
        name=name, kind="test", outer_diameter_mm=diameter, bend_radius_min_mm=bend, rigid_tip_mm=tip, working_length_mm=reach
    )


@pytest.fixture(scope="module")
def neck() -> tuple[SplineCurve, WallDistance, Track]:
    """A tube of 3 mm with a neck of 1 mm in its middle, and the straight way through it from 2 to 38 mm."""
    wall = WallDistance(narrow_neck().surface)
    knots = np.concatenate([np.zeros(4), np.ones(4)])
    curve = SplineCurve(3, knots, np.array([[0.0, y, 0.0] for y in (2.0, 14.0, 26.0, 38.0)]))
    return curve, wall, Track.of(curve, wall)


@pytest.mark.parametrize("radius", [1.05, 1.7, 2.4])
def test_the_shaft_comes_to_where_the_neck_is_as_narrow_as_it(
    neck: tuple[SplineCurve, WallDistance, Track], radius: float
) -> None:
    _, wall, track = neck
    model = narrow_neck()
    along = np.arange(2.0, 38.0, FINE)
    first = along[np.argmax(np.interp(along, model.arc_length, model.clearance) < radius)] - 2.0
    # The mesh lies up to 0.02 mm inside the tube, whose clearance falls by 0.2 mm per mm and more at these places.
    assert clear_until(track, wall, radius) == pytest.approx(first, abs=0.1)


def test_what_fits_comes_to_the_end_and_what_does_not_fit_at_the_start_to_nothing(
    neck: tuple[SplineCurve, WallDistance, Track],
) -> None:
    curve, wall, track = neck
    thin = scope(1.8, 8.0)
    assert shaft_until(curve, wall, track, thin, used=0.0) == track.length
    assert clear_until(track, wall, 3.1) == 0.0
    # Of a working length of 30 mm, 12 are spent before the start.
    assert shaft_until(curve, wall, track, scope(1.8, 8.0, reach=30.0), used=12.0) == pytest.approx(18.0)
    assert shaft_until(curve, wall, track, scope(1.8, 8.0, reach=10.0), used=12.0) == 0.0


@pytest.mark.parametrize("radius", [1.2, 1.9])
def test_no_place_before_it_is_narrower_and_one_just_behind_it_is(
    neck: tuple[SplineCurve, WallDistance, Track], radius: float
) -> None:
    _, wall, track = neck
    reached = clear_until(track, wall, radius)
    clearance = wall.clearance(track.at(np.arange(0.0, reached, FINE)))
    assert clearance.min() >= radius
    # Spans are halved to half a micrometre.
    assert wall.clearance(track.at(np.array([reached + FINE])))[0] < radius


def test_a_spline_is_followed_to_where_it_bends_too_much() -> None:
    # A parabola y = x^2 / 40 bends most at x = 0, by 1 / 20: it is too sharp where (1 + (x / 20)^2)^(3/2) < 20 / 30.
    x = np.linspace(-30.0, 30.0, 61)
    made = make_interp_spline(np.linspace(0.0, 1.0, 61), np.column_stack([x, x**2 / 40.0, 0.0 * x]), k=3)
    curve = SplineCurve(3, made.t, made.c)
    stop = -20.0 * np.sqrt((30.0 / 20.0) ** (2.0 / 3.0) - 1.0)
    expected = curve.arc_length([(stop + 30.0) / 60.0])[0]
    # The interpolating spline has the parabola's curvature to 1e-4 of it; 20 micrometres of path.
    assert curved_until(curve, 1.0 / 30.0) == pytest.approx(expected, abs=0.02)
    assert curved_until(curve, 1.0 / 19.9) == pytest.approx(curve.length)


@pytest.mark.parametrize(("length", "radius"), [(9.0, 2.6), (12.0, 2.4), (4.0, 2.5)])
def test_a_tip_is_caught_where_its_chord_first_comes_too_near(phantoms: ModuleType, length: float, radius: float) -> None:
    model = phantoms.torus_piece(20.0, 0.5 * np.pi, 3.0)
    points = model.axis_points[:: max(len(model.axis_points) // 60, 1)]
    made = make_interp_spline(np.linspace(0.0, 1.0, len(points)), points, k=3)
    curve, wall = SplineCurve(3, made.t, made.c), WallDistance(model.surface)
    track = Track.of(curve, wall)
    found = tip_until(track, wall, length, radius, until=track.length)
    # While the tip is not wholly on the path its chord of length c from the start loses 20 - sqrt(400 - c^2 / 4).
    chord = 2.0 * np.sqrt(20.0**2 - (20.0 - (3.0 - radius)) ** 2)
    if chord > length:
        assert found == track.length
        return
    # The mesh lies up to 0.04 mm inside the torus, and the sagitta grows by a tenth of the chord's growth.
    assert found == pytest.approx(40.0 * np.arcsin(chord / 40.0), abs=0.5)
    front = np.arange(FINE, track.length, 5.0 * FINE)
    ahead, behind = track.at(front), track.at(track.behind(front, length))
    least = np.min([wall.distance(t * ahead + (1.0 - t) * behind) for t in np.linspace(0.0, 1.0, 41)], axis=0)
    # Clearance is told to 0.01 mm there, and falls by a tenth of the way; fronts stand 0.05 mm apart.
    assert found == pytest.approx(front[np.argmax(least < radius)], abs=0.15)


@pytest.fixture(scope="module")
def catalogue() -> list[Instrument]:
    return [
        scope(diameter, bend, tip)
        for diameter in (1.0, 2.2, 2.8, 3.2, 3.8)
        for bend, tip in ((6.0, 0.0), (11.0, 5.0), (20.0, 8.0))
    ]


@pytest.fixture(scope="module")
def matrix(fork: Any, catalogue: list[Instrument]) -> Matrix:
    return instrument_matrix(fork.wall, START, fork.targets, catalogue, ReachSettings(), jobs=1)


def test_up_to_the_place_told_an_instrument_keeps_every_limit(fork: Any, matrix: Matrix) -> None:
    seen = 0
    for one, row in zip(matrix.instruments, matrix.cells, strict=True):
        for j, cell in enumerate(row):
            if cell.advance is None:
                continue
            seen += 1
            curve, reached = matrix.paths[j][cell.advance.path].curve, cell.advance.arc_length
            assert cell.advance.short == pytest.approx(curve.length - reached)
            front = np.linspace(0.0, reached, 400)
            u = curve.parameter(front)
            points = curve(u)
            assert np.allclose(points[-1], cell.advance.point, atol=1e-5)
            assert fork.wall.clearance(points).min() >= one.radius - 1e-9
            assert curve.curvature(u).max() <= one.limits.curvature_max * (1.0 + 1e-9)
            if one.rigid_tip_mm:
                track = Track.of(curve, fork.wall)
                back = track.at(track.behind(front, one.rigid_tip_mm))
                for share in (0.25, 0.5, 0.75):
                    assert fork.wall.clearance(share * points + (1.0 - share) * back).min() >= one.radius - 1e-6
    assert seen > 10


def test_a_cell_that_holds_is_short_of_nothing(matrix: Matrix) -> None:
    cells = [cell for row in matrix.cells for cell in row]
    assert {cell.verdict for cell in cells} >= {Verdict.FEASIBLE, Verdict.IMPOSSIBLE}
    assert all(cell.advance is None for cell in cells if cell.verdict is Verdict.FEASIBLE)
    assert all("before the target" in cell.reason for cell in cells if cell.advance is not None)


def test_a_thinner_or_softer_instrument_never_stays_shorter(matrix: Matrix) -> None:
    compared = 0
    for j in range(len(matrix.targets)):
        for one, row in zip(matrix.instruments, matrix.cells, strict=True):
            for other, other_row in zip(matrix.instruments, matrix.cells, strict=True):
                if one is other or not one.is_no_harder_than(other) or row[j].verdict is Verdict.FEASIBLE:
                    continue
                here, there = row[j].advance, other_row[j].advance
                if there is not None:
                    compared += 1
                    # Tips are told to 0.03 mm, and less where little is proved.
                    assert here is not None
                    assert here.short <= there.short + 0.05
    assert compared > 5


def test_the_thick_one_stops_where_the_narrow_branch_begins(fork: Any, matrix: Matrix) -> None:
    # 1.4 mm of radius against a branch of 1.2 mm: it leaves the stem's width within the bend, some 20 mm before the target.
    cell = next(
        row[1] for one, row in zip(matrix.instruments, matrix.cells, strict=True) if one.name.startswith("2.8 mm, bend 6")
    )
    assert cell.verdict is Verdict.IMPOSSIBLE
    assert cell.advance is not None
    # The branch: an arc of 12 mm and 90 degrees, and 6 mm more to the target.
    branch = 12.0 * 0.5 * np.pi + 6.0
    assert 0.4 * branch < cell.advance.short < branch
