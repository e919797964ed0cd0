"""A bright tube that runs from one tissue into another, its true radius known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from segmentation.isosurface import isosurface
from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.region_growing import Region
from segmentation.volume import Volume

RADIUS = 2.0
STEP = 0.7
FAT, KIDNEY, CONTRAST = -100.0, 170.0, 320.0


def ureter() -> Volume:
    """A tube of radius 2 mm, half in fat, half in kidney, seen through a point spread of 0.6 mm."""
    fine = 2
    n, m = 90, 41
    z = np.arange(n * fine) / fine * STEP
    x = (np.arange(m * fine) - (m * fine - 1) / 2) / fine * STEP
    away = np.hypot(*np.meshgrid(x, x, indexing="ij"))
    hu = np.where(z < z.mean(), FAT, KIDNEY)[:, None, None] + np.zeros_like(away)
    hu[:, away <= RADIUS] = CONTRAST
    hu = ndimage.gaussian_filter(hu, 0.6 / STEP * fine, mode="nearest")
    hu = hu.reshape(n, fine, m, fine, m, fine).mean(axis=(1, 3, 5))
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3)[:, ::-1] * STEP
    return Volume(np.round(hu).astype(np.int16), matrix)


def grown(volume: Volume, hu_min: float | str) -> Region:
    x, y, z = (float(v) for v in volume.to_lps((60, 20, 20)))
    return segment_lumen(volume, SegmentationSettings(anatomy="vessel", seed_point=(x, y, z), hu_min=hu_min, smoothing=0.0))


def radii(volume: Volume, region: Region) -> tuple[float, float]:
    """Mean distance of the wall from the axis, in fat and in kidney, mm."""
    index = volume.to_index(isosurface(volume, region).vertices)
    radius = np.hypot(index[:, 1] - 20, index[:, 2] - 20) * STEP
    wall = radius > 1.0
    return float(radius[wall & (index[:, 0] > 8) & (index[:, 0] < 38)].mean()), float(
        radius[wall & (index[:, 0] > 52) & (index[:, 0] < 82)].mean()
    )


def test_the_wall_lies_where_the_tube_ends_in_either_tissue() -> None:
    volume = ureter()
    in_fat, in_kidney = radii(volume, grown(volume, "auto"))
    # A blurred circle's half maximum lies about sigma^2 / (2 r) = 0.09 mm inside it; a tenth of a voxel more for sampling.
    assert in_fat == pytest.approx(RADIUS, abs=0.16)
    assert in_kidney == pytest.approx(RADIUS, abs=0.16)


def test_one_limit_for_both_would_miss_the_wall_in_fat() -> None:
    volume = ureter()
    in_fat, in_kidney = radii(volume, grown(volume, 245.0))  # halfway from kidney to contrast medium
    assert in_kidney == pytest.approx(RADIUS, abs=0.16)
    assert in_fat < RADIUS - 0.3


def test_a_limit_given_by_the_user_is_taken_as_it_is() -> None:
    volume = ureter()
    region = grown(volume, 245.0)
    assert region.wall_limits is None
    assert region.volume_ml == pytest.approx(int((volume.voxels >= 245).sum()) * volume.voxel_ml, abs=1e-9)


def test_the_automatic_region_keeps_its_curve_and_knows_the_borders() -> None:
    volume = ureter()
    region = grown(volume, "auto")
    assert region.curve is not None
    assert region.curve.varied == "hu_min"
    assert region.hu_min == region.curve.chosen > KIDNEY
    assert set(region.border) == {"first slice", "last slice"}
    assert region.wall_limits is not None
    assert region.wall_limits.shape == region.mask.shape
    assert region.volume_ml == pytest.approx(region.mask.sum() * volume.voxel_ml)
