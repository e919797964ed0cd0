"""Distance to the wall against brute force and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from segmentation.mesh import Cap, Surface
from tubeplan_viz.geometry import WallDistance

CENTER = np.array([30.0, -5.0, 2.0])


def brute_force_distance(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Least distance to triangles (m, 3, 3): to the plane where the foot is inside, else to the nearest edge."""
    best = np.full(len(points), np.inf)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for k, p in enumerate(points):
        height = np.einsum("ij,ij->i", p - a, normal)
        foot = p - height[:, None] * normal
        inside = np.ones(len(corners), dtype=bool)
        nearest = np.full(len(corners), np.inf)
        for start, end in ((a, b), (b, c), (c, a)):
            edge = end - start
            inside &= np.einsum("ij,ij->i", np.cross(edge, foot - start), normal) >= 0.0
            t = np.clip(np.einsum("ij,ij->i", p - start, edge) / np.einsum("ij,ij->i", edge, edge), 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(start + t[:, None] * edge - p, axis=1))
        best[k] = np.where(inside, np.abs(height), nearest).min()
    return best


def box_signed_distance(points: np.ndarray) -> np.ndarray:
    """Positive inside the box of 8 x 6 x 10 mm."""
    outside = np.abs(points) - np.array([4.0, 3.0, 5.0])
    return -(np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0))


@pytest.fixture(scope="module")
def sphere() -> Surface:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    return Surface(np.array(ball.vertices) + CENTER, np.array(ball.faces), np.full(len(ball.faces), -1), (), "mesh")


def open_box(box: Surface) -> Surface:
    """The box with its two faces at z = 5 named as a cap."""
    z = box.vertices[box.faces][:, :, 2]
    top = np.all(z == 5.0, axis=1)
    cap = Cap("C1", "flat end", np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, 1.0]), 48.0)
    return Surface(box.vertices, box.faces, np.where(top, 0, -1), (cap,), "mesh")


def test_clearance_in_a_box_is_the_closed_form(box: Surface) -> None:
    points = np.random.default_rng(1).uniform(-8.0, 8.0, (2000, 3))
    np.testing.assert_allclose(WallDistance(box).clearance(points), box_signed_distance(points), atol=1e-12)


def test_distance_to_a_sphere_mesh_is_that_of_brute_force(sphere: Surface) -> None:
    rng = np.random.default_rng(2)
    points = CENTER + rng.normal(0.0, 8.0, (200, 3))
    wall = WallDistance(sphere)
    exact = brute_force_distance(points, sphere.vertices[sphere.faces])
    np.testing.assert_allclose(wall.distance(points), exact, atol=1e-12)
    # The sphere lies outside its polyhedron by less than the sagitta of its 1,280 facets, 0.07 mm.
    gap = 10.0 - np.linalg.norm(points - CENTER, axis=1)
    clear = np.abs(gap) > 0.2
    assert np.all(np.abs(wall.clearance(points) - gap)[clear] < 0.1)


def test_nearest_names_the_face_and_the_foot_on_it(sphere: Surface) -> None:
    points = CENTER + np.random.default_rng(3).normal(0.0, 8.0, (50, 3))
    distance, face, foot = WallDistance(sphere).nearest(points)
    np.testing.assert_allclose(np.linalg.norm(points - foot, axis=1), distance, atol=1e-12)
    own = [brute_force_distance(p[None], sphere.vertices[sphere.faces[[f]]])[0] for p, f in zip(points, face, strict=True)]
    np.testing.assert_allclose(own, distance, atol=1e-12)


def test_a_cap_is_not_wall_unless_ends_are_closed(box: Surface) -> None:
    surface = open_box(box)
    near_cap = np.array([[0.0, 0.0, 4.5], [1.0, 0.5, 4.9], [0.0, 0.0, 0.0]])
    # With the lid open the nearest wall of these is a side: 3 mm less |y|.
    np.testing.assert_allclose(WallDistance(surface).clearance(near_cap), [3.0, 2.5, 3.0], atol=1e-12)
    np.testing.assert_allclose(WallDistance(surface, closed_ends=True).clearance(near_cap), [0.5, 0.1, 3.0], atol=1e-12)


def test_a_face_index_counts_among_all_faces_when_caps_are_left_out(box: Surface) -> None:
    surface = open_box(box)
    points = np.random.default_rng(4).uniform(-3.0, 3.0, (100, 3))
    _, face, foot = WallDistance(surface).nearest(points)
    assert np.all(surface.face_cap[face] == -1)
    on_face = [brute_force_distance(p[None], surface.vertices[surface.faces[[f]]])[0] for p, f in zip(foot, face, strict=True)]
    np.testing.assert_allclose(on_face, 0.0, atol=1e-12)


def test_the_middle_of_a_cap_is_inside_and_a_hair_beyond_it_is_not(box: Surface) -> None:
    wall = WallDistance(open_box(box))
    above = np.array([[0.0, 0.0, 5.0], [1.3, -0.7, 5.0], [0.0, 0.0, 5.0 + 5e-7], [0.0, 0.0, 5.00001], [0.0, 0.0, 5.5]])
    assert wall.inside(above).tolist() == [True, True, True, False, False]
    assert wall.clearance(above)[0] == pytest.approx(3.0)
    assert wall.clearance(above)[4] < 0.0


def test_inside_follows_the_closed_surface_and_not_the_caps_left_out(box: Surface) -> None:
    points = np.random.default_rng(5).uniform(-8.0, 8.0, (500, 3))
    points = points[np.abs(box_signed_distance(points)) > 1e-6]
    truth = box_signed_distance(points) > 0.0
    for closed_ends in (False, True):
        assert np.array_equal(WallDistance(open_box(box), closed_ends=closed_ends).inside(points), truth)


def test_one_point_may_be_given_without_its_own_axis(box: Surface) -> None:
    wall = WallDistance(box)
    assert wall.distance([0.0, 0.0, 0.0]) == pytest.approx([3.0])
    assert wall.inside([0.0, 0.0, 0.0]).tolist() == [True]


def test_cap_distance_is_that_to_the_lid_alone(box: Surface) -> None:
    surface = open_box(box)
    points = np.array([[0.0, 0.0, 2.0], [7.0, 0.0, 5.0], [0.0, 0.0, 9.0]])
    np.testing.assert_allclose(WallDistance(surface).cap_distance(points), [3.0, 3.0, 4.0], atol=1e-12)
    for wall in (WallDistance(surface, closed_ends=True), WallDistance(box)):
        assert np.all(np.isinf(wall.cap_distance(points)))
