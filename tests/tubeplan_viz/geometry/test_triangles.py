"""Triangle sets: exact nearest points, and no triangle within reach missed."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from tubeplan_viz.geometry.triangles import Triangles


@pytest.fixture(scope="module")
def corners() -> np.ndarray:
    """300 triangles of sizes from 0.01 to 30, one without area."""
    rng = np.random.default_rng(3)
    size = 10.0 ** rng.uniform(-2.0, 1.5, (300, 1, 1))
    made = rng.uniform(-20.0, 20.0, (300, 1, 3)) + size * rng.normal(size=(300, 3, 3))
    made[7, 2] = made[7, 1]
    return made


def test_nearest_points_are_exact(corners: np.ndarray) -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform(-25.0, 25.0, (300, 3))
    feet = Triangles(corners).closest(points, np.arange(300))
    for point, foot, triangle in zip(points, feet, corners, strict=True):
        square = igl.point_mesh_squared_distance(point[None], np.ascontiguousarray(triangle), np.array([[0, 1, 2]]))[0]
        assert np.linalg.norm(point - foot) == pytest.approx(float(np.sqrt(np.atleast_1d(square)[0])), abs=1e-9)


def test_no_triangle_within_reach_is_missed(corners: np.ndarray) -> None:
    rng = np.random.default_rng(6)
    points, reach = rng.uniform(-25.0, 25.0, (40, 3)), rng.uniform(0.0, 12.0, 40)
    triangles = Triangles(corners)
    rows, faces = triangles.within(points, reach)
    listed = set(zip(rows.tolist(), faces.tolist(), strict=True))
    all_rows, all_faces = np.repeat(np.arange(40), 300), np.tile(np.arange(300), 40)
    gap = np.linalg.norm(points[all_rows] - triangles.closest(points[all_rows], all_faces), axis=1)
    near = gap <= reach[all_rows]
    assert near.any()
    assert set(zip(all_rows[near].tolist(), all_faces[near].tolist(), strict=True)) <= listed


def test_points_on_a_face_find_it_as_likely_nearest(corners: np.ndarray) -> None:
    triangles = Triangles(corners)
    centers = corners.mean(axis=1)
    np.testing.assert_array_equal(triangles.likely_nearest(centers)[:, 0], np.arange(300))
