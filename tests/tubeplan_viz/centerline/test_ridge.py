"""The exact middle: closed forms for round tubes, linear programming for the small problems, thinning by width."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import cKDTree

from tubeplan_viz.bench.centerline import off_axis
from tubeplan_viz.centerline.ridge import greatest_least, normal_planes, to_ridge
from tubeplan_viz.centerline.sampling import SHARE, oriented_samples, thinned_samples

Prepare = Callable[[str], Any]


@pytest.mark.parametrize("name", ["straight", "torus", "helix", "marching cubes"])
def test_points_beside_the_axis_are_brought_onto_it(name: str, prepared: Prepare) -> None:
    model, wall = prepared(name).model, prepared(name).wall
    inner = (model.arc_length > 4.0) & (model.arc_length < model.length - 4.0)
    axis = model.axis_points[inner][::5]
    across = normal_planes(axis)
    beside = axis + 0.15 * model.radius[0] * across[:, :, 0]
    radii = model.radius[inner][::5]
    once, found = to_ridge(beside, wall, radii=radii, reach=0.3 * radii)
    twice, found = to_ridge(once, wall, radii=found, reach=0.3 * radii)
    # Facets of 0.4 mm on a radius of 3 mm have sagittas of 0.007 mm; the plane across a shifted curve is tilted a little.
    assert off_axis(twice, model)[0][3:-3].max() < 0.02
    assert np.abs(found - wall.distance(twice))[3:-3].max() < 0.03


def test_a_reach_of_zero_moves_nothing_and_a_short_one_no_farther(prepared: Prepare) -> None:
    model, wall = prepared("straight").model, prepared("straight").wall
    beside = model.axis_points[100:140] + np.array([0.8, 0.0, 0.0])
    radii = np.full(len(beside), 2.2)
    still, same = to_ridge(beside, wall, radii=radii, reach=np.zeros(len(beside)))
    np.testing.assert_array_equal(still, beside)
    np.testing.assert_array_equal(same, radii)
    moved, _ = to_ridge(beside, wall, radii=radii, reach=np.full(len(beside), 0.1))
    np.testing.assert_allclose(np.linalg.norm(moved - beside, axis=1), 0.1, atol=1e-9)


def test_greatest_least_distance_is_that_of_a_linear_programme() -> None:
    rng = np.random.default_rng(4)
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, (60, 12)), axis=1)
    slope = -np.stack([np.cos(angle), np.sin(angle)], axis=2)
    level = rng.uniform(2.0, 3.0, (60, 12))
    z = greatest_least(level, slope, np.full(60, 2.5))
    value = (level + np.einsum("nkj,nj->nk", slope, z)).min(axis=1)
    for n in range(60):
        best = linprog(
            [0.0, 0.0, -1.0], np.column_stack([-slope[n], np.ones(12)]), level[n], bounds=[(-2.5, 2.5)] * 2 + [(None, None)]
        )
        # The pull back costs up to 0.02 of the squared shift over the size; the soft minimum is sharp to 1/1280 of the size.
        assert value[n] > -best.fun - 0.02 - 0.02 * float(z[n] @ z[n]) / 2.5
        assert value[n] <= -best.fun + 1e-9


def test_thinned_samples_stay_dense_where_the_lumen_is_narrow(prepared: Prepare) -> None:
    surface = prepared("neck").model.surface
    points, normals = oriented_samples(surface, 5.0)
    edge = float(np.sqrt(surface.face_areas[surface.face_cap < 0].sum() / len(points)))
    fine = np.repeat(points, 3, axis=0) + np.random.default_rng(2).normal(0.0, 0.01, (3 * len(points), 3))
    kept = thinned_samples(fine, np.repeat(normals, 3, axis=0), cKDTree(fine), edge)
    assert len(kept) < 0.5 * len(fine)
    assert np.array_equal(kept, np.unique(kept))
    # No sample is farther from a kept one than the diagonal of a cell for the radius there, 3 mm at most.
    gap = cKDTree(fine[kept]).query(fine)[0]
    radius = np.linalg.norm(fine[:, [0, 2]], axis=1)
    assert np.all(gap < np.sqrt(3.0) * np.maximum(SHARE * radius / 0.8, edge * np.sqrt(2.0)) + 0.1)


def test_normals_of_samples_point_out_of_the_tube(prepared: Prepare) -> None:
    points, normals = oriented_samples(prepared("straight").model.surface, 0.3)
    outward = points[:, [0, 2]] / np.linalg.norm(points[:, [0, 2]], axis=1, keepdims=True)
    along = np.einsum("ij,ij->i", outward, normals[:, [0, 2]])
    # Facets of 0.44 mm on a radius of 3 mm lean by up to 9 degrees.
    assert along.min() > 0.98
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
