"""Path and obstacles of a needle drawn flat, on one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from reports.parts import Drawing
from segmentation.arrays import FloatArray

VIEW_SIZE = 560  # px of the longest side of all drawings together; they share one scale
CLOUD_SIZE = 300


@dataclass(frozen=True, eq=False)
class Layer:
    """Lines of one class of the style sheet, each (n, 3) mm."""

    name: str
    lines: Sequence[FloatArray]


def layers_of(result: Mapping[str, Any]) -> list[Layer]:
    """What is drawn over the obstacles: forms, insertions at random, the path, the pushed path."""
    details, path = result["details"], result["path"]
    chances = details.get("monte_carlo") or {}
    made = [
        Layer("needle-form", [np.array(f["points_mm"], float) for f in details.get("forms", ()) if f["feasible"]]),
        Layer("needle-trial", [np.array(line, float) for line in chances.get("paths_mm", ())]),
        Layer("needle-path", [] if path is None else [np.array(path["points_mm"], float)[::2]]),
        Layer("needle-pushed", [np.array(details["insertion"]["points_mm"], float)] if details.get("insertion") else []),
    ]
    return [layer for layer in made if layer.lines]


def cloud_drawings(result: Mapping[str, Any]) -> tuple[Drawing, ...]:
    """The swarm's population at a few rounds, each with the final path, seen so that the path's bend shows most."""
    clouds, path = result["details"].get("population") or (), result["path"]
    if not clouds:
        return ()
    ends = np.array([result["details"]["entry_mm"], result["details"]["target_mm"]], float)
    along = int(np.abs(ends[1] - ends[0]).argmax())
    line = ends if path is None else np.array(path["points_mm"], float)
    spread = [-1.0 if axis == along else float(np.ptp(line[:, axis])) for axis in range(3)]
    axes = (int(np.argmax(spread)), along)
    final = [] if path is None else [Layer("needle-path", [line[::4]])]
    extent = np.vstack([ends, line, *(np.array(strip, float) for strip in clouds[-1]["paths_mm"])])
    return tuple(
        Drawing(
            f"Round {cloud['round']}",
            flat_view(
                result,
                axes,
                [Layer("needle-swarm", [np.array(strip, float) for strip in cloud["paths_mm"]]), *final],
                f"{len(cloud['paths_mm'])} paths of the swarm in round {cloud['round']}, and the final path past the obstacles",
                size=CLOUD_SIZE,
                extent=extent,
            ),
        )
        for cloud in clouds
    )


def flat_view(
    result: Mapping[str, Any],
    axes: tuple[int, int],
    layers: Sequence[Layer],
    words: str,
    *,
    size: int = VIEW_SIZE,
    extent: FloatArray | None = None,
) -> Markup:
    """Lines and obstacles projected onto two axes; the second runs downwards.

    Parameters
    ----------
    result : mapping
    axes : (int, int)
        To the right and down.
    layers : sequence of Layer
    words : str
        What the drawing shows, for those who cannot see it.
    size : int, px
        Of the longest side of all that is seen.
    extent : (k, 3) float array, mm, optional
        What must be seen; everything that is drawn by default.
    """
    details = result["details"]
    safety = result["limits"]["clearance_min_mm"]
    ends = np.array([details["entry_mm"], details["target_mm"]], float)
    bodies = [_outline(body) for body in details.get("obstacles", ())]
    if extent is None:
        extent = np.vstack(
            [
                ends,
                *(line for layer in layers for line in layer.lines),
                *(c + s * r for c, r in bodies if r >= 0 for s in (-1.0, 1.0)),
                *(c for c, r in bodies if r < 0),
            ]
        )
    room = 6.0 + safety
    low, high = extent.min(axis=0) - room, extent.max(axis=0) + room
    scale = size / float(max(high - low))
    depth = next(axis for axis in range(3) if axis not in axes)
    slab = (low[depth], high[depth])
    low, high = low[list(axes)], high[list(axes)]
    low, high = np.minimum(low, 0.5 * (low + high) - 20.0), np.maximum(high, 0.5 * (low + high) + 20.0)
    box = (high - low) * scale

    def spot(points: FloatArray) -> FloatArray:
        return (np.atleast_2d(points)[:, list(axes)] - low) * scale

    drawn: list[Markup] = []
    for body, (centers, radius) in zip(details.get("obstacles", ()), bodies, strict=True):
        drawn += _body(body, spot(centers), radius * scale, safety * scale)
        rim = np.array(body.get("outline_mm", ()), float).reshape(-1, 3)
        # A file's obstacle may reach far to either side of what is drawn: of that only what lies beside the path.
        for x, y in spot(rim[(rim[:, depth] >= slab[0]) & (rim[:, depth] <= slab[1])]):
            if 0.0 <= x <= box[0] and 0.0 <= y <= box[1]:
                drawn.append(Markup('<circle class="needle-rim" cx="{:.1f}" cy="{:.1f}" r="1.5"/>').format(x, y))
    for layer in layers:
        drawn += [Markup('<path class="{}" d="{}"/>').format(layer.name, _way(spot(line))) for line in layer.lines]
    same = np.linalg.norm(spot(ends[0]) - spot(ends[1])) < 14.0
    for place, word in zip(ends, ("entry, target", "") if same else ("entry", "target"), strict=True):
        x, y = spot(place)[0]
        side, anchor = (-7, "end") if x > 0.75 * box[0] else (7, "start")
        drawn.append(Markup('<circle class="needle-dot" cx="{:.1f}" cy="{:.1f}" r="4"/>').format(x, y))
        drawn.append(
            Markup('<text class="needle-words" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(
                x + side, y + 4, anchor, escape(word)
            )
        )
    drawn.append(
        Markup(
            '<path class="needle-path" d="M8 {0:.1f}h{1:.1f}"/><text class="needle-words" x="8" y="{2:.1f}">10 mm</text>'
        ).format(box[1] - 8, 10.0 * scale, box[1] - 13)
    )
    return Markup('<svg width="{0:.0f}" viewBox="0 0 {0:.0f} {1:.0f}" role="img" aria-label="{2}">{3}</svg>').format(
        box[0], box[1], words, Markup("").join(drawn)
    )


def _body(body: Mapping[str, Any], spots: FloatArray, radius: float, safety: float) -> list[Markup]:
    """One obstacle and its safety shell, in px."""
    if body["kind"] in ("sphere", "circle"):
        x, y = spots[0]
        return [
            Markup('<circle class="{}" cx="{:.1f}" cy="{:.1f}" r="{:.1f}"/>').format(name, x, y, r)
            for name, r in (("needle-body", radius), ("needle-shell", radius + safety))
        ]
    if not len(spots):
        return []
    closed = body["kind"] == "polygon"
    way = _way(spots) + ("Z" if closed else "")
    size = 0.0 if closed else radius
    return [
        Markup('<path class="{}" d="{}" style="stroke-width:{:.1f}"/>').format(name, way, max(width, 1.0))
        for name, width in (("needle-rod-shell", 2 * (size + safety)), ("needle-body" if closed else "needle-rod", 2 * size))
    ]


def _outline(body: Mapping[str, Any]) -> tuple[FloatArray, float]:
    """Points of an obstacle's middle, (k, 3) mm, and its radius around them; a file's obstacle has no points here."""
    if "center_mm" in body:
        return np.array([body["center_mm"]], float), float(body["radius_mm"])
    if "points_mm" in body:
        return np.array(body["points_mm"], float), float(body.get("radius_mm", -1.0))
    return np.zeros((0, 3)), -1.0


def _way(points: Sequence[Sequence[float]] | FloatArray) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
