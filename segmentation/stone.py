"""A stone in a CT: grown from a point, or given as a mask; its volume, density and size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from segmentation.arrays import BoolArray, FloatArray, IntArray, frozen_array
from segmentation.errors import RegionError
from segmentation.volume import Volume

SNAP_MM = 2.0  # a point beside the stone counts as meant for its brightest voxel this near
REACH_MM = 45.0  # a stone that goes farther than this from its point is no stone: bone, or a leak
CORE_SHARE = 0.8  # voxels above this share of the way from surroundings to the brightest are the core
SHELL_MM = (1.0, 3.0)  # beyond the blur of the edge
ROUNDS = 12
CONTRAST_MIN = 80.0  # HU of core above surroundings; noise of an abdominal CT is 10 to 30


@dataclass(frozen=True, eq=False, kw_only=True)
class Stone:
    """One stone.

    Attributes
    ----------
    center : (3,) float array, mm, LPS
        Mean of its voxels.
    volume_mm3 : float
    diameter : float, mm
        Largest distance between corners of its voxels.
    hu_mean, hu_max : float, HU
    threshold : float or None, HU
        Lower limit it was grown with; None for a mask.
    """

    center: FloatArray
    volume_mm3: float
    diameter: float
    hu_mean: float
    hu_max: float
    threshold: float | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", frozen_array(self.center, (3,), "stone center"))


def grow_stone(volume: Volume, point: tuple[float, float, float]) -> Stone:
    """The bright body at a point, bounded halfway between its core and what surrounds it.

    The edge of a blurred step lies where the grey is halfway between both sides; both are
    found by repetition: grow, look at core and shell, set the limit between them, grow again.

    Parameters
    ----------
    volume : Volume
    point : (3,) float tuple, mm, LPS

    Raises
    ------
    RegionError
        If there is no bright body at the point, it is no brighter than its surroundings, or too large for a stone.
    """
    name = "({:.1f}, {:.1f}, {:.1f}) mm".format(*point)
    if not volume.contains(point):
        raise RegionError(f"the stone's point {name} lies outside the image; check its frame (LPS) and unit (mm)")
    lower, upper = _box(volume, point, REACH_MM)
    part = volume.crop(lower, upper)
    hu = np.asarray(part.voxels, dtype=np.float64)
    seed = _brightest(part, hu, point)
    surround = float(np.median(hu[_ball(part, point, 15.0)]))
    limit, mask = 0.5 * (hu[seed] + surround), None
    for _ in range(ROUNDS):
        labels, _ = ndimage.label(hu >= limit)
        mask = labels == labels[seed]
        if _touches_border(mask, lower, upper, volume):
            raise RegionError(
                f"what grows from the stone's point {name} above {limit:.0f} HU goes more than {REACH_MM:g} mm away; "
                "it is bone or contrast medium, give the stone as a mask"
            )
        away = ndimage.distance_transform_edt(~mask, sampling=part.spacing)
        shell = (away > SHELL_MM[0]) & (away <= SHELL_MM[1])
        surround, peak = float(np.median(hu[shell])), float(hu[mask].max())
        core = float(np.median(hu[mask & (hu >= surround + CORE_SHARE * (peak - surround))]))
        if core - surround < CONTRAST_MIN:
            raise RegionError(
                f"at the stone's point {name} the body has {core:.0f} HU and its surroundings {surround:.0f} HU, "
                f"expected {CONTRAST_MIN:g} HU more; contrast medium hides the stone, use an unenhanced CT or give a mask"
            )
        renewed = 0.5 * (core + surround)
        if abs(renewed - limit) < 0.5:
            break
        limit = min(renewed, float(hu[seed]))
    assert mask is not None
    return _stone(part, mask, limit)


def masked_stone(volume: Volume, mask: BoolArray) -> Stone:
    """A stone given as a mask on the grid of the CT.

    Raises
    ------
    RegionError
        If the mask has another grid than the CT, or is empty.
    """
    if mask.shape != volume.voxels.shape:
        raise RegionError(f"the stone's mask has {mask.shape} voxels, the CT {volume.voxels.shape}; it must lie on the CT's grid")
    if not mask.any():
        raise RegionError("the stone's mask is empty; draw the stone, or give a point in it")
    return _stone(volume, mask, None)


def _stone(volume: Volume, mask: BoolArray, threshold: float | None) -> Stone:
    index = np.argwhere(mask)
    values = np.asarray(volume.voxels)[mask]
    return Stone(
        center=volume.to_lps(index.mean(axis=0)),
        volume_mm3=len(index) * volume.voxel_ml * 1000.0,
        diameter=_largest_distance(volume, index),
        hu_mean=float(values.mean()),
        hu_max=float(values.max()),
        threshold=threshold,
    )


def _largest_distance(volume: Volume, index: IntArray) -> float:
    """Between voxel corners; the farthest two points of a body lie on its convex hull."""
    corners = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
    points = volume.to_lps(np.unique((index[:, None] + corners).reshape(-1, 3), axis=0))
    hull = points[ConvexHull(points).vertices]
    return float(pdist(hull).max())


def _box(volume: Volume, point: tuple[float, float, float], reach: float) -> tuple[FloatArray, FloatArray]:
    middle, margin = volume.to_index(point), np.ceil(reach / volume.spacing)
    lower = np.maximum(np.floor(middle - margin), 0).astype(int)
    return lower, np.minimum(np.ceil(middle + margin) + 1, volume.voxels.shape).astype(int)


def _ball(volume: Volume, point: tuple[float, float, float], reach: float) -> BoolArray:
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in volume.voxels.shape), indexing="ij"), axis=-1)
    return np.asarray(np.linalg.norm(volume.to_lps(grid) - np.asarray(point), axis=-1) <= reach)


def _brightest(volume: Volume, hu: FloatArray, point: tuple[float, float, float]) -> tuple[int, int, int]:
    near = _ball(volume, point, max(SNAP_MM, float(volume.spacing.max())))
    k = int(np.where(near, hu, -np.inf).argmax())
    i, j, m = np.unravel_index(k, hu.shape)
    return int(i), int(j), int(m)


def _touches_border(mask: BoolArray, lower: FloatArray, upper: FloatArray, volume: Volume) -> bool:
    """Whether a body reaches a face of its box that is not one of the image."""
    index = np.argwhere(mask)
    low, high = index.min(axis=0) + lower, index.max(axis=0) + lower
    return bool(((low == lower) & (lower > 0)).any() or ((high == upper - 1) & (upper < np.array(volume.voxels.shape))).any())
