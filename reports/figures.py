"""Charts as static SVG: readable without scripts, on paper and on a phone.

Each chart is drawn for three widths, of which the style sheet shows one, so that
type keeps its size. A script only moves the cursor that is already in the drawing:
``data-left``, ``data-right`` and the value range stand on the element for that.
Colours come from the style sheet through classes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.numbers import printed
from reports.svg import LEFT, RIGHT, Axis, Width, chart, frame, grid, nice_step, path_axis, step_digits, tag, trace
from segmentation.arrays import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Profile:
    """One quantity over arc length, before and after, with its limit and the stretches that break it.

    `kind` is ``clearance`` (the limit is a least value) or ``curvature`` (a largest one);
    `flags` hold ``from_mm``, ``to_mm``, ``worst``, ``worst_at_mm``.
    """

    kind: str
    arc: FloatArray
    values: FloatArray
    limit: float | None
    flags: Sequence[Mapping[str, Any]]
    label: str
    limit_label: str
    worst_label: str
    short_limit_label: str = ""
    before_arc: FloatArray | None = None
    before: FloatArray | None = None
    with_axis: bool = False


def _value_range(spec: Profile) -> tuple[float, float, float]:
    """Lowest and highest value shown, and the step of the grid."""
    asked = [] if spec.limit is None else [spec.limit]
    high = max([float(spec.values.max()), *asked]) * (1.15 if spec.kind == "curvature" else 1.06)
    low = min(0.0, float(spec.values.min()))
    if spec.before is not None:  # the first curve is shown whole unless it would flatten the planned one
        high = min(max(high, float(spec.before.max()) * 1.05), 1.7 * high)
    high = max(high, 1e-6)
    step = nice_step(high - low, 4)
    return math.floor(low / step) * step, math.ceil(high / step - 1e-9) * step, step


def profile_chart(spec: Profile, width: Width) -> Markup:
    """Limit as a thin line, before dashed, the planned curve, deficits filled, worst place ringed."""
    wide, tall = width.plot, (132 if width.name == "wide" else 140) + (14 if spec.with_axis else 0)
    low, high, step = _value_range(spec)
    length = float(spec.arc[-1])
    x, y = Axis(0.0, length, LEFT, wide - RIGHT), Axis(low, high, tall - (22 if spec.with_axis else 6), 16)
    parts = [
        tag(
            "rect",
            class_=f"band {spec.kind}",
            x=x(f["from_mm"]),
            width=max(3.0, x(f["to_mm"]) - x(f["from_mm"])),
            y=y.end,
            height=y.start - y.end,
        )
        for f in spec.flags
    ]
    parts += grid((LEFT, wide - RIGHT), y, step)
    if spec.with_axis:
        parts += path_axis(length, x, y.start, wide - LEFT - RIGHT)
    if spec.limit is not None:
        broken = np.minimum(spec.values, spec.limit) if spec.kind == "clearance" else np.maximum(spec.values, spec.limit)
        closing = f"L{x.end:.1f} {y(spec.limit):.1f}L{x.start:.1f} {y(spec.limit):.1f}Z"
        parts.append(tag("path", class_=f"excess {spec.kind}", d=trace(spec.arc, broken, x, y) + closing))
    parts += _before(spec, x, y)
    if spec.limit is not None:
        level = y(spec.limit)
        parts.append(tag("line", class_="limit", x1=x.start, x2=x.end, y1=level, y2=level))
    parts.append(tag("path", class_="after", d=trace(spec.arc, spec.values, x, y)))
    if spec.limit is not None:
        parts.append(_limit_label(spec, x, y, short=width.name != "wide"))
    parts += [tag("circle", class_=f"worst {spec.kind}", cx=x(f["worst_at_mm"]), cy=y(f["worst"]), r=4.0) for f in spec.flags]
    parts += _worst_label(spec, x, y)
    return chart(width, (wide, tall), spec.label, parts, kind=spec.kind, y=y, marks=Markup('<circle r="4"/>'))


def _before(spec: Profile, x: Axis, y: Axis) -> list[Markup]:
    if spec.before is None or spec.before_arc is None:
        return []
    shown = spec.before_arc <= x.high  # the first curve can be longer than the planned one
    parts = [tag("path", class_="before", d=trace(spec.before_arc[shown], spec.before[shown], x, y))]
    peak = int(spec.before[shown].argmax())
    if spec.before[peak] > y.high:  # a curve that leaves the range is cut and its peak printed
        at = min(max(x(float(spec.before_arc[peak])), x.start + 45), x.end - 45)
        parts.append(
            tag(
                "text",
                f"before: {printed(float(spec.before[peak]), 2)} ↑",
                class_="note",
                x=at,
                y=y.end - 5,
                text_anchor="middle",
            )
        )
    return parts


def _limit_label(spec: Profile, x: Axis, y: Axis, *, short: bool) -> Markup:
    """The limit in words, where it covers least of curves, bands and the worst place's figure."""
    assert spec.limit is not None  # the caller asked
    words = spec.short_limit_label if short and spec.short_limit_label else spec.limit_label
    level = y(spec.limit)
    curves = [(spec.arc, spec.values)]
    if spec.before is not None and spec.before_arc is not None:
        curves.append((spec.before_arc, spec.before))
    taken = _worst_place(spec, x, y)
    bands = [(x(flag["from_mm"]), x(flag["to_mm"])) for flag in spec.flags] + ([taken[:2]] if taken is not None else [])
    at, height = free_place(words, level, curves, bands, x, y)
    return tag("text", words, class_="limit-label halo", x=at, y=height)


