"""Grey values prepared for growing: clipped, smoothed in mm, held as int16 in eighths of a HU."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray, VoxelArray
from segmentation.flooding import BLOCKED, Box
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


@dataclass(frozen=True, eq=False, kw_only=True)
class GrowingVoxels:
    """A volume's grey values as regions grow on them, worked out for the box that is asked for.

    Clipped, smoothed and held in eighths of a HU (HU times `STEPS_PER_HU`). All is told in terms of a dark
    lumen: a bright one is turned upside down.

    Attributes
    ----------
    volume : Volume
    smoothing : float, mm
        Standard deviation of a Gaussian, the same in all directions; 0 for none.
    bright : bool
        Whether values are negated.
    bound : float or None, HU
        What lies beyond this limit (below it in a dark lumen, above it in a bright one) is `BLOCKED`.
    """

    volume: Volume
    smoothing: float
    bright: bool = False
    bound: float | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Slices, rows and columns of the volume."""
        return self.volume.voxels.shape

    def __getitem__(self, box: Box, /) -> VoxelArray:
        """Values of the box ``start <= index < stop``, int16; the same whatever box a voxel is asked for in."""
        outer = _with_reach(box, self.shape, self.reach)
        values = np.clip(self.volume.voxels[outer], HU_LOWEST, HU_HIGHEST)
        values *= STEPS_PER_HU
        if self.smoothing > 0:
            sigmas = smoothing_sigmas(self.volume, self.smoothing)
            ndimage.gaussian_filter(values, sigmas, output=values, mode="nearest", truncate=TRUNCATE)
            values = values[tuple(slice(i.start - o.start, i.stop - o.start) for i, o in zip(box, outer, strict=True))]
        if self.bound is None:
            return -values if self.bright else values
        limit = self.bound * STEPS_PER_HU
        outside = values > limit if self.bright else values < limit
        if self.bright:
            values = -values
        values[outside] = BLOCKED
        return values

    def between(self, box: Box, low: float, high: float) -> BoolArray:
        """Which voxels of the box lie between two limits in HU, both included; the ends of the range are no limits.

        A box with steps is looked at without smoothing.
        """
        if self.smoothing > 0 and all(axis.step is None for axis in box):
            values = self[box]
            return np.asarray((values >= low * STEPS_PER_HU) & (values <= high * STEPS_PER_HU))
        voxels = self.volume.voxels[box]
        found = np.ones(voxels.shape, dtype=bool) if high >= HU_HIGHEST else voxels <= np.floor(high).astype(np.int16)
        if low > HU_LOWEST:
            found &= voxels >= np.ceil(low).astype(np.int16)
        return found

    @property
    def reach(self) -> tuple[int, ...]:
        """Voxels by which the smoothing reaches along each axis."""
        if self.smoothing == 0:
            return 0, 0, 0
        return smoothing_reach(smoothing_sigmas(self.volume, self.smoothing))


def smoothing_reach(sigmas: tuple[float, float, float]) -> tuple[int, ...]:
    """Voxels to each side that scipy's Gaussian sums over."""
    return tuple(int(TRUNCATE * sigma + 0.5) for sigma in sigmas)


def _with_reach(box: tuple[slice, ...], shape: tuple[int, ...], reach: tuple[int, ...]) -> tuple[slice, ...]:
    """The box and `reach` voxels around it, as far as the image goes."""
    return tuple(slice(max(b.start - r, 0), min(b.stop + r, n)) for b, r, n in zip(box, reach, shape, strict=True))


def smoothed_box(
    volume: Volume, lower: tuple[int, ...], upper: tuple[int, ...], *, smoothing: float, among: BoolArray | None = None
) -> FloatArray:
    """HU of the box ``lower <= index < upper``, clipped and smoothed as for growing, but in float64.

    With `among`, a mask of the box, only of its voxels, (n,).
    """
    shape = volume.voxels.shape
    sigmas = smoothing_sigmas(volume, smoothing)
    outer = _with_reach(tuple(map(slice, lower, upper)), shape, smoothing_reach(sigmas))
    inner = tuple(slice(lo - o.start, up - o.start) for lo, up, o in zip(lower, upper, outer, strict=True))
    if smoothing == 0 and among is not None:
        return np.clip(volume.voxels[outer][among], HU_LOWEST, HU_HIGHEST).astype(np.float64)
    values = np.clip(volume.voxels[outer], HU_LOWEST, HU_HIGHEST).astype(np.float64)
    if smoothing > 0:
        ndimage.gaussian_filter(values, sigmas, output=values, mode="nearest", truncate=TRUNCATE)
    return np.asarray(values[inner] if among is None else values[inner][among], dtype=np.float64)


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


def noise(volume: Volume, index: tuple[int, int, int], *, radius: float, smoothing: float = 0.0) -> float:
    """Standard deviation of the image noise near one voxel, HU.

    Differences of neighbouring voxels in a row, by the median of their absolute
    values, so that the wall of a lumen and slow changes of grey count little.

    Parameters
    ----------
    volume : Volume
    index : (3,) int tuple
    radius : float, mm
        Half the side of the box in which differences are taken.
    smoothing : float, mm
        Standard deviation of a Gaussian whose effect on white noise is taken off; 0 for none.
    """
    reach = np.maximum(np.round(radius / volume.spacing), 1).astype(int)
    box = tuple(slice(max(i - r, 0), i + r + 1) for i, r in zip(index, reach, strict=True))
    patch = np.clip(volume.voxels[box], HU_LOWEST, HU_HIGHEST).astype(np.float64)
    steps = np.abs(np.diff(patch, axis=2))
    # The median of |x - y| of two normal values is 0.6745 sqrt(2) standard deviations.
    found = float(np.median(steps) / (0.6745 * np.sqrt(2.0))) if steps.size else 0.0
    return found * noise_left(smoothing_sigmas(volume, smoothing)) if smoothing > 0 else found


def noise_left(sigmas: tuple[float, ...]) -> float:
    """Standard deviation of white noise of unit deviation after a Gaussian, sigmas in voxels: the norm of its weights."""
    left = 1.0
    for sigma in sigmas:
        reach = int(TRUNCATE * sigma + 0.5)
        weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        left *= float(np.linalg.norm(weights / weights.sum()))
    return left
