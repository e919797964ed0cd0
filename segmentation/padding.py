"""Voxels of an image that the scanner did not measure: where they are, and whether a region comes near them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segmentation.arrays import BoolArray
from segmentation.region_growing import Region

# One slice as bits, eight voxels to a byte, row after row; None for a slice without any.
PackedPlane = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Padding:
    """Voxels that hold a fill value instead of HU: outside the scan circle, or beyond a resampled image.

    Held as bits, a sixteenth of the image.

    Attributes
    ----------
    planes : tuple of (n,) uint8 array or None
        One per slice.
    rows, columns : int
    """

    planes: tuple[PackedPlane | None, ...]
    rows: int
    columns: int

    @property
    def count(self) -> int:
        """Voxels of padding."""
        return sum(int(np.bitwise_count(plane).sum()) for plane in self.planes if plane is not None)

    def plane(self, number: int) -> BoolArray:
        """Which voxels of a slice are padding, (rows, columns)."""
        packed = self.planes[number]
        if packed is None:
            return np.zeros((self.rows, self.columns), dtype=bool)
        return np.unpackbits(packed, count=self.rows * self.columns).reshape(self.rows, self.columns).astype(bool)

    def count_within(self, box: tuple[slice, slice, slice], *, among: BoolArray | None = None) -> int:
        """Voxels of padding in a box ``start <= index < stop``; with `among`, a mask of the box, only of those."""
        found = 0
        for place, number in enumerate(range(box[0].start, box[0].stop)):
            if self.planes[number] is not None:
                plane = self.plane(number)[box[1:]]
                found += int(np.count_nonzero(plane if among is None else plane & among[place]))
        return found

    def touching(self, region: Region) -> int:
        """Voxels of padding that belong to a region or are face neighbours of one that does."""
        # A region's box has a margin of one voxel wherever the image has one.
        first, second, third = (slice(lo, lo + n) for lo, n in zip(region.lower, region.mask.shape, strict=True))
        return self.count_within((first, second, third), among=with_neighbours(region.mask))


def packed_planes(planes: Sequence[BoolArray]) -> tuple[PackedPlane | None, ...]:
    """Masks of slices as bits."""
    return tuple(np.packbits(plane) if plane.any() else None for plane in planes)


def together(one: Padding, other: Padding) -> Padding:
    """What is padding in either of two of the same image."""
    pairs = zip(one.planes, other.planes, strict=True)
    return Padding(tuple(b if a is None else a if b is None else a | b for a, b in pairs), one.rows, one.columns)


def with_neighbours(mask: BoolArray) -> BoolArray:
    """The mask and the face neighbours of its voxels."""
    wide = mask.copy()
    for axis in range(3):
        one, other = (np.moveaxis(part, axis, 0) for part in (wide, mask))
        one[1:] |= other[:-1]
        one[:-1] |= other[1:]
    return wide