def free_place(
    words: str,
    level: float,
    curves: Sequence[tuple[FloatArray, FloatArray]],
    taken: Sequence[tuple[float, float]],
    x: Axis,
    y: Axis,
) -> tuple[float, float]:
    """Where words beside a horizontal line at `level` cover least: left end and base line, as near to the left as is free."""
    room = 6.4 * len(words) + 8
    drawn = [(x.of(arc), y.of(values)) for arc, values in curves]
    best: tuple[float, float, float] = (-math.inf, x.start, level - 6)
    for base, top, bottom in ((level - 6, level - 18.0, level - 1.0), (level + 14, level + 1.0, level + 18.0)):
        if bottom > y.start or top < y.end - 16:
            continue
        for start in np.linspace(x.start + 4, max(x.end - room, x.start + 4), 32):
            end = float(start) + room
            covered = sum(_share_inside(px, py, float(start), end, top, bottom) for px, py in drawn)
            crowd = any(start < high and end > low for low, high in taken)
            score = -2.0 * covered - 0.5 * crowd - 0.02 * (start - x.start) / (x.end - x.start)
            best = max(best, (score, float(start), base))
    return best[1], best[2]


def _share_inside(px: FloatArray, py: FloatArray, left: float, right: float, top: float, bottom: float) -> float:
    """Share of a curve's samples between two x that lie between two heights."""
    near = (px >= left - 2) & (px <= right + 2)
    return float(np.mean((py[near] > top - 2) & (py[near] < bottom + 2))) if near.any() else 0.0


def _worst_place(spec: Profile, x: Axis, y: Axis) -> tuple[float, float, float, bool] | None:
    """Left and right end of the worst place's figure, its base line, and whether it stands left of its band.

    Beside its own band, or else over the place itself: wherever curve, limit and the bands of others leave it readable.
    """
    if not spec.flags:
        return None
    worst = (min if spec.kind == "clearance" else max)(spec.flags, key=lambda f: f["worst"])
    room = 7.0 * len(spec.worst_label) + 10
    low, high = x(worst["from_mm"]), x(worst["to_mm"])
    others = [(x(flag["from_mm"]), x(flag["to_mm"])) for flag in spec.flags if flag is not worst]
    level = None if spec.limit is None else y(spec.limit)
    beside = min(max(y(worst["worst"]) + (18 if spec.kind == "clearance" else -8), y.end + 10), y.start - 4)
    at = x(worst["worst_at_mm"])
    over = min(max(at - room / 2, x.start + 4), x.end - room)
    spans = [(high + 8, high + 8 + room, False), (low - 8 - room, low - 8, True), (over, over + room, False)]
    px, py = x.of(spec.arc), y.of(spec.values)
    best: tuple[float, float, tuple[float, float, float, bool]] | None = None
    for rank, (left, right, turned) in enumerate(spans):
        if left < x.start or right > x.end:
            continue
        crowded = any(left < end and right > begin for begin, end in others)
        for base in (beside, *np.arange(y.end + 12, y.start - 4, 6.0).tolist()):
            crossed = level is not None and base - 12 < level < base + 3
            score = _share_inside(px, py, left, right, base - 11, base + 2) + crossed + crowded
            away = rank + 0.01 * (abs(base - beside) + max(left - at, at - right, 0.0))
            order = (round(score, 2), away, (left, right, base, turned))
            best = order if best is None or order < best else best
    return None if best is None else best[2]


