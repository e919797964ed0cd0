"""Cubes of a lumen: what they claim of the clearance holds everywhere in them, and none of the lumen is missed."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.bench.models import y_junction
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.tube.cells import Cells, first_cells, split
from tubeplan_viz.tube.samples import with_knots


@pytest.fixture(scope="module")
def wall() -> WallDistance:
    return WallDistance(y_junction().surface)


@pytest.fixture(scope="module")
def cells(wall: WallDistance) -> Cells:
    made = first_cells(wall, 0.0)
    for _ in range(2):
        chosen = np.random.default_rng(3).choice(np.flatnonzero(made.alive), 300, replace=False)
        made = split(made, chosen, known=0.0, sharp=0.5)
    return made


def test_no_point_of_a_cube_is_farther_from_the_wall_than_its_bound(wall: WallDistance, cells: Cells) -> None:
    rng = np.random.default_rng(5)
    index = rng.choice(np.flatnonzero(cells.alive), 20_000)
    points = cells.origin + cells.unit * (cells.corner[index] + rng.uniform(size=(len(index), 3)) * cells.width[index][:, None])
    assert np.all(wall.distance(points) <= cells.upper[index] + 1e-9)


def test_every_point_of_the_lumen_lies_in_a_cube(wall: WallDistance, cells: Cells) -> None:
    low, high = wall.surface.vertices.min(axis=0), wall.surface.vertices.max(axis=0)
    points = np.random.default_rng(7).uniform(low, high, (4000, 3))
    points = points[wall.inside(points)]
    assert len(points) > 100
    assert all(cells.holding(point) >= 0 for point in points)


def test_cubes_that_share_a_face_are_paired_whatever_their_sizes(cells: Cells) -> None:
    rng = np.random.default_rng(9)
    index = rng.choice(np.flatnonzero(cells.alive), 400)
    pairs = {tuple(sorted(pair)) for pair in cells.pairs.tolist()}
    for one in index.tolist():
        # Just beyond the middle of a face lies the neighbour's cube, when there is one.
        for axis, side in ((0, 1), (1, -1), (2, 1)):
            point = cells.center(np.array([one]))[0]
            point[axis] += side * (0.5 + 1e-4) * cells.width[one] * cells.unit
            other = cells.holding(point + 1e-7)
            assert other < 0 or other == one or tuple(sorted((one, other))) in pairs


def test_added_knots_leave_the_curve_as_it_is() -> None:
    control = np.random.default_rng(1).normal(size=(7, 3)) * 10.0
    curve = SplineCurve(3, np.concatenate([np.zeros(4), [0.2, 0.5, 0.7], np.ones(4)]), control)
    finer = with_knots(curve, 1.0)
    u = np.linspace(0.0, 1.0, 200)
    np.testing.assert_allclose(finer(u), curve(u), atol=1e-12)
    # The table that turns arc length into parameters is good to a micrometre or two.
    assert np.diff(finer.arc_length(np.unique(finer.knots))).max() < 1.0 + 1e-3
