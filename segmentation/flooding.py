"""Flooding from a seed through rising limits, each voxel visited once."""

# Strategy: a flood per limit would visit the lumen hundreds of times. Here the voxels
# that the flood touched and found too high wait on its shore; raising the limit only
# re-examines the shore and goes on from there. The result is exact: a voxel joins at the
# smallest limit of the list for which a path of neighbours leads to it from the seed
# (the minimax path). Whole fronts are handled at once by numpy. Grey values are fetched block by
# block where the flood arrives: a tube is about 1 % of a CT, and memory that nobody wrote to costs nothing.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from skimage.segmentation import flood as flood_fill

from segmentation.arrays import BoolArray, IntArray, VoxelArray

# Value of voxels that may never join.
BLOCKED = np.int16(32767)

Box = tuple[slice, slice, slice]
Heights = NDArray[np.uint16]

# Heights are kept as unsigned numbers in the order of the values, so that an untouched array (zero) reads as unknown.
_FLIP = np.uint16(0x8000)
_UNKNOWN, _CLOSED = np.uint16(0), np.uint16(0xFFFF)
# Voxels fetched at a time: with the smoothing's margin around it a block is about twice as much work as without.
_BLOCK = np.array([16, 32, 64])
# The box of a flood at one limit is first guessed on every fourth voxel along each axis, and then taken this much larger.
_STRIDE = 4
_MARGIN = 8


class Terrain(Protocol):
    """What a flood needs of an image: its shape, and the values of any box above -32768; an int16 array is one."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Slices, rows and columns."""

    def __getitem__(self, box: Box, /) -> VoxelArray:
        """The values of a box, as a copy or a view."""


@dataclass(frozen=True, eq=False)
class Flood:
    """The order in which voxels joined.

    Attributes
    ----------
    joined : tuple of (n,) int array
        Flat indices into the image that joined at each limit, for the limits reached.
    values : tuple of (n,) int16 array
        Their values.
    complete : bool
        False when the flood was stopped because it held more than `voxels_max`.
    """

    joined: tuple[IntArray, ...]
    values: tuple[VoxelArray, ...]
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
    values: Terrain,
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
    values : Terrain
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
        Indices are flat ones of an array of the image's shape.
    """
    land = _Land(values)
    steps = neighbour_steps(land.shape, connectivity)
    shore = np.array([np.ravel_multi_index(tuple(i + 1 for i in seed), land.shape)], dtype=np.int64)
    heights = land.heights(shore)
    land.close(shore)
    joined: list[IntArray] = []
    joined_heights: list[Heights] = []
    held = 0
    for done, limit in enumerate(_stored(np.clip(limits, -BLOCKED, BLOCKED - 1).astype(np.int16)), start=1):
        below = heights <= limit
        front, front_heights = shore[below], heights[below]
        waiting, waiting_heights = [shore[~below]], [heights[~below]]
        arrived, arrived_heights = [front], [front_heights]
        held += len(front)
        while len(front) and held <= voxels_max:
            near = (front[:, None] + steps).ravel()
            near = np.unique(near[land.heights(near) != _CLOSED])
            high = land.heights(near)
            land.close(near)
            below = high <= limit
            front, front_heights = near[below], high[below]
            waiting.append(near[~below])
            waiting_heights.append(high[~below])
            arrived.append(front)
            arrived_heights.append(front_heights)
            held += len(front)
        shore, heights = np.concatenate(waiting), np.concatenate(waiting_heights)
        joined.append(_unpadded(np.concatenate(arrived), values.shape))
        joined_heights.append(np.concatenate(arrived_heights))
        if progress is not None:
            progress(done, len(limits))
        if held > voxels_max:
            break
    kept = tuple((part ^ _FLIP).view(np.int16) for part in joined_heights)
    return Flood(tuple(joined), kept, complete=held <= voxels_max)


def flood_once(
    inside: Callable[[Box], BoolArray],
    seed: tuple[int, int, int],
    shape: tuple[int, ...],
    *,
    connectivity: int,
    voxels_max: int,
) -> tuple[BoolArray, tuple[int, int, int], bool]:
    """What is connected to the seed, in a box that grows until the flood stays inside.

    Parameters
    ----------
    inside : callable
        Which voxels of a box of the image may be held; the seed may. Asked with steps too, for a guess at the box.
    seed : (3,) int tuple
    shape : (3,) int tuple
        Of the image.
    connectivity : {6, 26}
    voxels_max : int
        The box grows no further once the flood holds more than this.

    Returns
    -------
    mask : (k, l, m) bool array
    lower : (3,) int tuple
        Index of ``mask[0, 0, 0]`` in the image.
    complete : bool
        False when it was stopped because it held more than `voxels_max`.
    """
    reach_of = 1 if connectivity == 6 else 3
    start, end = np.array(seed), np.array(shape)
    coarse, at = inside(_every_fourth(seed, shape)), tuple(start // _STRIDE)
    # Unsmoothed, noise may put the seed outside; what a flood from there would hold is something else.
    coarse[at] = True
    bounds = bounding_box(flood_fill(coarse, at, connectivity=reach_of)) * _STRIDE + (start % _STRIDE)[:, None]
    lower, upper = np.maximum(bounds[:, 0] - _MARGIN, 0), np.minimum(bounds[:, 1] + _MARGIN + 1, end)
    while True:
        mask = flood_fill(inside(_slices(lower, upper)), tuple(start - lower), connectivity=reach_of)
        held = int(np.count_nonzero(mask))
        touched = np.array([[mask.take(place, axis=axis).any() for place in (0, -1)] for axis in range(3)])
        touched &= np.column_stack([lower > 0, upper < end])
        if held > voxels_max or not touched.any():
            return mask, (int(lower[0]), int(lower[1]), int(lower[2])), held <= voxels_max
        reach = upper - lower
        lower = np.where(touched[:, 0], np.maximum(lower - reach, 0), lower)
        upper = np.where(touched[:, 1], np.minimum(upper + reach, end), upper)


def bounding_box(mask: BoolArray) -> IntArray:
    """First and last index along each axis at which the mask holds anything, (3, 2)."""
    return np.array([np.flatnonzero(mask.any(axis=tuple({0, 1, 2} - {axis})))[[0, -1]] for axis in range(3)])


def without_voids(mask: BoolArray) -> BoolArray:
    """The mask and all from which no way along faces leads out of the array: scipy's `binary_fill_holes`, quicker."""
    # The rim joins whatever is open to any side of the array.
    outside = flood_fill(np.pad(~mask, 1, constant_values=True), (0, 0, 0), connectivity=1)
    return np.asarray(~outside[1:-1, 1:-1, 1:-1])


