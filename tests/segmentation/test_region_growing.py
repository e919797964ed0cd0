"""Growing with a planted gate in the wall, dark and bright alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from segmentation.errors import CaseError, RegionError
from segmentation.leak import LeakRule, leak_index
from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.region_growing import GrowthSettings, grow
from segmentation.volume import Volume

LUMEN, WALL, LUNG, GATE = -950, 0, -800, -850
SPACING = np.array([1.0, 0.8, 0.8])
GATE_AT = (30, 20, 28)
SEED = (30, 20, 20)


def phantom(*, upside_down: bool = False) -> Volume:
    """A dark tube of radius 5 mm along the slices, a wall of 1.6 mm, lung beyond, and one weak voxel in the wall."""
    z, y, x = np.meshgrid(*(np.arange(n) for n in (60, 41, 61)), indexing="ij")
    away = np.hypot(y - 20, x - 20) * 0.8
    hu = np.full(z.shape, LUNG)
    hu[away <= 6.9] = WALL
    hu[(away <= 5.0) & (z > 2) & (z < 57)] = LUMEN
    hu[GATE_AT] = GATE
    hu[30, 20, 27] = LUMEN
    matrix = np.diag([1.0, 1.0, 1.0, 1.0])
    matrix[:3, :3] = np.array([[0, 0, 0.8], [0, 0.8, 0], [1.0, 0, 0]])
    matrix[:3, 3] = (-10.0, 5.0, 100.0)
    return Volume((-hu if upside_down else hu).astype(np.int16), matrix)


RULE = LeakRule(volume_min=0.5, volume_max=20.0, jump=3.0)
DARK = GrowthSettings(hu_min=-1024.0, hu_max=-500.0, varied="hu_max", leak=RULE)


def test_the_limit_stops_before_the_leak_and_the_gate_is_named() -> None:
    volume = phantom()
    region = grow(volume, SEED, DARK)
    curve = region.curve
    assert curve is not None
    # Lung joins through the gate when the limit reaches the higher of the two, the lung's -800 HU.
    assert curve.leak_limit == LUNG
    # 15 % of the way from the leak back to the lumen, on the grid of whole HU: -800 - 22.5.
    assert curve.chosen == -823
    assert region.hu_max == curve.chosen
    expected = int((volume.voxels <= GATE).sum()) * volume.voxel_ml
    assert region.volume_ml == pytest.approx(expected, abs=1e-9)
    assert np.all(np.diff(curve.volumes_ml) >= 0)
    assert curve.leak_voxel == (30, 20, 29)
    assert curve.leak_point is not None
    np.testing.assert_allclose(curve.leak_point, volume.to_lps(curve.leak_voxel))


def test_a_bright_lumen_is_the_same_upside_down() -> None:
    dark = grow(phantom(), SEED, DARK)
    bright = grow(phantom(upside_down=True), SEED, replace(DARK, hu_min=500.0, hu_max=3071.0, varied="hu_min"))
    np.testing.assert_array_equal(dark.mask, bright.mask)
    assert dark.curve is not None
    assert bright.curve is not None
    np.testing.assert_array_equal(dark.curve.limits, -bright.curve.limits)
    assert bright.curve.leak_voxel == dark.curve.leak_voxel
    assert bright.hu_min == -dark.hu_max


def test_the_region_is_cropped_with_a_margin_and_knows_the_border_it_touches() -> None:
    volume = phantom()
    region = grow(volume, SEED, replace(DARK, hu_max=-900.0, varied=None))
    whole = np.zeros(volume.voxels.shape, dtype=bool)
    box = tuple(slice(lo, lo + n) for lo, n in zip(region.lower, region.mask.shape, strict=True))
    whole[box] = region.mask
    np.testing.assert_array_equal(whole, volume.voxels <= -900)
    assert region.border == {}
    assert not region.mask[0].any()
    cut = grow(volume.crop((0, 0, 20), volume.voxels.shape), (30, 20, 0), replace(DARK, hu_max=-900.0, varied=None))
    assert cut.border == {"first column": int((volume.voxels[:, :, 20] <= -900).sum())}
    assert cut.lower[2] == 0


def test_a_fixed_limit_that_leaks_is_refused_with_the_numbers() -> None:
    with pytest.raises(RegionError, match=r"leaks: between -1024 and -700 HU it holds more than 20 ml .* the seed -950 HU"):
        grow(phantom(), SEED, replace(DARK, hu_max=-700.0, varied=None))


def test_a_seed_in_the_wall_is_refused_and_the_nearest_lumen_named() -> None:
    volume = phantom()
    # (3, 20, 20) is the lumen's first voxel: one slice of 1 mm from the seed.
    point = ", ".join(f"{x:.1f}" for x in volume.to_lps((3, 20, 20))).replace(".", r"\.")
    with pytest.raises(
        RegionError, match=rf"the seed has 0 HU, outside the limits -1024 to -900 HU; .* 1\.0 mm away at LPS \({point}\)"
    ):
        grow(volume, (2, 20, 20), replace(DARK, hu_max=-900.0, varied=None))


def test_a_seed_far_from_anything_is_refused_plainly() -> None:
    with pytest.raises(RegionError, match="no voxel within 10 mm lies between them"):
        grow(phantom(), (30, 20, 58), replace(DARK, hu_max=-900.0, varied=None))


def test_diagonal_neighbours_count_with_26_only() -> None:
    hu = np.zeros((9, 9, 9), dtype=np.int16)
    for k in range(1, 8):
        hu[k, k, k] = -950
    volume = Volume(hu, np.eye(4))
    fixed = replace(DARK, hu_max=-900.0, varied=None)
    assert grow(volume, (4, 4, 4), fixed).mask.sum() == 1
    assert grow(volume, (4, 4, 4), replace(fixed, connectivity=26)).mask.sum() == 7


def test_settings_refuse_what_cannot_be_meant() -> None:
    with pytest.raises(CaseError, match="both auto"):
        SegmentationSettings(anatomy="generic", hu_min="auto", hu_max="auto")
    with pytest.raises(CaseError, match="expected one of airway, urinary, vessel, generic"):
        SegmentationSettings(anatomy="nose")
    with pytest.raises(CaseError, match="connectivity is 18"):
        SegmentationSettings(anatomy="airway", connectivity=18)
    with pytest.raises(CaseError, match="hu_max is 'high'"):
        SegmentationSettings(anatomy="airway", hu_max="high")
    with pytest.raises(CaseError, match="needs at least one limit"):
        segment_lumen(phantom(), SegmentationSettings(anatomy="generic", seed_point=(6.0, 21.0, 130.0)))
    with pytest.raises(CaseError, match="vessel does not find its own seed"):
        segment_lumen(phantom(), SegmentationSettings(anatomy="vessel"))
    with pytest.raises(RegionError, match=r"the seed \(500\.0, 0\.0, 0\.0\) mm lies outside the image"):
        segment_lumen(phantom(), SegmentationSettings(anatomy="generic", hu_max=-900, seed_point=(500.0, 0.0, 0.0)))
    with pytest.raises(RegionError, match="the lower one must be below the upper"):
        segment_lumen(phantom(), SegmentationSettings(anatomy="generic", hu_min=5, hu_max=-900, seed_point=(6.0, 21.0, 130.0)))


def test_a_generic_lumen_grows_from_seed_and_an_automatic_limit() -> None:
    volume = phantom()
    point = tuple(float(x) for x in volume.to_lps(SEED))
    region = segment_lumen(
        volume, SegmentationSettings(anatomy="generic", hu_max="auto", seed_point=(point[0], point[1], point[2]))
    )
    assert region.curve is not None
    assert region.curve.leak_limit == LUNG
    assert region.volume_ml == pytest.approx(int((volume.voxels <= GATE).sum()) * volume.voxel_ml, abs=1e-9)


@pytest.mark.parametrize("noise", [10.0, 15.0])
def test_a_wide_lumen_joining_within_its_own_noise_is_no_leak(noise: float) -> None:
    rng = np.random.default_rng(2)
    z, y, x = np.meshgrid(*(np.arange(n) for n in (100, 33, 33)), indexing="ij")
    lumen = (np.hypot(y - 16, x - 16) <= 12.0) & (z > 1) & (z < 98)
    hu = np.where(lumen, -980.0, 40.0) + rng.normal(0.0, noise, size=z.shape)
    hu[50, 16, 16] = -980.0 - noise  # the search begins at the seed's own value, in a pocket of the noise
    volume = Volume(np.rint(hu).astype(np.int16), np.eye(4))
    rule = LeakRule(volume_min=3.0, volume_max=150.0, jump=10.0)
    region = grow(volume, (50, 16, 16), GrowthSettings(hu_min=-1024.0, hu_max=-650.0, varied="hu_max", leak=rule))
    curve = region.curve
    assert curve is not None
    # The volumes alone look like a leak: that is what the noise has to be told apart from.
    assert leak_index(curve.volumes_ml, rule) is not None
    assert curve.leak_limit is None
    assert region.volume_ml == pytest.approx(lumen.sum() / 1000.0, abs=1e-9)


def test_a_leak_beyond_the_noise_of_a_noisy_lumen_is_still_found() -> None:
    clean = phantom()
    rng = np.random.default_rng(3)
    hu = clean.voxels + np.rint(rng.normal(0.0, 12.0, size=clean.voxels.shape))
    hu[SEED] = LUMEN
    curve = grow(Volume(hu.astype(np.int16), clean.index_to_lps), SEED, DARK).curve
    assert curve is not None
    assert curve.leak_limit is not None
    # Lung joins within its own noise, of 12 HU.
    assert abs(curve.leak_limit - LUNG) <= 3 * 12
