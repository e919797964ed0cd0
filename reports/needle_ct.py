"""A needle in its surroundings: CT planes through the tightest place and along the needle, and the scene in space."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from skimage.measure import find_contours

from reports.parts import Drawing
from reports.places import PLANES
from reports.slices import Window, cut, png, windows_for
from reports.still import Label, Solid, View, choose_view, still_picture
from reports.svg import tag
from reports.turnable import turnable
from reports.wall import LightMesh, light_mesh
from segmentation.arrays import BoolArray, FloatArray
from segmentation.mesh import Surface
from segmentation.volume import Volume
from tubeplan_viz.needle.shape import level_surface

FIELD_MM = 70.0
PIXELS = 220
CONTOUR_STEPS = 110
NEAR_MM = 3.0  # of the path counts as in the plane
BESIDE_MM = 22.0  # of what stands beside the path is shown in space
BODY = "#c47400"  # of obstacles in the picture that stands still: the style sheet's --clearance
SCALE_MM = 10.0
LETTER_MM = 3.8
SIDES = ((-0.95, 0.03, "start"), (0.95, 0.03, "end"), (0.0, -0.88, "middle"), (0.0, 0.95, "middle"))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What a needle goes through, for drawing.

    Attributes
    ----------
    volume : Volume or None
        The CT.
    distance : callable or None
        Signed distance, mm, of (k, 3) points to the nearest obstacle, (k,); None without obstacles.
    """

    volume: Volume | None
    distance: Callable[[FloatArray], FloatArray] | None


@dataclass(frozen=True, eq=False)
class Plane:
    """A square plane of the CT: its middle and the directions to the right and down, (3,), its side in mm."""

    title: str
    middle: FloatArray
    right: FloatArray
    down: FloatArray
    field: float
    letters: Sequence[str] = ()


def ct_drawings(result: Mapping[str, Any], around: Surroundings) -> tuple[tuple[Drawing, ...], Window | None]:
    """Planes through the tightest place and along the needle, and the window they are shown in; nothing without CT or path."""
    path = result["path"]
    if around.volume is None or path is None:
        return (), None
    points = np.array(path["points_mm"], float)
    index = np.clip(np.round(around.volume.to_index(points)).astype(int), 0, np.array(around.volume.voxels.shape) - 1)
    window = windows_for(None, float(np.median(around.volume.voxels[tuple(index.T)])))[0]
    tight = int(np.argmin(path["clearance_mm"])) if path["clearance_mm"] else len(points) // 2
    planes = [along_needle(points, tight)]
    for _, name, right, down, letters in PLANES:
        planes.append(Plane(name, points[tight], np.array(right), np.array(down), FIELD_MM, letters))
    safety = float(result["limits"]["clearance_min_mm"])
    return tuple(Drawing(p.title, picture(p, points, around, window, safety, here=points[tight])) for p in planes), window


def along_needle(points: FloatArray, tight: int) -> Plane:
    """The plane of the straight way in which the tightest place lies, or the largest bend where that is on the way."""
    way = points[-1] - points[0]
    right = way / np.linalg.norm(way)
    aside = points - points[0] - ((points - points[0]) @ right)[:, None] * right
    far = aside[tight] if np.linalg.norm(aside[tight]) > 0.5 else aside[int(np.linalg.norm(aside, axis=1).argmax())]
    if np.linalg.norm(far) < 1e-6:
        far = np.cross(right, np.eye(3)[int(np.abs(right).argmin())])
    down = far / np.linalg.norm(far)
    field = float(np.linalg.norm(way)) + 24.0
    return Plane("Along the needle", 0.5 * (points[0] + points[-1]), right, down, field)


