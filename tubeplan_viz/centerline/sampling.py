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
from segmentation.errors import GeometryError
from segmentation.mesh import Surface

# Cell of the grid over the radius of the lumen beside it. Cells leave gaps of up to two cells between
# neighbours; a ball of radius R bulges by R/7 through a gap of R, at worst.
SHARE = 0.5
# The test ball is this much smaller than the one it stands for, since normals of stair meshes lean by up to 30 degrees.
SLACK = 0.8
LEVEL = 2.0**0.5
# Coarser than this the diagram is small already.
ENOUGH = 1500
# Rows and points this much nearer than the spacing leave no place of a face farther from one than in triangles whose edges are
# as long as the spacing: half the diagonal of a square against the radius around such a triangle.
CLOSER = 0.8
# A tube needs some ten thousand samples, an airway with all its branches a few hundred thousand.
WALL_POINTS_MAX = 3_000_000


def wall_samples(surface: Surface, spacing: float) -> FloatArray:
    """Wall vertices, and more points on faces whose edges are longer than `spacing`, (k, 3) mm.

    Coarse meshes have faces longer than the tube is wide; their vertices alone do
    not describe the wall. Caps are left out: an instrument passes through them, and
    their rim belongs to the wall anyway.
    """
    return oriented_samples(surface, spacing)[0]


def oriented_samples(surface: Surface, spacing: float) -> tuple[FloatArray, FloatArray]:
    """The points of `wall_samples` and the unit normals out of the lumen there, both (k, 3).

    Raises
    ------
    GeometryError
        If the wall is so large against `spacing` that it cannot be a lumen's.
    """
    wall = surface.face_cap < 0
    faces, normals = surface.faces[wall], surface.face_normals[wall]
    areas, vertices = surface.face_areas[wall], surface.vertices
    sums = np.column_stack(
        [np.bincount(faces.ravel(), np.repeat(areas * normals[:, k], 3), minlength=len(vertices)) for k in range(3)]
    )
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    # Rows of points along the longest edge, and points on all edges: a sliver gets as many as it is long, not their square.
    step = CLOSER * spacing
    lengths = np.column_stack([np.linalg.norm(vertices[faces[:, (k + 1) % 3]] - vertices[faces[:, k]], axis=1) for k in range(3)])
    longest = lengths.max(axis=1)
    height = 2.0 * areas / np.maximum(longest, 1e-300)
    count = np.where(longest > spacing, np.ceil(height / step), 1.0)
    if (np.maximum(longest / step, 1.0) * count).sum() > WALL_POINTS_MAX:
        raise GeometryError(
            f"the wall has {areas.sum():.3g} mm^2 around {surface.volume_ml:.3g} ml, too much for points "
            f"{spacing:.2g} mm apart, which its narrowness asks for; a lumen is no such sheet: mend the mesh"
        )
    # A fine mesh has few edges and faces that are cut at all: what follows is made for those alone.
    cut = np.flatnonzero(lengths.ravel() > spacing)
    ends = faces[cut // 3, cut % 3], faces[cut // 3, (cut + 1) % 3]
    _, first = np.unique(np.minimum(*ends) * len(vertices) + np.maximum(*ends), return_index=True)
    segments = np.stack([vertices[end[first]] for end in ends], axis=1)
    leaning = normals[cut[first] // 3]
    tall = np.flatnonzero(count > 1.0)
    along = lengths[tall].argmax(axis=1)
    a, b, c = (vertices[faces[tall, (along + k) % 3]] for k in range(3))
    face, share = even_shares(count[tall].astype(np.int64))
    within = np.stack([a[face] + share * (c - a)[face], b[face] + share * (c - b)[face]], axis=1)
    segments, leaning = np.concatenate([segments, within]), np.concatenate([leaning, normals[tall[face]]])
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    segment, share = even_shares(np.where(length > spacing, np.ceil(length / step), 1.0).astype(np.int64))
    # The ends of a row within a face lie on edges, which have points of their own.
    added = segments[segment, 0] + share * (segments[segment, 1] - segments[segment, 0])
    direction = np.concatenate([sums[used], leaning[segment]])
    norm = np.linalg.norm(direction, axis=1, keepdims=True)
    points = np.concatenate([vertices[used], added])
    return points, np.divide(direction, norm, out=np.zeros_like(direction), where=norm > 0.0)


def even_shares(count: IntArray) -> tuple[IntArray, FloatArray]:
    """Shares of the way that cut each of several ways into `count` even pieces.

    Returns
    -------
    way : (k,) int array
        Which of them.
    share : (k, 1) float array
        Between 0 and 1, without either.

    Examples
    --------
    >>> way, share = even_shares(np.array([1, 4, 2]))
    >>> way.tolist(), share.ravel().tolist()
    ([1, 1, 1, 2], [0.25, 0.5, 0.75, 0.5])
    """
    way = np.repeat(np.arange(len(count)), count - 1)
    place = np.arange(len(way)) - np.repeat(np.cumsum(count - 1) - (count - 1), count - 1)
    return way, ((place + 1) / count[way])[:, None]


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
