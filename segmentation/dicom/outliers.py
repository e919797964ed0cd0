"""Slices that do not belong between their neighbours: blank, byte-swapped, bit-flipped.

Strategy: a slice differs from each of its neighbours by noise and anatomy, and the
neighbours, twice as far apart, differ from one another by at least as much anatomy.
A damaged slice differs from both neighbours far more than they do from each other.
Neighbours that are damaged alike are found by what no CT slice is: one constant, or
rougher from pixel to pixel than the rest of the stack.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from segmentation.arrays import FloatArray, VoxelArray

_MAX_EXCESS = 2.0
"""A slice's difference to its neighbours over theirs to each other; real CTs (four
scanners, 297 slices) stay below 1.25."""
_MAX_EDGE_EXCESS = 4.0
"""The same for the first and last slice, which have one neighbour; real CTs stay below 1.7."""
_MAX_ROUGHNESS = 2.5
"""Pixel-to-pixel roughness over the median of the nearby slices; real CTs stay below 1.5."""
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
    blank = _blank(voxels)
    rough = _roughness(voxels)
    excess = _excess(voxels)
    for k, name in enumerate(names):
        nearby = np.delete(rough[max(0, k - 4) : k + 5], min(k, 4))
        usual = float(np.median(nearby))
        if blank[k] and not blank.all():
            yield f"{name} is blank (one value throughout) while other slices are not; export the series again"
        elif rough[k] > _MAX_ROUGHNESS * usual + _FLOOR:
            yield (
                f"{name} is {rough[k]:.0f} HU rough from pixel to pixel, its neighbours {usual:.0f} HU; "
                "its bytes are swapped or damaged, export the series again"
            )
        elif excess[k] > (_MAX_EDGE_EXCESS if k in (0, len(names) - 1) else _MAX_EXCESS):
            yield (
                f"{name} differs {excess[k]:.1f} times more from its neighbours than they differ from each other; "
                "it is damaged or of another series, export the series again"
            )


def _blank(voxels: VoxelArray) -> np.ndarray:
    return np.array([plane.min() == plane.max() for plane in voxels])


def _roughness(voxels: VoxelArray) -> FloatArray:
    """Mean absolute second difference along some rows of each slice, (slices,) HU."""
    step = max(1, voxels.shape[1] // 64)
    rows = voxels[:, ::step]
    return np.array([np.abs(np.diff(plane.astype(np.int32), n=2, axis=1)).mean(dtype=float) for plane in rows])


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