def picture(plane: Plane, points: FloatArray, around: Surroundings, window: Window, safety: float, *, here: FloatArray) -> Markup:
    """One plane: CT, outlines of obstacles and safety shell, the path (faint where it leaves the plane)."""
    assert around.volume is not None
    half = plane.field / 2.0
    grey = png(cut(around.volume, plane.middle, plane.right, plane.down, window, pixels=PIXELS, field=plane.field))
    parts = [Markup('<image x="{0}" y="{0}" width="{1}" height="{1}" href="{2}"/>').format(-half, plane.field, grey)]
    if around.distance is not None:
        steps = (np.arange(CONTOUR_STEPS) + 0.5) * plane.field / CONTOUR_STEPS - half
        places = plane.middle + steps[:, None, None] * plane.down + steps[None, :, None] * plane.right
        gaps = around.distance(places.reshape(-1, 3)).reshape(CONTOUR_STEPS, CONTOUR_STEPS)
        for name, level in (("ct-shell", safety), ("ct-body", 0.0)):
            for line in find_contours(gaps, level):
                at = (line[:, ::-1] + 0.5) * plane.field / CONTOUR_STEPS - half
                parts.append(tag("path", class_=name, d="M" + "L".join(f"{a:.2f} {b:.2f}" for a, b in at)))
    offset = points - plane.middle
    flat = np.column_stack([offset @ plane.right, offset @ plane.down])
    near = np.abs(offset @ np.cross(plane.right, plane.down)) <= NEAR_MM
    parts.append(tag("path", class_="path-line far", d="M" + "L".join(f"{a:.2f} {b:.2f}" for a, b in flat[::4])))
    for first, last in runs(near):
        line = flat[first : last + 1]
        parts.append(tag("path", class_="path-line", d="M" + "L".join(f"{a:.2f} {b:.2f}" for a, b in line)))
    size = LETTER_MM if plane.letters else 0.7 * LETTER_MM  # the plane along the needle is drawn larger
    spot = (float((here - plane.middle) @ plane.right), float((here - plane.middle) @ plane.down))
    parts.append(tag("circle", class_="here", cx=f"{spot[0]:.2f}", cy=f"{spot[1]:.2f}", r=f"{0.25 * size:.2f}"))
    for word, (x, y, anchor) in zip(plane.letters, SIDES, strict=False):
        parts.append(letter(word, x * half, y * half, size, anchor))
    left, bottom = -0.94 * half, 0.93 * half
    parts.append(tag("path", class_="ct-scale", d=f"M{left:.2f} {bottom:.2f}h{SCALE_MM:.2f}"))
    parts.append(letter("10 mm", left, bottom - 0.4 * size, 0.9 * size, "start"))
    label = f"CT, {plane.title.lower()}: path, outlines of obstacles, and their safety distance dashed"
    return Markup('<svg class="cut" viewBox="{0} {0} {1} {1}" role="img" aria-label="{2}">{3}</svg>').format(
        -half, plane.field, label, Markup("").join(parts)
    )


def letter(word: str, x: float, y: float, size: float, anchor: str) -> Markup:
    """A word over a plane, mm."""
    return tag("text", word, class_="side", x=f"{x:.2f}", y=f"{y:.2f}", text_anchor=anchor, style=f"font-size:{size:.2f}px")


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """First and last index of each run of true values that is two long or more."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, np.int8), [0]])))
    return [(int(a), int(b - 1)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]


@dataclass(frozen=True, eq=False)
class Space:
    """The path and what stands beside it, to be turned: the picture that stands still and what the script needs."""

    still: Markup
    scene: Mapping[str, Any]


def space_of(result: Mapping[str, Any], around: Surroundings, ramp: tuple[float, float] | None) -> Space | None:
    """Obstacles beside the path as glass, with the path, what was pushed, and both ends; None in the plane or without a path."""
    path = result["path"]
    if path is None or around.distance is None or result["planner"]["name"] == "needle2d":
        return None
    points = np.array(path["points_mm"], float)
    vertices, faces = level_surface(around.distance, points, beside=BESIDE_MM)
    if not len(faces):
        return None
    shown = light_mesh(Surface(vertices, faces, np.full(len(faces), -1), frame="mesh"))
    # The path's points belong to no face; with them the picture is wide enough for both.
    mesh = LightMesh(np.vstack([shown.vertices, points]), shown.faces, shown.planned)
    labels = [Label(points[0], "Entry", "start", 0), Label(points[-1], "Target", "goal", 0)]
    tight = int(np.argmin(path["clearance_mm"]))
    labels.append(Label(points[tight], f"{path['clearance_mm'][tight]:.2f} mm", "clearance", 1))
    insertion = result["details"].get("insertion")
    pushed = np.array(insertion["points_mm"], float) if insertion else None
    lines = [] if pushed is None else [("needle-pushed", pushed)]
    view = choose_view(points, "LPS") if result["frame"] == "LPS" else downwards(points)
    words = "obstacles beside the path, planned path from entry to target"
    # Its colour is the obstacles': the mesh itself only says how large the picture is drawn.
    frame, bodies = LightMesh(mesh.vertices, mesh.faces[:0], mesh.planned), [Solid(shown, BODY, dense=False)]
    still = still_picture(frame, points, (), labels, view, f"In space: {words}.", lines=lines, solids=bodies)
    return Space(still, turnable(mesh, view, labels, start=tight, ramp=ramp, before=pushed, body="--clearance", words=words))


def downwards(points: FloatArray) -> View:
    """A view with the entry above the target, from the side to which the path bends, a little from above."""
    up = points[0] - points[-1]
    up /= np.linalg.norm(up)
    aside = points - points[0] - ((points - points[0]) @ up)[:, None] * up
    bend = aside[int(np.linalg.norm(aside, axis=1).argmax())]
    if np.linalg.norm(bend) < 1e-6:
        bend = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    across = np.cross(up, bend / np.linalg.norm(bend))
    toward = across + 0.5 * bend / np.linalg.norm(bend) + 0.3 * up
    toward /= np.linalg.norm(toward)
    return View(toward, up - (up @ toward) * toward)
