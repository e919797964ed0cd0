"""Points on the wall that stand for it in the Voronoi diagram: dense ones, and a choice thinned to the lumen's width."""

# Strategy: the diagram's vertices near the middle of a tube need samples no closer than a
# share of the tube's radius; what a coarser choice costs in accuracy is won back where the
# line runs (ridge.py). Samples are thinned level by level: a sample may go to the next
# level where a ball that wide, laid against the wall from inside, holds no other sample.
# Each level keeps one sample per cell of a grid, so every level has a fraction of the last one's work.

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray
from segmentation.mesh import Surface

# Cell of the grid over the radius of the lumen beside it. Cells leave gaps of up to two cells between
# neighbours; a ball of radius R bulges by R/7 through a gap of R, at worst.
SHARE = 0.5
# The test ball is this much smaller than the one it stands for, since normals of stair meshes lean by up to 30 degrees.
SLACK = 0.8
LEVEL = 2.0**0.5
# Coarser than this the diagram is small already.
ENOUGH = 1500


def wall_samples(surface: Surface, spacing: float) -> FloatArray:
    """Wall vertices, and more points on faces whose edges are longer than `spacing`, (k, 3) mm.

    Coarse meshes have faces longer than the tube is wide; their vertices alone do
    not describe the wall. Caps are left out: an instrument passes through them, and
    their rim belongs to the wall anyway.
    """
    return oriented_samples(surface, spacing)[0]


def oriented_samples(surface: Surface, spacing: float) -> tuple[FloatArray, FloatArray]:
    """The points of `wall_samples` and the unit normals out of the lumen there, both (k, 3)."""
    wall = surface.face_cap < 0
    faces, normals = surface.faces[wall], surface.face_normals[wall]
    corners = surface.vertices[faces]  # (m, 3, 3)
    weighted = surface.face_areas[wall][:, None] * normals
    sums = np.column_stack(
        [np.bincount(faces.ravel(), np.repeat(weighted[:, k], 3), minlength=len(surface.vertices)) for k in range(3)]
    )
    used = np.zeros(len(surface.vertices), dtype=bool)
    used[faces] = True
    points, directions = [surface.vertices[used]], [sums[used]]
    while len(corners):
        square = np.zeros(len(corners))
        for one, other in ((0, 1), (1, 2), (2, 0)):
            edge = corners[:, one] - corners[:, other]
            square = np.maximum(square, np.einsum("ij,ij->i", edge, edge))
        long = square > spacing**2
        corners, normals = corners[long], normals[long]
        if not len(corners):
            break
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        points.append(np.concatenate([ab, bc, ca]))
        directions.append(np.tile(normals, (3, 1)))
        corners = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        normals = np.tile(normals, (4, 1))
    if len(points) > 1:
        added, leaning = np.concatenate(points[1:]), np.concatenate(directions[1:])
        _, first = np.unique(np.round(added / 1e-4).astype(np.int64), axis=0, return_index=True)
        points, directions = [points[0], added[first]], [directions[0], leaning[first]]
    direction = np.concatenate(directions)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    return np.concatenate(points), np.divide(direction, length, out=np.zeros_like(direction), where=length > 0.0)


def thinned_samples(points: FloatArray, normals: FloatArray, tree: cKDTree, edge: float) -> IntArray:
    """Indices of a choice of the samples, as dense as the lumen beside them is narrow.

    Parameters
    ----------
    points, normals : (k, 3) float arrays
        Samples in mm and unit normals out of the lumen.
    tree : cKDTree
        Of the points.
    edge : float, mm
        Distance between neighbouring samples.

    Returns
    -------
    (m,) int array
        Ascending.
    """
    kept: list[IntArray] = []
    free = np.arange(len(points))
    cell = edge
    while len(free) > ENOUGH:
        cell *= LEVEL
        radius = cell / SHARE
        first, number = cell_members(points[free], cell)
        # One sample of a cell answers for all of it; the cell is small against the ball.
        site = free[first]
        gap = tree.query(points[site] - radius * normals[site], distance_upper_bound=SLACK * radius)[0]
        wide = np.isinf(gap) & (np.einsum("ij,ij->i", normals[site], normals[site]) > 0.5)
        if not wide.any():
            break
        kept.append(free[~wide[number]])
        free = site[wide]
    return np.sort(np.concatenate([*kept, free]))


def cell_members(points: FloatArray, cell: float) -> tuple[IntArray, IntArray]:
    """The most central point of each cell of a cubic grid that holds any, (c,), and the cell's number for each point, (k,)."""
    place = (points - points.min(axis=0)) / cell
    index = np.floor(place).astype(np.int64)
    size = index.max(axis=0) + 1
    key = (index[:, 0] * size[1] + index[:, 1]) * size[2] + index[:, 2]
    off = np.einsum("ij,ij->i", place - index - 0.5, place - index - 0.5)
    order = np.lexsort((off, key))
    begins = np.concatenate([[True], np.diff(key[order]) > 0])
    number = np.empty(len(points), dtype=np.int64)
    number[order] = np.cumsum(begins) - 1
    return order[begins], number