def _worst_label(spec: Profile, x: Axis, y: Axis) -> list[Markup]:
    """The figure of the worst flagged place, beside its band on the side that has room."""
    place = _worst_place(spec, x, y)
    if place is None:
        return []
    left, right, height, turned = place
    return [
        tag(
            "text",
            spec.worst_label,
            class_=f"worst-label {spec.kind}",
            x=right if turned else left,
            y=height,
            text_anchor="end" if turned else "start",
        )
    ]


def part_labels(x: Axis, length: float, parts_named: Sequence[Mapping[str, Any]]) -> list[Markup]:
    """A line over each part of the anatomy, with its name where there is room; the last, where the goal is, may reach back."""
    made: list[Markup] = []
    free = 0.0
    for part in parts_named:
        start, end = x(max(part["from_mm"], 0.0)), x(min(part["to_mm"], length))
        made.append(tag("line", class_="part", x1=start + 1, x2=end - 1, y1=19.5, y2=19.5))
        wide, middle = 6.2 * len(part["name"]), (start + end) / 2
        if wide < end - start:
            made.append(tag("text", str(part["name"]), class_="part-name", x=middle, y=12, text_anchor="middle"))
            free = middle + wide / 2 + 12
        elif part is parts_named[-1] and end - wide > free:
            made.append(tag("text", str(part["name"]), class_="part-name", x=end, y=12, text_anchor="end"))
    return made


def strip_chart(
    length: float,
    shares: FloatArray,
    flags: Sequence[Mapping[str, Any]],
    parts_named: Sequence[Mapping[str, Any]],
    label: str,
    width: Width,
) -> Markup:
    """The whole path as one bar: parts of the anatomy above, flags in two lanes, distance below.

    `shares` is the roominess of each equal piece of the path, 0 tight to 1 roomy.
    """
    wide, tall = width.strip, 82
    x = Axis(0.0, length, 7, wide - 7)
    parts = part_labels(x, length, parts_named)
    for k, share in enumerate(shares):
        start, end = x(k * length / len(shares)), x((k + 1) * length / len(shares))
        mix = f"fill:color-mix(in srgb, var(--roomy) {100 * share:.0f}%, var(--tight))"
        parts.append(tag("rect", x=start, width=end - start + 0.5, y=38, height=8, style=mix))
    for flag in flags:
        lane = 27 if flag["kind"] == "clearance" else 46
        start, wide_mark = x(flag["from_mm"]), max(4.0, x(flag["to_mm"]) - x(flag["from_mm"]))
        names = [f"flag-solid {flag['kind']}"] + (["flag-hatch"] if flag["kind"] == "curvature" else [])
        parts += [tag("rect", class_=name, x=start, width=wide_mark, y=lane, height=11, rx=2) for name in names]
    parts += [tag("circle", class_="end", cx=x(at), cy=42, r=5) for at in (0.0, length)]
    step = nice_step(length, max(2, int(wide / 75)))
    digits = step_digits(step)
    last = f"{printed(length, 1)} mm"
    for k in range(int(length / step + 1e-9) + 1):
        at = x(k * step)
        parts.append(tag("line", class_="tick", x1=at, x2=at, y1=61, y2=65))
        if k == 0 or at < wide - 7.0 * len(last) - 16:
            parts.append(
                tag(
                    "text",
                    f"{k * step:.{digits}f}" + ("" if k else " mm"),
                    class_="axis",
                    x=at if k else 1,
                    y=78,
                    text_anchor="middle" if k else "start",
                )
            )
    parts.append(tag("text", last, class_="axis", x=wide - 1, y=78, text_anchor="end"))
    parts.append(Markup('<g class="cursor"><line y1="24" y2="60"/><path d="M-5 20h10l-5 6z"/></g>'))
    return frame(width, (wide, tall), label, parts, data_chart="strip", data_left=7, data_right=7)


@dataclass(frozen=True, eq=False, kw_only=True)
class Steps:
    """The worst value of one limit after each iteration, or of a robot after each step; `full` draws it as wide as a path's."""

    kind: str
    values: FloatArray
    limit: float | None
    limit_label: str
    label: str
    full: bool = False


