"""Cross-sections of a closed surface: how much room a plane finds around a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.mesh import Surface


@dataclass(frozen=True, eq=False, kw_only=True)
class Outline:
    """Outline of one cross-section, holes included, around a point.

    Attributes
    ----------
    start, end : (k, 2) float array, mm
        Ends of its segments from the point, in the plane's axes; the inside is on the left.
    plane : (2, 3) float array
        Unit vectors of the plane's axes.
    """

    start: FloatArray
    end: FloatArray
    plane: FloatArray

    @property
    def area(self) -> float:
        """Enclosed area, mm^2."""
        return float(0.5 * (self.start[:, 0] * self.end[:, 1] - self.start[:, 1] * self.end[:, 0]).sum())

    def radii(self, angles: FloatArray) -> FloatArray:
        """Distance from the point to the first segment, (n,) mm, at angles in rad from the plane's first axis."""
        heading = np.column_stack([np.cos(angles), np.sin(angles)])  # (n, 2)
        along = self.end - self.start
        # Ray r h meets the segment a + t (b - a): r = cross(a, b - a) / cross(h, b - a), t = cross(a, h) / cross(h, b - a).
        below = heading[:, :1] * along[:, 1] - heading[:, 1:] * along[:, 0]  # (n, k)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (self.start[:, 0] * along[:, 1] - self.start[:, 1] * along[:, 0]) / below
            share = (self.start[:, 0] * heading[:, 1:] - self.start[:, 1] * heading[:, :1]) / below
        met = (share >= -1e-9) & (share <= 1.0 + 1e-9) & (reach > 0.0)
        return np.asarray(np.where(met, reach, np.inf).min(axis=1))


class SurfaceSections:
    """Areas of the cross-sections of one surface, caps included, so that every section is closed.

    Parameters
    ----------
    surface : Surface
    reach : float, mm
        A section that goes farther than this from its point is not measured.
    """

    def __init__(self, surface: Surface, *, reach: float = 40.0) -> None:
        self.surface = surface
        self._vertices, self._faces = surface.vertices, surface.faces
        corners = surface.vertices[surface.faces]
        centers = corners.mean(axis=1)
        self._size = float(np.linalg.norm(corners - centers[:, None], axis=2).max())
        self._tree = cKDTree(centers)
        self._reach = reach

    def outline(self, point: FloatArray, normal: FloatArray) -> Outline | None:
        """The part of the section with the plane through `point` that holds the point.

        Parameters
        ----------
        point : (3,) float array, mm
            Inside the surface.
        normal : (3,) float array
            Of the plane, any length.

        Returns
        -------
        Outline or None
            None where no closed outline within `reach` goes around the point.
        """
        axis = normal / np.linalg.norm(normal)
        first = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first)
        plane = np.stack([first, np.cross(axis, first)])
        # The outline is mostly near: a small search first, a wider one where the outline leaves it.
        for radius in (0.2 * self._reach, self._reach):
            near = np.array(self._tree.query_ball_point(point, radius + self._size), dtype=np.int64)
            if not len(near):
                continue
            start, end, edges = self._segments(near, point, axis, plane)
            if not len(edges):
                continue
            # What a plane cuts out of a closed surface is closed, unless the search has cut it off.
            closed, label = outlines(edges)
            kept = enclosing(start, end, label, closed)
            if kept is not None:
                return Outline(start=start[kept], end=end[kept], plane=plane)
        return None

    def diameter(self, point: FloatArray, normal: FloatArray) -> float | None:
        """Diameter in mm of the circle of the section's area, or None as for `outline`."""
        found = self.outline(point, normal)
        return None if found is None else float(np.sqrt(4.0 * found.area / np.pi))

    def _segments(
        self, near: IntArray, point: FloatArray, axis: FloatArray, plane: FloatArray
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Where triangles cross the plane: ends in plane coordinates, (k, 2) mm each, and the mesh edges they lie on, (k, 2).

        Seen against `axis` the inside is on the left of each segment.
        """
        faces = self._faces[near]
        side = (self._vertices[faces] - point) @ axis  # (m, 3)
        above = side >= 0.0
        crossing = above.any(axis=1) & ~above.all(axis=1)
        faces, side, above = faces[crossing], side[crossing], above[crossing]
        rows = np.arange(len(faces))
        alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
        ends, edges = [], []
        for step in (1, 2):
            other = (alone + step) % 3
            a, b = faces[rows, alone], faces[rows, other]
            # The same edge must give the same point from both its faces, to the last digit.
            low, high = np.minimum(a, b), np.maximum(a, b)
            low_side, high_side = ((self._vertices[k] - point) @ axis for k in (low, high))
            share = low_side / (low_side - high_side)
            place = self._vertices[low] + share[:, None] * (self._vertices[high] - self._vertices[low])
            ends.append((place - point) @ plane.T)
            edges.append(low * len(self._vertices) + high)
        # With the lone corner above, the cut runs from its first edge to its second.
        flip = ~above[rows, alone]
        start = np.where(flip[:, None], ends[1], ends[0])
        end = np.where(flip[:, None], ends[0], ends[1])
        return start, end, np.column_stack(edges)


def outlines(edges: IntArray) -> tuple[BoolArray, IntArray]:
    """For each outline whether it is closed, and for each segment the number of its outline."""
    names, node = np.unique(edges, return_inverse=True)
    node = node.reshape(edges.shape)
    count, parts = connected_components(
        coo_matrix((np.ones(len(edges)), (node[:, 0], node[:, 1])), shape=(len(names), len(names))), directed=False
    )
    degree = np.bincount(node.ravel(), minlength=len(names))
    closed = np.ones(count, dtype=bool)
    closed[parts[degree != 2]] = False
    return closed, parts[node[:, 0]]


def winding(start: FloatArray, end: FloatArray, label: IntArray, count: int) -> FloatArray:
    """How often each outline goes around the origin, (count,)."""
    turn = np.arctan2(start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0], np.einsum("ij,ij->i", start, end))
    return np.asarray(np.bincount(label, turn, count) / (2.0 * np.pi))


def enclosing(start: FloatArray, end: FloatArray, label: IntArray, closed: BoolArray) -> BoolArray | None:
    """Segments of the innermost outline around the origin and of the holes inside it; None without such an outline."""
    areas = 0.5 * np.bincount(label, start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0], len(closed))
    around = np.abs(winding(start, end, label, len(closed))) > 0.5
    holding = np.flatnonzero(closed & around & (areas > 0.0))
    if not len(holding):
        return None
    outer = int(holding[np.argmin(areas[holding])])
    rim = label == outer
    kept = rim.copy()
    for hole in np.flatnonzero(closed & (areas < 0.0)):
        place = start[label == hole][0]
        if abs(winding(start[rim] - place, end[rim] - place, np.zeros(np.count_nonzero(rim), dtype=np.int64), 1)[0]) > 0.5:
            kept |= label == hole
    return kept
