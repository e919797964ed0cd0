"""Triangles to one two-sided wall: merging, components, touching sheets, orientation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import SurfaceError

# Exporters write one vertex as several that differ in the last digits of a 32-bit float (about 1e-7 of the size).
MERGE_TOLERANCE = 1e-5


@dataclass(frozen=True, eq=False)
class EdgeMap:
    """Undirected edges of a mesh.

    Attributes
    ----------
    ends : (e, 2) int array
        Vertices, the lower index first.
    count : (e,) int array
        Faces at each edge.
    of_corner : (3 m,) int array
        Edge of the half-edges (0, 1), (1, 2), (2, 0) of each face, face by face.
    """

    ends: IntArray
    count: IntArray
    of_corner: IntArray


def edge_map(faces: IntArray) -> EdgeMap:
    """Edges of (m, 3) faces."""
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    lower, upper = half.min(axis=1), half.max(axis=1)
    span = int(faces.max()) + 1
    keys, of_corner, count = np.unique(lower * span + upper, return_inverse=True, return_counts=True)
    return EdgeMap(np.column_stack([keys // span, keys % span]), count, of_corner)


def merge_vertices(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Join vertices nearer than 1e-5 of the mesh's diagonal; drop what no face uses.

    The first of each group keeps its coordinates, so that a clean mesh comes back
    number for number.
    """
    # Equal coordinates first, through one 64-bit key each: an STL names every vertex six times.
    columns = np.ascontiguousarray(vertices + 0.0).view(np.uint64).astype(np.uint64)
    key = (
        columns[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        ^ columns[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
        ^ columns[:, 2] * np.uint64(0x165667B19E3779F9)
    )
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    if not np.array_equal(vertices[first][inverse], vertices):  # two points met in one key: do it the slow way
        _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    points, faces = vertices[first], inverse.reshape(-1)[faces]
    used = np.unique(faces)
    diagonal = float(np.linalg.norm(np.ptp(points[used], axis=0)))
    pairs = cKDTree(points).query_pairs(MERGE_TOLERANCE * diagonal, output_type="ndarray")
    if len(pairs):
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
        _, group = connected_components(graph, directed=False)
    else:
        group = np.arange(len(points))
    # Keep the file's order: the representative is the group's first vertex in the file.
    lead = np.full(int(group.max()) + 1, len(vertices), dtype=np.int64)
    np.minimum.at(lead, group, first)
    kept = np.zeros(len(lead), dtype=bool)
    kept[group[used]] = True
    order = np.argsort(np.where(kept, lead, len(vertices)), kind="stable")[: int(kept.sum())]
    rank = np.full(len(lead), -1, dtype=np.int64)
    rank[order] = np.arange(len(order))
    return vertices[lead[order]], rank[group[faces]]


def clean_faces(faces: IntArray) -> tuple[IntArray, int, int]:
    """Faces without those that name a vertex twice or repeat another; and how many of each went.

    Two faces on the same vertices that look opposite ways are a collapsed flap: both go, which
    keeps a closed mesh closed. Where most faces are such pairs the file was written two-sided,
    and one of each stays.
    """
    sound = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    kept = faces[sound]
    degenerate = len(faces) - len(kept)
    if not len(kept):
        return kept, degenerate, 0
    order = np.sort(kept, axis=1)
    span = int(order.max()) + 1
    columns = order[:, :1] * span + order[:, 1:2]
    _, first, inverse, count = np.unique(
        columns[:, 0] * span + order[:, 2] if span < 2_000_000 else np.column_stack([columns, order[:, 2]]),
        axis=None if span < 2_000_000 else 0,
        return_index=True,
        return_inverse=True,
        return_counts=True,
    )
    if len(first) == len(kept):
        return kept, degenerate, 0
    # +1 for an even permutation of the sorted vertices, -1 for an odd one.
    sense = np.sign((kept[:, 1] - kept[:, 0]) * (kept[:, 2] - kept[:, 1]) * (kept[:, 0] - kept[:, 2])) * -1
    flap = (count > 1) & (np.bincount(inverse.ravel(), weights=sense) == 0.0)
    stays = np.ones(len(first), dtype=bool) if 2 * int(flap.sum()) > len(first) else ~flap
    chosen = np.sort(first[stays])
    return kept[chosen], degenerate, len(kept) - len(chosen)


def face_components(faces: IntArray, edges: EdgeMap) -> tuple[int, IntArray]:
    """Number of components joined through edges, and the component of each face, (m,)."""
    m = len(faces)
    graph = coo_array((np.ones(3 * m), (np.repeat(np.arange(m), 3), m + edges.of_corner)), shape=(m + len(edges.ends),) * 2)
    count, label = connected_components(graph, directed=False)
    return count, label[:m].astype(np.int64)


def solid_angle(vertices: FloatArray, faces: IntArray, point: FloatArray) -> float:
    """Winding number of the mesh around one point: 1 inside, 0 outside a closed one [1]_.

    References
    ----------
    .. [1] Van Oosterom, A., Strackee, J. (1983). The solid angle of a plane triangle. IEEE
       Trans. Biomed. Eng. 30(2), 125-126.
    """
    a, b, c = (vertices[faces[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    below = la * lb * lc + np.einsum("ij,ij->i", a, b) * lc + np.einsum("ij,ij->i", b, c) * la + np.einsum("ij,ij->i", c, a) * lb
    return float(np.arctan2(triple, below).sum() / (2.0 * np.pi))


def choose_component(vertices: FloatArray, faces: IntArray, label: IntArray, near: FloatArray | None) -> int:
    """The component that holds `near`, else the nearest to it, else the one of largest area."""
    corners = vertices[faces]
    if near is None:
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return int(np.argmax(np.bincount(label, weights=area)))
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    holders = []
    for number in range(int(label.max()) + 1):
        mine = label == number
        low, high = lower[mine].min(axis=0), upper[mine].max(axis=0)
        if np.all(near >= low) and np.all(near <= high) and abs(solid_angle(vertices, faces[mine], near)) > 0.5:
            holders.append((float(np.prod(high - low)), number))
    if holders:
        return min(holders)[1]  # of nested shells the innermost is the lumen around the point
    return int(label[np.argmin(np.linalg.norm(corners - near, axis=2).min(axis=1))])


def separate_sheets(vertices: FloatArray, faces: IntArray, name: str) -> tuple[FloatArray, IntArray, int]:
    """Cut a mesh apart where more than two faces meet at an edge, and say at how many edges.

    Two sheets that only touch along an edge (collapsed slivers of marching cubes do) become
    two sheets with vertices of their own at the same place.

    Raises
    ------
    SurfaceError
        If a third sheet grows out of the wall, so that no cut leaves it whole and two-sided.
    """
    edges = edge_map(faces)
    crowded = edges.count > 2
    if not crowded.any():
        return vertices, faces, 0
    place = vertices[edges.ends[np.flatnonzero(crowded)[0]]].mean(axis=0)
    # Corners stay together when their faces share an edge of two faces at that vertex.
    order = np.argsort(edges.of_corner, kind="stable")
    order = order[edges.count[edges.of_corner[order]] == 2]
    one, two = order[0::2], order[1::2]
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    begin, end = np.arange(3 * len(faces)), 3 * (np.arange(3 * len(faces)) // 3) + (np.arange(3 * len(faces)) + 1) % 3
    same = half[one, 0] == half[two, 0]
    links_a = np.concatenate([begin[one], end[one]])
    links_b = np.concatenate([np.where(same, begin[two], end[two]), np.where(same, end[two], begin[two])])
    graph = coo_array((np.ones(len(links_a)), (links_a, links_b)), shape=(3 * len(faces),) * 2)
    _, fan = connected_components(graph, directed=False)
    corner = faces.ravel().copy()
    extra: list[FloatArray] = []
    for vertex in np.unique(edges.ends[crowded]):
        mine = np.flatnonzero(corner == vertex)
        for number in np.unique(fan[mine])[1:]:
            corner[mine[fan[mine] == number]] = len(vertices) + len(extra)
            extra.append(vertices[vertex])
    faces = corner.reshape(-1, 3)
    vertices = np.concatenate([vertices, np.array(extra).reshape(-1, 3)])
    after = edge_map(faces)
    # Sheets that only touch come apart without a new border; a fin or a membrane does not.
    if (after.count > 2).any() or (after.count == 1).sum() > (edges.count == 1).sum() or (edges.count[crowded] % 2).any():
        raise SurfaceError(
            f"{name}: more than two faces meet at {int(crowded.sum())} edges, the first at "
            f"({place[0]:.2f}, {place[1]:.2f}, {place[2]:.2f}); a wall has two sides: remove inner sheets or re-mesh it"
        )
    return vertices, faces, int(crowded.sum())


def orient(vertices: FloatArray, faces: IntArray, edges: EdgeMap, name: str) -> tuple[IntArray, int]:
    """Faces of one component with one sense of rotation, and how many were turned.

    Raises
    ------
    SurfaceError
        If no consistent sense exists (a Moebius strip).
    """
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward = half[:, 0] < half[:, 1]
    order = np.argsort(edges.of_corner, kind="stable")
    paired = edges.count[edges.of_corner[order]] == 2
    one, two = order[paired][0::2], order[paired][1::2]
    agree = forward[one] != forward[two]  # neighbours run along their common edge in opposite senses
    turned = np.zeros(len(faces), dtype=bool)
    if not agree.all():
        f, g = one // 3, two // 3
        graph = coo_array((np.where(agree, 1.0, 2.0), (f, g)), shape=(len(faces),) * 2).tocsr()
        graph = graph.maximum(graph.T).tocsr()
        sequence, before = breadth_first_order(graph, 0, directed=False)
        weights = np.asarray(graph[before[sequence[1:]], sequence[1:]]).ravel()
        for face, weight in zip(sequence[1:], weights, strict=True):
            turned[face] = turned[before[face]] ^ (weight == 2.0)
        if np.any(agree == (turned[f] ^ turned[g])):
            raise SurfaceError(f"{name}: the mesh has no inside (it is one-sided like a Moebius strip); re-mesh it")
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    return faces, int(min(turned.sum(), len(faces) - turned.sum()))


def signed_volume(vertices: FloatArray, faces: IntArray) -> float:
    """Enclosed volume in cubed units, positive when the faces look outward."""
    a, b, c = (vertices[faces[:, k]] - vertices.mean(axis=0) for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def closed_and_oriented(faces: IntArray) -> BoolArray:
    """One bool per half-edge: whether its opposite runs exactly once the other way."""
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    span = int(faces.max()) + 1
    forward, backward = half[:, 0] * span + half[:, 1], half[:, 1] * span + half[:, 0]
    keys, count = np.unique(forward, return_counts=True)
    found = np.minimum(np.searchsorted(keys, backward), len(keys) - 1)
    return np.asarray((keys[found] == backward) & (count[found] == 1))
