from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from segmentation.anatomy.nasal import SIDES, NasalScene, NasalSettings, Tissue, propose_scene, require_entry
from segmentation.errors import CaseError, VolumeError
from segmentation.synthetic.nasal import NasalPhantom
from segmentation.volume import Volume

# Least overlap (Dice) with the truth. Voxels of 1 mm: a shift of the border by half a voxel, which partial volume and the
# choice of limits allow, costs 2 * 0.5 * surface / volume / 2, that is 0.02 for the brain, 0.1 for an orbit of radius 13.5 mm
# and 0.2 for a turbinate of radius 4 mm or a septum of 5 mm.
DICE = {"brain": 0.95, "orbit_left": 0.9, "orbit_right": 0.9, "septum": 0.9, "turbinate_left": 0.8, "turbinate_right": 0.8}


def dice(one: np.ndarray, other: np.ndarray) -> float:
    return float(2.0 * np.count_nonzero(one & other) / (np.count_nonzero(one) + np.count_nonzero(other)))


@pytest.mark.parametrize("side", SIDES)
def test_the_entry_region_equals_the_construction_within_one_voxel(
    phantom: NasalPhantom, proposed: NasalScene, side: str
) -> None:
    for kind in ("nostril", "widened"):
        truth, found = (getattr(scene.entries[side], kind) for scene in (phantom.scene, proposed))
        for one, other in ((truth, found), (found, truth)):
            assert ndimage.distance_transform_cdt(~one, "chessboard")[other].max() <= 1


def test_each_structure_is_found_where_it_is(phantom: NasalPhantom, proposed: NasalScene) -> None:
    found = {name: dice(proposed.structures[name], mask) for name, mask in phantom.scene.structures.items()}
    assert all(found[name] >= least for name, least in DICE.items()), found
    assert set(proposed.origin.values()) == {"proposed"}


def test_the_plane_of_symmetry_is_that_of_the_construction(proposed: NasalScene) -> None:
    # A tenth of a voxel at the middle and at 80 mm from it.
    assert proposed.midline == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=0.1 / 80.0)


def test_tissue_classes_follow_the_limits(phantom: NasalPhantom, proposed: NasalScene) -> None:
    hu = phantom.volume.voxels
    assert ((proposed.tissue == Tissue.AIR) == (hu <= NasalSettings().air_max)).all()
    assert ((proposed.tissue == Tissue.BONE) == (hu >= NasalSettings().bone_min)).all()


def test_the_order_and_direction_of_the_axes_change_nothing(phantom: NasalPhantom, proposed: NasalScene) -> None:
    """The same head stored as [column, slice, row], slices from above, rows from behind."""
    turned = phantom.volume.voxels[::-1, ::-1].transpose(2, 0, 1)
    matrix = phantom.volume.index_to_lps
    size = phantom.volume.voxels.shape
    other = np.eye(4)
    other[:3, :3] = np.column_stack([matrix[:3, 2], -matrix[:3, 0], -matrix[:3, 1]])
    other[:3, 3] = phantom.volume.to_lps([size[0] - 1, size[1] - 1, 0])
    scene = propose_scene(Volume(np.ascontiguousarray(turned), other))
    assert scene.midline == pytest.approx(proposed.midline)
    for name, mask in proposed.structures.items():
        assert (scene.structures[name] == mask[::-1, ::-1].transpose(2, 0, 1)).all(), name
    for side in SIDES:
        assert (scene.entries[side].widened == proposed.entries[side].widened[::-1, ::-1].transpose(2, 0, 1)).all()


