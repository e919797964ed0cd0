"""The wall of the lumen as the page needs it: a light mesh, and its outline across the path."""

from __future__ import annotations

import base64
import gzip
from dataclasses import dataclass
from typing import Any

import fast_simplification
import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import FloatArray, IntArray
from segmentation.mesh import Surface
from tubeplan_viz.geometry import moving_frames

FACES_SHOWN = 18_000  # a turnable scene stays smooth on a phone; the outline of a tube does not change visibly
DIRECTIONS = 48  # rays across the path at each place
RIM_STEP_MM = 0.01
RIM_REACH_MM = 40.0
RIM_PLACES = 400


def packed(array: ArrayLike, kind: str) -> str:
    """Little-endian bytes of `array` as `kind`, gzip, base64; without a time stamp, so that equal input gives equal text."""
    data = np.ascontiguousarray(np.asarray(array).astype(np.dtype(kind).newbyteorder("<")))
    return base64.b64encode(gzip.compress(data.tobytes(), 6, mtime=0)).decode("ascii")


@dataclass(frozen=True, eq=False)
class LightMesh:
    """A wall with few faces, for drawing only: (n, 3) vertices in mm and (m, 3) faces; `planned` is the count planning used."""

    vertices: FloatArray
    faces: IntArray
    planned: int

    def packed(self) -> dict[str, Any]:
        """16-bit vertices and faces for the page's script, sorted so that they compress well."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        size = np.maximum(high - low, 1e-9)
        order = np.argsort(self.vertices[:, int(size.argmax())], kind="stable")
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        faces = place[self.faces]
        faces = faces[np.argsort(faces.min(axis=1), kind="stable")]
        return {
            "low": [round(float(v), 4) for v in low],
            "high": [round(float(v), 4) for v in high],
            "vertices": packed(np.round((self.vertices[order] - low) / size * 65535), "u2"),
            "faces": packed(faces, "u4" if len(order) > 65535 else "u2"),
            "wide": len(order) > 65535,
        }


def light_mesh(surface: Surface, *, faces: int = FACES_SHOWN) -> LightMesh:
    """At most about `faces` triangles with the shape of `surface`.

    Quadric decimation moves the outline of a tube by far less than a drawn pixel; if it
    gave a mesh whose box differs by more than 2 %, the full mesh is shown instead.
    """
    full = LightMesh(surface.vertices, surface.faces, len(surface.faces))
    if len(surface.faces) <= faces * 1.1:
        return full
    vertices, triangles = fast_simplification.simplify(
        np.ascontiguousarray(surface.vertices, np.float32),
        np.ascontiguousarray(surface.faces, np.int32),
        1.0 - faces / len(surface.faces),
    )
    if len(triangles) < 4 or not np.isfinite(vertices).all():
        return full
    size = np.ptp(surface.vertices, axis=0)
    if np.abs(np.ptp(vertices, axis=0) - size).max() > 0.02 * size.max():
        return full
    return LightMesh(np.asarray(vertices, float), np.asarray(triangles, np.int64), len(surface.faces))


def sideways_frames(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tangents, normals and binormals that turn as little as possible along a polyline, each (n, 3).

    The first normal points across the line and across the body's front-to-back axis: the straightened
    CT of a line that runs along the body begins in the coronal plane, in which it is usually read.
    """
    ahead = points[1] - points[0]
    front = np.array([0.0, 1.0, 0.0]) if abs(ahead[1]) < 0.9 * np.linalg.norm(ahead) else np.array([0.0, 0.0, 1.0])
    frames = moving_frames(points, first=np.cross(ahead, front))
    return frames[:, :, 2], frames[:, :, 0], frames[:, :, 1]


def rims(
    surface: Surface,
    points: FloatArray,
    tangent: FloatArray,
    normal: FloatArray,
    binormal: FloatArray,
    *,
    directions: int = DIRECTIONS,
) -> FloatArray:
    """Distance from the path to the first wall met in each direction across it.

    Parameters
    ----------
    surface : Surface
    points : (n, 3) float array, mm
        Places on the path, in order.
    tangent, normal, binormal : (n, 3) float array
        Frame of the path at each place.
    directions : int
        Direction k points along ``cos(a) normal + sin(a) binormal``, ``a = 2 pi k / directions``.

    Returns
    -------
    (n, directions) float array, mm
        At most `RIM_REACH_MM`, which also stands for "no wall met".
    """
    angle = 2.0 * np.pi * np.arange(directions) / directions
    cosine, sine = np.cos(angle), np.sin(angle)
    faces = surface.wall_faces
    vertices = surface.vertices
    out = np.full((len(points), directions), RIM_REACH_MM)
    for i, point in enumerate(points):
        heights = (vertices - point) @ tangent[i]
        above = heights >= 0.0
        first = above[faces[:, 0]]
        cut = (above[faces[:, 1]] != first) | (above[faces[:, 2]] != first)
        if not cut.any():
            continue
        local = vertices[faces[cut]] - point  # (k, 3, 3)
        height = heights[faces[cut]]
        flat = np.stack([local @ normal[i], local @ binormal[i]], axis=2)  # (k, 3, 2)
        odd = _lone_corner(height)
        rows = np.arange(len(odd))
        ends = []
        for other in (1, 2):
            j = (odd + other) % 3
            share = height[rows, odd] / (height[rows, odd] - height[rows, j])
            ends.append(flat[rows, odd] + share[:, None] * (flat[rows, j] - flat[rows, odd]))
        out[i] = np.minimum(out[i], _first_hits(ends[0], ends[1], cosine, sine))
    # In the plane of an end the wall may just have ended: there the next place stands in, direction by direction.
    if len(out) > 3:
        for end, inner in ((1, 2), (0, 1), (-2, -3), (-1, -2)):
            out[end] = np.where(out[end] < RIM_REACH_MM, out[end], out[inner])
    return out


def _lone_corner(height: FloatArray) -> IntArray:
    """Of each triangle cut by the plane, the corner that is alone on its side."""
    above = height >= 0.0
    alone_above = above.sum(axis=1) == 1
    return np.where(alone_above, above.argmax(axis=1), (~above).argmax(axis=1))


def _first_hits(start: FloatArray, end: FloatArray, cosine: FloatArray, sine: FloatArray) -> FloatArray:
    """Least distance from the origin along each ray to 2D segments, inf where none is hit."""
    # Across the ray: a = -sin x + cos y; the segment is hit where a changes sign.
    across0 = start[:, 1, None] * cosine - start[:, 0, None] * sine  # (k, d)
    across1 = end[:, 1, None] * cosine - end[:, 0, None] * sine
    along0 = start[:, 0, None] * cosine + start[:, 1, None] * sine
    along1 = end[:, 0, None] * cosine + end[:, 1, None] * sine
    # A ray through a corner that two segments share must hit one of them in spite of rounding.
    span = across0 - across1
    sloped = np.abs(span) > 1e-12
    share = np.divide(across0, span, out=np.full_like(across0, -1.0), where=sloped)
    crossed = (share >= -1e-6) & (share <= 1.0 + 1e-6)
    distance = along0 + share * (along1 - along0)
    return np.where(crossed & (distance >= 0.0), distance, np.inf).min(axis=0)
