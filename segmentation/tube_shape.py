"""Is a grown region a tube? Its length, width and cross-sections, and the refusal when it is not."""

# Strategy: distances are measured inside the region along voxel neighbours (a geodesic), so
# that bends do not shorten it. The region is cut into slices of equal geodesic distance from
# its far end; each connected part of a slice is a cross-section of one branch (a Reeb graph).
# In a tube the area of a section is that of its inscribed circle times a small factor; in a
# sheet or a sponge, which may be just as long, it is many times larger.

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from skimage.measure import euler_number, label

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import RegionError

# Coarser voxels keep the geodesic quick: the measures are of the size of the tube.
VOXELS_MAX = 80_000


@dataclass(frozen=True, kw_only=True)
class TubeShape:
    """Measures of a region's shape.

    Attributes
    ----------
    volume : float, ml
        With enclosed voids filled.
    length : float, mm
        Longest way inside the region.
    radius : float, mm
        Of the largest sphere inside; the image's border is not wall.
    radius_voxels : float
        The same sphere in voxels of the coarsest axis.
    elongation : float
        `length` over the diameter of a cylinder of the same length and volume.
    tunnels : int
        Holes right through, as in a ring.
    section_excess : float
        Area of the cross-sections over that of their inscribed circles, median by volume.
    """

    volume: float
    length: float
    radius: float
    radius_voxels: float
    tunnels: int
    elongation: float
    section_excess: float


@dataclass(frozen=True, kw_only=True)
class TubeRule:
    """Limits beyond which a region is refused.

    Measured: four real airways have an elongation of 6.4 (a trachea alone) to 15 and a section
    excess of 1.1 to 1.5; the upper 75 mm of a trachea 5.1 and 1.2. Gas in the colon has
    2.9 and 2.3, a lung 3.5 and 9.2, the bones of trunk and pelvis 10 and 5 to 7.

    Attributes
    ----------
    elongation_min : float
    section_excess_max : float
    tunnels_max : int
        A spine has 65, a real collecting system up to 23, an airway none.
    radius_voxels_min : float
        Below this the image shows a line of voxels and no wall: ribs at 3 mm have 1.4.
    """

    elongation_min: float = 4.0
    section_excess_max: float = 2.6
    tunnels_max: int = 40
    radius_voxels_min: float = 1.5