class _Land:
    """Heights on the image's grid with a rim around it, known where the flood has been."""

    def __init__(self, values: Terrain) -> None:
        self.values = values
        self.shape = tuple(n + 2 for n in values.shape)
        # Zeroed memory is given by the system page by page, when it is written to.
        self._grid: Heights = np.zeros(self.shape, dtype=np.uint16)
        self._flat = self._grid.reshape(-1)

    def heights(self, flat: IntArray) -> Heights:
        """Heights at flat indices, fetched where they are not known."""
        found = self._flat[flat]
        unknown = found == _UNKNOWN
        if unknown.any():
            self._fetch(flat[unknown])
            found = self._flat[flat]
        return found

    def close(self, flat: IntArray) -> None:
        """The flood need not look at these again."""
        self._flat[flat] = _CLOSED

    def _fetch(self, flat: IntArray) -> None:
        index = np.column_stack(np.unravel_index(flat, self.shape)) - 1
        rim = np.any((index < 0) | (index >= self.values.shape), axis=1)
        self._flat[flat[rim]] = _CLOSED
        for block in np.unique(index[~rim] // _BLOCK, axis=0):
            lower, upper = block * _BLOCK, np.minimum((block + 1) * _BLOCK, self.values.shape)
            self._grid[_slices(lower + 1, upper + 1)] = _stored(self.values[_slices(lower, upper)])


def _stored(values: VoxelArray) -> Heights:
    """Values as unsigned numbers in the same order; `BLOCKED` becomes the highest, which is closed."""
    return np.ascontiguousarray(values).view(np.uint16) ^ _FLIP


def _every_fourth(seed: tuple[int, int, int], shape: tuple[int, ...]) -> Box:
    """A grid of every fourth voxel along each axis, the seed among them."""
    first, second, third = (slice(i % _STRIDE, n, _STRIDE) for i, n in zip(seed, shape, strict=True))
    return first, second, third


def _slices(lower: IntArray, upper: IntArray) -> Box:
    first, second, third = (slice(int(a), int(b)) for a, b in zip(lower, upper, strict=True))
    return first, second, third


def _unpadded(flat: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Flat indices of the padded array as flat indices of the array inside it."""
    index = np.unravel_index(flat, tuple(n + 2 for n in shape))
    return np.asarray(np.ravel_multi_index(tuple(i - 1 for i in index), shape), dtype=np.int64)