def test_what_the_user_brings_replaces_and_corrects_proposals(phantom: NasalPhantom) -> None:
    truth = phantom.scene
    everything_else = {name: mask for name, mask in truth.structures.items() if name not in ("orbit_left", "septum")}
    scene = propose_scene(
        phantom.volume,
        masks={**everything_else, "entry_left": truth.entries["left"].nostril},
        boxes={
            "septum": [[-20.0, -60.0, -20.0], [20.0, -40.0, 20.0]],
            "entry_right": [[-30.0, -90.0, -20.0], [-8.0, -50.0, 0.0]],
        },
        seeds={"orbit_left": [32.0, -36.0, 22.0]},
    )
    for name, mask in everything_else.items():
        assert (scene.structures[name] == mask).all()
        assert (scene.origin[name], scene.confidence[name]) == ("mask", 1.0)
    points = phantom.volume.to_lps(np.argwhere(scene.structures["septum"]))
    assert (points.min(axis=0) >= [-20.0, -60.0, -20.0]).all()
    assert (points.max(axis=0) <= [20.0, -40.0, 20.0]).all()
    assert scene.origin["septum"] == "box"
    assert scene.origin["orbit_left"] == "seed"
    assert dice(scene.structures["orbit_left"], truth.structures["orbit_left"]) >= DICE["orbit_left"]
    assert scene.entries["left"].origin == "mask"
    assert (scene.entries["left"].widened == truth.entries["left"].widened).all()
    assert scene.entries["right"].origin == "box"
    assert (phantom.volume.to_lps(np.argwhere(scene.entries["right"].nostril))[:, 0] <= -8.0).all()


def test_a_closed_nostril_is_absent_and_said_so(phantom: NasalPhantom) -> None:
    voxels = phantom.volume.voxels.copy()
    below = phantom.volume.to_lps(np.argwhere(np.ones(voxels.shape, dtype=bool))).reshape(*voxels.shape, 3)
    voxels[
        (below[..., 0] < 0.0)
        & (below[..., 1] < -54.0)
        & (below[..., 1] > -80.0)
        & (np.abs(below[..., 0]) < 16.0)
        & (below[..., 2] < 8.0)
    ] = 40
    scene = propose_scene(Volume(voxels, phantom.volume.index_to_lps), masks=dict(phantom.scene.structures))
    assert set(scene.entries) == {"left"}
    assert any("right nostril: not found" in note for note in scene.notes)
    with pytest.raises(CaseError, match=r"the right nostril was not found \(found: left\)"):
        require_entry(scene, "right")


def test_a_head_without_its_nose_is_refused(phantom: NasalPhantom) -> None:
    # Cut at y = -40: behind nose and lips.
    cut = phantom.volume.crop([0, 52, 0], phantom.volume.voxels.shape)
    with pytest.raises(VolumeError, match="runs out of the image in front"):
        propose_scene(cut)


def test_a_head_that_shows_no_nose_is_refused(phantom: NasalPhantom) -> None:
    with pytest.raises(VolumeError, match="no nose in the image: what lies foremost is"):
        propose_scene(phantom.volume.crop([88, 0, 0], phantom.volume.voxels.shape))


def test_a_scan_without_a_head_is_refused() -> None:
    with pytest.raises(VolumeError, match="this is no head"):
        propose_scene(Volume(np.full((40, 40, 40), -1000, dtype=np.int16), np.diag([2.0, 2.0, 2.0, 1.0])[[2, 1, 0, 3]]))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"masks": {"brain": np.ones((3, 4, 5), dtype=bool)}}, "mask brain: has 3 x 4 x 5 voxels, the CT has 135 x 196 x 152"),
        ({"masks": {"ear": np.ones((3, 4, 5), dtype=bool)}}, "mask 'ear' is for nothing that is known"),
        ({"seeds": {"brain": [900.0, 0.0, 0.0]}}, r"seed brain: \(900.0, 0.0, 0.0\) mm lies outside"),
        ({"seeds": {"entry_left": [0.0, 0.0, 0.0]}}, "seed 'entry_left' is for nothing"),
        ({"boxes": {"septum": [[900.0, 0.0, 0.0], [901.0, 1.0, 1.0]]}}, "box septum: holds no voxel"),
        ({"boxes": {"septum": [1.0, 2.0, 3.0]}}, "expected two opposite corners"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_sentence(phantom: NasalPhantom, given: dict, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        propose_scene(phantom.volume, **given)


def test_settings_are_checked() -> None:
    with pytest.raises(CaseError, match="air ends at 300 HU and bone begins at 200 HU"):
        replace(NasalSettings(), air_max=300.0)
