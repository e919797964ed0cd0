"""Three ways to mesh a model tube, each with flat, labelled end caps."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay
from skimage.measure import marching_cubes

from segmentation.arrays import FloatArray, IntArray
from segmentation.mesh import Cap, Surface
from tubeplan_viz.bench.axes import Axis

Radius = Callable[[FloatArray], FloatArray]

# A facet of a marching-cubes mesh within a voxel and a half of an end is cap, not wall, where its normal leans towards the
# cap's by more than this beyond the lean of the tube's own wall there: it belongs to the chamfer between the two, cuts
# up to 0.3 mm off the rim and would bind as wall. Facets of the wall itself scatter by less than 0.1. So is a facet with
# a corner that the chamfer has moved inwards by more than a tenth of a voxel.
RIM_COSINE = 0.15
RIM_CUT = 0.1
RIM_DEPTH = 1.5


def constant_radius(radius: float) -> Radius:
    """The same radius in mm at every arc length."""
    return lambda s: np.full(np.shape(s), radius)


def sweep(
    axis: Axis, radius: Radius, *, edge: float, twisted: bool, rng: np.random.Generator, sites: FloatArray | None = None
) -> Surface:
    """Rings on the axis joined by triangles, vertices exactly on the tube.

    Parameters
    ----------
    axis : Axis
    radius : callable
        Radius in mm at (n,) arc lengths.
    edge : float, mm
        Wanted edge length.
    twisted : bool
        Turn every ring by its own random angle of at most half an edge, so that no
        two rings line up and no quad is cospherical.
    sites : (n,) float array, mm, optional
        Arc lengths that need a ring of their own (kinks of the radius).
    """
    kinks = np.unique(np.concatenate([[0.0, axis.length], sites if sites is not None else []]))
    s = np.unique(np.concatenate([np.linspace(a, b, max(int(np.ceil((b - a) / edge)), 1) + 1) for a, b in pairwise(kinks)]))
    r = radius(s)
    around = max(int(np.ceil(2.0 * np.pi * float(r.max()) / edge / 2.0)) * 2, 12)
    half_edge = np.pi / around
    phase = np.cumsum(rng.uniform(-half_edge, half_edge, len(s))) if twisted else np.zeros(len(s))
    points, frames = axis.at(s)
    # Frames of pieces meet at joints with equal tangents and normals, so rings need no untwisting.
    angle = phase[:, None] + 2.0 * half_edge * np.arange(around)
    rings = points[:, None] + r[:, None, None] * (
        np.cos(angle)[..., None] * frames[:, None, :, 1] + np.sin(angle)[..., None] * frames[:, None, :, 2]
    )
    vertices = rings.reshape(-1, 3)
    base = (np.arange(len(s) - 1) * around)[:, None]
    j, k = np.arange(around), (np.arange(around) + 1) % around
    a, b, c, d = (
        np.broadcast_to(x, (len(s) - 1, around)).ravel() for x in (base + j, base + k, base + around + k, base + around + j)
    )
    if twisted:
        first = np.linalg.norm(vertices[a] - vertices[c], axis=1) <= np.linalg.norm(vertices[b] - vertices[d], axis=1)
    else:
        first = np.ones(len(a), dtype=bool)
    one = np.where(first[:, None], np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    two = np.where(first[:, None], np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    wall = np.concatenate([one, two])
    ends = [(0, -frames[0, :, 0]), (len(s) - 1, frames[-1, :, 0])]
    return _with_discs(vertices, wall, [(np.arange(i * around, (i + 1) * around), points[i], normal) for i, normal in ends], edge)


def _with_discs(
    vertices: FloatArray, wall: IntArray, ends: list[tuple[IntArray, FloatArray, FloatArray]], edge: float
) -> Surface:
    """Close each rim (vertex indices in order, centre, outward normal) by a flat disc of triangles."""
    parts, labels, caps = [wall], [np.full(len(wall), -1)], []
    for number, (rim, center, normal) in enumerate(ends):
        radial = vertices[rim[0]] - center
        radius = float(np.linalg.norm(radial))
        u = radial / radius
        v = np.cross(normal, u)
        count = int(radius / edge)
        inner = [np.zeros((1, 2))]
        for ring in range(1, count):
            angle = np.linspace(0.0, 2.0 * np.pi, 6 * ring, endpoint=False) + 0.37 * ring
            inner.append(radius * ring / count * np.column_stack([np.cos(angle), np.sin(angle)]))
        disc = np.concatenate(inner)
        flat = np.concatenate([np.column_stack([(vertices[rim] - center) @ u, (vertices[rim] - center) @ v]), disc])
        index = np.concatenate([rim, len(vertices) + np.arange(len(disc))])
        triangles = Delaunay(flat).simplices
        e1, e2 = (flat[triangles[:, k]] - flat[triangles[:, 0]] for k in (1, 2))
        swap = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0] < 0.0
        triangles[swap] = triangles[swap][:, ::-1]
        vertices = np.concatenate([vertices, center + disc[:, :1] * u + disc[:, 1:] * v])
        parts.append(index[triangles])
        labels.append(np.full(len(triangles), number))
        area = 0.5 * abs(float(np.sum((e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]) * np.where(swap, -1.0, 1.0))))
        caps.append(Cap(f"C{number + 1}", "flat end", center, normal, area))
    return Surface(vertices, np.concatenate(parts), np.concatenate(labels), tuple(caps), "mesh")


def marching_surface(axes: list[tuple[Axis, Radius, tuple[bool, bool]]], *, voxel: float) -> Surface:
    """Marching cubes of the union of tubes, their outer ends cut flat.

    The level function is the distance to the nearest axis point less the radius there:
    zero exactly on the tube. Where the plane of an end cuts, it is the distance to that
    plane, which is linear, so that the cap comes out flat; its rim is chamfered by one voxel.

    Parameters
    ----------
    axes : list of (Axis, radius, (bool, bool))
        The flags say whether the first and last end is cut flat; the other ends, inside a
        junction, are rounded off by a ball.
    voxel : float, mm
    """
    clouds = [axis.at(np.linspace(0.0, axis.length, 200))[0] for axis, _, _ in axes]
    widest = max(float(radius(np.linspace(0.0, axis.length, 400)).max()) for axis, radius, _ in axes)
    cloud = np.concatenate(clouds)
    # An offset that is no round share of a voxel keeps grid points off the surface, where facets would degenerate.
    lower = cloud.min(axis=0) - widest - 3.0 * voxel - voxel * np.array([0.131, 0.237, 0.353])
    count = np.ceil((cloud.max(axis=0) + widest + 3.0 * voxel - lower) / voxel).astype(int) + 1
    level = np.full(count, 3.0 * voxel, dtype=np.float32)
    ends = []
    for axis, radius, flat in axes:
        width = float(radius(np.linspace(0.0, axis.length, 400)).max())
        index = _grid_near(axis, width + 3.0 * voxel, lower, voxel, count)
        grid = lower + voxel * np.column_stack(np.unravel_index(index, count))
        distance, arc = axis.nearest(grid, width + 3.0 * voxel)
        tube = distance - radius(np.clip(arc, 0.0, axis.length))
        points, frames = axis.at(np.array([0.0, axis.length]))
        for end, sign, beyond in [(0, -1.0, -arc), (1, 1.0, arc - axis.length)]:
            point, normal = points[end], sign * frames[end, :, 0]
            if flat[end]:
                near = beyond > -2.0
                tube[near] = np.maximum(tube[near], (grid[near] - point) @ normal)
                ends.append((point, normal, float(radius(np.array([0.0, axis.length]))[end]), lean(axis, radius, end)))
            else:
                past = (beyond > 0.0) & np.isfinite(distance)
                tube[past] = np.linalg.norm(grid[past] - point, axis=1) - float(radius(np.array([0.0, axis.length]))[end])
        level.ravel()[index] = np.minimum(level.ravel()[index], tube)
    vertices, faces, _, _ = marching_cubes(level, 0.0, gradient_direction="ascent")
    vertices = lower + voxel * vertices.astype(np.float64)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if np.einsum("ij,ij->", corners[:, 0] - lower, normals) < 0.0:
        faces, normals = faces[:, ::-1], -normals
    areas = np.linalg.norm(normals, axis=1)
    labels, caps = np.full(len(faces), -1), []
    for number, (point, normal, r, leaning) in enumerate(ends):
        depth, offset = (corners - point) @ normal, np.linalg.norm(corners - point, axis=2)
        cap = (
            (np.abs(depth).max(axis=1) < RIM_DEPTH * voxel)
            & (offset.max(axis=1) < r + voxel)
            & ((normals @ normal > (leaning + RIM_COSINE) * areas) | (offset.min(axis=1) < r - RIM_CUT * voxel))
        )
        labels[cap] = number
        # Marching cubes work in single precision: put the flat part exactly on its plane.
        disc = np.unique(faces[cap & (np.abs(depth).max(axis=1) < 1e-3 * voxel)])
        vertices[disc] -= ((vertices[disc] - point) @ normal)[:, None] * normal
        caps.append(Cap(f"C{number + 1}", "flat end", point, normal, 0.5 * float(areas[cap].sum())))
    return Surface(vertices, faces.astype(np.int64), labels, tuple(caps), "mesh")


def lean(axis: Axis, radius: Radius, end: int) -> float:
    """Cosine between the wall's outward normal and the cap's at an end (0 or 1): positive where the tube narrows towards it."""
    step = 1e-3 * axis.length
    here, inner = radius(np.array([0.0, step] if end == 0 else [axis.length, axis.length - step]))
    slope = float(inner - here) / step
    return slope / float(np.hypot(1.0, slope))


def _grid_near(axis: Axis, within: float, lower: FloatArray, voxel: float, count: IntArray) -> IntArray:
    """Flat indices of the grid's points in boxes along the axis that hold all points within `within` mm of it."""
    lead, piece = 3.0, 5.0
    s = np.linspace(-lead, axis.length + lead, max(int(np.ceil((axis.length + 2.0 * lead) / piece)), 1) + 1)
    chosen = np.zeros(count, dtype=bool)
    for a, b in pairwise(s):
        # A box around sites 1/8 piece apart misses less than a piece's eighth of the curve.
        sites = axis.at(np.linspace(a, b, 9))[0]
        low = np.floor((sites.min(axis=0) - within - piece / 8.0 - lower) / voxel).astype(int).clip(0, count)
        high = np.ceil((sites.max(axis=0) + within + piece / 8.0 - lower) / voxel).astype(int).clip(0, count - 1) + 1
        chosen[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
    return np.flatnonzero(chosen)
