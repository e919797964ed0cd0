"""The wall of a bright lumen at half maximum, whatever tissue lies behind it."""

# Strategy: one limit for the whole lumen must stay above the brightest neighbour (the kidney), and
# so cuts deep into a thin ureter in fat, whose blurred edge runs from contrast medium down to -100
# HU. The edge of a blurred step lies where the grey is halfway between both sides. So after growing
# with the one leak-proof limit, each place gets its own: halfway between the lumen's plateau and the
# tissue a few mm outside. The region may move by a few voxels only, so no leak can arise.

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray
from segmentation.region_growing import FACES, Region
from segmentation.smoothing import smoothed_box
from segmentation.volume import Volume

# How far the wall may move outwards, mm: two voxels of an abdominal CT.
REACH = 1.6
# Tissue is sampled in this distance from the region, beyond the blur of its edge, and averaged with
# a Gaussian of this standard deviation.
TISSUE = (1.5, 5.0)
TISSUE_SIGMA = 2.0


def at_half_maximum(volume: Volume, region: Region) -> Region:
    """The bright region with its wall moved to half maximum.

    Parameters
    ----------
    volume : Volume
    region : Region
        Grown above `region.hu_min`.

    Returns
    -------
    Region
        With `wall_limits`, the local lower limit; `hu_min` stays the limit it was grown with.
    """
    shape = np.array(volume.voxels.shape)
    margin = np.ceil((TISSUE[1] + 1.0) / volume.spacing).astype(int)
    lower = np.maximum(np.array(region.lower) - margin, 0)
    upper = np.minimum(np.array(region.lower) + region.mask.shape + margin, shape)
    mask = np.zeros(upper - lower, dtype=bool)
    start = np.array(region.lower) - lower
    mask[tuple(slice(a, a + n) for a, n in zip(start, region.mask.shape, strict=True))] = region.mask
    hu = smoothed_box(volume, tuple(lower), tuple(upper), smoothing=region.smoothing)

    away = ndimage.distance_transform_edt(~mask, sampling=volume.spacing)
    limits = local_limits(hu, mask, away, region.hu_min, volume.spacing)
    candidates = (hu >= limits) & (hu <= region.hu_max) & (away <= REACH)
    seed = tuple(np.array(region.seed) - lower)
    candidates[seed] = True
    labels, _ = ndimage.label(candidates)
    moved = labels == labels[seed]

    index = np.argwhere(moved)
    low, high = np.maximum(index.min(axis=0) - 1, 0), np.minimum(index.max(axis=0) + 2, mask.shape)
    box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    index += lower
    border = {
        name: int(np.count_nonzero(index[:, axis] == place))
        for axis, names in enumerate(FACES)
        for name, place in zip(names, (0, shape[axis] - 1), strict=True)
        if np.any(index[:, axis] == place)
    }
    origin = lower + low
    return replace(
        region,
        mask=moved[box].copy(),
        lower=(int(origin[0]), int(origin[1]), int(origin[2])),
        volume_ml=len(index) * volume.voxel_ml,
        border=border,
        wall_limits=limits[box].copy(),
    )


def local_limits(hu: FloatArray, mask: BoolArray, away: FloatArray, limit: float, spacing: FloatArray) -> FloatArray:
    """Halfway between the lumen's plateau and the tissue around each place; `limit` where no tissue is near."""
    depth = ndimage.distance_transform_edt(mask, sampling=spacing)
    core = hu[depth >= min(2.0 * float(spacing.max()), 0.7 * float(depth.max()))]
    plateau = float(np.median(core))
    tissue = ((away >= TISSUE[0]) & (away <= TISSUE[1]) & (hu < limit)).astype(np.float64)
    sigmas = tuple(TISSUE_SIGMA / spacing)
    weight = ndimage.gaussian_filter(tissue, sigmas, truncate=3.0)
    mean = ndimage.gaussian_filter(tissue * hu, sigmas, truncate=3.0)
    known = weight > 1e-3
    return np.where(known, 0.5 * (plateau + mean / np.where(known, weight, 1.0)), limit)
