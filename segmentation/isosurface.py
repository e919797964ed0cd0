"""The surface of a grown region at sub-voxel place, cut flat where the image ends."""

# Strategy: marching cubes runs on a field that is the CT's distance to the limit in HU, positive
# inside, with the sign forced to that of the region: nothing but the region's wall arises, and
# where wall and limit agree (everywhere but at voids and touching neighbours) the wall lies
# between the voxels as the grey values say. Where the region runs out of the image, its last
# layer is repeated once and then mirrored in sign; what marching cubes puts beyond the image's
# face is moved onto that face, which leaves a flat cap with a sharp rim.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.region_growing import FACES, Region
from segmentation.smoothing import HU_HIGHEST, HU_LOWEST, STEPS_PER_HU, smoothed_box
from segmentation.volume import Volume

# The wall keeps this share of the usual step between voxels clear of the voxel centres, so that no
# triangle shrinks to a point; 2 % of a voxel is far below what a CT resolves.
CLEAR = 0.02


@dataclass(frozen=True, eq=False)
class Isosurface:
    """Triangles as marching cubes gives them, before any smoothing.

    Attributes
    ----------
    vertices : (n, 3) float array, mm, LPS
    faces : (m, 3) int array
        Outward.
    vertex_plane : (n,) int array
        0 off the image's faces, otherwise a sum of bits ``1 << k`` for the faces k of
        `planes` on which the vertex lies.
    planes : (6, 3) float array
        Unit normals out of the image, LPS, in the order of `region_growing.FACES`.
    filled_ml : float, ml
        Volume of the voids that were filled.
    """

    vertices: FloatArray
    faces: IntArray
    vertex_plane: IntArray
    planes: FloatArray
    filled_ml: float


def isosurface(volume: Volume, region: Region) -> Isosurface:
    """Marching cubes of the region with the CT's grey values."""
    field, filled = lumen_field(volume, region)
    shape = np.array(volume.voxels.shape)
    lower, upper = np.array(region.lower), np.array(region.lower) + region.mask.shape
    ends = np.column_stack([_reaches(region.mask, lower == 0, first=True), _reaches(region.mask, upper == shape, first=False)])
    if ends.any():
        # One repeated layer and one of opposite sign on each face that cuts the region.
        field = np.pad(field, [(2 * int(a), 2 * int(b)) for a, b in ends], mode="edge")
        for axis, (first, last) in enumerate(ends):
            layers = np.moveaxis(field, axis, 0)
            for layer in (*layers[: int(first)], *layers[len(layers) - int(last) :]):
                np.negative(np.abs(layer, out=layer), out=layer)
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    index = vertices.astype(np.float64) + lower - 2 * ends[:, 0]

    low, high = -0.5, shape - 0.5
    vertex_plane = np.zeros(len(index), dtype=np.int64)
    for axis in range(3):
        for side, cut in enumerate(ends[axis]):
            if cut:
                place = low if side == 0 else float(high[axis])
                over = index[:, axis] <= place if side == 0 else index[:, axis] >= place
                index[over, axis] = place
                vertex_plane[over] |= 1 << (2 * axis + side)
    points = volume.to_lps(index)
    return Isosurface(
        points, outward(points, faces.astype(np.int64)), vertex_plane, _plane_normals(volume), filled * volume.voxel_ml
    )


def lumen_field(volume: Volume, region: Region) -> tuple[NDArray[np.float32], int]:
    """HU to the nearer limit over the region's box, positive exactly inside, and the number of void voxels filled.

    Away from the wall, where no triangle comes from it, the field is 1 or -1.
    """
    inside = region.filled
    band = _beside_wall(inside)
    upper = tuple(lo + n for lo, n in zip(region.lower, region.mask.shape, strict=True))
    hu = smoothed_box(volume, region.lower, upper, smoothing=region.smoothing, among=band)
    # Growing compares in eighths of a HU; half a step puts the limit between two of them.
    half = 0.5 / STEPS_PER_HU
    gaps = []
    if region.hu_max < HU_HIGHEST:
        gaps.append(region.hu_max + half - hu)
    if region.wall_limits is not None:
        gaps.append(hu - region.wall_limits[band])
    elif region.hu_min > HU_LOWEST:
        gaps.append(hu - region.hu_min + half)
    gap = np.abs(np.min(gaps, axis=0)) if gaps else np.ones(len(hu))
    skin = inside & ~_each_with_faces(inside, np.logical_and)
    clear = CLEAR * 2.0 * float(np.median(gap[skin[band]]))
    gap = np.maximum(gap, max(clear, 1e-6))
    field = np.where(inside, np.float32(1.0), np.float32(-1.0))
    field[band] = np.where(inside[band], gap, -gap)
    return field, int(np.count_nonzero(inside) - np.count_nonzero(region.mask))


def _beside_wall(inside: BoolArray) -> BoolArray:
    """Corners of the cubes that the wall passes through: voxels with one on its other side among their 26 neighbours."""
    some, all_ = inside, inside
    for axis in range(3):
        some, all_ = (_each_with_neighbours(part, axis, op) for part, op in ((some, np.logical_or), (all_, np.logical_and)))
    return some & ~all_


def _each_with_faces(mask: BoolArray, op: np.ufunc) -> BoolArray:
    """Each voxel and its six face neighbours in the array, joined by a logical function."""
    found = mask
    for axis in range(3):
        found = op(found, _each_with_neighbours(mask, axis, op))
    return found


def _each_with_neighbours(mask: BoolArray, axis: int, op: np.ufunc) -> BoolArray:
    """Each voxel and its two neighbours along one axis in the array, joined by a logical function."""
    found = mask.copy()
    one, other = (np.moveaxis(part, axis, 0) for part in (found, mask))
    op(one[1:], other[:-1], out=one[1:])
    op(one[:-1], other[1:], out=one[:-1])
    return found


def outward(vertices: FloatArray, faces: IntArray) -> IntArray:
    """The faces turned, all or none, so that the enclosed volume is positive."""
    return faces if signed_volume(vertices, faces) >= 0 else np.ascontiguousarray(faces[:, ::-1])


def signed_volume(vertices: FloatArray, faces: IntArray) -> float:
    """Enclosed volume in mm^3, negative when the faces look inward."""
    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def _reaches(mask: BoolArray, at_border: BoolArray, *, first: bool) -> BoolArray:
    """For each axis: the box ends at the image's border there and the mask has voxels in that layer."""
    place = 0 if first else -1
    return np.array([bool(at) and bool(mask.take(place, axis=axis).any()) for axis, at in enumerate(at_border)])


def _plane_normals(volume: Volume) -> FloatArray:
    """Outward unit normals of the image's six faces in LPS, (6, 3)."""
    # The gradient of index k in LPS is row k of the inverse matrix; for a sheared image it is not its axis.
    gradients = volume.lps_to_index[:3, :3]
    units = gradients / np.linalg.norm(gradients, axis=1, keepdims=True)
    return np.array([sign * units[axis] for axis in range(len(FACES)) for sign in (-1.0, 1.0)])
