"""What the instrument must not touch: label volumes as unions of voxel boxes, and the rim of the way in.

Every structure is the union of its voxels' boxes, so that distances mean something between voxel centres too. Its exposed
faces are cut into small rectangles ("cells"); a kd-tree holds their centres, and every point of the surface lies within
`cover` of one of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.volume import Volume

CELL_MM = 0.3
"""Longest side of a cell; it sets how far the envelope reaches beyond the exact instrument (0.21 mm and less)."""
BAND_MM = 6.0
"""Up to here the fields hold the distance to the nearest cell itself, beyond a lower bound of it."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The image's own axes as a rotated copy of LPS, in mm: there voxels are upright boxes.

    Attributes
    ----------
    origin : (3,) float array, mm
        LPS of the centre of voxel (0, 0, 0).
    axes : (3, 3) float array
        Columns: LPS unit vectors along slice, row and column.
    spacing : (3,) float array, mm
    """

    origin: FloatArray
    axes: FloatArray
    spacing: FloatArray

    @classmethod
    def of(cls, volume: Volume) -> Frame:
        """The frame of a volume."""
        linear = volume.index_to_lps[:3, :3]
        return cls(volume.index_to_lps[:3, 3].copy(), linear / np.linalg.norm(linear, axis=0), np.asarray(volume.spacing))

    def to_frame(self, lps: FloatArray) -> FloatArray:
        """(..., 3) LPS points in the frame, mm."""
        return np.asarray((lps - self.origin) @ self.axes)

    def turn(self, vectors: FloatArray) -> FloatArray:
        """(..., 3) LPS vectors in the frame."""
        return np.asarray(vectors @ self.axes)

    def to_lps(self, points: FloatArray) -> FloatArray:
        """(..., 3) points of the frame in LPS."""
        return np.asarray(points @ self.axes.T + self.origin)


@dataclass(frozen=True, eq=False)
class Field:
    """Bounds of the distance to a surface at any point, from its values at voxel centres.

    Attributes
    ----------
    values : (slices, rows, columns) float32 array, mm
        At voxel centres: the distance, or up to half the diagonal of a voxel less; negative inside.
    low : (3,) float array, mm
        Centre of the first voxel, in the image frame.
    spacing : (3,) float array, mm
    """

    values: NDArray[np.float32]
    low: FloatArray
    spacing: FloatArray

    def bounds(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the distance of (n, 3) points to the surface cannot be less and not be more than; for points outside."""
        # A distance changes by no more than the way walked, and the box of the field holds all of the structure:
        # moving a point into that box brings it no further from it.
        share = (points - self.low) / self.spacing
        index = np.rint(share)
        np.clip(index, 0, np.array(self.values.shape) - 1, out=index)
        off = np.abs(share - index) * self.spacing
        flat = (index[:, 0] * self.values.shape[1] + index[:, 1]) * self.values.shape[2] + index[:, 2]
        known = self.values.ravel()[flat.astype(np.int64)].astype(np.float64)
        away = np.sqrt(np.einsum("ij,ij->i", off, off))
        most = known + away + 0.5 * float(np.linalg.norm(self.spacing))
        out = np.maximum(off - 0.5 * self.spacing, 0.0)
        beyond = np.sqrt(np.einsum("ij,ij->i", out, out))
        inner = np.minimum(off, 0.5 * self.spacing)
        least = known - np.sqrt(np.einsum("ij,ij->i", inner, inner))
        return np.where(beyond > 0.0, np.maximum(beyond, least), least), most


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Structures ready for queries; all points in the image frame, mm.

    Attributes
    ----------
    frame : Frame
    names : tuple of str
    masks : tuple of (slices, rows, columns) bool array
    cells : (m, 3) float array
        Centres of the cells of all exposed faces.
    half : (m, 3) float array
        Half the sides of each cell; 0 along its normal.
    label : (m,) int array
        Index into `names`.
    cover : float
        Every point of a surface is within this of the centre of a cell.
    """

    frame: Frame
    names: tuple[str, ...]
    masks: tuple[BoolArray, ...]
    cells: FloatArray
    half: FloatArray
    label: IntArray
    cover: float
    tree: cKDTree
    trees: tuple[cKDTree, ...]
    rows: tuple[IntArray, ...]
    field: Field
    fields: tuple[Field, ...]

    def holds(self, points: FloatArray) -> IntArray:
        """Index of a structure whose voxels hold each (n, 3) point, -1 where none does."""
        index = np.rint(points / self.frame.spacing).astype(int)
        found = np.full(len(points), -1, dtype=np.int64)
        for k, mask in enumerate(self.masks):
            inside = ((index >= 0) & (index < np.array(mask.shape))).all(axis=1)
            there = np.zeros(len(points), dtype=bool)
            there[inside] = mask[tuple(index[inside].T)]
            found[there & (found < 0)] = k
        return found


def build_obstacles(
    volume: Volume, masks: Mapping[str, BoolArray], *, within: tuple[FloatArray, FloatArray] | None = None
) -> Obstacles:
    """Obstacles of named masks on the voxels of a volume.

    Parameters
    ----------
    volume : Volume
        Its axes are perpendicular, as every reader of the project makes sure.
    masks : mapping of name to (slices, rows, columns) bool array
        Empty ones are left out.
    within : pair of (3,) float array, mm, optional
        Corners of a box in the image frame; voxels beyond it are left out.
    """
    frame = Frame.of(volume)
    low, high = np.zeros(3, int), np.array(volume.voxels.shape)
    if within is not None:
        low = np.clip(np.floor(within[0] / frame.spacing).astype(int), 0, high)
        high = np.clip(np.ceil(within[1] / frame.spacing).astype(int) + 1, low, high)
    window = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    names: list[str] = []
    kept: list[BoolArray] = []
    cells: list[FloatArray] = []
    half: list[FloatArray] = []
    label: list[IntArray] = []
    for name, mask in masks.items():
        part = mask[window]
        if not part.any():
            continue
        centres, sides = exposed_cells(part, frame.spacing)
        inside = np.zeros_like(mask, dtype=bool)
        inside[window] = part
        label.append(np.full(len(centres), len(names), dtype=np.int64))
        names.append(name)
        kept.append(inside)
        cells.append(centres + low * frame.spacing)
        half.append(sides)
    points = np.vstack(cells) if cells else np.empty((0, 3))
    sides = np.vstack(half) if half else np.empty((0, 3))
    labels = np.concatenate(label) if label else np.empty(0, np.int64)
    rows = tuple(np.flatnonzero(labels == k) for k in range(len(names)))
    trees = tuple(cKDTree(points[r], balanced_tree=False) for r in rows)
    fields = tuple(_field(mask[window], tree, low * frame.spacing, frame.spacing) for mask, tree in zip(kept, trees, strict=True))
    nearest = np.minimum.reduce([field.values for field in fields]) if fields else np.full((1, 1, 1), 1e6, np.float32)
    return Obstacles(
        frame,
        tuple(names),
        tuple(kept),
        points,
        sides,
        labels,
        float(np.linalg.norm(sides, axis=1).max()) if len(sides) else 0.0,
        cKDTree(points if len(points) else np.full((1, 3), 1e9), balanced_tree=False),
        trees,
        rows,
        Field(nearest, low * frame.spacing, frame.spacing),
        fields,
    )


def _field(mask: BoolArray, tree: cKDTree, low: FloatArray, spacing: FloatArray) -> Field:
    """Distance to the cells at voxel centres near them, and a lower bound of it elsewhere."""
    half_diagonal = 0.5 * float(np.linalg.norm(spacing))
    centres: NDArray[np.float64] = distance_transform_edt(~mask, sampling=spacing)
    values = (centres - half_diagonal).astype(np.float32)
    band = np.argwhere((centres < BAND_MM) & ~mask)
    values[tuple(band.T)] = tree.query(low + band * spacing)[0]
    values[mask] = -half_diagonal
    return Field(values, low, spacing)


def exposed_cells(mask: BoolArray, spacing: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centres and half sides, (m, 3) mm each, of the cells that the exposed faces of a mask are cut into."""
    centres: list[FloatArray] = []
    halves: list[FloatArray] = []
    padded = np.pad(mask, 1)
    core = (slice(1, -1),) * 3
    for axis in range(3):
        parts = [1 if k == axis else int(np.ceil(spacing[k] / CELL_MM)) for k in range(3)]
        offsets = [np.zeros(1) if k == axis else ((np.arange(parts[k]) + 0.5) / parts[k] - 0.5) * spacing[k] for k in range(3)]
        grid: NDArray[np.float64] = np.stack(np.meshgrid(*offsets, indexing="ij"), axis=-1).reshape(-1, 3)
        side = np.array([0.0 if k == axis else 0.5 * spacing[k] / parts[k] for k in range(3)])
        for way in (-1, 1):
            beyond = np.roll(padded, -way, axis=axis)[core]
            voxels = np.argwhere(mask & ~beyond) * spacing
            voxels[:, axis] += 0.5 * way * spacing[axis]
            made = (voxels[:, None] + grid[None]).reshape(-1, 3)
            centres.append(made)
            halves.append(np.broadcast_to(side, made.shape))
    return np.vstack(centres), np.vstack(halves)
