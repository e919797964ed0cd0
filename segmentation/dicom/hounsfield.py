"""Stored values to Hounsfield units, and whether the result can be a CT."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from segmentation.arrays import VoxelArray
from segmentation.errors import VolumeError
from segmentation.padding import PackedPlane, Padding, packed_planes

FILL_HU = -1024
"""What voxels outside the image are set to: air."""
_PADDING_LIMIT = -900
"""HU: a declared padding value above this is a tissue value and is left alone."""
_LOW, _HIGH = -32768, 32767


@dataclass(frozen=True, eq=False)
class Conversion:
    """What happened to the values of one slice.

    Attributes
    ----------
    padding : (n,) uint8 array or None
        Voxels that held the padding value and were set to `FILL_HU`, as bits; None without any.
    clipped : int
        Voxels outside the int16 range, set to its nearest end.
    kept_padding : int
        Voxels that hold a declared padding value which reads as tissue; unchanged.
    """

    padding: PackedPlane | None
    clipped: int
    kept_padding: int


def to_hounsfield(
    stored: NDArray[np.integer],
    out: VoxelArray,
    *,
    slope: float,
    intercept: float,
    padding: tuple[int, int] | None,
) -> Conversion:
    """Rescale one slice into `out`.

    Values are rounded to whole HU and clipped to int16, -32768 to 32767: no tissue and
    no metal reaches that far.

    Parameters
    ----------
    stored : (rows, columns) integer array
    out : (rows, columns) int16 array, HU
        Written.
    slope, intercept : float
        HU per stored value, HU of stored value 0.
    padding : (2,) ints or None
        Lowest and highest stored value that means "no image here".
    """
    whole = slope.is_integer() and intercept.is_integer() and slope < 1 << 14 and abs(intercept) < 1 << 30
    if whole:
        values: NDArray[Any] = stored.astype(np.int32 if slope == 1 else np.int64) * int(slope) + int(intercept)
    else:
        values = np.rint(stored.astype(np.float64) * slope + intercept)
    beyond: NDArray[np.bool_] = np.logical_or(values < _LOW, values > _HIGH)
    clipped = int(np.count_nonzero(beyond))
    np.clip(values, _LOW, _HIGH, out=values)
    out[...] = values
    if padding is None:
        return Conversion(None, clipped, 0)
    mask = (stored >= padding[0]) & (stored <= padding[1])
    count = int(np.count_nonzero(mask))
    if padding[1] * slope + intercept > _PADDING_LIMIT:
        return Conversion(None, clipped, count)
    out[mask] = FILL_HU
    return Conversion(packed_planes([mask])[0], clipped, 0)


def settle_fill(voxels: VoxelArray) -> Padding:
    """Set an undeclared fill value to `FILL_HU`, in place.

    Scanners mark the corners outside the scan circle with one constant far below air
    (-2000, -3024); without its tag it is known by being the minimum, far below air, in a
    corner of a slice, and alone: next to no voxels within 200 HU above it.

    Parameters
    ----------
    voxels : (slices, rows, columns) int16 array, HU

    Returns
    -------
    Padding
        Voxels changed.
    """
    lowest = int(voxels.min())
    corners = voxels[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    none = Padding((None,) * len(voxels), *voxels.shape[1:])
    if lowest > -1500 or lowest not in corners:
        return none
    filled = sum(int(np.count_nonzero(plane == lowest)) for plane in voxels)
    close = sum(int(np.count_nonzero(plane <= lowest + 200)) for plane in voxels) - filled
    if close > 0.01 * filled:
        return none
    found: list[PackedPlane | None] = []
    for plane in voxels:
        mask = plane == lowest
        plane[mask] = FILL_HU
        found += packed_planes([mask])
    return Padding(tuple(found), *voxels.shape[1:])


def hounsfield_faults(voxels: VoxelArray) -> Iterator[str]:
    """What shows that the values are no Hounsfield units.

    Air, if there is any, reads about -1000; tissue is between fat and blood with
    contrast. Values with a missing, doubled or wrong rescale break one of the two.

    Parameters
    ----------
    voxels : (slices, rows, columns) int16 array, HU
        Padding already set to `FILL_HU`.

    Yields
    ------
    str
        A sentence without the name of the file or folder.
    """
    step = tuple(max(1, size // 128) for size in voxels.shape)
    sample = voxels[:: step[0], :: step[1], :: step[2]].ravel()
    sample = sample[sample != FILL_HU] if np.count_nonzero(sample != FILL_HU) > 100 else sample
    low, middle, high = (float(value) for value in np.percentile(sample, (0.5, 50, 99.5)))
    if high - low < 100:
        yield f"the values span only {low:g} to {high:g}, but air and tissue are 1000 HU apart; it is a mask or empty"
        return
    far_below = sample[sample < -1200]
    if len(far_below) > 0.02 * len(sample):
        share, typical = 100 * len(far_below) / len(sample), np.median(far_below)
        yield f"{share:.0f} % of the voxels are near {typical:.0f} HU, but air is -1000; the rescale is wrong, export again"
        return
    tissue = np.count_nonzero((sample > -250) & (sample < 500)) / len(sample)
    if tissue < 0.005:
        yield f"no tissue between -250 and 500 HU (median {middle:.0f}); the rescale is wrong or missing, export in HU"
        return
    shifted = np.count_nonzero((sample > 700) & (sample < 1500)) / len(sample)
    if low > -100 and shifted > 0.3:
        yield f"the values start at {low:.0f} and tissue reads {middle:.0f}; the intercept is missing, export in HU"


def require_hounsfield(voxels: VoxelArray, name: str) -> None:
    """Refuse values that are no HU.

    Raises
    ------
    VolumeError
        With the first reason, led by `name`.
    """
    for fault in hounsfield_faults(voxels):
        raise VolumeError(f"{name}: {fault}")
