"""Flooding from a seed through rising limits, each voxel visited once."""

# Strategy: a flood per limit would visit the lumen hundreds of times. Here the voxels
# that the flood touched and found too high wait on its shore; raising the limit only
# re-examines the shore and goes on from there. The result is exact: a voxel joins at the
# smallest limit of the list for which a path of neighbours leads to it from the seed
# (the minimax path). Whole fronts are handled at once by numpy.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from segmentation.arrays import IntArray, VoxelArray

# Value of the rim around the image and of voxels that may never join.
BLOCKED = np.int16(32767)


@dataclass(frozen=True, eq=False)
class Flood:
    """The order in which voxels joined.

    Attributes
    ----------
    joined : tuple of (n,) int array
        Flat indices into the image that joined at each limit, for the limits reached.
    complete : bool
        False when the flood was stopped because it held more than `voxels_max`.
    """

    joined: tuple[IntArray, ...]
    complete: bool

    @property
    def counts(self) -> IntArray:
        """Voxels held at each limit, (n,)."""
        return np.cumsum([len(front) for front in self.joined])


def neighbour_steps(shape: tuple[int, ...], connectivity: int) -> IntArray:
    """Flat offsets of the 6 or 26 neighbours of a voxel in an array of the given shape."""
    reach = 1 if connectivity == 6 else 3
    steps = [s for s in product((-1, 0, 1), repeat=3) if 0 < sum(map(abs, s)) <= reach]
    return np.array([(s[0] * shape[1] + s[1]) * shape[2] + s[2] for s in steps], dtype=np.int64)


def flood(
    values: VoxelArray,
    seed: tuple[int, int, int],
    limits: NDArray[np.integer],
    *,
    connectivity: int,
    voxels_max: int,
    progress: Callable[[int, int], None] | None = None,
) -> Flood:
    """Let a flood rise from the seed.

    Parameters
    ----------
    values : (slices, rows, columns) int16 array
        A voxel joins when its value is at most the limit; `BLOCKED` never joins.
    seed : (3,) int tuple
    limits : (n,) int array
        Rising.
    connectivity : {6, 26}
    voxels_max : int
        The flood stops once it holds more than this.
    progress : callable, optional
        Called with the number of limits done and their count.

    Returns
    -------
    Flood
        Indices refer to ``values.ravel()``.
    """
    shape = tuple(n + 2 for n in values.shape)
    padded = np.full(shape, BLOCKED, dtype=np.int16)
    padded[1:-1, 1:-1, 1:-1] = values
    height = padded.ravel()
    steps = neighbour_steps(shape, connectivity)
    start = int(np.ravel_multi_index(tuple(i + 1 for i in seed), shape))
    seen = np.zeros(height.size, dtype=bool)
    seen[start] = True
    shore = np.array([start], dtype=np.int64)
    joined: list[IntArray] = []
    held = 0
    for done, limit in enumerate(limits, start=1):
        below = height[shore] <= limit
        front, waiting, arrived = shore[below], [shore[~below]], []
        while len(front) and held <= voxels_max:
            arrived.append(front)
            held += len(front)
            near = (front[:, None] + steps).ravel()
            near = np.unique(near[~seen[near]])
            seen[near] = True
            below = height[near] <= limit
            front = near[below]
            waiting.append(near[~below & (height[near] != BLOCKED)])
        shore = np.concatenate(waiting)
        joined.append(_unpadded(np.concatenate(arrived) if arrived else np.zeros(0, dtype=np.int64), values.shape))
        if progress is not None:
            progress(done, len(limits))
        if held > voxels_max:
            return Flood(tuple(joined), complete=False)
    return Flood(tuple(joined), complete=True)


def _unpadded(flat: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Flat indices of the padded array as flat indices of the array inside it."""
    index = np.unravel_index(flat, tuple(n + 2 for n in shape))
    return np.asarray(np.ravel_multi_index(tuple(i - 1 for i in index), shape), dtype=np.int64)
