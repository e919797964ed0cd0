"""Slices that do not belong between their neighbours: blank, byte-swapped, bit-flipped.

Strategy: a slice differs from each of its neighbours by noise and anatomy, and the
neighbours, twice as far apart, differ from one another by at least as much anatomy.
A damaged slice differs from both neighbours far more than they do from each other.
Neighbours that are damaged alike are found by what no CT slice is: one constant, or
rougher from pixel to pixel than the rest of the stack. Planted in real CTs, whole-slice
damage (blank, swapped bytes, a flipped bit, rows shifted) is found and named, as are
flips of 2048 HU and more in 0.1 % of the pixels of a 512 x 512 slice; flips of 1024 HU
and less in 1 % of the pixels look like noise and are not. Metal makes streaks in single
slices too, so moderate differences only warn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from segmentation.arrays import FloatArray, IntArray, VoxelArray

# (warn, refuse), against the largest value met in 538 slices of six real CTs (GE, Siemens, resampled).
_EXCESS = (1.5, 2.5)
"""A slice's difference to its neighbours over theirs to each other; real: 0.70."""
_EDGE_EXCESS = (3.0, 5.0)
"""The same for the first and last slice, which have one neighbour; real: 1.39."""
_ROUGHNESS = (1.6, 3.0)
"""Pixel-to-pixel roughness over the median of the nearby slices; real: 1.12."""
_LONE_STEP = 1500
"""HU by which a lone pixel stands out from both its neighbours in the row; metal is wider than a pixel."""
_MAX_LONE = 12
"""Lone pixels in the rows looked at, beyond four times those of the neighbours; real: 1."""
_FLOOR = 4.0
"""HU: differences below this are no damage worth naming."""


def judge_slices(voxels: VoxelArray, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Name the slices that do not fit between their neighbours.

    Parameters
    ----------
    voxels : (slices, rows, columns) int16 array, HU
        Padding already set to one value; at least three slices.
    names : sequence of str
        One per slice, for the message.

    Returns
    -------
    faults, warnings : list of str
        Sentences without the folder's name; at most one per slice.
    """
    blank = [plane.min() == plane.max() for plane in voxels]
    rough, noise, lone = _roughness(voxels)
    excess = _excess(voxels)
    last = len(names) - 1
    faults: list[str] = []
    warnings: list[str] = []
    for k, name in enumerate(names):
        usual = float(np.median(np.delete(rough[max(0, k - 4) : k + 5], min(k, 4)))) + _FLOOR
        beside = max(lone[k - 1] if k else 0, lone[k + 1] if k < last else 0)
        edge = _EDGE_EXCESS if k in (0, last) else _EXCESS
        bristles = f"{name} is {rough[k]:.0f} HU rough from pixel to pixel, its neighbours {usual - _FLOOR:.0f} HU"
        differs = f"{name} differs {excess[k]:.1f} times more from its neighbours than they from each other"
        if blank[k] and np.median(noise[max(0, k - 4) : k + 5]) > 0:  # a generated image without noise may have blank ends
            faults.append(f"{name} is blank (one value throughout) while its neighbours are not; export the series again")
        elif rough[k] > _ROUGHNESS[1] * usual:
            faults.append(f"{bristles}; its bytes are swapped or damaged, export the series again")
        elif lone[k] > _MAX_LONE + 4 * beside:
            faults.append(
                f"{name} has {lone[k]} lone pixels {_LONE_STEP} HU off, its neighbours at most {beside}; "
                "bits of it are damaged, export the series again"
            )
        elif excess[k] > edge[1]:
            faults.append(f"{differs}; it is damaged or of another place, export the series again")
        elif rough[k] > _ROUGHNESS[0] * usual:
            warnings.append(f"{bristles}; look at it")
        elif excess[k] > edge[0]:
            warnings.append(f"{differs}; look at it")
    return faults, warnings


def _roughness(voxels: VoxelArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Mean and upper quartile of the absolute second difference (HU) along some rows of each slice, and the lone pixels in them.

    (slices,) each. The quartile is 0 in an image without noise, however many edges it has.
    """
    step = max(1, voxels.shape[1] // 64)
    rough = np.zeros(len(voxels))
    noise = np.zeros(len(voxels))
    lone = np.zeros(len(voxels), dtype=np.int64)
    for k, plane in enumerate(voxels[:, ::step]):
        slope = np.diff(plane.astype(np.int32), axis=1)
        rise, fall = slope[:, :-1], slope[:, 1:]
        bend = np.abs(fall - rise)
        rough[k] = bend.mean(dtype=float)
        noise[k] = np.percentile(bend, 75)
        lone[k] = np.count_nonzero(((rise > _LONE_STEP) & (fall < -_LONE_STEP)) | ((rise < -_LONE_STEP) & (fall > _LONE_STEP)))
    return rough, noise, lone


def _excess(voxels: VoxelArray) -> FloatArray:
    """How much more each slice differs from its neighbours than they from each other, (slices,)."""
    step = max(1, min(voxels.shape[1:]) // 64)
    small = [plane[::step, ::step].astype(np.int32) for plane in voxels]

    def difference(first: int, second: int) -> float:
        return float(np.abs(small[first] - small[second]).mean())

    last = len(small) - 1
    excess = np.zeros(len(small))
    for k in range(1, last):
        excess[k] = min(difference(k - 1, k), difference(k, k + 1)) / (difference(k - 1, k + 1) + _FLOOR)
    excess[0] = difference(0, 1) / (difference(1, 2) + _FLOOR)
    excess[last] = difference(last - 1, last) / (difference(last - 2, last - 1) + _FLOOR)
    return excess
