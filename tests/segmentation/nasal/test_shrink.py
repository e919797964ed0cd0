from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from segmentation.anatomy.nasal import SIDES, NasalScene, Tissue, shrink
from segmentation.anatomy.nasal.shrink import LAYER, SEPTUM_MOST, TURBINATE_MOST
from segmentation.errors import CaseError
from segmentation.synthetic.nasal import NasalPhantom
from segmentation.volume import Volume

AIR, MUCOSA, BONE = -1000, 50, 700


def slab(*, mucosa: int, bone: slice | None, step: float = 0.5) -> NasalScene:
    """A septum of known layers: `mucosa` voxels on each side of 4 voxels of bone, which `bone` rows have."""
    voxels = np.full((12, 40, 60), AIR, dtype=np.int16)
    first, last = 30 - 2 - mucosa, 30 + 2 + mucosa
    voxels[:, :, first:last] = MUCOSA
    if bone is not None:
        voxels[:, bone, 28:32] = BONE
    septum = np.zeros(voxels.shape, dtype=bool)
    septum[:, :, first:last] = True
    matrix = np.diag([step, step, step, 1.0])[[2, 1, 0, 3]]
    tissue = np.where(voxels <= -400, Tissue.AIR, np.where(voxels >= 200, Tissue.BONE, Tissue.SOFT)).astype(np.uint8)
    return NasalScene(
        volume=Volume(voxels, matrix), tissue=tissue, structures={"septum": septum}, entries={}, confidence={"septum": 1.0},
        origin={"septum": "mask"}, midline=np.array([1.0, 0.0, 0.0, 15.0]),
    )  # fmt: skip


@pytest.mark.parametrize(("side", "columns"), [("left", slice(34, 38)), ("right", slice(22, 26))])
def test_the_septum_retreats_to_a_layer_on_its_bone(side: str, columns: slice) -> None:
    """3 mm of mucosa on bone: 2 mm go, which are 4 voxels of 0.5 mm on the operated side alone."""
    scene = slab(mucosa=6, bone=slice(None))
    result = shrink(scene, 1.0, side)
    removed = scene.structures["septum"] & ~result.scene.structures["septum"]
    expected = np.zeros_like(removed)
    expected[:, :, columns] = True
    assert (removed == expected).all()
    assert result.septum_mm == pytest.approx(6 * 0.5 - LAYER)
    assert result.removed_ml == pytest.approx(12 * 40 * 4 * 0.5**3 / 1000.0)
    assert (result.scene.tissue[removed] == Tissue.AIR).all()


def test_rows_without_bone_line_up_with_their_neighbours() -> None:
    scene = slab(mucosa=6, bone=slice(10, 30))
    result = shrink(scene, 1.0, "left")
    removed = scene.structures["septum"] & ~result.scene.structures["septum"]
    assert (removed == removed[:, 20:21]).all()


def test_the_greatest_displacement_is_the_text_s() -> None:
    thick = slab(mucosa=14, bone=slice(None))  # 7 mm on each side
    assert shrink(thick, 1.0, "left").septum_mm == pytest.approx(SEPTUM_MOST)
    assert shrink(thick, 0.5, "left").septum_mm == pytest.approx(0.5 * SEPTUM_MOST)


def test_nothing_shrinks_by_nothing(phantom: NasalPhantom) -> None:
    result = shrink(phantom.scene, 0.0, "left")
    assert (result.septum_mm, result.turbinate_mm, result.removed_ml) == (0.0, 0.0, 0.0)
    assert (result.scene.tissue == phantom.scene.tissue).all()


@pytest.mark.parametrize("side", SIDES)
def test_more_shrinkage_takes_away_all_that_less_does(proposed: NasalScene, side: str) -> None:
    results = [shrink(proposed, amount, side) for amount in np.linspace(0.0, 1.0, 9)]
    for less, more in pairwise(results):
        assert (more.scene.tissue[less.scene.tissue == Tissue.AIR] == Tissue.AIR).all()
        for name, mask in more.scene.structures.items():
            assert not (mask & ~less.scene.structures[name]).any()
        assert more.removed_ml >= less.removed_ml
    assert results[-1].removed_ml > 0.2
    assert results[-1].turbinate_mm <= TURBINATE_MOST


@pytest.mark.parametrize("side", SIDES)
def test_bone_and_the_other_side_stay(proposed: NasalScene, side: str) -> None:
    result = shrink(proposed, 1.0, side)
    assert ((result.scene.tissue == Tissue.BONE) == (proposed.tissue == Tissue.BONE)).all()
    other = "right" if side == "left" else "left"
    assert (result.scene.structures[f"turbinate_{other}"] == proposed.structures[f"turbinate_{other}"]).all()
    assert (result.scene.structures["brain"] == proposed.structures["brain"]).all()


def test_mirrored_heads_shrink_alike(phantom: NasalPhantom) -> None:
    """The truth without noise is symmetric; its HU are not, so that the limits may differ by a voxel row."""
    left, right = (shrink(phantom.scene, 1.0, side) for side in SIDES)
    assert left.removed_ml == pytest.approx(right.removed_ml, rel=0.15)


def test_a_wrong_amount_or_side_is_refused(phantom: NasalPhantom) -> None:
    with pytest.raises(CaseError, match=r"a shrinkage of 1.5 was given, expected 0 to 1"):
        shrink(phantom.scene, 1.5, "left")
    with pytest.raises(CaseError, match="mucosa of side 'up' cannot be shrunk"):
        shrink(phantom.scene, 0.5, "up")


def test_a_scene_whose_masks_lie_on_other_voxels_is_refused() -> None:
    scene = slab(mucosa=6, bone=None)
    with pytest.raises(ValueError, match=r"tissue has shape \(11, 40, 60\), expected \(12, 40, 60\)"):
        replace(scene, tissue=scene.tissue[1:])
    with pytest.raises(ValueError, match=r"septum has shape \(12, 40, 59\), expected \(12, 40, 60\)"):
        replace(scene, structures={"septum": scene.structures["septum"][:, :, 1:]})
    with pytest.raises(ValueError, match="read-only"):
        scene.tissue[0, 0, 0] = Tissue.BONE
