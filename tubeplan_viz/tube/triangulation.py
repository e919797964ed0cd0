"""Chains of Delaunay tetrahedra between wall points: how wide the triangles are that any path must cross."""

# Strategy: wall points, and points of a hood set on each end cap, are triangulated (Delaunay). A path from
# start to goal runs through a chain of tetrahedra and crosses the triangles between them. On a
# triangle no point is farther from all three corners than its circumradius (or, when it is obtuse,
# less), so the path comes that near to the wall. The hood keeps chains from leaving through a cap and coming back outside.

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.geometry import WallDistance

# Keeps Qhull off the degenerate lattices of structured meshes, mm.
JITTER = 1e-3
# A corner moved by the jitter moves the bound by no more than this.
JITTER_BOUND = float(np.sqrt(3.0)) * JITTER


def lattice(corners: FloatArray, spacing: float) -> FloatArray:
    """The corners of triangles (m, 3, 3), and points on them at most `spacing` mm apart along each edge."""
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    count = np.clip(np.ceil(longest / spacing), 1, 64).astype(int)
    made = [np.empty((0, 3))]
    for n in np.unique(count):
        own = corners[count == n]
        i, j = (grid.ravel() for grid in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
        s, t = (axis[i + j <= n, None] / n for axis in (i, j))
        points = own[:, None, 0] + s * (own[:, None, 1] - own[:, None, 0]) + t * (own[:, None, 2] - own[:, None, 0])
        made.append(points.reshape(-1, 3))
    points = np.concatenate(made)
    _, first = np.unique(np.round(points / 1e-5).astype(np.int64), axis=0, return_index=True)
    return points[first]


def hoods(wall: WallDistance, depth: float, spacing: float) -> FloatArray:
    """Points of a hood over each cap that is no wall: its rim pushed outwards, closed `depth` mm beyond.

    From inside, a hood's sides are hidden behind the rim, which is wall, and its end is
    `depth` mm away. A hood point that another part of the surface is nearer to than the depth is left
    out: leaving one out only opens ways, and the bound stays a bound.
    """
    surface = wall.surface
    if wall.closed_ends:
        return np.empty((0, 3))
    made = [np.empty((0, 3))]
    for number, cap in enumerate(surface.caps):
        faces = surface.faces[surface.face_cap == number]
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        unique, count = np.unique(edges, axis=0, return_counts=True)
        rim = surface.vertices[np.unique(unique[count == 1])]
        top = float(((surface.vertices[np.unique(faces)] - cap.center) @ cap.normal).max())
        heights = np.arange(spacing, depth + spacing, spacing)
        flat = rim - ((rim - cap.center) @ cap.normal)[:, None] * cap.normal
        sides = (rim[None] + (top + heights)[:, None, None] * cap.normal).reshape(-1, 3)
        radius = float(np.linalg.norm(flat - cap.center, axis=1).max())
        rings = [np.zeros((1, 2))]
        for r in np.arange(spacing, radius + spacing, spacing):
            angle = np.linspace(0.0, 2.0 * np.pi, int(np.ceil(2.0 * np.pi * r / spacing)), endpoint=False)
            rings.append(r * np.column_stack([np.cos(angle), np.sin(angle)]))
        disc = np.concatenate(rings)
        side = np.cross(cap.normal, np.eye(3)[int(np.argmin(np.abs(cap.normal)))])
        side /= np.linalg.norm(side)
        end = cap.center + (top + depth) * cap.normal + disc[:, :1] * side + disc[:, 1:] * np.cross(cap.normal, side)
        hood = np.concatenate([sides, end])
        others = surface.vertices[np.unique(surface.faces[surface.face_cap != number])]
        others = others[np.linalg.norm(others - cap.center, axis=1) > radius + depth] if len(others) else others
        if len(others):
            hood = hood[cKDTree(others).query(hood)[0] > depth]
        made.append(hood[~wall.inside(hood)] if len(hood) else hood)
    return np.concatenate(made)


def spanning_tree(cells: int, i: IntArray, j: IntArray, width: FloatArray) -> csr_matrix:
    """Tree that joins all cells over the widest triangles."""
    # The minimum tree takes the least weights; they must be positive.
    weight = width.max() + 1.0 - width
    return minimum_spanning_tree(csr_matrix((weight, (i, j)), shape=(cells, cells)))


def triangle_widths(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Largest distance that a point of each triangle keeps from all three corners, (k,) mm, and that point.

    It is the circumradius when the triangle is acute. When it is obtuse the point lies on the longest edge,
    where the perpendicular bisector of the longer of the other two meets it.
    """
    a, b, c = (corners[:, k] for k in range(3))
    lengths = np.stack([np.linalg.norm(b - c, axis=1), np.linalg.norm(c - a, axis=1), np.linalg.norm(a - b, axis=1)], axis=1)
    order = np.argsort(lengths, axis=1)
    ordered = np.take_along_axis(corners, order[:, :, None], axis=1)  # corner opposite the shortest, middle, longest edge
    short, middle, long = np.take_along_axis(lengths, order, axis=1).T
    first, second, apex = ordered[:, 0], ordered[:, 1], ordered[:, 2]
    # The longest edge runs from `first` to `second`; apex-second is the shortest edge, apex-first the middle one.
    cosine = (middle**2 + long**2 - short**2) / np.maximum(2.0 * middle * long, 1e-30)
    obtuse = short**2 + middle**2 <= long**2
    along = 0.5 * middle / np.maximum(cosine, 1e-30)
    edge = (second - first) / np.maximum(long, 1e-30)[:, None]
    on_edge = first + along[:, None] * edge
    height = apex - first
    height = height - np.einsum("ij,ij->i", height, edge)[:, None] * edge
    height /= np.maximum(np.linalg.norm(height, axis=1, keepdims=True), 1e-30)
    sine = np.sqrt(np.clip(1.0 - cosine**2, 0.0, None))
    radius = 0.5 * short / np.maximum(sine, 1e-30)
    rise = np.sqrt(np.clip(radius**2 - 0.25 * long**2, 0.0, None))
    center = first + 0.5 * long[:, None] * edge + rise[:, None] * height
    return np.where(obtuse, along, radius), np.where(obtuse[:, None], on_edge, center)
