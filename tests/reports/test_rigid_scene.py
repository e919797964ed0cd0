"""What the turnable scene of a rigid page is made of: solids of revolution, poses, and nothing of a face."""

from __future__ import annotations

import numpy as np
import pytest

from reports.rigid_scene import AROUND, box_around, instrument_parts, moved, nearest_stretches, poses_of, revolved, surface_of
from reports.wall import LightMesh
from segmentation.anatomy.nasal import Tissue, inner_air
from segmentation.arrays import FloatArray
from segmentation.synthetic.nasal import NasalPhantomSettings, nasal_phantom

TOOL = {
    "scope_diameter_mm": 4.0,
    "shaver_diameter_mm": 2.9,
    "offset_mm": 6.0,
    "setback_mm": 8.0,
    "view_angle_deg": 30.0,
}


def volume_of(mesh: LightMesh) -> float:
    """Signed volume that a closed mesh holds, mm^3."""
    corners = mesh.vertices[mesh.faces]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0


def test_a_revolved_cylinder_holds_the_prism_of_its_corners() -> None:
    length, radius = 10.0, 2.0
    made = revolved(np.array([[0.0, 0.0], [0.0, radius], [length, radius], [length, 0.0]]))
    # A regular polygon of n corners has the area n/2 r^2 sin(2 pi / n).
    area = 0.5 * AROUND * radius**2 * np.sin(2.0 * np.pi / AROUND)
    assert abs(volume_of(made)) == pytest.approx(length * area, rel=1e-12)


def test_the_parts_stand_as_the_instruments_lengths_say() -> None:
    shaver, scope, sight = (mesh for _, mesh in instrument_parts(TOOL, 70.0))
    # The shaver's tip is the origin, its axis x; the endoscope lies 6 mm above and ends 8 mm behind it.
    assert shaver.vertices[:, 0].max() == pytest.approx(0.0, abs=1e-12)
    assert np.hypot(shaver.vertices[:, 1], shaver.vertices[:, 2]).max() == pytest.approx(1.45)
    assert scope.vertices[:, 0].max() == pytest.approx(-8.0)
    assert np.hypot(scope.vertices[:, 1] - 6.0, scope.vertices[:, 2]).max() == pytest.approx(2.0)
    # Seen at 30 degrees towards the shaver the line of sight falls by half its length of 10 mm, the working distance.
    end = sight.vertices[np.argsort(sight.vertices[:, 0])[-AROUND:]].mean(axis=0)
    assert end == pytest.approx([-8.0 + 10.0 * np.cos(np.radians(30.0)), 6.0 - 5.0, 0.0], abs=0.2)


def test_a_part_is_put_on_the_path_with_its_axis_along_the_segment() -> None:
    along, up = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    place = np.array([5.0, 6.0, 7.0])
    probe = LightMesh(np.array([[-3.0, 0.0, 0.0], [0.0, 6.0, 0.0]]), np.empty((0, 3), np.int64), 0)
    assert moved(probe, place, along, up).vertices == pytest.approx(np.array([[5.0, 3.0, 7.0], [5.0, 6.0, 13.0]]))


def document() -> dict[str, object]:
    """A path of two segments with its nodes and distances, as in result.json."""
    return {
        "path": {"s_mm": [0.0, 1.0, 2.0, 3.0, 4.0]},
        "feature_points": [{"s_mm": 0.0}, {"s_mm": 2.0}, {"s_mm": 4.0}],
        "details": {
            "nodes": [
                {"direction": [1.0, 0.0, 0.0], "up": [0.0, 0.0, 1.0]},
                {"direction": [0.0, 1.0, 0.0], "up": [0.0, 0.0, 1.0]},
            ],
            "structure_distances_mm": {"brain": [9.0, 8.0, 3.0, 2.0, 2.0], "orbit_left": [4.0, 4.0, 4.0, 4.0, None]},
        },
    }


def test_every_sample_has_the_pose_of_its_segment() -> None:
    assert [(last, along.tolist()) for last, along, _ in poses_of(document())] == [(2, [1.0, 0.0, 0.0]), (4, [0.0, 1.0, 0.0])]


def test_the_nearest_structure_is_named_by_stretches() -> None:
    told = nearest_stretches(document())
    assert [(row["name"], row["from"], row["to"]) for row in told] == [
        ("nearest: orbit left", 0.0, 2.0),
        ("nearest: brain", 2.0, 4.0),
    ]


def test_inner_air_holds_the_cavities_and_none_of_the_air_around_the_head() -> None:
    phantom = nasal_phantom(NasalPhantomSettings(spacing=(2.0, 2.0, 2.0)))
    air, inside = phantom.scene.tissue == Tissue.AIR, inner_air(phantom.scene)
    assert not (inside & ~air).any()
    # Air of the image's rim in front, behind and beside the head is outside.
    for axis in (1, 2):
        rim = np.moveaxis(inside, axis, 0)
        assert not rim[0].any()
        assert not rim[-1].any()
    # Most of the air between nostril and lesion is the nose's.
    nostril = phantom.volume.to_lps(np.argwhere(phantom.scene.entries["left"].nostril)).mean(axis=0)
    way: FloatArray = np.linspace(phantom.lesions["left"], nostril, 60)
    index = np.rint(phantom.volume.to_index(way)).astype(int)
    there = air[tuple(index.T)]
    assert inside[tuple(index[there].T)].mean() > 0.6


def test_a_surface_is_cut_by_the_box_and_lies_at_the_masks_rim() -> None:
    phantom = nasal_phantom(NasalPhantomSettings(spacing=(2.0, 2.0, 2.0)))
    volume, mask = phantom.volume, phantom.scene.structures["orbit_left"]
    middles = volume.to_lps(np.argwhere(mask))
    mesh = surface_of(mask, volume, box_around(volume, middles), faces=3000)
    assert mesh is not None
    # Smoothing by 0.8 mm rounds corners by less than a voxel; nothing lies farther out than half a voxel.
    assert np.all(mesh.vertices.min(axis=0) >= middles.min(axis=0) - 1.2)
    assert np.all(mesh.vertices.max(axis=0) <= middles.max(axis=0) + 1.2)
    assert surface_of(np.zeros_like(mask), volume, box_around(volume, middles), faces=3000) is None
