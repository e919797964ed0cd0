from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from segmentation.mesh_repair import closed_and_oriented
from tubeplan_viz.bench.models import (
    bent_cylinder_1,
    bent_cylinder_2,
    helix_tube,
    narrow_neck,
    straight_tube,
    too_narrow_cylinder_2,
    torus_piece,
    variant_1,
    variant_2,
    y_junction,
)

MESHINGS = ("swept", "structured", "marching_cubes")


def test_cylinder_1_fills_the_printed_box_without_straight_pieces():
    lower, upper = bent_cylinder_1(meshing="structured").surface.bounds
    # The rings stand on the axis' own radius; the box is exact up to the rounding of sines.
    np.testing.assert_allclose(upper - lower, [71.0, 65.0, 6.0], atol=1e-9)
    np.testing.assert_allclose(lower, [-3.0, 0.0, -3.0], atol=1e-9)


@pytest.mark.parametrize(
    ("build", "bends"), [(bent_cylinder_1, (12, 15, 18, 20)), (variant_1, (10, 13, 16, 19)), (variant_2, (8, 12, 16, 20))]
)
def test_axis_of_tangent_quarter_bends_ends_at_the_sum_of_the_radii(build, bends):
    model = build()
    assert model.length == pytest.approx(0.5 * np.pi * sum(bends), abs=1e-12)
    np.testing.assert_allclose(model.goal, [sum(bends), sum(bends), 0.0], atol=1e-12)
    first, last = np.diff(model.axis_points[[0, 1, -2, -1]], axis=0)[[0, 2]]
    # One step of 0.1 mm on the tightest bend turns by 0.1 / 8 / 2 rad.
    assert first[1] / np.linalg.norm(first) == pytest.approx(1.0, abs=1e-4)
    assert last[1] / np.linalg.norm(last) == pytest.approx(1.0, abs=1e-4)
    assert model.curvature.max() == pytest.approx(1.0 / min(bends))


@pytest.mark.parametrize("meshing", MESHINGS)
@pytest.mark.parametrize("build", [variant_2, bent_cylinder_2, helix_tube, narrow_neck])
def test_every_mesh_is_closed_two_sided_and_outward_with_two_flat_caps(build, meshing):
    model = build(meshing=meshing)
    surface = model.surface
    assert closed_and_oriented(surface.faces).all()
    assert surface.volume_ml > 0.0
    assert [cap.origin for cap in surface.caps] == ["flat end", "flat end"]
    for cap, end, outward in zip(surface.caps, (0, -1), (-1.0, 1.0), strict=True):
        np.testing.assert_allclose(cap.center, model.axis_points[end], atol=1e-9)
        tangent = model.axis_points[[0, 1]] if end == 0 else model.axis_points[[-2, -1]]
        step = np.diff(tangent, axis=0)[0]
        assert outward * cap.normal @ step / np.linalg.norm(step) > 0.999


@pytest.mark.parametrize(
    ("model", "area", "length"),
    [
        (straight_tube(meshing="structured"), np.pi * 3.0**2, 40.0),
        (torus_piece(meshing="structured"), np.pi * 3.0**2, 20.0 * np.pi / 2),
        (helix_tube(meshing="structured"), np.pi * 2.5**2, 80.0),
    ],
)
def test_volume_is_cross_section_times_axis_length(model, area, length):
    # Pappus. A ring of n vertices on the circle has sin(2 pi / n) n / 2 pi of its area: 0.4 % less for n = 44.
    assert model.surface.volume_ml * 1000.0 == pytest.approx(area * length, rel=8e-3)


@pytest.mark.parametrize("meshing", MESHINGS)
def test_wall_of_cylinder_1_lies_three_millimetres_from_the_axis(meshing):
    model = bent_cylinder_1(meshing=meshing)
    wall = model.surface.vertices[np.unique(model.surface.wall_faces)]
    distance = cKDTree(model.axis_points).query(wall)[0]
    inner = (wall[:, 1] > 0.5) & (wall[:, 1] < model.goal[1] - 0.5)
    # Axis points every 0.1 mm add sqrt(9 + 0.05^2) - 3 = 0.0004 mm; linear interpolation in a 0.4 mm voxel
    # leaves h^2 / (8 r) = 0.007 mm.
    tolerance = 0.01 if meshing == "marching_cubes" else 0.001
    np.testing.assert_allclose(distance[inner], 3.0, atol=tolerance)


