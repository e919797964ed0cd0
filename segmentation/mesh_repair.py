"""Triangles to one closed, outward-oriented wall: merging, components, orientation, open ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import SurfaceError
from segmentation.mesh import Cap

# Exporters write one vertex as several that differ in the last digits of a 32-bit float (about 1e-7 of the size).
MERGE_TOLERANCE = 1e-5
MAX_OPEN_LOOPS = 40
# An open end closes a tube, it is not most of it: a straight tube as long as wide has caps of half its wall.
MAX_CAP_SHARE = 0.6
# Around a tube's open end the wall stands along the end's normal, around a hole in its side across it.
SIDE_HOLE_COSINE = 0.7


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


def boundary_loops(faces: IntArray, edges: EdgeMap) -> list[IntArray]:
    """Closed vertex loops along the open border of consistently oriented faces, in the sense of a cap's own rotation."""
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    open_half = half[edges.count[edges.of_corner] == 1][:, ::-1]
    following: dict[int, list[int]] = {}
    for a, b in open_half:
        following.setdefault(int(a), []).append(int(b))
    loops = []
    while following:
        trail = [next(iter(following))]
        place = {trail[0]: 0}
        while trail:
            here = trail[-1]
            if here not in following:
                break
            onward = following[here].pop()
            if not following[here]:
                del following[here]
            if onward in place:  # a border that touches itself at a vertex falls into simple loops
                loops.append(np.array(trail[place[onward] :]))
                for vertex in trail[place[onward] + 1 :]:
                    del place[vertex]
                trail = trail[: place[onward] + 1]
            else:
                place[onward] = len(trail)
                trail.append(onward)
    return loops


@dataclass(frozen=True, eq=False)
class Closing:
    """A mesh closed by fills: all faces, the cap of each (-1 wall), the caps, and words about side holes."""

    vertices: FloatArray
    faces: IntArray
    face_cap: IntArray
    caps: tuple[Cap, ...]
    notes: tuple[str, ...]


def close_loops(vertices: FloatArray, faces: IntArray, loops: list[IntArray], name: str) -> Closing:
    """Fill every open loop: ends of the tube as caps, holes in its side as wall.

    `faces` must look outward or inward consistently; fills follow their sense.

    Raises
    ------
    SurfaceError
        If there are too many loops, or the open ends are too large for a tube.
    """
    if len(loops) > MAX_OPEN_LOOPS:
        raise SurfaceError(
            f"{name}: the mesh has {len(loops)} open borders, expected at most {MAX_OPEN_LOOPS}; close it in a mesh editor first"
        )
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    wall_area = 0.5 * float(length.sum())
    fills: list[tuple[IntArray, int]] = []
    ends: list[tuple[int, float, FloatArray, FloatArray]] = []
    notes = []
    for loop in loops:
        points = vertices[loop]
        center = points.mean(axis=0)
        area_vector = 0.5 * np.cross(points - center, np.roll(points, -1, axis=0) - center).sum(axis=0)
        area = float(np.linalg.norm(area_vector))
        extra, triangles = _fill(vertices, loop, len(vertices), area_vector)
        rim = np.isin(faces, loop).sum(axis=1) == 2
        across = float(np.abs(cross[rim] @ area_vector).sum() / max(area * length[rim].sum(), 1e-300))
        if across > SIDE_HOLE_COSINE:
            notes.append(
                f"a hole of {area:.2f} mm^2 in the side of the wall at ({center[0]:.1f}, {center[1]:.1f}, {center[2]:.1f}) "
                "was filled and counts as wall"
            )
        else:
            ends.append((len(fills), area, center, area_vector / max(area, 1e-300)))
        fills.append((triangles, len(extra)))
        vertices = np.concatenate([vertices, extra])
    capped = sum(end[1] for end in ends)
    if capped > MAX_CAP_SHARE * wall_area:
        raise SurfaceError(
            f"{name}: its open ends cover {capped:.1f} mm^2 against {wall_area:.1f} mm^2 of wall; "
            "this is an open sheet, no tube: give a closed mesh"
        )
    ends.sort(key=lambda end: -end[1])
    labels = [np.full(len(faces), -1, dtype=np.int64)] + [np.full(len(triangles), -1, dtype=np.int64) for triangles, _ in fills]
    for rank, (number, _, _, _) in enumerate(ends):
        labels[number + 1][:] = rank
    caps = tuple(Cap(f"C{rank + 1}", "open mesh", center, normal, area) for rank, (_, area, center, normal) in enumerate(ends))
    everything = np.concatenate([faces, *(triangles for triangles, _ in fills)])
    return Closing(vertices, everything, np.concatenate(labels), caps, tuple(notes))


