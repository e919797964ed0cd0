"""Clearance by slices of the wall across the path (Dai 2024, algorithm 1)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray
from segmentation.mesh import Surface
from tubeplan_viz.geometry import SplineCurve, WallDistance


class SliceClearance:
    """Finds the samples of a curve whose slice clearance falls short of a limit.

    For a sample F(u_i) and s = 1..sigma, two planes go through it, perpendicular to the
    chords from F(u_i - s du) and to F(u_i + s du). The clearance is the mean of the least
    distances to the two contours, least over s. Caps leave no contour: they are not wall.

    A contour is part of the wall, so a slice distance is never below the exact distance,
    and that moves by no more than the sample does. Only samples that could fall short are
    sliced; the outcome is the same as slicing them all.

    Parameters
    ----------
    surface : Surface
    wall : WallDistance
        Of the same surface.
    limit : float, mm
        r_th.
    pairs : int
        sigma, pairs of slices per sample.
    """

    def __init__(self, surface: Surface, wall: WallDistance, *, limit: float, pairs: int = 2) -> None:
        self.wall, self.limit, self.pairs = wall, limit, pairs
        faces = surface.faces if wall.closed_ends else surface.wall_faces
        self._corners = surface.vertices[faces]  # (m, 3, 3)
        centers = self._corners.mean(axis=1)
        self._reach = float(np.linalg.norm(self._corners - centers[:, None], axis=2).max())
        self._tree = cKDTree(centers)
        self._points: FloatArray | None = None
        self._distance: FloatArray = np.empty(0)

    def short_samples(self, curve: SplineCurve, u: FloatArray) -> tuple[IntArray, FloatArray]:
        """Indices of the samples with slice clearance below the limit, and those clearances in mm."""
        points = curve(u)
        suspects = self._suspects(points)
        short, values = [], []
        for i in suspects:
            value = self._slice(points, int(i))
            if value < self.limit:
                short.append(int(i))
                values.append(value)
        return np.array(short, dtype=np.int64), np.array(values)

    def _suspects(self, points: FloatArray) -> IntArray:
        """Samples whose exact distance is below the limit; distances known to be above are not asked again."""
        if self._points is None or len(self._points) != len(points):
            self._distance = self.wall.clearance(points)
            self._points = points.copy()
        else:
            moved = np.linalg.norm(points - self._points, axis=1)
            doubtful = np.flatnonzero(self._distance - moved < self.limit)
            if len(doubtful):
                self._distance[doubtful] = self.wall.clearance(points[doubtful])
                self._points[doubtful] = points[doubtful]
        return np.flatnonzero(self._distance < self.limit)

    def _slice(self, points: FloatArray, i: int) -> float:
        if self._distance[i] <= 0:
            return float(self._distance[i])
        least = float("inf")
        # Only a mean of two matters that is below the limit, so neither may exceed twice the limit.
        near = self._corners[self._tree.query_ball_point(points[i], 2.0 * self.limit + self._reach)]
        for s in range(1, self.pairs + 1):
            sides = [points[i] - points[max(i - s, 0)], points[min(i + s, len(points) - 1)] - points[i]]
            distances = [contour_distance(points[i], normal, near) for normal in sides if np.any(normal)]
            least = min(least, float(np.mean(distances)))
        return least


def contour_distance(point: FloatArray, normal: FloatArray, corners: FloatArray) -> float:
    """Least distance from `point` to where triangles (m, 3, 3) cross the plane through it; inf if none does."""
    side = (corners - point) @ normal  # (m, 3)
    crossing = (side.min(axis=1) < 0) & (side.max(axis=1) >= 0)
    if not crossing.any():
        return float("inf")
    corners, side = corners[crossing], side[crossing]
    # Bring the corner that is alone on its side to the front: two edges leave from it.
    above = side >= 0
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    rows = np.arange(len(corners))
    apex, apex_side = corners[rows, alone], side[rows, alone]
    ends = []
    for k in (1, 2):
        other, other_side = corners[rows, (alone + k) % 3], side[rows, (alone + k) % 3]
        t = apex_side / (apex_side - other_side)
        ends.append(apex + t[:, None] * (other - apex))
    a, b = ends
    ab = b - a
    square = np.maximum(np.einsum("ij,ij->i", ab, ab), 1e-300)
    t = np.clip(np.einsum("ij,ij->i", point - a, ab) / square, 0.0, 1.0)
    return float(np.linalg.norm(a + t[:, None] * ab - point, axis=1).min())
