"""Drawings of a rigid plan's page: CT planes with labels, entry map, instrument in its corridor, distances, goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from reports.slices import png
from reports.svg import LEFT, RIGHT, Axis, Width, chart, grid, nice_step, path_axis, tag, trace
from segmentation.arrays import BoolArray, FloatArray
from segmentation.volume import Volume

LABEL_COLORS = {
    "brain": "#b8688a",
    "orbit_left": "#c79a1e",
    "orbit_right": "#c79a1e",
    "septum": "#2f7fd0",
    "turbinate_left": "#c4553f",
    "turbinate_right": "#c4553f",
    "nostril border": "#8a93a0",
}
GOAL_NAMES = ("brain", "orbit", "septum", "turbinate", "length", "tissue")
FIELD_MM, PIXELS = 100.0, 220
HU_LOW, HU_HIGH = -1000.0, 1000.0
PLANES = {
    "axial": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    "coronal": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])),
    "sagittal": (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])),
}
BEST_CLASSES = {"overall": "rigid-overall", "brain": "rigid-brain", "length": "rigid-length", "tissue": "rigid-tissue"}
LABEL_ROOM = 60.0  # drawing units that a word takes beside its place
SHOWN_BEHIND_MM = 45.0


def label_picture(
    volume: Volume, structures: Mapping[str, BoolArray], center: FloatArray, plane: str, points: Sequence[Any] | None
) -> Markup:
    """A CT plane through a place with the labels' colours mixed in, the path and a cross drawn over it."""
    right, down = PLANES[plane]
    offset = ((np.arange(PIXELS) + 0.5) / PIXELS - 0.5) * FIELD_MM
    places = center + offset[:, None, None] * down + offset[None, :, None] * right
    index = np.rint(volume.to_index(places)).astype(int)
    inside = ((index >= 0) & (index < np.array(volume.voxels.shape))).all(axis=-1)
    index[~inside] = 0
    key = tuple(np.moveaxis(index, -1, 0))
    grey = np.clip((volume.voxels[key].astype(float) - HU_LOW) / (HU_HIGH - HU_LOW), 0.0, 1.0) * 255.0 * inside
    picture: NDArray[np.float64] = np.repeat(grey[..., None], 3, axis=-1)
    for name, mask in structures.items():
        here = mask[key] & inside
        picture[here] = 0.62 * picture[here] + 0.38 * rgb(LABEL_COLORS[name])
    full = np.concatenate([picture, np.full((*grey.shape, 1), 255.0)], axis=-1).astype(np.uint8)
    parts = [
        Markup('<image href="{}" width="{}" height="{}"/>').format(png(full), PIXELS, PIXELS),
    ]
    if points is not None:
        offsets = np.array(points, float) - center
        at = np.column_stack([offsets @ right, offsets @ down]) / FIELD_MM * PIXELS + 0.5 * PIXELS
        way = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in at[::5])
        parts.append(tag("path", class_="rigid-way", d=way))
    middle = 0.5 * PIXELS
    parts.append(tag("path", class_="rigid-cross", d=f"M{middle - 7} {middle}h14M{middle} {middle - 7}v14"))
    words = f"CT, {plane}, {FIELD_MM:.0f} mm wide, with labels"
    return _svg((PIXELS, PIXELS), words, parts)


def rgb(color: str) -> FloatArray:
    """Red, green and blue of ``#rrggbb``.

    Examples
    --------
    >>> rgb("#0a10ff").tolist()
    [10.0, 16.0, 255.0]
    """
    return np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)], dtype=float)


