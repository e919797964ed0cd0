"""Exact distance to the wall and inside-ness, by other means than the planners'."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray

BATCH = 24  # consecutive samples, at most this many and this near the first, share one list of candidate faces
BATCH_REACH_MM = 1.0
PAIRS_AT_ONCE = 40_000  # point-triangle pairs per pass: the temporaries stay in the cache
NORMAL_TRUSTED = 1e-4  # twice the area over the radius squared: the normal of a thinner face is uncertain by over 1e-12
NEEDLE = 1e-8  # the same: a thinner face is measured as its three edges, which is off by 1e-8 of its length at most
PRUNING_SLACK = 1e-9  # mm^2 at 1 mm: rounding must not drop the nearest face
SOLID_ANGLES_AT_ONCE = 200_000


@dataclass(frozen=True, eq=False)
class Triangles:
    """A set of triangles, (m, 3, 3) mm, that answers exact distances.

    # Strategy: faces are sorted into classes of like size, each with a tree of its faces' centres. The
    # distance to any one face bounds the answer from above; a face whose centre is farther than that
    # bound plus its own radius cannot be nearer. Nor can one whose plane is at the distance h while the
    # foot on it is at l from the centre, if h^2 + (l - radius)^2 exceeds the bound's square: in a round tube
    # that leaves a narrow ring. What is left is measured exactly. Classes keep a few long thin faces from
    # widening the search among the many small ones.
    """

    corners: FloatArray

    @cached_property
    def _centers(self) -> FloatArray:
        return np.asarray(self.corners.mean(axis=1))

    @cached_property
    def _radii(self) -> FloatArray:
        return np.asarray(np.linalg.norm(self.corners - self._centers[:, None], axis=2).max(axis=1))

    @cached_property
    def _normals(self) -> FloatArray:
        cross = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        size = np.linalg.norm(cross, axis=1, keepdims=True)
        # Without a trustworthy normal a face keeps the zero vector, and is pruned by its centre alone.
        return np.divide(cross, size, out=np.zeros_like(cross), where=size > NORMAL_TRUSTED * self._radii[:, None] ** 2)

    @cached_property
    def _classes(self) -> list[tuple[IntArray, float, cKDTree]]:
        size = np.ceil(2.0 * np.log2(np.maximum(self._radii, 1e-9))).astype(int)
        groups = [np.flatnonzero(size == value) for value in np.unique(size)]
        return [(group, float(self._radii[group].max()), cKDTree(self._centers[group])) for group in groups]

    @cached_property
    def _center_tree(self) -> cKDTree:
        return cKDTree(self._centers)

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance of each point to the nearest triangle, (k,) mm; infinite if there is no triangle.

        Fast when consecutive points are near each other, as along a path.
        """
        if len(self.corners) == 0:
            return np.full(len(points), np.inf)
        nearest = np.asarray(self._center_tree.query(points)[1])
        best = point_triangle_distance(points, self.corners[nearest])
        first = 0
        while first < len(points):
            far = np.linalg.norm(points[first : first + BATCH] - points[first], axis=1) > BATCH_REACH_MM
            rows = slice(first, first + (int(far.argmax()) if far.any() else len(far)))
            best[rows] = self._refine(points[rows], best[rows])
            first = rows.stop
        return best

    def _refine(self, points: FloatArray, bound: FloatArray) -> FloatArray:
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        spread = np.linalg.norm(points - middle, axis=1)
        found = [
            group[tree.query_ball_point(middle, float((bound + spread).max()) + radius, return_sorted=False)]
            for group, radius, tree in self._classes
        ]
        faces = np.concatenate(found).astype(np.int64)
        local, centers, normals = points - middle, self._centers[faces] - middle, self._normals[faces]
        away = _dot(local, local)[:, None] + _dot(centers, centers) - 2.0 * local @ centers.T
        height = (local @ normals.T - _dot(centers, normals)) ** 2
        beside = np.sqrt(np.maximum(away - height, 0.0)) - self._radii[faces]
        square = bound[:, None] ** 2
        rows, columns = np.nonzero(height + np.maximum(beside, 0.0) ** 2 <= square + PRUNING_SLACK * (1.0 + square))
        best = bound.copy()
        for start in range(0, len(rows), PAIRS_AT_ONCE):
            row, column = rows[start : start + PAIRS_AT_ONCE], columns[start : start + PAIRS_AT_ONCE]
            np.minimum.at(best, row, point_triangle_distance(points[row], self.corners[faces[column]]))
        return best


