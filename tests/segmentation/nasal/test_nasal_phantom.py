from __future__ import annotations

import numpy as np
import pytest

from segmentation.anatomy.nasal import SIDES, STRUCTURES, Tissue
from segmentation.synthetic import head
from segmentation.synthetic.nasal import NasalPhantom, nostril_segment


def test_every_structure_is_there_and_none_shares_a_voxel_with_another(phantom: NasalPhantom) -> None:
    structures = phantom.scene.structures
    assert set(structures) == set(STRUCTURES)
    assert np.sum(list(structures.values()), axis=0).max() == 1


def test_structures_hold_tissue_and_the_airway_holds_none(phantom: NasalPhantom) -> None:
    tissue = phantom.scene.tissue
    for mask in phantom.scene.structures.values():
        assert (tissue[mask] != Tissue.AIR).all()
    assert (tissue[phantom.airway] == Tissue.AIR).all()


def test_hounsfield_units_follow_the_tissue_away_from_edges(phantom: NasalPhantom) -> None:
    from scipy import ndimage

    tissue, hu = phantom.scene.tissue, phantom.volume.voxels
    # Two voxels from any edge blur (0.5 mm) is over; noise has 12 HU, streaks between bones reach a few ten.
    for kind, low, high in ((Tissue.AIR, -1024, -850), (Tissue.SOFT, -250, 250)):
        deep = ndimage.binary_erosion(tissue == kind, iterations=3)
        assert low <= np.percentile(hu[deep], 0.1)
        assert np.percentile(hu[deep], 99.9) <= high


@pytest.mark.parametrize("side", SIDES)
def test_the_nostril_runs_from_the_rim_to_the_floor(phantom: NasalPhantom, side: str) -> None:
    """Each voxel lies on the segment of its sagittal plane: at most half a voxel diagonal off it."""
    region = phantom.scene.entries[side]
    points = phantom.volume.to_lps(np.argwhere(region.nostril))
    assert (points[:, 0] > 0.0).all() == (side == "left")
    for point in points:
        front, rear = nostril_segment(side, abs(point[0]))[:, 1:]
        along = (rear - front) / np.linalg.norm(rear - front)
        off = (point[1:] - front) - ((point[1:] - front) @ along) * along
        assert np.linalg.norm(off) <= 0.5 * np.sqrt(2.0) + 1e-9


@pytest.mark.parametrize("side", SIDES)
def test_the_widened_region_is_the_nostril_moved_up_and_outwards(phantom: NasalPhantom, side: str) -> None:
    region = phantom.scene.entries[side]
    assert (region.widened >= region.nostril).all()
    points = phantom.volume.to_lps(np.argwhere(region.nostril))
    wide = phantom.volume.to_lps(np.argwhere(region.widened))
    assert wide[:, 2].max() == pytest.approx(points[:, 2].max() + 10.0)
    assert wide[:, 2].min() == pytest.approx(points[:, 2].min())
    assert np.abs(wide[:, 0]).max() == pytest.approx(np.abs(points[:, 0]).max() + 10.0)
    assert np.abs(wide[:, 0]).min() == pytest.approx(np.abs(points[:, 0]).min())


@pytest.mark.parametrize("side", SIDES)
def test_the_lesion_lies_in_bone_between_sinus_and_nerve(phantom: NasalPhantom, side: str) -> None:
    index = np.rint(phantom.volume.to_index(phantom.lesions[side])).astype(int)
    assert phantom.bone[tuple(index)]
    assert abs(phantom.lesions[side][0]) > head.SINUS_HALF
