"""Masks grown, shrunk and split in millimetres, by exact distances."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray, IntArray


def grown(mask: BoolArray, radius: float, spacing: FloatArray) -> BoolArray:
    """All voxels within `radius` mm of the mask."""
    out = np.zeros_like(mask)
    if mask.any():
        box = box_of(mask, radius, spacing)
        out[box] = ndimage.distance_transform_edt(~mask[box], sampling=spacing) <= radius
    return out


def shrunk(mask: BoolArray, radius: float, spacing: FloatArray) -> BoolArray:
    """Voxels of the mask farther than `radius` mm from any voxel outside; the array's border is not outside."""
    out = np.zeros_like(mask)
    if mask.any():
        box = box_of(mask, float(spacing.max()), spacing)
        out[box] = True if mask[box].all() else ndimage.distance_transform_edt(mask[box], sampling=spacing) > radius
    return out


def closed(mask: BoolArray, radius: float, spacing: FloatArray) -> BoolArray:
    """The mask without gaps that a ball of `radius` mm does not fit into; contains the mask."""
    pad = np.ceil(radius / spacing).astype(int) + 1
    wide = np.pad(mask, [(int(p), int(p)) for p in pad])
    inner = tuple(slice(int(p), int(p) + n) for p, n in zip(pad, mask.shape, strict=True))
    return np.asarray(shrunk(grown(wide, radius, spacing), radius, spacing)[inner] | mask)


def opened(mask: BoolArray, radius: float, spacing: FloatArray) -> BoolArray:
    """The parts of the mask that a ball of `radius` mm fits into; contained in the mask."""
    return grown(shrunk(mask, radius, spacing), radius, spacing) & mask


def largest(mask: BoolArray) -> BoolArray:
    """The largest part connected across faces; empty if the mask is."""
    labels, count = ndimage.label(mask)
    if count == 0:
        return np.zeros_like(mask)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(labels == sizes.argmax())


def holding(mask: BoolArray, place: IntArray) -> BoolArray:
    """The part connected across faces that holds one voxel; empty if that voxel is not in the mask."""
    labels, _ = ndimage.label(mask)
    label = labels[tuple(int(i) for i in place)]
    return np.asarray(labels == label) if label else np.zeros_like(mask)


def box_of(mask: BoolArray, margin: float, spacing: FloatArray) -> tuple[slice, slice, slice]:
    """Index box of a mask that is not empty, widened by `margin` mm within the array."""
    reach = np.ceil(margin / spacing).astype(int)
    sides = []
    for axis in range(3):
        there = np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis)))
        sides.append(slice(max(int(there[0] - reach[axis]), 0), min(int(there[-1] + reach[axis]) + 1, mask.shape[axis])))
    return sides[0], sides[1], sides[2]


def parts(mask: BoolArray, smallest: int = 1) -> list[BoolArray]:
    """The parts connected across faces with at least so many voxels, the largest first."""
    labels, count = ndimage.label(mask)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    return [np.asarray(labels == k + 1) for k in np.argsort(sizes)[::-1] if sizes[k] >= smallest]


def near(mask: BoolArray, place: IntArray | FloatArray, radius: float, spacing: FloatArray) -> BoolArray:
    """The part connected across faces that comes nearest to a place; empty if none comes within `radius` mm."""
    places = np.argwhere(mask)
    away = np.linalg.norm((places - place) * spacing, axis=1)
    return holding(mask, places[away.argmin()]) if away.size and away.min() <= radius else np.zeros_like(mask)