def point_triangle_distance(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Distance of the i-th point, (k, 3), to the i-th triangle, (k, 3, 3): (k,) mm.

    The distance to the triangle's plane where the foot of the perpendicular is inside
    the triangle, otherwise that to the nearest edge. A triangle without area is its edges.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    square = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, to_point = end - start, points - start
        length = _dot(edge, edge)
        share = np.clip(_dot(to_point, edge) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
        rest = to_point - share[:, None] * edge
        square = np.minimum(square, _dot(rest, rest))
    first, second, to_point = b - a, c - a, points - a
    normal = np.cross(first, second)
    size = _dot(normal, normal)
    ff, fs, ss, fp, sp = (
        _dot(x, y) for x, y in ((first, first), (first, second), (second, second), (first, to_point), (second, to_point))
    )
    along_first, along_second = ss * fp - fs * sp, ff * sp - fs * fp  # barycentric, times the area's square
    inside = (
        (size > (NEEDLE * (ff + ss)) ** 2) & (along_first >= 0.0) & (along_second >= 0.0) & (along_first + along_second <= size)
    )
    return np.sqrt(np.where(inside, _dot(to_point, normal) ** 2 / np.where(size > 0.0, size, 1.0), square))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def winding_number(points: FloatArray, corners: FloatArray) -> FloatArray:
    """How often the closed surface of (m, 3, 3) triangles winds around each point, (k,): 1 inside, 0 outside.

    Sum of the triangles' solid angles over 4 pi [1]_.

    References
    ----------
    .. [1] Van Oosterom, A. and Strackee, J. (1983). The solid angle of a plane triangle.
       IEEE Transactions on Biomedical Engineering, 30(2), 125-126.
    """
    total = np.zeros(len(points))
    block = max(SOLID_ANGLES_AT_ONCE // max(len(corners), 1), 1)
    for first in range(0, len(points), block):
        rows = slice(first, first + block)
        a, b, c = (corners[None, :, k] - points[rows, None] for k in range(3))
        la, lb, lc = (np.sqrt(np.einsum("kmi,kmi->km", v, v)) for v in (a, b, c))
        triple = np.einsum("kmi,kmi->km", a, np.cross(b, c))
        below = (
            la * lb * lc
            + np.einsum("kmi,kmi->km", a, b) * lc
            + np.einsum("kmi,kmi->km", b, c) * la
            + np.einsum("kmi,kmi->km", c, a) * lb
        )
        total[rows] = np.arctan2(triple, below).sum(axis=1) / (2.0 * np.pi)
    return total


@dataclass(frozen=True, eq=False)
class Lumen:
    """The closed surface of a run, told apart into what counts as wall and what does not.

    Attributes
    ----------
    wall, ends : Triangles
        Faces that count for clearance, and the end caps that do not.
    """

    wall: Triangles
    ends: Triangles

    @cached_property
    def _all(self) -> FloatArray:
        return np.concatenate([self.wall.corners, self.ends.corners])

    def clearance(self, points: FloatArray, *, on_surface: float) -> tuple[FloatArray, BoolArray]:
        """Signed distance to the wall, (k,) mm, negative outside; and which points are inside the lumen.

        Points within `on_surface` mm of the closed surface count as inside: a path begins and ends on caps.
        Between two points that are farther apart than neither is from the surface lies no
        wall, so one winding number serves all points of such a chain.
        """
        to_wall, to_ends = self.wall.distance(points), self.ends.distance(points)
        free = np.minimum(to_wall, to_ends)
        step = np.linalg.norm(np.diff(points, axis=0), axis=1)
        joined = step < np.maximum(free[1:], free[:-1])  # the segment stays inside a ball that holds no surface
        chain = np.concatenate([[0], np.cumsum(~joined)])
        order = np.lexsort((-free, chain))  # the point of a chain that is farthest from the surface speaks for it
        speakers = order[np.searchsorted(chain[order], np.arange(chain[-1] + 1))]
        inside = winding_number(points[speakers], self._all)[chain] > 0.5
        inside |= free <= on_surface
        return np.where(inside, to_wall, -to_wall), inside
