"""A picture of the scene made without a graphics card: for print, and where WebGL is missing.

The wall is drawn by its outline, as in the turnable scene: the more it turns away from
the viewer, the denser. Path, flags and labels are vectors on top, so they stay sharp
and take the page's colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from reports.plates import HEIGHT, LETTER, RIM, nearest_edge, raster, stand
from reports.slices import png
from reports.svg import tag
from reports.wall import LightMesh
from segmentation.arrays import FloatArray

WIDE, TALL, MARGIN = 340, 470, 30
SHARPNESS = 2.0  # raster pixels per drawing unit
WALL_RGB = (141, 117, 101)


@dataclass(frozen=True, eq=False)
class View:
    """Where the viewer stands: unit vectors towards the viewer, up and to the right, each (3,)."""

    toward: FloatArray
    up: FloatArray

    @property
    def right(self) -> FloatArray:
        """Unit vector to the viewer's right."""
        return np.cross(self.up, self.toward)


@dataclass(frozen=True, eq=False)
class Label:
    """A named place in the scene: ``kind`` start, goal, clearance or curvature; lower `rank` is kept first when room is short."""

    point: FloatArray
    text: str
    kind: str
    rank: int


@dataclass(frozen=True, eq=False)
class Solid:
    """A further body of the scene: ``colour`` as ``#rrggbb``; `dense` hides most of what lies behind, else it is glass."""

    mesh: LightMesh
    colour: str
    dense: bool


@dataclass(frozen=True, eq=False)
class Dots:
    """Places drawn as dots, (n, 3) mm, with their class of the style sheet."""

    points: FloatArray
    name: str


def choose_view(points: FloatArray, frame: str) -> View:
    """From the front of the patient for LPS; for a mesh, facing the plane in which the points spread most.

    The first point is at the bottom of the picture in a mesh frame.
    """
    if frame == "LPS":
        return View(_unit(np.array([0.18, -1.0, 0.1])), np.array([0.0, 0.0, 1.0]))
    _, vectors = np.linalg.eigh(np.cov((points - points.mean(axis=0)).T))
    up, toward = vectors[:, 2], vectors[:, 0]
    if float((points[-1] - points[0]) @ up) < 0.0:
        up = -up
    if toward[int(np.abs(toward).argmax())] < 0.0:
        toward = -toward
    return View(toward, up)


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


def still_picture(
    mesh: LightMesh | None,
    path: FloatArray,
    stretches: Sequence[tuple[str, int, int]],
    labels: Sequence[Label],
    view: View,
    words: str,
    *,
    lines: Sequence[tuple[str, FloatArray]] = (),
    solids: Sequence[Solid] = (),
    dots: Sequence[Dots] = (),
    most: int = 8,
) -> Markup:
    """The scene as one <svg>.

    Parameters
    ----------
    mesh : LightMesh or None
    path : (n, 3) float array, mm; may be empty
    stretches : sequence of (kind, first index, last index)
        Flagged parts of the path.
    labels : sequence of Label
    view : View
    words : str
        What the picture shows, for those who cannot see it.
    lines : sequence of (class, (n, 3) float array in mm)
        Further paths, each with its class of the style sheet.
    solids : sequence of Solid
        Further bodies, over the wall in this order; they do not decide how large the picture is drawn.
    dots : sequence of Dots
    most : int
        Labels that are shown, those of least rank.
    """
    toward = _unit(view.toward)
    right = _unit(np.cross(view.up, toward))
    axes = np.stack([right, np.cross(toward, right), toward], axis=1)  # columns: right, up, depth
    shown = (mesh.vertices if mesh is not None else np.vstack([path.reshape(-1, 3), *(line for _, line in lines)])) @ axes
    if len(shown) == 0:
        return Markup("")
    low, high = shown[:, :2].min(axis=0), shown[:, :2].max(axis=0)
    scale = min((WIDE - 2 * MARGIN) / max(high[0] - low[0], 1e-6), (TALL - 2 * MARGIN) / max(high[1] - low[1], 1e-6))
    centre = (low + high) / 2

    def place(points: FloatArray) -> FloatArray:
        flat = points @ axes
        return np.stack([(flat[:, 0] - centre[0]) * scale + WIDE / 2, TALL / 2 - (flat[:, 1] - centre[1]) * scale], axis=1)

    parts: list[Markup] = []
    if mesh is not None:
        layers = []
        for body, colour, dense in ((mesh, WALL_RGB, False), *((s.mesh, _rgb(s.colour), s.dense) for s in solids)):
            if len(body.faces):
                depth = (body.vertices @ axes)[:, 2] * scale * SHARPNESS
                layers.append(_glass(np.column_stack([place(body.vertices) * SHARPNESS, depth]), body, colour, dense=dense))
        if layers:
            picture = layers[0] if len(layers) == 1 else _over(layers)
            parts.append(Markup('<image width="{}" height="{}" href="{}"/>').format(WIDE, TALL, png(picture)))
    for some in dots:
        spots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in place(some.points))
        parts.append(tag("path", class_=f"still-dots {some.name}", d=spots))
    if len(path) > 1:
        line = place(path)
        parts.append(_line(line, "still-path"))
        parts += [_line(line[first : last + 1], f"still-flag {kind}") for kind, first, last in stretches if last > first]
        parts += [tag("circle", class_="end", cx=float(p[0]), cy=float(p[1]), r=4.5) for p in (line[0], line[-1])]
    parts += [_line(place(line), name) for name, line in lines]
    if labels:
        drawn = raster(
            (TALL, WIDE),
            place(mesh.vertices) if mesh is not None else np.empty((0, 2)),
            [place(line) for line in (path, *(line for _, line in lines)) if len(line)],
        )
        shown_labels = sorted(labels, key=lambda label: label.rank)[:most]
        parts += _labels(shown_labels, place(np.array([label.point for label in shown_labels])), drawn)
    return Markup('<svg class="still" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
        WIDE, TALL, words, Markup("").join(parts)
    )


