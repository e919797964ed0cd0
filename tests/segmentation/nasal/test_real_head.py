"""The real head CT of Debian's invesalius-examples: a fractured right orbit, a deviated septum, a gap in the frontal bone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from segmentation.anatomy.nasal import SIDES, STRUCTURES, NasalScene, Tissue, propose_lesion, propose_scene, shrink
from segmentation.volume import Volume

# Volumes of the labels that were looked at slice by slice in three planes and found right, ml; 15 %: half a voxel all around
# the smallest.
MILLILITRES = {
    "brain": 1452.5,
    "orbit_left": 26.5,
    "orbit_right": 30.1,
    "septum": 12.8,
    "turbinate_left": 5.2,
    "turbinate_right": 6.8,
}


@pytest.fixture(scope="module")
def scene(head_ct: Volume) -> NasalScene:
    return propose_scene(head_ct)


def test_every_structure_is_found_with_the_volume_that_was_looked_at(scene: NasalScene) -> None:
    found = {name: float(np.count_nonzero(mask) * scene.volume.voxel_ml) for name, mask in scene.structures.items()}
    assert set(found) == set(STRUCTURES)
    assert found == pytest.approx(MILLILITRES, rel=0.15)
    assert min(scene.confidence.values()) >= 0.7
    assert scene.notes == ()


def test_structures_are_tissue_apart_from_each_other_and_on_their_side(scene: NasalScene) -> None:
    masks = scene.structures
    for mask in masks.values():
        assert (scene.tissue[mask] != Tissue.AIR).all()
    assert np.sum(list(masks.values()), axis=0).max() == 1
    for name in ("orbit", "turbinate"):
        left, right = (
            scene.volume.to_lps(np.argwhere(masks[f"{name}_{side}"])) @ scene.midline[:3] - scene.midline[3] for side in SIDES
        )
        # A deviated septum takes a turbinate a few mm over the middle at most.
        assert left.min() > -4.0
        assert right.max() < 4.0


def test_both_nostrils_are_found_where_they_open(scene: NasalScene, head_ct: Volume) -> None:
    for side in SIDES:
        region = scene.entries[side]
        columns = np.flatnonzero(region.nostril.any(axis=(0, 1)))
        width = len(columns) * head_ct.spacing[2]
        assert 5.0 <= width <= 10.0, side  # read off the slices: 6.7 mm on the right, 5.7 mm on the left
        assert np.array_equal(columns, np.arange(columns[0], columns[-1] + 1))
        # The segments are air but for their ends.
        assert np.mean(scene.tissue[region.nostril] == Tissue.AIR) >= 0.6
        # The tip of the nose lies between both, a few mm before them.
        assert (region.widened >= region.nostril).all()
    left, right = (np.argwhere(scene.entries[side].nostril)[:, 2] for side in SIDES)
    assert left.min() - right.max() >= 5


def test_a_head_tilted_backwards_shows_the_same(head_ct: Volume) -> None:
    """By 12 degrees, resampled; below the image's old border there is nothing, where a trace of the lip might end."""
    angle = np.deg2rad(-12.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    spacing, middle = head_ct.spacing, 0.5 * (np.array(head_ct.voxels.shape) - 1.0)
    matrix = np.diag(1.0 / spacing) @ turn @ np.diag(spacing)
    voxels = ndimage.affine_transform(head_ct.voxels, matrix, middle - matrix @ middle, order=1, cval=-1000)
    tilted = propose_scene(Volume(voxels, head_ct.index_to_lps))
    found = {name: float(np.count_nonzero(mask) * head_ct.voxel_ml) for name, mask in tilted.structures.items()}
    # Limits of septum and turbinates across and along the slices move by half a slice of 1.5 mm with the tilt.
    assert found == pytest.approx(MILLILITRES, rel=0.25)
    for side in SIDES:
        places = head_ct.to_lps(np.argwhere(tilted.entries[side].nostril))
        assert np.ptp(places, axis=0).max() < 25.0


def test_a_target_is_proposed_at_each_optic_canal(scene: NasalScene, head_ct: Volume) -> None:
    lesions = {side: propose_lesion(scene, side) for side in SIDES}
    away = {}
    for side, lesion in lesions.items():
        assert lesion is not None
        assert lesion.confidence >= 0.7
        index = tuple(np.rint(head_ct.to_index(lesion.center)).astype(int))
        assert scene.tissue[index] != Tissue.AIR
        assert not any(mask[index] for mask in scene.structures.values())
        away[side] = float(lesion.center @ scene.midline[:3] - scene.midline[3])
    # Optic canals lie 10 to 16 mm off the middle at their medial wall, alike on both sides.
    assert 7.0 <= away["left"] <= 17.0
    assert away["left"] == pytest.approx(-away["right"], abs=5.0)


@pytest.mark.parametrize("side", SIDES)
def test_shrunk_mucosa_opens_the_airway(scene: NasalScene, side: str) -> None:
    half, whole = (shrink(scene, amount, side) for amount in (0.5, 1.0))
    assert 1.0 <= whole.septum_mm <= 4.06
    assert 4.0 <= whole.turbinate_mm <= 8.13
    assert whole.removed_ml > half.removed_ml > 0.5
    # What goes lies against the airway: it joins the air that was there.
    opened = (whole.scene.tissue == Tissue.AIR) & (scene.tissue != Tissue.AIR)
    labels, _ = ndimage.label(whole.scene.tissue == Tissue.AIR)
    sizes = np.bincount(labels.ravel())
    assert np.mean(sizes[labels[opened]] > 10_000) > 0.95
