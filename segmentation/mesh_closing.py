"""Open borders of a mesh: followed as loops and filled, the tube's ends as caps and holes in its side as wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import SurfaceError
from segmentation.mesh import Cap
from segmentation.mesh_repair import EdgeMap

MAX_OPEN_LOOPS = 40
# An open end closes a tube, it is not most of it: a straight tube as long as wide has caps of half its wall.
MAX_CAP_SHARE = 0.6
# Around a tube's open end the wall stands along the end's normal, around a hole in its side across it.
SIDE_HOLE_COSINE = 0.7


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

    Parameters
    ----------
    vertices : (n, 3) float array, mm
    faces : (m, 3) int array
        Looking outward, or inward, consistently; fills follow their sense.
    loops : list of (k,) int arrays
        Vertices of each open border in order.
    name : str
        Of the file, for messages.

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
