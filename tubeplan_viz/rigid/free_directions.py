"""Directions in which the instrument can stand with its tip on the lesion: what any last segment has to lie along.

# Strategy: pushed along its axis the instrument only draws its shafts out backwards, where soon nothing but air is left; so
# whether a last segment is free is a matter of its direction, hardly of its length. Directions are two numbers: a grid across
# the cone of the entry region finds the free ones, and is made finer where it found some, since a way between bones may be
# half a millimetre wide at the nostril. Where no direction is free, no path of any number of bends ends at the lesion.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.rigid.instrument import UP, unit
from tubeplan_viz.rigid.judge import Judge

FINEST_MM = 0.125  # pitch of the finest grid, at the distance of the entry region: a tenth of a degree decides at its border
PITCHES = (8, 4, 2, 1)  # of the grids, in units of the finest
ENOUGH = 400  # directions; more free ones need no finer grid
BESIDE_MM = 1.5  # of the entry voxels, seen from the lesion, within which directions are tried


def free_directions(judge: Judge, starts: FloatArray, goal: FloatArray, roll: float, *, known: FloatArray) -> FloatArray:
    """Unit vectors from the goal outwards along which the instrument reaches it, (k, 3).

    Parameters
    ----------
    judge : Judge
    starts : (n, 3) float array, LPS mm
        The entry region.
    goal : (3,) float array, LPS mm
    roll : float, radian
    known : (m, 3) float array, LPS mm
        Starts that are known to have a free straight push with that roll; the finer grids are tried around them too.
    """
    plane = _Plane(starts, goal)
    seen = plane.of(starts)
    tree = cKDTree(seen)
    tried: dict[tuple[int, int], bool] = {}
    for pitch in PITCHES:
        free = [cell for cell, ok in tried.items() if ok]
        first = pitch == PITCHES[0]
        fresh = list(_grid(seen, pitch)) if first else [cell for place in free for cell in _around(place, pitch)]
        fresh += [cell for place in plane.of(known) for cell in _corners(place, pitch)]
        # The finer grid spreads from free places for as long as it finds any.
        while fresh := [cell for cell in dict.fromkeys(fresh) if cell not in tried]:
            found = _free(judge, plane, goal, tree, np.array(fresh), roll)
            tried.update(zip(fresh, found.tolist(), strict=True))
            fresh = [] if first else [c for cell in fresh if tried[cell] for c in _around(cell, pitch)]
        if sum(tried.values()) >= ENOUGH:
            break
    return plane.directions(np.array([cell for cell, ok in tried.items() if ok], dtype=np.int64).reshape(-1, 2))


def direction_grid(starts: FloatArray, goal: FloatArray) -> tuple[FloatArray, float]:
    """Directions of the coarsest grid, (k, 3) unit vectors, and the distance of the farthest start, mm."""
    plane = _Plane(starts, goal)
    seen = plane.of(starts)
    cells = np.array(list(_grid(seen, PITCHES[0])))
    away, _ = cKDTree(seen).query(FINEST_MM * cells)
    return plane.directions(cells[away <= BESIDE_MM]), plane.reach


class _Plane:
    """Directions as points of a plane across the middle of the entry region's cone, as far from the goal as the region."""

    def __init__(self, starts: FloatArray, goal: FloatArray) -> None:
        self.goal = goal
        self.ahead = unit((starts - goal).mean(axis=0))
        other = UP if abs(self.ahead @ UP) < 0.99 else np.array([0.0, -1.0, 0.0])
        across = unit(np.cross(self.ahead, other))
        self.axes = np.stack([across, np.cross(self.ahead, across)])
        self.away = float(((starts - goal) @ self.ahead).mean())
        self.reach = float(np.linalg.norm(starts - goal, axis=1).max())

    def of(self, points: FloatArray) -> FloatArray:
        """Where the lines from the goal to some points meet the plane, (n, 2) mm."""
        offset = points - self.goal
        return np.asarray(offset @ self.axes.T * (self.away / (offset @ self.ahead))[:, None])

    def directions(self, cells: IntArray) -> FloatArray:
        """Unit vectors to cells of the finest grid, (n, 3)."""
        return unit(self.away * self.ahead + FINEST_MM * cells @ self.axes)


def _grid(seen: FloatArray, pitch: int) -> Iterator[tuple[int, int]]:
    """All cells of a grid that holds some places."""
    low, high = (np.floor(v / (FINEST_MM * pitch)).astype(int) for v in (seen.min(axis=0), seen.max(axis=0)))
    return ((pitch * i, pitch * j) for i in range(low[0], high[0] + 2) for j in range(low[1], high[1] + 2))


def _around(cell: tuple[int, int], pitch: int) -> Iterator[tuple[int, int]]:
    """The eight neighbours of a cell on the grid of a pitch."""
    return ((cell[0] + pitch * i, cell[1] + pitch * j) for i, j in product((-1, 0, 1), repeat=2) if i or j)


def _corners(place: FloatArray, pitch: int) -> Iterator[tuple[int, int]]:
    """The four cells of a grid around a place, mm."""
    i, j = (np.floor(place / (FINEST_MM * pitch)).astype(int) * pitch).tolist()
    return ((i + pitch * a, j + pitch * b) for a, b in product((0, 1), repeat=2))


def _free(judge: Judge, plane: _Plane, goal: FloatArray, tree: cKDTree, cells: IntArray, roll: float) -> BoolArray:
    """Whether the push along some directions is free, from as far away as the farthest start."""
    free = np.zeros(len(cells), dtype=bool)
    away, _ = tree.query(FINEST_MM * cells)
    rows = np.flatnonzero(away <= BESIDE_MM)
    begin = goal + plane.reach * plane.directions(cells[rows])
    label, _ = judge.push(begin, np.broadcast_to(goal, begin.shape), np.full(len(rows), roll))
    free[rows] = label < 0
    return free