def test_clearance_of_cylinder_2_is_the_distance_to_a_finely_sampled_wall():
    model = bent_cylinder_2()
    # A wall of its own, from the definition: rings of the stated radius every 0.02 mm of axis.
    s = np.linspace(0.0, 72.0, 3601)
    radius = np.minimum(10.0, 2.0 + np.minimum(s, 72.0 - s) / 2.0)
    bend = 40.0 / np.deg2rad(60.0)
    turn = np.clip((s - 16.0) / bend, 0.0, np.deg2rad(60.0))
    beyond = np.clip(s - 56.0, 0.0, None)
    axis = np.column_stack([bend * (np.cos(turn) - 1.0), np.minimum(s, 16.0) + bend * np.sin(turn)])
    axis += beyond[:, None] * np.column_stack([-np.sin(turn), np.cos(turn)])
    np.testing.assert_allclose(
        model.axis_points[:, :2], np.column_stack([np.interp(model.arc_length, s, axis[:, k]) for k in (0, 1)]), atol=1e-4
    )
    across = np.column_stack([np.cos(turn), np.sin(turn)])
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    wall = np.concatenate([np.column_stack([axis + (radius * np.cos(a))[:, None] * across, radius * np.sin(a)]) for a in angle])
    distance = cKDTree(wall).query(model.axis_points)[0]
    # Samples of the wall are 0.02 mm by up to 0.7 mm apart: an excess of 0.35^2 / (2 r) at r = 10.
    np.testing.assert_allclose(distance, model.clearance, atol=0.01)


def test_stretches_too_narrow_for_six_millimetres_are_where_the_clearance_says_so():
    model = bent_cylinder_2()
    (start, entry), (leave, end) = too_narrow_cylinder_2(6.0)
    narrow = model.clearance < 6.0
    expected = (model.arc_length < entry) | (model.arc_length > leave)
    assert start == 0.0
    assert end == model.length == pytest.approx(72.0)
    np.testing.assert_array_equal(narrow, expected)


def test_noise_moves_the_wall_by_its_deviation_and_leaves_the_mesh_closed():
    clean = bent_cylinder_1()
    noisy = bent_cylinder_1(noise=0.01, rng=np.random.default_rng(3))
    shift = noisy.surface.vertices - clean.surface.vertices
    on_wall = np.zeros(len(shift), dtype=bool)
    on_wall[clean.surface.wall_faces] = True
    # 3 x 10^4 samples: the deviation is known to 0.4 %.
    assert shift[on_wall].std() == pytest.approx(0.01, rel=0.02)
    assert not shift[~on_wall].any()
    assert closed_and_oriented(noisy.surface.faces).all()


def test_noise_without_a_generator_is_refused():
    with pytest.raises(ValueError, match="pass rng"):
        straight_tube(noise=0.01)


def test_narrow_neck_is_nearest_to_the_wall_in_its_middle():
    model = narrow_neck(neck=1.0)
    middle = int(np.argmin(model.clearance))
    assert model.arc_length[middle] == pytest.approx(20.0, abs=0.05)
    assert model.clearance[middle] == pytest.approx(1.0, abs=1e-6)
    assert np.all(model.clearance <= model.radius + 1e-9)


def test_y_junction_has_three_caps_and_a_second_branch():
    model = y_junction()
    assert closed_and_oriented(model.surface.faces).all()
    assert [cap.label for cap in model.surface.caps] == ["C1", "C2", "C3"]
    np.testing.assert_allclose(model.branches[0][-1] * [-1, 1, 1], model.goal, atol=1e-9)
    # Children of 2.2 mm stay 2.2 mm from their wall past the junction.
    wall = model.surface.vertices[np.unique(model.surface.wall_faces)]
    free = cKDTree(wall).query(model.branches[0][120:180])[0]
    assert free.min() > 2.2 - 0.02
