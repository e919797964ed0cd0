from __future__ import annotations

import fast_simplification
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from segmentation.caps import mark_flat_ends
from segmentation.errors import SurfaceError
from segmentation.mesh import Surface
from tubeplan_viz.geometry import WallDistance

MESHINGS = ("swept", "structured", "marching_cubes")


def free_of_wall(surface: Surface, point: np.ndarray) -> float:
    """Distance in mm from a point to the nearest vertex of the wall."""
    return float(np.linalg.norm(surface.vertices[np.unique(surface.wall_faces)] - point, axis=1).min())


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("meshing", MESHINGS)
@pytest.mark.parametrize("build", ["bent_cylinder_1", "bent_cylinder_2", "helix_tube"])
def test_flat_ends_of_a_tube_become_caps_and_leave_no_rim(phantoms, build, meshing, noise):
    model = getattr(phantoms, build)(meshing=meshing, noise=noise, rng=np.random.default_rng(5))
    marked = mark_flat_ends(phantoms.unlabelled(model.surface), [model.start, model.goal])
    assert [cap.origin for cap in marked.caps] == ["flat end", "flat end"]
    assert [cap.label for cap in marked.caps] == ["C1", "C2"]
    assert marked.caps[0].area >= marked.caps[1].area
    found, known = marked.face_cap >= 0, model.surface.face_cap >= 0
    # The chamfer that marching cubes leave at a rim belongs to the model's caps; only what lies flat must be found.
    flat = known & (
        np.abs(model.surface.face_normals @ np.array([cap.normal for cap in model.surface.caps]).T).max(axis=1) > 0.95
    )
    missed = model.surface.face_areas[flat & ~found].sum()
    assert missed < 0.01 * model.surface.face_areas[flat].sum()
    # What is left of the wall is as far from the end's middle as the tube is wide; marching cubes of voxel h cut
    # the rim by up to h / 2 (0.2 mm here, 0.3 mm on cylinder 2), noise by four deviations.
    slack = (0.3 if meshing == "marching_cubes" else 1e-9) + 4.0 * noise
    for end, radius in [(model.start, model.radius[0]), (model.goal, model.radius[-1])]:
        assert free_of_wall(marked, end) > radius - slack


@pytest.mark.parametrize("build", ["bent_cylinder_1", "variant_2", "helix_tube"])
def test_the_chamfer_of_marching_cubes_does_not_narrow_the_end(phantoms, build):
    model = getattr(phantoms, build)(meshing="marching_cubes")
    marked = mark_flat_ends(phantoms.unlabelled(model.surface), [model.start, model.goal])
    found, known = (WallDistance(surface).distance([model.start, model.goal]) for surface in (marked, model.surface))
    # The model knows its own caps, chamfer included; a facet of the chamfer that is taken for wall costs 0.15 to 0.35 mm.
    assert (found > known - 0.1).all()


@pytest.mark.parametrize("meshing", ["swept", "marching_cubes"])
def test_caps_are_found_on_decimated_meshes(phantoms, meshing):
    model = phantoms.bent_cylinder_1(meshing=meshing)
    vertices, faces = fast_simplification.simplify(
        model.surface.vertices.astype(np.float32), model.surface.faces.astype(np.int32), 0.8
    )
    coarse = Surface(vertices.astype(float), faces.astype(np.int64), np.full(len(faces), -1), (), "mesh")
    marked = mark_flat_ends(coarse, [model.start, model.goal])
    assert len(marked.caps) == 2
    for cap in marked.caps:
        # The disc alone, without the chamfer that marching cubes leave: at least (r - h)^2 of r^2.
        assert cap.area > np.pi * 2.6**2


@pytest.mark.parametrize("depth", [0.0, 0.9, 4.0])
@pytest.mark.parametrize("radius", [1.0, 3.0])
def test_a_point_before_the_end_means_it_too(phantoms, radius, depth):
    model = phantoms.straight_tube(length=30.0, radius=radius)
    inside = model.start + np.array([0.2 * radius, min(depth, 3.0 * radius), 0.0])
    marked = mark_flat_ends(phantoms.unlabelled(model.surface), [inside])
    assert len(marked.caps) == 1
    np.testing.assert_allclose(marked.caps[0].normal, [0.0, -1.0, 0.0], atol=1e-6)
    # A regular polygon of n corners has this share of the disc: sin(2 pi / n) n / (2 pi), 0.95 for n = 12.
    assert 0.94 * np.pi * radius**2 < marked.caps[0].area < np.pi * radius**2


@pytest.mark.parametrize("radius", [0.5, 0.8, 1.5, 3.0, 6.0])
def test_a_round_end_is_wall(phantoms, radius):
    tube = phantoms.capsule(30.0, radius)
    points = [[0.0, 0.0, -radius], [0.0, 0.0, 30.0 + radius], [0.0, 0.0, 0.0], [0.0, 0.0, 15.0]]
    assert mark_flat_ends(tube, points) is tube


def test_a_point_in_the_middle_of_a_tube_means_no_end(phantoms):
    surface = phantoms.unlabelled(phantoms.bent_cylinder_1().surface)
    assert mark_flat_ends(surface, [phantoms.bent_cylinder_1().axis_points[500]]) is surface


def test_a_flat_step_behind_which_the_lumen_goes_on_is_wall(phantoms):
    # Two boxes of different width in one: the wide one's end is a flat ring around the narrow one.
    wide, narrow = phantoms.straight_tube(radius=4.0, length=20.0), phantoms.straight_tube(radius=1.5, length=40.0)
    vertices, faces = phantoms.joined(
        (wide.surface.vertices, wide.surface.faces), (narrow.surface.vertices + np.array([0.0, 10.0, 0.0]), narrow.surface.faces)
    )
    both = Surface(vertices, faces, np.full(len(faces), -1), (), "mesh")
    assert mark_flat_ends(both, [[2.8, 20.0, 0.0]]) is both


def test_caps_turn_with_the_mesh(phantoms):
    model = phantoms.variant_1(meshing="marching_cubes")
    turn, shift = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([50.0, -20.0, 900.0])
    surface = phantoms.unlabelled(model.surface)
    moved = Surface(surface.vertices @ turn.T + shift, surface.faces, surface.face_cap, (), "mesh")
    here = mark_flat_ends(surface, [model.start, model.goal])
    there = mark_flat_ends(moved, np.array([model.start, model.goal]) @ turn.T + shift)
    np.testing.assert_array_equal(here.face_cap, there.face_cap)


def test_caps_that_exist_stay_and_all_are_named_by_area(phantoms):
    model = phantoms.bent_cylinder_2()
    one = Surface(
        model.surface.vertices, model.surface.faces, np.where(model.surface.face_cap == 0, 0, -1), model.surface.caps[:1], "mesh"
    )
    marked = mark_flat_ends(one, [model.start, model.goal])
    assert len(marked.caps) == 2
    assert [cap.label for cap in marked.caps] == ["C1", "C2"]
    np.testing.assert_array_equal(marked.face_cap >= 0, model.surface.face_cap >= 0)


def test_a_tolerance_of_zero_is_refused(phantoms):
    with pytest.raises(SurfaceError, match="expected a positive length"):
        mark_flat_ends(phantoms.straight_tube().surface, [[0.0, 0.0, 0.0]], tolerance=0.0)
