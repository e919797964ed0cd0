"""The run as coloured meshes for slides: wall, path, flagged stretches, start and goal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from segmentation.mesh import Surface
from segmentation.mesh_exports import ScenePart
from tubeplan_viz.geometry import moving_frames

AROUND = 12
PATH_RADIUS, FLAG_RADIUS, END_RADIUS = 0.4, 0.7, 1.0  # mm; flags stand out from the path
# The report's colours (design tokens, light), turned from sRGB to linear light as glTF wants them.
COLORS = {
    "wall": "#8d7565",
    "path": "#0b5c9e",
    "clearance": "#e08a00",
    "curvature": "#c8410b",
    "start": "#16202b",
    "goal": "#16202b",
}
WALL_OPACITY = 0.35


def scene_parts(result: Mapping[str, Any], surface: Surface | None) -> list[ScenePart]:
    """Wall, path, flags and ends of a run; what it does not have is left out."""
    parts = []
    if surface is not None:
        parts.append(ScenePart(name="wall", vertices=surface.vertices, faces=surface.faces, color=linear("wall", WALL_OPACITY)))
    if result["path"] is None:
        return parts
    s, points = np.array(result["path"]["s_mm"]), np.array(result["path"]["points_mm"])
    parts.append(_part("path", "path", points, PATH_RADIUS))
    for number, flag in enumerate(result["flagged_intervals"], start=1):
        inside = np.flatnonzero((s > flag["from_mm"]) & (s < flag["to_mm"]))
        ends = np.array([[np.interp(at, s, points[:, k]) for k in range(3)] for at in (flag["from_mm"], flag["to_mm"])])
        line = np.concatenate([ends[:1], points[inside], ends[1:]])
        if flag["to_mm"] - flag["from_mm"] > 1e-6:
            parts.append(_part(f"flag {number} {flag['kind']}", flag["kind"], distinct(line), FLAG_RADIUS))
    for name, point in (("start", points[0]), ("goal", points[-1])):
        vertices, faces = octasphere(point, END_RADIUS)
        parts.append(ScenePart(name=name, vertices=vertices, faces=faces, color=linear(name)))
    return parts


def _part(name: str, color: str, line: FloatArray, radius: float) -> ScenePart:
    vertices, faces = swept_tube(line, radius)
    return ScenePart(name=name, vertices=vertices, faces=faces, color=linear(color))


def linear(name: str, opacity: float = 1.0) -> tuple[float, float, float, float]:
    """A colour of the report in linear light with its opacity (IEC 61966-2-1)."""
    coded = [int(COLORS[name][k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in coded)
    return red, green, blue, opacity


def distinct(line: FloatArray) -> FloatArray:
    """A polyline without vertices that repeat the one before; its last vertex stays."""
    keep = np.concatenate([np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-9, [True]])
    return np.asarray(line[keep])


def swept_tube(line: FloatArray, radius: float) -> tuple[FloatArray, IntArray]:
    """A closed tube of `AROUND` sides along a polyline: vertices (n, 3) mm and faces (m, 3), outward."""
    frames = moving_frames(line)  # (k, 3, 3): normal, binormal, tangent
    turn = 2.0 * np.pi * np.arange(AROUND) / AROUND
    ring = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    rings = line[:, None] + np.einsum("aj,kij->kai", ring, frames[:, :, :2])
    count = len(line)
    station, side = (grid.ravel() for grid in np.meshgrid(np.arange(count - 1), np.arange(AROUND), indexing="ij"))
    a, b = station * AROUND + side, station * AROUND + (side + 1) % AROUND
    first, last = count * AROUND, count * AROUND + 1
    near, far = np.arange(AROUND), (count - 1) * AROUND + np.arange(AROUND)
    faces = np.concatenate(
        [
            np.column_stack([a, b, a + AROUND]),
            np.column_stack([b, b + AROUND, a + AROUND]),
            np.column_stack([np.full(AROUND, first), np.roll(near, -1), near]),
            np.column_stack([np.full(AROUND, last), far, np.roll(far, -1)]),
        ]
    )
    return np.concatenate([rings.reshape(-1, 3), line[[0, -1]]]), faces.astype(np.int64)


def octasphere(center: FloatArray, radius: float, rounds: int = 3) -> tuple[FloatArray, IntArray]:
    """A sphere from an octahedron whose faces are quartered `rounds` times."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(rounds):
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, place = np.unique(edges, axis=0, return_inverse=True)
        middle = vertices[unique].mean(axis=1)
        new = len(vertices) + place.reshape(-1, 3)
        vertices = np.concatenate([vertices, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        a, b, c = faces.T
        ab, bc, ca = new.T
        faces = np.concatenate([np.column_stack(part) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return center + radius * vertices, faces.astype(np.int64)
