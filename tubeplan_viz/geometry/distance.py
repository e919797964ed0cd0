"""Exact distance from points to the wall, and which points are inside the lumen."""

from __future__ import annotations

from functools import cached_property

import igl
import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.mesh import Surface
from tubeplan_viz.geometry.triangles import Triangles

# A point on a cap lies on the closed surface, where the winding number is 1/2 and
# rounding decides; inside or outside by less than this is inside.
ON_SURFACE = 1e-6


class WallDistance:
    """Distance queries against one surface, its search trees built once.

    The wall is the surface without its end caps, which an instrument passes, unless `closed_ends`
    is set; inside-ness always refers to the closed surface. Distances to triangles
    are exact (libigl's AABB tree); inside-ness uses its fast winding number.

    Parameters
    ----------
    surface : Surface
    closed_ends : bool
        Count the caps as wall too.
    """

    def __init__(self, surface: Surface, *, closed_ends: bool = False) -> None:
        self.surface = surface
        self.closed_ends = closed_ends
        self._vertices = np.array(surface.vertices)
        self._faces = np.array(surface.faces)
        self._wall = self._faces if closed_ends else np.array(surface.wall_faces)
        self._wall_index = np.arange(len(self._faces)) if closed_ends else np.flatnonzero(surface.face_cap < 0)
        self._tree = igl.AABB()
        self._tree.init(self._vertices, self._wall)
        self._caps = self._faces[:0] if closed_ends else np.array(self._faces[surface.face_cap >= 0])
        self._cap_tree = igl.AABB()
        if len(self._caps):
            self._cap_tree.init(self._vertices, self._caps)
        self._winding = igl.FastWindingNumberBVH()
        self._winding.init(self._vertices, self._faces)

    @cached_property
    def triangles(self) -> Triangles:
        """The wall's faces as a set that lists all faces within a distance."""
        return Triangles(self._vertices[self._wall])

    @cached_property
    def openings(self) -> Triangles | None:
        """Faces of the caps that are not counted as wall, their normals out of the lumen; None without any."""
        return Triangles(self._vertices[self._caps]) if len(self._caps) else None

    def nearest(self, points: ArrayLike) -> tuple[FloatArray, IntArray, FloatArray]:
        """Unsigned distance, mm (k,), index of the nearest face of the surface (k,), and nearest wall point (k, 3)."""
        query = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=float)))
        square, face, foot = self._tree.squared_distance(self._vertices, self._wall, query)
        return np.sqrt(np.atleast_1d(square)), self._wall_index[np.atleast_1d(face)], np.atleast_2d(foot)

    def distance(self, points: ArrayLike) -> FloatArray:
        """Unsigned distance to the wall, mm, (k,)."""
        return self.nearest(points)[0]

    def cap_distance(self, points: ArrayLike) -> FloatArray:
        """Distance to the nearest cap that is not counted as wall, mm, (k,); infinite where there is none."""
        query = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=float)))
        if not len(self._caps):
            return np.full(len(query), np.inf)
        return np.sqrt(np.atleast_1d(self._cap_tree.squared_distance(self._vertices, self._caps, query)[0]))

    def inside(self, points: ArrayLike) -> BoolArray:
        """Whether each point lies in the lumen or within a micrometre of its closed surface, (k,)."""
        query = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=float)))
        inside = np.atleast_1d(self._winding.winding_number(query)) > 0.5
        if self.surface.caps and not inside.all():
            outside = np.flatnonzero(~inside)
            inside[outside] = np.minimum(self.distance(query[outside]), self.cap_distance(query[outside])) <= ON_SURFACE
        return np.asarray(inside, dtype=bool)

    def clearance(self, points: ArrayLike) -> FloatArray:
        """Signed distance to the wall, mm, (k,): negative outside the lumen."""
        query = np.atleast_2d(np.asarray(points, dtype=float))
        distance = self.distance(query)
        return np.where(self.inside(query), distance, -distance)
