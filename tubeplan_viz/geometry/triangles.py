"""Sets of triangles that answer which of them are near, and where on them the nearest point lies."""

from __future__ import annotations

from functools import cached_property
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray

# Samples of a long face for the search of likely neighbours; finer than this share of the
# median face changes no answer and only costs memory.
SAMPLES_PER_FACE = 64
# Point-face pairs per pass: the temporaries stay in the cache.
PAIRS_AT_ONCE = 8192


class Triangles:
    """Triangles (m, 3, 3) mm with search trees over their bounding spheres.

    # Strategy: faces are sorted into classes of like size, each with a tree of its
    # faces' centres, so that a few long thin faces do not widen the search among the
    # many small ones. Every triangle within a distance is found; none is missed.
    """

    def __init__(self, corners: FloatArray) -> None:
        self._origin = np.ascontiguousarray(corners[:, 0])
        self._first = corners[:, 1] - corners[:, 0]
        self._second = corners[:, 2] - corners[:, 0]
        self._ff = _dot(self._first, self._first)
        self._fs = _dot(self._first, self._second)
        self._ss = _dot(self._second, self._second)
        self._centers = corners.mean(axis=1)
        self._radii = np.linalg.norm(corners - self._centers[:, None], axis=2).max(axis=1)

    def __len__(self) -> int:
        return len(self._origin)

    @cached_property
    def _classes(self) -> list[tuple[IntArray, float, cKDTree]]:
        size = np.ceil(2.0 * np.log2(np.maximum(self._radii, 1e-6))).astype(int)
        # Classes smaller than the median are searched together: their spheres widen nothing.
        size = np.maximum(size, int(np.median(size)))
        groups = [np.flatnonzero(size == value) for value in np.unique(size)]
        return [(group, float(self._radii[group].max()), cKDTree(self._centers[group])) for group in groups]

    @cached_property
    def _samples(self) -> tuple[IntArray, cKDTree]:
        """Face of each sample, and the samples' tree: centres, and a lattice of three points or more on each face."""
        median = float(np.median(self._radii))
        faces, points = [np.arange(len(self))], [self._centers]
        count = np.clip(np.ceil(self._radii / max(0.6 * median, 1e-9)), 1, np.sqrt(2.0 * SAMPLES_PER_FACE)).astype(int)
        for n in np.unique(count[count > 1]):
            i, j = (grid.ravel() for grid in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
            i, j = (axis[i + j < n] for axis in (i, j))
            own = np.flatnonzero(count == n)
            s, t = (i + 1.0 / 3.0) / n, (j + 1.0 / 3.0) / n
            lattice = self._origin[own, None] + s[:, None] * self._first[own, None] + t[:, None] * self._second[own, None]
            faces.append(np.repeat(own, len(s)))
            points.append(lattice.reshape(-1, 3))
        return np.concatenate(faces), cKDTree(np.concatenate(points))

    def closest(self, points: FloatArray, faces: IntArray) -> FloatArray:
        """Nearest point of the i-th face to the i-th point, (k, 3) mm, exact."""
        if len(points) > PAIRS_AT_ONCE:
            blocks = [slice(i, i + PAIRS_AT_ONCE) for i in range(0, len(points), PAIRS_AT_ONCE)]
            return np.concatenate([self.closest(points[block], faces[block]) for block in blocks])
        offset = points - self._origin[faces]
        first, second = self._first[faces], self._second[faces]
        ff, fs, ss = self._ff[faces], self._fs[faces], self._ss[faces]
        fp, sp = _dot(offset, first), _dot(offset, second)
        size = ff * ss - fs * fs
        with np.errstate(divide="ignore", invalid="ignore"):
            s, t = (ss * fp - fs * sp) / size, (ff * sp - fs * fp) / size
            inside = (size > 0.0) & (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
            along_first = np.clip(np.where(ff > 0.0, fp / ff, 0.0), 0.0, 1.0)
            along_second = np.clip(np.where(ss > 0.0, sp / ss, 0.0), 0.0, 1.0)
            third = ff - 2.0 * fs + ss
            along_third = np.clip(np.where(third > 0.0, (sp - fp + ff - fs) / third, 0.0), 0.0, 1.0)
        zero = np.zeros(len(points))
        options = ((along_first, zero), (zero, along_second), (1.0 - along_third, along_third))
        # |offset - s first - t second|^2 without its constant: enough to choose the nearest edge.
        cost = np.stack([s_ * (s_ * ff + 2.0 * t_ * fs - 2.0 * fp) + t_ * (t_ * ss - 2.0 * sp) for s_, t_ in options])
        best = np.argmin(cost, axis=0)
        s = np.where(inside, s, np.choose(best, [option[0] for option in options]))
        t = np.where(inside, t, np.choose(best, [option[1] for option in options]))
        return np.asarray(self._origin[faces] + s[:, None] * first + t[:, None] * second)

    def ahead(self, points: FloatArray, faces: IntArray) -> FloatArray:
        """Height of each of the points (k, c, 3) over the plane of the i-th face, on the side of its normal, (k, c) mm."""
        normal = np.cross(self._first[faces], self._second[faces])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        return np.asarray(np.einsum("kci,ki->kc", points - self._origin[faces, None], normal))

    def within(self, points: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
        """Pairs (row of a point, face) that hold every face nearer to the i-th point than reach[i] mm, and some farther ones."""
        rows, faces = [], []
        for group, radius, tree in self._classes:
            found = tree.query_ball_point(points, reach + radius, return_sorted=False)
            counts = np.fromiter((len(f) for f in found), dtype=np.int64, count=len(found))
            row = np.repeat(np.arange(len(points)), counts)
            face = group[np.fromiter(chain.from_iterable(found), dtype=np.int64, count=int(counts.sum()))]
            gap = np.linalg.norm(points[row] - self._centers[face], axis=1)
            keep = gap - self._radii[face] <= reach[row]
            rows.append(row[keep])
            faces.append(face[keep])
        return np.concatenate(rows), np.concatenate(faces)

    def likely_nearest(self, points: FloatArray, count: int = 1) -> IntArray:
        """Faces whose samples are nearest to each point, (k, count): wall near the point, not proved the nearest."""
        owner, tree = self._samples
        _, index = tree.query(points, k=range(1, min(count, tree.n) + 1))
        return np.asarray(owner[index], dtype=np.int64)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", a, b))