def tube_shape(mask: BoolArray, spacing: FloatArray) -> TubeShape:
    """Measure a region that fills its box, voids closed.

    Parameters
    ----------
    mask : (k, l, m) bool array
        Touches the array's border only where the image ends.
    spacing : (3,) float array, mm
    """
    volume = float(mask.sum() * np.prod(spacing))
    coarse, factor = _coarser(mask, spacing)
    step = spacing * factor
    index = np.argwhere(coarse)
    depth = _depth(coarse, index, step)
    distance = _geodesic(coarse, index, int(np.argmax(depth)), step)
    length = float(distance.max() + step.max())

    width = max(1.5 * float(step.max()), 1.0)
    shells = np.zeros(coarse.shape, dtype=np.int32)
    shells[tuple(index.T)] = (distance // width).astype(np.int32) + 1
    section = label(shells, background=0, connectivity=3)[tuple(index.T)]
    parts = np.bincount(section) * float(np.prod(step))
    radius = np.zeros(len(parts))
    np.maximum.at(radius, section, depth)
    excess = (parts[1:] / width) / (np.pi * radius[1:] ** 2)
    order = np.argsort(excess)
    share = np.cumsum(parts[1:][order])
    return TubeShape(
        volume=volume / 1000.0,
        length=length,
        radius=float(depth.max()),
        radius_voxels=float(depth.max() / spacing.max()),
        tunnels=1 - int(euler_number(np.pad(mask, 1), connectivity=1)),
        elongation=float(length / (2.0 * np.sqrt(volume / (np.pi * length)))),
        section_excess=float(excess[order][np.searchsorted(share, 0.5 * share[-1])]),
    )


def refuse_unless_tube(shape: TubeShape, rule: TubeRule, name: str) -> None:
    """Raise `RegionError` with the measures when the region cannot be a tube."""
    if shape.radius_voxels < rule.radius_voxels_min:
        raise RegionError(
            f"{name} is no tube that this image resolves: its widest place has a radius of "
            f"{shape.radius_voxels:.1f} voxels, expected at least {rule.radius_voxels_min:g} ({shape.volume:.2f} ml grown); "
            "check the seed and the limits, or use thinner slices"
        )
    if shape.elongation < rule.elongation_min:
        raise RegionError(
            f"{name} is a blob and no tube: {shape.volume:.1f} ml over a length of {shape.length:.0f} mm "
            f"is {shape.elongation:.1f} times as long as wide, expected at least {rule.elongation_min:g}; "
            "check the seed and the limits"
        )
    if shape.tunnels > rule.tunnels_max:
        raise RegionError(
            f"{name} is a sponge and no tube: {shape.tunnels} tunnels run through it, expected at most {rule.tunnels_max} "
            f"({shape.volume:.1f} ml grown); smooth the image first, tighten the limits or check the seed"
        )
    if shape.section_excess > rule.section_excess_max:
        raise RegionError(
            f"{name} is a sheet or a sponge and no tube: its cross-sections are {shape.section_excess:.1f} times "
            f"their inscribed circles, expected at most {rule.section_excess_max:g} "
            f"({shape.volume:.1f} ml grown, {shape.length:.0f} mm long); "
            "tighten the limits or check the seed"
        )


def _coarser(mask: BoolArray, spacing: FloatArray) -> tuple[BoolArray, IntArray]:
    """The mask on larger voxels, each inside when any of its parts is, and how many parts along each axis."""
    many = mask.sum() / VOXELS_MAX
    if many <= 1.0:
        return mask, np.ones(3, dtype=np.int64)
    # Finer axes are joined first, so that the larger voxels come out nearly cubic.
    side = np.cbrt(many * np.prod(spacing))
    factor = np.maximum(np.ceil(side / spacing - 0.25), 1).astype(np.int64)
    wide = np.pad(mask, [(0, int(-n % f)) for n, f in zip(mask.shape, factor, strict=True)])
    (k, m, n), (a, b, c) = wide.shape, (int(f) for f in factor)
    return np.asarray(wide.reshape(k // a, a, m // b, b, n // c, c).any(axis=(1, 3, 5))), factor


def _depth(mask: BoolArray, index: IntArray, step: FloatArray) -> FloatArray:
    """Distance of each inside voxel to the nearest outside one that the image holds, (n,) mm."""
    shore = np.argwhere(ndimage.binary_dilation(mask) & ~mask)
    if len(shore) == 0:
        return np.full(len(index), float(np.linalg.norm(step * mask.shape)))
    return np.asarray(cKDTree(shore * step).query(index * step)[0])


def _geodesic(inside: BoolArray, index: IntArray, source: int, step: FloatArray) -> FloatArray:
    """Distance inside the region from its far end, (n,) mm: from `source` to the farthest voxel, and from there."""
    number = np.full(inside.shape, -1, dtype=np.int64)
    number[tuple(index.T)] = np.arange(len(index))
    padded = np.pad(number, 1, constant_values=-1)
    rows, columns, weights = [], [], []
    for offset in product((-1, 0, 1), repeat=3):
        if offset <= (0, 0, 0):
            continue
        other = padded[tuple((index + 1 + offset).T)]
        linked = other >= 0
        rows.append(np.flatnonzero(linked))
        columns.append(other[linked])
        weights.append(np.full(int(linked.sum()), float(np.linalg.norm(np.array(offset) * step))))
    graph = coo_matrix(
        (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(len(index),) * 2
    ).tocsr()
    distance = dijkstra(graph, directed=False, indices=source)
    distance = dijkstra(graph, directed=False, indices=int(np.argmax(np.where(np.isfinite(distance), distance, -1.0))))
    return np.where(np.isfinite(distance), distance, 0.0)
