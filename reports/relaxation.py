"""What would have to give where the limits cannot be met: the proof or its absence, the single changes, the line between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.numbers import Phrase, Source, phrase, printed
from reports.svg import RIGHT, Axis, Width, frame, grid, in_all_widths, nice_step, step_digits, tag
from reports.tables import DASH, or_dash

KEY = "details.relaxation"
WAY = "details.bottleneck"
FOOT = 36


@dataclass(frozen=True)
class Change:
    """One limit: what was asked for, what would do with the other limit kept, and by how much it differs."""

    name: str
    asked: Phrase
    would_do: Phrase
    change: Phrase
    smallest: bool


@dataclass(frozen=True)
class Relief:
    """The section of a run whose limits no path was found to keep."""

    lead: Phrase
    changes: tuple[Change, ...]
    line: tuple[tuple[Phrase, Phrase], ...]
    line_words: Phrase
    chart: Markup


def relief(source: Source) -> Relief | None:
    """The smallest changes that make a path feasible, or None for a run that needs or looked for none."""
    told = (source.result.get("details") or {}).get("relaxation")
    if not told:
        return None
    trades = told.get("pareto") or []
    return Relief(
        lead=_lead(source, told),
        changes=_changes(source, told),
        line=tuple(
            (
                or_dash(source.figure(f"{KEY}.pareto.{k}.bend_radius_mm", 2)),
                phrase(source.need(f"{KEY}.pareto.{k}.clearance_mm", 3)),
            )
            for k in range(len(trades))
        ),
        line_words=_line_words(trades),
        chart=_chart(source, trades),
    )


def _lead(source: Source, told: Mapping[str, Any]) -> Phrase:
    bound = source.figure(f"{WAY}.clearance_upper_bound_mm", 3, "mm")
    required = source.figure(f"{WAY}.required_mm", 3, "mm")
    way = (source.result.get("details") or {}).get("bottleneck") or {}
    bend = way.get("bend")
    bent = source.figure(f"{WAY}.bend.clearance_upper_bound_mm", 3, "mm") if bend else None
    said: list[Any] = []
    if bend and bent is not None and required is not None and bend["proves_impossible"]:
        at = ", ".join(printed(float(value), 1) for value in bend["point_mm"])
        said += ["Proved: under the curvature limit no path past the bend keeps ", bent, f", at ({at}) mm; ", required]
        said += [" are asked for. "]
    elif bound is not None and required is not None and way.get("proves_impossible"):
        at = ", ".join(printed(float(value), 1) for value in way["point_mm"])
        said += ["Proved: whatever its bends, no path keeps more than ", bound, f", at ({at}) mm; ", required]
        said += [" are asked for. "]
    elif bent is not None:
        said += ["No path was found, and none is excluded: under the curvature limit the sharpest bend leaves less than ", bent]
        said += [". "]
    elif bound is not None:
        said += ["No path was found, and none is excluded: the widest way through the lumen leaves at most ", bound]
        said += [" at its narrowest place. "]
    smallest = told.get("smallest")
    said.append(f"The smallest change that would do is of the {smallest}." if smallest else "No single change was found to do.")
    return phrase(*said)


def _changes(source: Source, told: Mapping[str, Any]) -> tuple[Change, ...]:
    """Instrument radius alone, then bend radius alone."""
    rows = (
        ("instrument radius", "limits.clearance_min_mm", f"{KEY}.clearance_mm", f"{KEY}.clearance_change_percent", 3),
        ("bend radius", "derived:bend_radius_limit_mm", f"{KEY}.bend_radius_mm", f"{KEY}.bend_radius_change_percent", 2),
    )
    made = []
    for name, asked, would_do, change, digits in rows:
        value, percent = source.figure(would_do, digits, "mm"), source.figure(change, 1, "%", signed=True)
        made.append(
            Change(
                name=f"{name[:1].upper()}{name[1:]}",
                asked=or_dash(source.figure(asked, digits, "mm")),
                would_do=phrase("none found") if value is None else phrase(value),
                change=DASH if percent is None else phrase(percent),
                smallest=told.get("smallest") == name,
            )
        )
    return tuple(made)


def _line_words(trades: Sequence[Mapping[str, Any]]) -> Phrase:
    if len(trades) < 2:
        return phrase("No bend radius helps: there is no trade between the two.")
    return phrase("Every point is proved: an instrument of this bend radius and at most this radius has a path.")


def _chart(source: Source, trades: Sequence[Mapping[str, Any]]) -> Markup:
    """Instrument radius against bend radius; empty with fewer than two trades."""
    asked = (source.value("derived:bend_radius_limit_mm"), source.value("limits.clearance_min_mm"))
    if len(trades) < 2 or asked[0] is None or asked[1] is None:
        return Markup("")
    bends = np.array([1.0 / trade["curvature_per_mm"] for trade in trades])
    radii = np.array([trade["clearance_mm"] for trade in trades])
    return in_all_widths(partial(_draw, bends, radii, (asked[0], asked[1])))


def _draw(bends: np.ndarray, radii: np.ndarray, asked: tuple[float, float], width: Width) -> Markup:
    wide, tall, left = width.half, 210, 52
    low, high = (float(f(np.append(bends, asked[0]))) for f in (np.min, np.max))
    pad = 0.12 * (high - low)
    x = Axis(low - pad, high + pad, left, wide - RIGHT)
    low, high = (float(f(np.append(radii, asked[1]))) for f in (np.min, np.max))
    step = nice_step(1.3 * (high - low), 4)
    y = Axis(step * np.floor(low / step - 0.2), step * np.ceil(high / step + 0.2), tall - FOOT, 12)
    parts = grid((left, wide - RIGHT), y, step)
    across = nice_step(x.high - x.low, max(2, int(wide / 110)))
    digits = step_digits(across)
    for k in range(int(np.ceil(x.low / across)), int(np.floor(x.high / across)) + 1):
        at = x(k * across)
        parts.append(tag("line", class_="tick", x1=at, x2=at, y1=y.start, y2=y.start + 4))
        parts.append(tag("text", printed(k * across, digits), class_="axis", x=at, y=y.start + 16, text_anchor="middle"))
    parts.append(tag("text", "bend radius, mm", class_="axis", x=wide - RIGHT, y=tall - 4, text_anchor="end"))
    order = np.argsort(bends)
    corners = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x.of(bends[order]), y.of(radii[order]), strict=True))
    parts.append(tag("path", class_="after", d=f"M{corners}"))
    parts += [tag("circle", class_="sample", cx=x(float(a)), cy=y(float(b)), r=3) for a, b in zip(bends, radii, strict=True)]
    parts.append(tag("circle", class_="asked-point", cx=x(asked[0]), cy=y(asked[1]), r=5))
    words = tag("text", "asked for", class_="limit-label halo", x=x(asked[0]) - 9, y=y(asked[1]) + 4, text_anchor="end")
    label = (
        f"Instrument radius that has a path, against the bend radius: {printed(float(radii.min()), 2)} mm at "
        f"{printed(float(bends.max()), 1)} mm to {printed(float(radii.max()), 2)} mm at {printed(float(bends.min()), 1)} mm; "
        f"asked for are {printed(asked[1], 2)} mm at {printed(asked[0], 1)} mm."
    )
    return frame(width, (wide, tall), label, [*parts, words])