def _line(points: FloatArray, name: str) -> Markup:
    thin = points[:: max(1, len(points) // 300)]
    if not np.array_equal(thin[-1], points[-1]):
        thin = np.vstack([thin, points[-1]])
    return tag("path", class_=name, d="M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in thin))


def _labels(labels: Sequence[Label], spots: FloatArray, drawn: FloatArray) -> list[Markup]:
    """Labels beside their places, where they hide least, with leaders."""
    widths = [LETTER * len(label.text) + RIM for label in labels]
    corners = stand(spots, widths, drawn, bottom=float(TALL))
    parts: list[Markup] = []
    for label, spot, corner, width in zip(labels, spots, corners, widths, strict=True):
        if not np.isfinite(corner).all():
            continue
        end = nearest_edge(spot, corner[:1], corner[1:], width)[0]
        x, y = (float(v) for v in corner)
        parts += [
            tag("line", class_=f"leader {label.kind}", x1=float(spot[0]), y1=float(spot[1]), x2=float(end[0]), y2=float(end[1])),
            tag("rect", class_=f"plate {label.kind}", x=x, y=y, width=width, height=HEIGHT, rx=4),
            tag("text", label.text, class_=f"plate-text {label.kind}", x=x + width / 2, y=y + 14, text_anchor="middle"),
        ]
    return parts


def _rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of ``#rrggbb``.

    Examples
    --------
    >>> _rgb("#0a10ff")
    (10, 16, 255)
    """
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def _over(layers: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures laid over each other, the first one below."""
    colour, cover = np.zeros((*layers[0].shape[:2], 3)), np.zeros((*layers[0].shape[:2], 1))
    for layer in layers:
        alpha = layer[..., 3:] / 255.0
        colour = layer[..., :3] * alpha + colour * (1.0 - alpha)
        cover = alpha + cover * (1.0 - alpha)
    picture = np.concatenate([colour / np.maximum(cover, 1e-6), 255.0 * cover], axis=2)
    return np.clip(picture, 0.0, 255.0).astype(np.uint8)


def _glass(pixels: FloatArray, mesh: LightMesh, colour: tuple[int, int, int], *, dense: bool) -> NDArray[np.uint8]:
    """A body as (h, w, 4) pixels: front and back layer, each dense where it is seen edge on; a dense one everywhere.

    Triangles are filled by points: each gets as many as its area asks for, and the
    nearest (or farthest) of those that fall on a pixel decides its density.
    """
    height, width = round(TALL * SHARPNESS), round(WIDE * SHARPNESS)
    corner = pixels[mesh.faces]  # (m, 3, 3) right, down, toward
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(cross, axis=1)
    facing = np.abs(cross[:, 2]) / np.maximum(area, 1e-12)
    normal = np.zeros((len(pixels), 3))
    for k in range(3):  # smooth shading: normals at the vertices, weighted by area
        np.add.at(normal, mesh.faces[:, k], cross)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    tilt = np.abs(normal[:, 2])[mesh.faces]  # (m, 3)
    edge = np.linalg.norm(corner[:, :, :2] - corner[:, [1, 2, 0], :2], axis=2).max(axis=1)
    order = np.clip(np.ceil(edge * 1.35), 1, 60).astype(int)
    flat: list[NDArray[np.int64]] = []
    depth: list[FloatArray] = []
    lean: list[FloatArray] = []
    for n in np.unique(order):
        rows = np.flatnonzero((order == n) & (area > 0) & (facing > 0.01))
        weights = np.array([(a + 1 / 3, b + 1 / 3, n - a - b - 2 / 3) for a in range(n) for b in range(n - a)]) / n
        spots = np.einsum("wk,mkc->mwc", weights, corner[rows]).reshape(-1, 3)
        column, row = np.floor(spots[:, 0]).astype(int), np.floor(spots[:, 1]).astype(int)
        seen = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        flat.append((row * width + column)[seen])
        depth.append(spots[seen, 2])
        lean.append((tilt[rows] @ weights.T).reshape(-1)[seen])
    where, away, facing_at = np.concatenate(flat), np.concatenate(depth), np.concatenate(lean)
    density = np.zeros(width * height)
    # The farthest layer first, then the nearest over it.
    for sign, face, rim in ((-1.0, 0.10, 0.30), (1.0, 0.85, 0.15) if dense else (1.0, 0.06, 0.74)):
        best = np.full(width * height, -np.inf)
        np.maximum.at(best, where, sign * away)
        top = sign * away >= best[where]
        layer = np.zeros(width * height)
        layer[where[top]] = face + rim * (1.0 - facing_at[top]) ** 3
        density += layer * (1.0 - density)
    picture = np.empty((height, width, 4), np.uint8)
    picture[..., :3] = colour
    picture[..., 3] = (density * 255).reshape(height, width).astype(np.uint8)
    return picture
