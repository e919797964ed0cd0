"""Slices that do not belong between their neighbours: blank, byte-swapped, bit-flipped.

Strategy: a slice differs from each of its neighbours by noise and anatomy, and the
neighbours, twice as far apart, differ from one another by at least as much anatomy.
A damaged slice differs from both neighbours far more than they do from each other.
Neighbours that are damaged alike are found by what no CT slice is: one constant, or
rougher from pixel to pixel than the rest of the stack. Planted in real CTs, whole-slice
damage (blank, swapped bytes, a flipped bit, rows shifted, a slice of another place) is
found and named, as are flips of 2048 HU and more in 0.1 % of the pixels; flips of less
than 1024 HU in under 1 % of the pixels look like noise and are not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from segmentation.arrays import FloatArray, IntArray, VoxelArray

# Limits against the largest value met in 538 slices of six real CTs (GE, Siemens, resampled).
_MAX_EXCESS = 1.6
"""A slice's difference to its neighbours over theirs to each other; real: 0.70."""
_MAX_EDGE_EXCESS = 3.5
"""The same for the first and last slice, which have one neighbour; real: 1.39."""
_MAX_ROUGHNESS = 1.8
"""Pixel-to-pixel roughness over the median of the nearby slices; real: 1.12."""
_SPIKE = 3000
"""HU of second difference along a row that a lone pixel makes when it is 1500 HU off."""
_MAX_SPIKES = 12
"""Spikes in the rows looked at, beyond four times those of the neighbours; real: 2."""
_FLOOR = 4.0
"""HU: differences below this are no damage worth naming."""


def outlier_faults(voxels: VoxelArray, names: Sequence[str]) -> Iterator[str]:
    """Name the slices that do not fit between their neighbours.

    Parameters
    ----------
    voxels : (slices, rows, columns) int16 array, HU
        Padding already set to one value.
    names : sequence of str
        One per slice, for the message.

    Yields
    ------
    str
        A sentence without the folder's name; at most one per slice.
    """
    blank = [plane.min() == plane.max() for plane in voxels]
    rough, spikes = _roughness(voxels)
    excess = _excess(voxels)
    last = len(names) - 1
    for k, name in enumerate(names):
        usual = float(np.median(np.delete(rough[max(0, k - 4) : k + 5], min(k, 4))))
        beside = max(spikes[max(0, k - 1)] if k else 0, spikes[k + 1] if k < last else 0)
        if blank[k] and not all(blank):
            yield f"{name} is blank (one value throughout) while other slices are not; export the series again"
        elif rough[k] > _MAX_ROUGHNESS * usual + _FLOOR:
            yield (
                f"{name} is {rough[k]:.0f} HU rough from pixel to pixel, its neighbours {usual:.0f} HU; "
                "its bytes are swapped or damaged, export the series again"
            )
        elif spikes[k] > _MAX_SPIKES + 4 * beside:
            yield (
                f"{name} has lone pixels 1500 HU off ({spikes[k]} of them, its neighbours at most {beside}); "
                "bits of it are damaged, export the series again"
            )
        elif excess[k] > (_MAX_EDGE_EXCESS if k in (0, last) else _MAX_EXCESS):
            yield (
                f"{name} differs {excess[k]:.1f} times more from its neighbours than they differ from each other; "
                "it is damaged or of another series, export the series again"
            )


def _roughness(voxels: VoxelArray) -> tuple[FloatArray, IntArray]:
    """Mean absolute second difference (HU) along some rows of each slice, and how many are spikes; (slices,) each."""
    step = max(1, voxels.shape[1] // 64)
    rough = np.zeros(len(voxels))
    spikes = np.zeros(len(voxels), dtype=np.int64)
    for k, plane in enumerate(voxels[:, ::step]):
        bend = np.abs(np.diff(plane.astype(np.int32), n=2, axis=1))
        rough[k] = bend.mean(dtype=float)
        spikes[k] = np.count_nonzero(bend > _SPIKE)
    return rough, spikes


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