def entry_map(entry: Mapping[str, Any], goal: FloatArray, side: str) -> Markup:
    """Entry voxels seen along the way to the lesion; the foremost of those behind each other is on top, feasible ones first."""
    points = np.array(entry["points_mm"], float)
    feasible = np.array(entry["feasible"], bool)
    blocked = np.array(entry["blocked_by"], int)
    names = entry["structures"]
    ahead = goal - points.mean(axis=0)
    ahead /= np.linalg.norm(ahead)
    across = np.cross(ahead, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    down = np.cross(ahead, across)
    # Seen from in front of the face: the patient's left is on the right.
    flat = np.column_stack([-(points @ across), points @ down])
    if flat[:, 0] @ (points[:, 0] - points[:, 0].mean()) < 0.0:
        flat[:, 0] *= -1.0
    if flat[:, 1] @ (points[:, 2] - points[:, 2].mean()) > 0.0:
        flat[:, 1] *= -1.0
    low, high = flat.min(axis=0) - 2.0, flat.max(axis=0) + 2.0
    scale = 400.0 / float(max(high - low))
    size = (high - low) * scale
    pitch = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1])) if len(points) > 1 else 1.0
    side_px, step = 1.1 * pitch * scale, 0.5 * pitch * scale
    # Voxels behind each other fall on the same half pitch; the feasible ones come last and are what is seen.
    seen: dict[tuple[int, int], str] = {}
    for k in np.argsort(feasible, kind="stable"):
        x, y = (flat[k] - low) * scale
        color = "var(--holds)" if feasible[k] else LABEL_COLORS.get(names[blocked[k]] if blocked[k] >= 0 else "", "#8a93a0")
        place = (round(x / step), round(y / step))
        seen.pop(place, None)
        seen[place] = color
    parts = [
        Markup('<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" style="fill:{}"/>').format(
            i * step - 0.5 * side_px, j * step - 0.5 * side_px, side_px, side_px, color
        )
        for (i, j), color in seen.items()
    ]
    bar = 5.0 * scale
    parts.append(tag("path", class_="rigid-bar", d=f"M8 {size[1] + 14:.1f}h{bar:.1f}"))
    parts.append(tag("text", "5 mm", class_="axis", x=bar + 14, y=float(size[1] + 18)))
    words = f"Entry region of the {side} nostril: {int(feasible.sum())} of {len(points)} voxels feasible"
    return _svg((float(size[0]), float(size[1]) + 24.0), words, parts)


