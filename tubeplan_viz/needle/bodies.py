"""What a needle must keep away from: spheres, capsules, polygons, meshes and label volumes, each with its signed distance.

Spheres and polygons also have closed formulas against arcs and lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray, frozen_array
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from segmentation.volume import Volume
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.needle.arc_distance import STRAIGHT, angle_on, arc_distance, on_arc
from tubeplan_viz.needle.kinematics import Arcs

ROUNDING = 1e-9  # mm by which a crossing may lie beyond an edge's ends
FINE_VOXELS = 8_000_000  # of a label volume whose field has half its spacing: 64 million values, 1.5 GB while it is made
NEIGHBOURS = 16  # voxels among which the nearest box usually is


class Obstacle(Protocol):
    """A body to keep away from."""

    @property
    def kind(self) -> str:
        """As in the case file."""

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm, of (..., 3) points, negative inside; never more than the true one."""


@dataclass(frozen=True, eq=False)
class Sphere:
    """A ball, or a circle where the path stays in the plane x = 0. `center` (3,) and `radius` in mm."""

    center: FloatArray
    radius: float
    kind: str = "sphere"

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", frozen_array(self.center, (3,), "center"))
        check_radius(self.kind, self.radius)

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm."""
        return np.asarray(np.linalg.norm(points - self.center, axis=-1) - self.radius)


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` of a polyline: a vessel, a rib. `points` (n, 3) in mm, n >= 2."""

    points: FloatArray
    radius: float
    kind: str = "capsule"

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_array(self.points, (None, 3), "points"))
        if len(self.points) < 2:
            raise CaseError(f"a capsule has {len(self.points)} point, expected two or more; one point is a sphere")
        check_radius(self.kind, self.radius)

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm."""
        return segment_distance(points, self.points[:-1], self.points[1:]).min(axis=-1) - self.radius


@dataclass(frozen=True, eq=False)
class Polygon:
    """An area of the plane x = 0, or the prism along x over it. `corners` (n, 2): y, z in mm, in order, not crossing."""

    corners: FloatArray
    kind: str = "polygon"

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners", frozen_array(self.corners, (None, 2), "points"))
        if len(self.corners) < 3:
            raise CaseError(f"a polygon has {len(self.corners)} corners, expected three or more")
        if abs(self.area) < 1e-9:
            raise CaseError("a polygon has no area; expected corners in order around it")

    @property
    def area(self) -> float:
        """Signed area, mm2."""
        y, z = self.corners.T
        return float(0.5 * (y * np.roll(z, -1) - np.roll(y, -1) * z).sum())

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm, in the plane."""
        flat = points[..., 1:]
        first, second = self.corners, np.roll(self.corners, -1, axis=0)
        gap = segment_distance(flat, first, second).min(axis=-1)
        y, z = flat[..., None, 0], flat[..., None, 1]
        crosses = (first[:, 1] > z) != (second[:, 1] > z)
        rise = np.where(second[:, 1] == first[:, 1], 1.0, second[:, 1] - first[:, 1])
        at = first[:, 0] + (z - first[:, 1]) * (second[:, 0] - first[:, 0]) / rise
        inside = np.count_nonzero(crosses & (y < at), axis=-1) % 2 == 1
        return np.where(inside, -gap, gap)

    def arc_gaps(self, arcs: Arcs) -> FloatArray:
        """Exact distance, mm, of pieces in the plane x = 0, (..., n); below 0 where one goes through the polygon.

        An arc and an edge are nearest at a corner, at an end of the arc, or where the circle's radius meets the
        edge at a right angle; or they cross. Of one that crosses, the depth is that at the deepest middle of the stretches
        between its crossings.
        """
        corners = np.column_stack([np.zeros(len(self.corners)), self.corners])
        edge = np.roll(corners, -1, axis=0) - corners
        size = np.linalg.norm(edge, axis=1)
        along = edge / size[:, None]
        across = np.cross(along, [1.0, 0.0, 0.0])
        start, end = self.distance(arcs.starts), self.distance(arcs.ends)
        gap = np.minimum(np.minimum(start, end), arc_distance(arcs, corners).min(axis=-1))
        bent = arcs.curvatures[..., None] > STRAIGHT
        radius = 1.0 / np.maximum(arcs.curvatures, STRAIGHT)[..., None]
        center = np.where(bent, arcs.starts + radius * arcs.normals, arcs.starts)[..., None, :]  # (..., n, 1, 3)
        height = np.einsum("...md,md->...m", center - corners, across)
        foot = np.einsum("...md,md->...m", center - corners, along)
        touch = np.abs(height) - radius
        beside = bent & (touch >= 0.0) & (foot >= 0.0) & (foot <= size)
        inward = -np.sign(height)[..., None] * across  # from the centre to the edge
        gap = np.minimum(gap, np.where(beside & on_arc(arcs, inward), touch, np.inf).min(axis=-1))
        whole = arcs.lengths[..., None]
        half = np.sqrt(np.maximum(radius**2 - height**2, 0.0))
        reach = np.einsum("...d,md->...m", arcs.tangents, across)
        ahead = -height / np.where(np.abs(reach) < 1e-300, 1e-300, reach)
        at = foot + ahead * np.einsum("...d,md->...m", arcs.tangents, along)
        crossings = [(~bent & (ahead >= 0.0), ahead, at)]
        for at in (foot + half, foot - half):
            way = angle_on(arcs, corners + at[..., None] * along - center) * radius
            crossings.append((bent & (touch < 0.0), way, at))
        # A path through a corner can miss both edges by rounding: what lies between is asked, so that too many do no harm.
        ways = [
            np.where(may & (way <= whole) & (at >= -ROUNDING) & (at <= size + ROUNDING), way, whole) for may, way, at in crossings
        ]
        depth = self.distance(arcs.points(middles(np.concatenate(ways, axis=-1), arcs.lengths))).min(axis=-1)
        met = np.any([may & (way <= whole) & (at >= 0.0) & (at <= size) for may, way, at in crossings], axis=(0, -1))
        return np.minimum(gap, np.where(met | (depth < 0.0), np.minimum(depth, 0.0), np.inf))