def step_chart(spec: Steps, width: Width) -> Markup:
    """A figure per iteration against its limit; the dot says whether the limit is kept."""
    wide, tall = width.plot if spec.full else width.half, 150
    asked = [] if spec.limit is None else [spec.limit]
    low, high = min([float(spec.values.min()), *asked]), max([float(spec.values.max()), *asked])
    spread = max(high - low, 0.05 * abs(high), 1e-6)
    # Room below the lowest value, but none for values that cannot be where nothing is below zero.
    low = 0.0 if spec.kind == "curvature" else max(low - 0.3 * spread, 0.0 if low >= 0.0 else -math.inf)
    step = nice_step(high + 0.2 * spread - low, 4)
    low, high = math.floor(low / step) * step, math.ceil((high + 0.12 * spread) / step) * step
    last = max(len(spec.values) - 1, 1)
    x, y = Axis(0.0, last, LEFT, wide - RIGHT), Axis(low, high, tall - 22, 12)
    parts = grid((LEFT, wide - RIGHT), y, step)
    every = max(1, math.ceil(nice_step(last, max(2, int(wide / 45))))) if last > 1 else 1
    parts += [tag("text", str(k), class_="axis", x=x(k), y=tall - 6, text_anchor="middle") for k in range(0, last + 1, every)]
    index = np.arange(len(spec.values), dtype=float)
    parts.append(tag("path", class_="after", d=trace(index, spec.values, x, y)))
    if spec.limit is not None:
        level = y(spec.limit)
        parts.append(tag("line", class_="limit", x1=LEFT, x2=wide - RIGHT, y1=level, y2=level))
        dense = np.linspace(0.0, last, 400)
        at, height = free_place(spec.limit_label, level, [(dense, np.interp(dense, index, spec.values))], [], x, y)
        parts.append(tag("text", spec.limit_label, class_="limit-label halo", x=at, y=height))
    for k, value in enumerate(spec.values):
        # A command at the limit itself comes back from radians with its last digits changed.
        beyond = 0.0 if spec.limit is None else (spec.limit - value) * (1.0 if spec.kind == "clearance" else -1.0)
        kept = beyond <= 1e-9 * abs(spec.limit or 0.0)
        parts.append(
            tag(
                "circle",
                class_=f"step {'holds' if kept else spec.kind}",
                cx=x(k),
                cy=y(float(value)),
                r=2.75 if last < 80 else 1.75,
            )
        )
    return frame(width, (wide, tall), spec.label, parts)


def growth_chart(limits: FloatArray, volumes: FloatArray, chosen: float, leak: float | None, label: str, width: Width) -> Markup:
    """Grown volume against the varied HU limit, the chosen limit and the leak marked."""
    wide, tall = width.half, 190
    order = np.argsort(limits)
    limits, volumes = limits[order], volumes[order]
    step_y = nice_step(max(float(volumes.max()), 1e-6), 4)
    left = 52
    x = Axis(float(limits[0]), float(limits[-1]), left, wide - RIGHT)
    y = Axis(0.0, math.ceil(float(volumes.max()) / step_y - 1e-9) * step_y or step_y, tall - 22, 16)
    parts = grid((left, wide - RIGHT), y, step_y)
    step = nice_step(x.high - x.low, max(2, int(wide / 110)))
    for k in range(math.ceil(x.low / step - 1e-9), math.floor(x.high / step + 1e-9) + 1):
        at = x(k * step)
        end = "end" if at > wide - RIGHT - 24 else "start" if at < left + 20 else "middle"
        parts.append(tag("text", f"{printed(k * step, step_digits(step))} HU", class_="axis", x=at, y=tall - 6, text_anchor=end))
    parts.append(tag("path", class_="after", d=trace(limits, volumes, x, y)))
    parts += [tag("circle", class_="sample", cx=x(float(a)), cy=y(float(b)), r=2) for a, b in zip(limits, volumes, strict=True)]
    marks, words = [("limit", "limit-label", chosen, "chosen", 10.0)], []  # words last: no line runs through one
    if leak is not None:
        marks.append(("leak", "leak-label", leak, "leaks at", 10.0))
    for line, name, hu, word, height in marks:
        at = x(min(max(hu, x.low), x.high))
        text = f"{word} {printed(hu, 0)} HU"
        room = 6.2 * len(text) + 8
        other = chosen if line == "leak" else leak
        turned = hu < other if other is not None else at > (left + wide) / 2  # each on its own side of the pair
        if turned and at - room < left:
            turned = False
        elif not turned and at + room > wide:
            turned = True
        crossed = other is not None and min(at, at - room if turned else at + room) < x(other) < max(
            at, at - room if turned else at + room
        )
        parts.append(tag("line", class_=line, x1=at, x2=at, y1=y.end - 8, y2=y.start))
        words.append(
            tag(
                "text",
                text,
                class_=f"{name} halo",
                x=at + (-6 if turned else 6),
                y=height + 14 * crossed,
                text_anchor="end" if turned else "start",
            )
        )
    return frame(width, (wide, tall), label, [*parts, *words])