def corridor_view(result: Mapping[str, Any], axes: tuple[int, int], signs: tuple[float, float]) -> Markup:
    """Instrument at each node, paths and entry region projected onto two axes; the second runs upwards."""
    details = result["details"]
    tool, goal = details["instrument"], np.array(details["goal_mm"], float)
    flip = np.array(signs) * [1.0, -1.0]

    def flat(points: Any) -> FloatArray:
        return np.asarray(np.atleast_2d(np.array(points, float))[:, list(axes)] * flip)

    shapes: list[tuple[str, FloatArray, float]] = []
    last = len(details["nodes"]) - 1
    for k, node in enumerate(details["nodes"]):
        way, tip, front = (np.array(node[name], float) for name in ("direction", "tip_mm", "endoscope_front_mm"))
        back = SHOWN_BEHIND_MM + float(np.linalg.norm(tip - np.array(result["path"]["points_mm"][0], float)))
        radius = 0.5 * tool["shaver_diameter_mm"]
        tone = "" if k == last else " rigid-early"
        shapes.append((f"rigid-shaver{tone}", np.array([tip - back * way, tip - radius * way]), radius))
        shapes.append((f"rigid-scope{tone}", np.array([front - back * way, front]), 0.5 * tool["scope_diameter_mm"]))
    entry = np.array(details["entry"]["points_mm"], float)[np.array(details["entry"]["feasible"], bool)]
    extent = np.vstack([*(flat(line) for _, line, _ in shapes), flat(entry), flat(goal)])
    low, high = extent.min(axis=0) - 6.0, extent.max(axis=0) + 6.0
    scale = 560.0 / float((high - low).max())
    size = (high - low) * scale
    parts = [
        tag("rect", class_="rigid-entry", x=float(x), y=float(y), width=2.0, height=2.0)
        for x, y in (flat(entry)[:: max(1, len(entry) // 600)] - low) * scale
    ]
    for name, line, radius in shapes:
        a, b = (flat(line) - low) * scale
        cap = "round" if "shaver" in name else "butt"
        parts.append(
            Markup('<path class="{}" d="M{:.1f} {:.1f}L{:.1f} {:.1f}" style="stroke-width:{:.1f};stroke-linecap:{}"/>').format(
                name, a[0], a[1], b[0], b[1], 2.0 * radius * scale, cap
            )
        )
    for points in details["best_paths"]:
        parts.append(tag("path", class_="rigid-thin", d=_way((flat(points) - low) * scale)))
    parts.append(tag("path", class_="rigid-way", d=_way((flat(result["path"]["points_mm"][::5]) - low) * scale)))
    x, y = (flat(goal)[0] - low) * scale
    parts.append(tag("circle", class_="rigid-goal", cx=float(x), cy=float(y), r=4.0))
    beside, anchor = (-7.0, "end") if x > size[0] - LABEL_ROOM else (7.0, "start")
    parts.append(tag("text", "lesion", class_="axis", x=float(x) + beside, y=float(y) - 6, text_anchor=anchor))
    bar = 10.0 * scale
    parts.append(tag("path", class_="rigid-bar", d=f"M8 {size[1] - 8:.1f}h{bar:.1f}"))
    parts.append(tag("text", "10 mm", class_="axis", x=bar + 14, y=float(size[1]) - 4))
    return _svg((float(size[0]), float(size[1])), "Instrument at each node, to scale", parts)


def distances_chart(result: Mapping[str, Any], width: Width) -> Markup:
    """Distances to the structures over arc length."""
    s = np.array(result["path"]["s_mm"], float)
    rows = {
        name: np.array([np.nan if v is None else v for v in values], float)
        for name, values in result["details"]["structure_distances_mm"].items()
    }
    rows = {name: values for name, values in rows.items() if np.isfinite(values).any()}
    shown = min(30.0, max(float(np.nanmax(values)) for values in rows.values()))
    step = nice_step(shown, 4)
    wide, tall = width.plot, 190.0
    x, y = Axis(0.0, float(s[-1]), LEFT, wide - RIGHT), Axis(0.0, step * np.ceil(shown / step), tall - 22.0, 12.0)
    parts = [*grid((x.start, x.end), y, step), *path_axis(float(s[-1]), x, y.start, wide - LEFT - RIGHT)]
    limit = float(result["limits"]["clearance_min_mm"])
    if limit > 0.0:
        parts.append(tag("line", class_="limit", x1=x.start, x2=x.end, y1=y(limit), y2=y(limit)))
    for name, values in rows.items():
        keep = np.isfinite(values)
        line = Markup('<path class="rigid-line" style="stroke:{}" d="{}"><title>{}</title></path>')
        parts.append(line.format(LABEL_COLORS[name], trace(s[keep], values[keep], x, y), name.replace("_", " ")))
    told = ", ".join(f"{name.replace('_', ' ')} {np.nanmin(values):.2f}" for name, values in rows.items())
    words = f"Distance of the instrument to each structure over arc length; least, mm: {told}."
    return chart(width, (wide, tall), words, parts, kind="distance", y=y, marks=Markup(""))


def place_in_the_way(details: Mapping[str, Any]) -> tuple[str, FloatArray] | None:
    """The structure that blocks most straight pushes and the place of it nearest to the lesion; None where none is blocked."""
    entry = details["entry"]
    blocked = np.array(entry["blocked_by"], int)
    if not (blocked >= 0).any():
        return None
    worst = int(np.bincount(blocked[blocked >= 0]).argmax())
    places = np.array([place for place, k in zip(entry["blocked_at_mm"], blocked, strict=True) if k == worst], float)
    nearest = places[np.linalg.norm(places - np.array(details["goal_mm"], float), axis=1).argmin()]
    return str(entry["structures"][worst]).replace("_", " "), nearest


def goals_chart(details: Mapping[str, Any]) -> Markup:
    """Parallel coordinates: one line per path through its six normalised goals, the best at the bottom."""
    rows = details["candidates"]
    width, tall, top = 720.0, 280.0, 26.0
    xs = np.linspace(60.0, width - 60.0, len(GOAL_NAMES))
    y = Axis(0.0, 1.0, tall - 26.0, top)
    parts = []
    for k, name in enumerate(GOAL_NAMES):
        parts.append(tag("line", class_="grid", x1=float(xs[k]), x2=float(xs[k]), y1=y.start, y2=y.end))
        parts.append(tag("text", name, class_="axis", x=float(xs[k]), y=tall - 6, text_anchor="middle"))
    parts.append(tag("text", "1, worst", class_="axis", x=8.0, y=top + 4))
    parts.append(tag("text", "0, best", class_="axis", x=8.0, y=tall - 24))
    best = {choice["path"]: BEST_CLASSES[name] for name, choice in reversed(list(details["best"].items()))}
    ordered = sorted(range(len(rows)), key=lambda i: (i in best, rows[i]["pareto"]))
    step = max(1, len(rows) // 500)
    for place, i in enumerate(ordered):
        if i not in best and place % step:
            continue
        name = best.get(i, "rigid-pareto" if rows[i]["pareto"] else "rigid-any")
        spots = np.column_stack([xs, y.of(np.array(rows[i]["normalised"], float))])
        parts.append(tag("path", class_=f"rigid-path {name}", d=_way(spots)))
    legend = (
        ("overall", "overall best"),
        ("brain", "farthest from the brain"),
        ("length", "shortest"),
        ("tissue", "least tissue"),
    )
    for k, (key, told) in enumerate(legend):
        at = 60.0 + 165.0 * k
        parts.append(tag("path", class_=f"rigid-path {BEST_CLASSES[key]}", d=f"M{at} 10h18"))
        parts.append(tag("text", told, class_="axis", x=at + 24, y=14.0))
    return _svg((width, tall), "Goals of every path, normalised", parts)


def _way(points: FloatArray) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _svg(size: tuple[float, float], words: str, parts: Sequence[Markup]) -> Markup:
    return Markup('<svg width="{0:.0f}" viewBox="0 0 {0:.0f} {1:.0f}" role="img" aria-label="{2}">{3}</svg>').format(
        size[0], size[1], words, Markup("").join(parts)
    )