class MeshObstacle:
    """The inside of a closed surface; distances to its triangles are exact."""

    kind = "mesh"

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self._wall = WallDistance(surface, closed_ends=True)

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm."""
        return -self._wall.clearance(points.reshape(-1, 3)).reshape(points.shape[:-1])


class MaskObstacle:
    """The voxels of a label volume, each a box.

    `exact` asks the boxes themselves; a search asks the interpolated field of `distance`. Every value of the field is the
    distance to the nearest box, on a grid of half the voxels' spacing (for volumes over `FINE_VOXELS` it is that between voxel
    centres, off by half a diagonal). A distance changes by no more than the way walked, so interpolation adds half a
    diagonal of the field's cells at most; `bound` is what both add, and `distance` is less by so much.

    Parameters
    ----------
    mask : Volume
        Voxels above 0 are the obstacle.
    """

    kind = "mask"

    def __init__(self, mask: Volume) -> None:
        inside = np.asarray(mask.voxels) > 0
        if not inside.any():
            raise CaseError("a mask obstacle has no voxel above 0; expected a label volume in which the obstacle is marked")
        self.volume = mask
        spacing = np.asarray(mask.spacing)
        self._halves = 2 if inside.size <= FINE_VOXELS else 1
        step = spacing / self._halves
        diagonal = float(np.linalg.norm(step))
        self.bound = 0.5 * diagonal if self._halves == 2 else diagonal
        boxes = inside
        if self._halves == 2:  # voxel i takes the places 2 i to 2 i + 2: its faces and its middle
            boxes = np.zeros(2 * np.array(inside.shape) + 1, dtype=bool)
            for shift in np.ndindex(3, 3, 3):
                boxes[tuple(slice(o, o + 2 * n, 2) for o, n in zip(shift, inside.shape, strict=True))] |= inside
        outside = ndimage.distance_transform_edt(~boxes, sampling=tuple(step))
        within = ndimage.distance_transform_edt(boxes, sampling=tuple(step))
        self._field = np.asarray(outside - within, dtype=np.float32)

    def rim(self) -> FloatArray:
        """Centres, mm, (k, 3), of the obstacle's voxels that touch another one."""
        return self.volume.to_lps(self._rim_indices)

    @cached_property
    def _rim_indices(self) -> IntArray:
        inside = np.asarray(self.volume.voxels) > 0
        return np.argwhere(inside & ~ndimage.binary_erosion(inside))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._rim_indices * np.asarray(self.volume.spacing))

    def exact(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm, of (..., 3) points to the voxels' boxes; within them the field's."""
        flat = points.reshape(-1, 3)
        spacing = np.asarray(self.volume.spacing)
        here = self.volume.to_index(flat) * spacing
        centers: FloatArray = self._tree.data
        count = min(NEIGHBOURS, len(centers))
        far, near = self._tree.query(here, k=list(range(1, count + 1)))
        gaps = np.linalg.norm(np.maximum(np.abs(centers[near] - here[:, None]) - 0.5 * spacing, 0.0), axis=-1).min(axis=1)
        # A box is nearer than its centre by half a diagonal at most: where that leaves a doubt, all that could be nearest.
        reach = gaps + 0.5 * float(np.linalg.norm(spacing))
        for k in np.flatnonzero(far[:, -1] < reach) if count < len(centers) else ():
            boxes = centers[self._tree.query_ball_point(here[k], reach[k])]
            gaps[k] = np.linalg.norm(np.maximum(np.abs(boxes - here[k]) - 0.5 * spacing, 0.0), axis=1).min()
        index = np.rint(here / spacing).astype(int)
        held = np.clip(index, 0, np.array(self.volume.voxels.shape) - 1)
        deep = (np.asarray(self.volume.voxels)[tuple(held.T)] > 0) & (held == index).all(axis=1)
        gaps[deep] = np.minimum(self.distance(flat[deep]), 0.0)
        return np.asarray(gaps.reshape(points.shape[:-1]))

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm, less its error bound; outside the volume that of the nearest voxel within, plus the way to it."""
        flat = points.reshape(-1, 3)
        spacing = np.asarray(self.volume.spacing)
        place = self._halves * self.volume.to_index(flat) + (self._halves - 1)
        held = np.clip(place, 0.0, np.array(self._field.shape) - 1.0)
        value = ndimage.map_coordinates(self._field, held.T, order=1, mode="nearest").astype(float)
        beyond = np.linalg.norm((place - held) * spacing / self._halves, axis=1)
        # Beyond the volume's faces nothing is known; the obstacle is taken to end with the image.
        return np.asarray(np.maximum(value - self.bound, beyond - self.bound) if beyond.any() else value - self.bound).reshape(
            points.shape[:-1]
        )


def middles(ways: FloatArray, length: FloatArray) -> FloatArray:
    """Middles, mm, (..., k + 1), of the stretches into which k places, mm, (..., k), part pieces of given lengths, (...)."""
    ends = np.concatenate([np.zeros((*length.shape, 1)), np.sort(ways, axis=-1), length[..., None]], axis=-1)
    return np.asarray(0.5 * (ends[..., :-1] + ends[..., 1:]))


def check_radius(kind: str, radius: float) -> None:
    """Refuse a radius that is none."""
    if not 0.0 < radius <= 1000.0:
        raise CaseError(f"a {kind} obstacle has radius_mm {radius:g}, expected more than 0 and at most 1000")


def segment_distance(points: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Distance, mm, of (..., d) points to each of m segments, (m, d) ends: (..., m)."""
    way = second - first
    square = np.maximum(np.einsum("md,md->m", way, way), 1e-300)
    off = points[..., None, :] - first
    share = np.clip(np.einsum("...md,md->...m", off, way) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(off - share[..., None] * way, axis=-1))


def exact_distance(body: Obstacle, points: FloatArray) -> FloatArray:
    """Signed distance, mm, of (..., 3) points to a body, without what a label volume's field keeps back for its error bound."""
    return body.exact(points) if isinstance(body, MaskObstacle) else body.distance(points)


def body_distance(body: Obstacle, points: FloatArray) -> FloatArray:
    """As `exact_distance`, to the field's bound: for drawing, on many points."""
    return body.distance(points) + (body.bound if isinstance(body, MaskObstacle) else 0.0)
