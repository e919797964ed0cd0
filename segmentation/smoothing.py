"""Grey values prepared for growing: clipped, smoothed in mm, held as int16 in eighths of a HU."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from segmentation.arrays import FloatArray, VoxelArray
from segmentation.volume import Volume

# CT numbers outside these are padding, metal or resampling overshoot; both ends of the
# 12-bit range of DICOM CT at slope 1 and intercept -1024.
HU_LOWEST, HU_HIGHEST = -1024, 3071

# Fixed point: [-1024, 3071] HU times 8 fits int16, holds a CT in half the memory of
# float32, and rounds by at most 1/8 HU for each of the three axes.
STEPS_PER_HU = 8

# The Gaussian's tail beyond three sigma holds 0.3 % of its weight.
TRUNCATE = 3.0


def smoothing_sigmas(volume: Volume, smoothing: float) -> tuple[float, float, float]:
    """Standard deviations in voxels, along slice, row and column, of a Gaussian of `smoothing` mm."""
    slices, rows, columns = (smoothing / step for step in volume.spacing)
    return float(slices), float(rows), float(columns)


def growing_voxels(volume: Volume, *, smoothing: float) -> VoxelArray:
    """The whole volume clipped and smoothed, in eighths of a HU.

    Parameters
    ----------
    volume : Volume
    smoothing : float, mm
        Standard deviation of the Gaussian, the same in all directions; 0 for none.

    Returns
    -------
    (slices, rows, columns) int16 array
        HU times `STEPS_PER_HU`.
    """
    values = np.clip(volume.voxels, HU_LOWEST, HU_HIGHEST)
    values *= STEPS_PER_HU
    if smoothing > 0:
        ndimage.gaussian_filter(values, smoothing_sigmas(volume, smoothing), output=values, mode="nearest", truncate=TRUNCATE)
    return values


def smoothed_box(volume: Volume, lower: tuple[int, ...], upper: tuple[int, ...], *, smoothing: float) -> FloatArray:
    """HU of the box ``lower <= index < upper``, clipped and smoothed as for growing, but in float64."""
    shape = volume.voxels.shape
    sigmas = smoothing_sigmas(volume, smoothing)
    reach = [int(TRUNCATE * sigma + 0.5) for sigma in sigmas]
    outer = tuple(slice(max(lo - r, 0), min(up + r, n)) for lo, up, r, n in zip(lower, upper, reach, shape, strict=True))
    values = np.clip(volume.voxels[outer], HU_LOWEST, HU_HIGHEST).astype(np.float64)
    if smoothing > 0:
        values = ndimage.gaussian_filter(values, sigmas, mode="nearest", truncate=TRUNCATE)
    inner = tuple(slice(lo - o.start, up - o.start) for lo, up, o in zip(lower, upper, outer, strict=True))
    return np.asarray(values[inner], dtype=np.float64)


def block_mean(voxels: VoxelArray, factor: tuple[int, int, int]) -> NDArray[np.float32]:
    """Mean HU, clipped below at -1024, over blocks of `factor` voxels; an incomplete block at the end of an axis is left out."""
    k, m, n = (size // f for size, f in zip(voxels.shape, factor, strict=True))
    total = np.zeros((k, m, n), dtype=np.float32)
    for a, b, c in product(*(range(f) for f in factor)):
        total += np.maximum(
            voxels[a : k * factor[0] : factor[0], b : m * factor[1] : factor[1], c : n * factor[2] : factor[2]], HU_LOWEST
        )
    total /= float(np.prod(factor))
    return total


def noise(volume: Volume, index: tuple[int, int, int], *, radius: float) -> float:
    """Standard deviation of the image noise near one voxel, HU.

    Differences of neighbouring voxels in a row, by the median of their absolute
    values, so that the wall of a lumen and slow changes of grey count little.

    Parameters
    ----------
    volume : Volume
    index : (3,) int tuple
    radius : float, mm
        Half the side of the box in which differences are taken.
    """
    reach = np.maximum(np.round(radius / volume.spacing), 1).astype(int)
    box = tuple(slice(max(i - r, 0), i + r + 1) for i, r in zip(index, reach, strict=True))
    patch = np.clip(volume.voxels[box], HU_LOWEST, HU_HIGHEST).astype(np.float64)
    steps = np.abs(np.diff(patch, axis=2))
    # The median of |x - y| of two normal values is 0.6745 sqrt(2) standard deviations.
    return float(np.median(steps) / (0.6745 * np.sqrt(2.0))) if steps.size else 0.0
