"""Clearance by slices of the wall across the path (Dai 2024, algorithm 1)."""

from __future__ import annotations

import numpy as np

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
        self._corners = surface.vertices[faces]  # (m, 3, 3), in the order of the wall's triangles
        self._points: FloatArray | None = None
        self._distance: FloatArray = np.empty(0)

    def short_samples(self, curve: SplineCurve, u: FloatArray) -> tuple[IntArray, FloatArray]:
        """Indices of the samples with slice clearance below the limit, and those clearances in mm."""
        points = curve(u)
        suspects = self._nearer_than(self.limit, points)
        if not len(suspects):
            return suspects, np.empty(0)
        values = self._slices(points, suspects)
        short = values < self.limit
        return suspects[short], values[short]

    def outside(self, curve: SplineCurve, u: FloatArray) -> IntArray:
        """Indices of the samples that lie outside the lumen or on its wall."""
        return self._nearer_than(0.0, curve(u))

    def _nearer_than(self, threshold: float, points: FloatArray) -> IntArray:
        """Samples with a clearance of `threshold` or less; clearances known to be above it are not asked again."""
        if self._points is None or len(self._points) != len(points):
            self._distance = self.wall.clearance(points)
            self._points = points.copy()
        else:
            moved = np.linalg.norm(points - self._points, axis=1)
            doubtful = np.flatnonzero(self._distance - moved <= threshold)
            if len(doubtful):
                self._distance[doubtful] = self.wall.clearance(points[doubtful])
                self._points[doubtful] = points[doubtful]
        return np.flatnonzero(self._distance <= threshold)

    def _slices(self, points: FloatArray, samples: IntArray) -> FloatArray:
        """Slice clearance of the given samples, mm; at twice the limit and beyond it may read infinite."""
        middle, last = points[samples], len(points) - 1
        chords = [middle - points[np.maximum(samples - s, 0)] for s in range(1, self.pairs + 1)]
        chords += [points[np.minimum(samples + s, last)] - middle for s in range(1, self.pairs + 1)]
        # Only a mean of two matters that is below the limit, so neither may exceed twice the
        # limit. A contour is seldom much farther than the wall, so a near search comes first;
        # what it finds within its radius is final.
        far = np.full(len(samples), 2.0 * self.limit)
        near = np.minimum(1.25 * np.abs(self._distance[samples]) + 0.1, far)
        found = self._contours(middle, chords, near)  # (2 pairs, samples)
        again = np.flatnonzero((found > near).any(axis=0) & (near < far))
        if len(again):
            found[:, again] = self._contours(middle[again], [chord[again] for chord in chords], far[again])
        # At either end of the path one of the two chords is missing.
        found[[~chord.any(axis=1) for chord in chords]] = np.nan
        least = np.nanmean(found.reshape(2, self.pairs, -1), axis=0).min(axis=0)
        return np.where(self._distance[samples] <= 0, self._distance[samples], least)

    def _contours(self, points: FloatArray, chords: list[FloatArray], radii: FloatArray) -> FloatArray:
        """Distances (planes, points) to the wall's contours, from the faces that come nearer than `radii`."""
        owner, faces = self.wall.triangles.within(points, radii)
        if not len(owner):
            return np.full((len(chords), len(points)), np.inf)
        corners = self._corners[faces] - points[owner, None]  # (k, 3, 3)
        return np.array([contour_distances(corners, chord, owner) for chord in chords])


def contour_distances(corners: FloatArray, normals: FloatArray, owner: IntArray) -> FloatArray:
    """Least distance from the origin to where triangles cross a plane through it, for many planes.

    Parameters
    ----------
    corners : (k, 3, 3) float array, mm
        Triangles relative to their plane's point.
    normals : (m, 3) float array
        Of the planes, any length.
    owner : (k,) int array
        Plane that each triangle belongs to.

    Returns
    -------
    (m,) float array, mm
        Infinite where no triangle crosses.
    """
    least = np.full(len(normals), np.inf)
    side = np.einsum("kij,kj->ki", corners, normals[owner])  # (k, 3)
    above = side >= 0
    # Column by column: numpy's reductions along an axis of three take ten times as long.
    first, second, third = above.T
    crossing = (first | second | third) & ~(first & second & third)
    corners, side, above, owner = corners[crossing], side[crossing], above[crossing], owner[crossing]
    if not len(owner):
        return least
    # Bring the corner that is alone on its side to the front: two edges leave from it.
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    rows = np.arange(len(corners))
    apex, apex_side = corners[rows, alone], side[rows, alone]
    ends = []
    for k in (1, 2):
        other, other_side = corners[rows, (alone + k) % 3], side[rows, (alone + k) % 3]
        t = apex_side / (apex_side - other_side)
        ends.append(apex + t[:, None] * (other - apex))
    a, ab = ends[0], ends[1] - ends[0]
    square = np.maximum(np.einsum("ij,ij->i", ab, ab), 1e-300)
    t = np.clip(-np.einsum("ij,ij->i", a, ab) / square, 0.0, 1.0)
    np.minimum.at(least, owner, np.linalg.norm(a + t[:, None] * ab, axis=1))
    return least
