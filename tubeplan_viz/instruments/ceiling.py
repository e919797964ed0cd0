"""The most clearance that any path from the start to each target can have: what proves that a thicker instrument cannot pass."""

# Strategy: the argument is that of `tube.bottleneck`: a path crosses a chain of Delaunay triangles of wall points, and on
# none of them can it keep more than the triangle's width. Here one triangulation and one tree of widest chains, rooted at
# the start, serve all targets, at the spacing of the mesh; a bottleneck asked for one limit is refined further there.

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse.csgraph import breadth_first_order
from scipy.spatial import Delaunay

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.tube.bottleneck import Bottleneck
from tubeplan_viz.tube.triangulation import JITTER, JITTER_BOUND, hoods, lattice, spanning_tree, triangle_widths

# A line that keeps this share of what its ends allow leaves nothing to search.
CLOSE = 0.97
CORNERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


class ClearanceCeiling:
    """Widest ways from one start, prepared once for all targets and only when one of them needs it.

    Parameters
    ----------
    wall : WallDistance
    start : (3,) float array, mm
        Inside the lumen.
    """

    def __init__(self, wall: WallDistance, start: FloatArray) -> None:
        self._wall = wall
        self._start = np.asarray(start, dtype=float)
        # No path has more clearance than its start, so that hoods need be no deeper.
        self._first = float(wall.distance(self._start)[0])

    @cached_property
    def _ways(self) -> WidestWays:
        return WidestWays(self._wall, self._start, depth=self._first)

    def to(self, goal: FloatArray, *, kept: float = 0.0) -> Bottleneck:
        """What no path from the start to `goal` surpasses, and where.

        Parameters
        ----------
        goal : (3,) float array, mm
        kept : float, mm
            Least clearance of a line that is known to lead there. Where the ends themselves allow hardly
            more, they are the answer and nothing is searched.
        """
        goal = np.asarray(goal, dtype=float)
        last = float(self._wall.distance(goal)[0])
        lowest = (
            Bottleneck(bound=self._first, place=self._start, end="start")
            if self._first <= last
            else Bottleneck(bound=last, place=goal, end="goal")
        )
        if kept >= CLOSE * lowest.bound:
            return lowest
        found = self._ways.narrowest(goal)
        return found if found is not None and found.bound < lowest.bound else lowest


class WidestWays:
    """The tree of widest chains of tetrahedra from one start.

    Parameters
    ----------
    wall : WallDistance
    start : (3,) float array, mm
    depth : float, mm
        Of the hoods over open ends: no path of interest keeps more clearance.
    """

    def __init__(self, wall: WallDistance, start: FloatArray, *, depth: float) -> None:
        surface = wall.surface
        corners = surface.vertices[surface.faces if wall.closed_ends else surface.wall_faces]
        spacing = float(np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)))
        points = np.concatenate([lattice(corners, 0.8 * spacing), hoods(wall, 1.2 * depth + spacing, spacing)])
        self._points = points + np.random.default_rng(0).uniform(-JITTER, JITTER, points.shape)
        delaunay = Delaunay(self._points, qhull_options="Qbb Qc Qz Q12")
        self._simplices = delaunay.simplices
        cells = len(self._simplices)
        # What lies beyond the hull is one more cell, joined to each tetrahedron there once.
        i, side = np.repeat(np.arange(cells), 4), np.tile(np.arange(4), cells)
        j = np.where(delaunay.neighbors.ravel() < 0, cells, delaunay.neighbors.ravel())
        keep = j > i
        i, j, side = i[keep], j[keep], side[keep]
        width, middle = triangle_widths(self._points[np.take_along_axis(self._simplices[i], CORNERS[side], axis=1)])
        i, j, width, middle = widest_of_each(i, j, width, middle)
        self._key = i * (cells + 1) + j  # rises, so that a pair is found by bisection
        self._width, self._middle = width, middle
        tree = spanning_tree(cells + 1, i, j, width)
        self._previous = breadth_first_order(tree, self._cell(start), directed=False)[1]

    def narrowest(self, goal: FloatArray) -> Bottleneck | None:
        """The narrowest triangle on the widest chain to `goal`; None where start and goal share a tetrahedron."""
        cell, chain = self._cell(goal), []
        while self._previous[cell] >= 0:
            before = int(self._previous[cell])
            chain.append(min(cell, before) * (len(self._simplices) + 1) + max(cell, before))
            cell = before
        if not chain:
            return None
        crossed = np.searchsorted(self._key, np.array(chain))
        least = int(crossed[np.argmin(self._width[crossed])])
        return Bottleneck(bound=float(self._width[least]) + JITTER_BOUND, place=self._middle[least])

    def _cell(self, point: FloatArray) -> int:
        """The tetrahedron that holds a point, or the cell beyond the hull."""
        # The point lies in the box of few tetrahedra; Delaunay.find_simplex goes through all of them where some are flat.
        boxed = np.flatnonzero(in_box(self._points, self._simplices, point))
        corners = self._points[self._simplices[boxed]]
        edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        solid = np.abs(np.linalg.det(edges)) > 1e-15
        share = np.linalg.solve(edges[solid], (point - corners[solid, 0])[..., None])[..., 0]
        least = np.minimum(share.min(axis=1), 1.0 - share.sum(axis=1)) if len(share) else np.empty(0)
        if not len(least) or least.max() < -1e-9:
            return len(self._simplices)
        return int(boxed[np.flatnonzero(solid)[int(np.argmax(least))]])


def widest_of_each(
    i: IntArray, j: IntArray, width: FloatArray, middle: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Of all triangles between the same two cells the widest, in order of the cells."""
    order = np.lexsort((-width, j, i))
    i, j, width, middle = i[order], j[order], width[order], middle[order]
    first = np.concatenate([[True], (np.diff(i) != 0) | (np.diff(j) != 0)])
    return i[first], j[first], width[first], middle[first]


def in_box(points: FloatArray, simplices: IntArray, point: FloatArray) -> BoolArray:
    """Whether a point lies in the bounding box of each tetrahedron, (m,)."""
    below, above = points <= point, points >= point
    lower, upper = np.any(below[simplices], axis=1), np.any(above[simplices], axis=1)
    return np.all(lower & upper, axis=1)
