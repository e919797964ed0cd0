from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from segmentation.anatomy.nasal import SIDES, NasalScene, Tissue, given_lesion, propose_lesion
from segmentation.errors import CaseError
from segmentation.synthetic.nasal import NasalPhantom


@pytest.mark.parametrize("side", SIDES)
def test_the_canal_is_proposed_in_the_sinus_wall_near_the_lesion(phantom: NasalPhantom, side: str) -> None:
    lesion = propose_lesion(phantom.scene, side)
    assert lesion is not None
    index = tuple(np.rint(phantom.volume.to_index(lesion.center)).astype(int))
    assert phantom.scene.tissue[index] != Tissue.AIR
    # The canal is 8 to 12 mm long: within a quarter of it.
    assert np.linalg.norm(lesion.center - phantom.lesions[side]) <= 3.0
    assert lesion.confidence >= 0.8


@pytest.mark.parametrize("side", SIDES)
def test_from_proposed_labels_the_canal_is_found_with_less_confidence(
    phantom: NasalPhantom, proposed: NasalScene, side: str
) -> None:
    lesion, best = propose_lesion(proposed, side), propose_lesion(phantom.scene, side)
    assert lesion is not None
    assert best is not None
    # The rolled ball does not reach the last millimetres of the apex; the canal's length is the scale.
    assert np.linalg.norm(lesion.center - phantom.lesions[side]) <= 10.0
    assert lesion.confidence < best.confidence


def test_both_sides_of_a_symmetric_head_mirror_each_other(phantom: NasalPhantom) -> None:
    left, right = (propose_lesion(phantom.scene, side) for side in SIDES)
    assert left is not None
    assert right is not None
    assert left.center * [-1.0, 1.0, 1.0] == pytest.approx(right.center)


def test_without_an_orbit_nothing_is_proposed(phantom: NasalPhantom) -> None:
    rest = {name: mask for name, mask in phantom.scene.structures.items() if name != "orbit_left"}
    assert propose_lesion(replace(phantom.scene, structures=rest), "left") is None


def test_a_mask_s_centroid_is_the_goal(phantom: NasalPhantom) -> None:
    mask = np.zeros(phantom.volume.voxels.shape, dtype=bool)
    center = np.rint(phantom.volume.to_index(phantom.lesions["left"])).astype(int)
    box = tuple(slice(c - 1, c + 2) for c in center)
    mask[box] = True
    lesion = given_lesion(phantom.scene, "left", mask=mask)
    assert lesion.center == pytest.approx(phantom.volume.to_lps(center))
    assert (lesion.origin, lesion.confidence) == ("mask", 1.0)


def test_a_lesion_in_air_is_refused_with_the_way_to_tissue(phantom: NasalPhantom) -> None:
    # The sphenoid sinus: its side wall is at 10.5 mm, the first bone voxel's centre beyond it at 11.5.
    with pytest.raises(CaseError, match=r"lesion: \(8.5, 3.5, 24.5\) mm lies in air, the nearest tissue is 2.0 mm away"):
        given_lesion(phantom.scene, "left", point=[8.5, 3.5, 24.5])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"point": [500.0, 0.0, 0.0]}, "lies outside of the image"),
        ({}, "neither or twice"),
        ({"point": [12.0, 3.0, 27.0], "radius": -1.0}, "radius of -1 mm"),
        ({"mask": np.ones((2, 2, 2), dtype=bool)}, "its mask has 2 x 2 x 2 voxels"),
        ({"mask": np.zeros((135, 196, 152), dtype=bool)}, "its mask holds no voxel"),
    ],
)
def test_what_is_no_lesion_is_refused(phantom: NasalPhantom, given: dict, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        given_lesion(phantom.scene, "left", **given)


def test_a_side_that_is_none_is_refused(phantom: NasalPhantom) -> None:
    with pytest.raises(CaseError, match="side 'middle' is none"):
        propose_lesion(phantom.scene, "middle")
