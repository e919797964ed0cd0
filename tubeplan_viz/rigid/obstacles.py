"""What the instrument must not touch: label volumes as unions of voxel boxes, and the rim of the way in.

Every structure is the union of its voxels' boxes, so that distances mean something between voxel centres too. Its exposed
faces are cut into small rectangles ("cells"); a kd-tree holds their centres, and every point of the surface lies within
`cover` of one of them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import pairwise

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

    def covers(self, low: IntArray, shape: tuple[int, ...]) -> bool:
        """Whether the field stands on the voxels of a box: its first one and how many there are along each axis."""
        return self.values.shape == shape and np.array_equal(self.low, low * self.spacing)

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
class Structure:
    """One structure ready for queries; as in `Obstacles`."""

    mask: BoolArray
    cells: FloatArray
    half: FloatArray
    tree: cKDTree
    field: Field


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

    def structures(self) -> dict[str, Structure]:
        """Each structure by its name."""
        parts = zip(self.names, self.masks, self.rows, self.trees, self.fields, strict=True)
        return {name: Structure(mask, self.cells[r], self.half[r], tree, own) for name, mask, r, tree, own in parts}

    def without(self, names: Collection[str]) -> Obstacles:
        """These obstacles but some."""
        return _joined(self.frame, {name: one for name, one in self.structures().items() if name not in names})


def _joined(frame: Frame, structures: Mapping[str, Structure]) -> Obstacles:
    """Obstacles of structures on the same part of the same volume."""
    parts = tuple(structures.values())
    cells = np.vstack([one.cells for one in parts]) if parts else np.empty((0, 3))
    half = np.vstack([one.half for one in parts]) if parts else np.empty((0, 3))
    ends = np.cumsum([0, *(len(one.cells) for one in parts)])
    if parts:
        field = Field(np.minimum.reduce([one.field.values for one in parts]), parts[0].field.low, frame.spacing)
    else:
        field = Field(np.full((1, 1, 1), 1e6, np.float32), np.zeros(3), frame.spacing)
    return Obstacles(
        frame=frame,
        names=tuple(structures),
        masks=tuple(one.mask for one in parts),
        cells=cells,
        half=half,
        label=np.repeat(np.arange(len(parts)), np.diff(ends)),
        cover=float(np.linalg.norm(half, axis=1).max()) if len(half) else 0.0,
        tree=cKDTree(cells if len(cells) else np.full((1, 3), 1e9), balanced_tree=False),
        trees=tuple(one.tree for one in parts),
        rows=tuple(np.arange(first, last) for first, last in pairwise(ends.tolist())),
        field=field,
        fields=tuple(one.field for one in parts),
    )


def build_obstacles(
    volume: Volume,
    masks: Mapping[str, BoolArray],
    *,
    within: tuple[FloatArray, FloatArray] | None = None,
    like: Obstacles | None = None,
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
    like : Obstacles, optional
        On the same volume; what is the same there is taken from there.
    """
    frame = Frame.of(volume)
    low, high = np.zeros(3, int), np.array(volume.voxels.shape)
    if within is not None:
        low = np.clip(np.floor(within[0] / frame.spacing).astype(int), 0, high)
        high = np.clip(np.ceil(within[1] / frame.spacing).astype(int) + 1, low, high)
    window = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    known = {} if like is None else like.structures()
    made: dict[str, Structure] = {}
    for name, mask in masks.items():
        part = mask[window]
        if not part.any():
            continue
        inside = np.zeros_like(mask, dtype=bool)
        inside[window] = part
        same = known.get(name)
        if same is not None and same.field.covers(low, part.shape) and np.array_equal(same.mask, inside):
            made[name] = same
            continue
        centres, sides = exposed_cells(part, frame.spacing)
        centres = centres + low * frame.spacing
        tree = cKDTree(centres, balanced_tree=False)
        made[name] = Structure(inside, centres, sides, tree, _field(part, tree, low * frame.spacing, frame.spacing))
    return _joined(frame, made)


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