def _fill(vertices: FloatArray, loop: IntArray, first_new: int, area_vector: FloatArray) -> tuple[FloatArray, IntArray]:
    """New vertices and triangles that close one loop.

    A loop that its centroid sees whole gets shrinking rings about as far apart as its
    points; any other is cut into ears.
    """
    points = vertices[loop]
    n = len(loop)
    normal = area_vector / max(float(np.linalg.norm(area_vector)), 1e-300)
    following = np.roll(points, -1, axis=0)
    edges = np.linalg.norm(following - points, axis=1)
    center = points.mean(axis=0)
    weight = np.cross(points - center, following - center) @ normal
    center = center + np.einsum("i,ij->j", weight, (points - center) + (following - center)) / max(
        3.0 * float(weight.sum()), 1e-300
    )
    visible = np.cross(points - center, following - center) @ normal > 0.0
    if n == 3:
        return np.empty((0, 3)), loop[None, :].astype(np.int64)
    if not visible.all():
        return np.empty((0, 3)), _ears(points, loop, normal)
    mean_radius = float(np.linalg.norm(points - center, axis=1).mean())
    rings = max(1, round(mean_radius / max(float(edges.mean()), 1e-12)))
    extra, triangles, outer = [], [], loop
    for ring in range(1, rings):
        inner = first_new + (ring - 1) * n + np.arange(n)
        extra.append(points + (center - points) * (ring / rings))
        a, b, c, d = outer, np.roll(outer, -1), np.roll(inner, -1), inner
        triangles += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
        outer = inner
    apex = first_new + (rings - 1) * n
    triangles.append(np.column_stack([outer, np.roll(outer, -1), np.full(n, apex)]))
    return np.concatenate([*extra, center[None]]), np.concatenate(triangles).astype(np.int64)


def _ears(points: FloatArray, loop: IntArray, normal: FloatArray) -> IntArray:
    """Ear clipping of a loop in the plane across `normal`; always the ear with the widest smallest angle."""
    u = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    u /= np.linalg.norm(u)
    flat = np.column_stack([points @ u, points @ np.cross(normal, u)])
    left, triangles = list(range(len(loop))), []
    while len(left) > 3:
        index = np.array(left)
        before, after = np.roll(index, 1), np.roll(index, -1)
        a, b, c = flat[before], flat[index], flat[after]
        turn = _turn(a, b, c)
        reach = np.maximum(((c - a) ** 2).sum(axis=1), np.maximum(((b - a) ** 2).sum(axis=1), ((c - b) ** 2).sum(axis=1)))
        quality = turn / np.maximum(reach, 1e-300)
        best = None
        for k in np.argsort(-quality):
            others = flat[[i for i in left if i not in (before[k], index[k], after[k])]]
            inside = (_turn(a[k], b[k], others) > 0) & (_turn(b[k], c[k], others) > 0) & (_turn(c[k], a[k], others) > 0)
            if not inside.any():
                best = int(k)
                break
        best = int(np.argmax(quality)) if best is None else best
        triangles.append([before[best], index[best], after[best]])
        left.pop(best)
    triangles.append(left)
    return np.asarray(loop)[np.array(triangles)].astype(np.int64)


def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Twice the signed area of the plane triangles a, b, c."""
    return np.asarray((b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0]))


def closed_and_oriented(faces: IntArray) -> BoolArray:
    """One bool per half-edge: whether its opposite runs exactly once the other way."""
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    span = int(faces.max()) + 1
    forward, backward = half[:, 0] * span + half[:, 1], half[:, 1] * span + half[:, 0]
    keys, count = np.unique(forward, return_counts=True)
    found = np.minimum(np.searchsorted(keys, backward), len(keys) - 1)
    return np.asarray((keys[found] == backward) & (count[found] == 1))
