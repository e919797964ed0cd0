"""Charts of a needle's page: convergence of each goal, the Pareto front, final errors of insertions at random."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.numbers import printed
from reports.svg import LEFT, RIGHT, Axis, Width, frame, in_all_widths, nice_step, step_digits, tag
from segmentation.arrays import FloatArray

TALL = 190
BINS = 24
GOAL_WIDTHS = {"wide": 400, "narrow": 350, "print": 250}  # px; three beside each other on a wide page and in print
GOALS = (("error_mm", "Tip error", "mm"), ("length_mm", "Length", "mm"), ("danger", "Danger", ""))


def convergence_charts(rounds: Sequence[Mapping[str, Any]]) -> tuple[tuple[str, str, Markup], ...]:
    """Title, unit and chart of each goal of the swarm's best path by round."""
    if len(rounds) < 2:
        return ()
    made = []
    for key, title, unit in GOALS:
        values = np.array([state[key] for state in rounds], float)
        words = f"{title} of the swarm's best path by round, from {printed(values[0], 3)} to {printed(values[-1], 3)} {unit}"
        swarms = np.array([state["swarm"] for state in rounds])
        index = np.array([state["round"] for state in rounds], float)
        lines = [(index[swarms == k], values[swarms == k]) for k in np.unique(swarms)]
        logged = key == "error_mm" and bool(values.min() > 0.0)
        made.append((title, unit, in_all_widths(partial(line_chart, lines, words.rstrip(), log=logged))))
    return tuple(made)


def line_chart(lines: Sequence[tuple[FloatArray, FloatArray]], words: str, width: Width, *, log: bool) -> Markup:
    """Lines over rounds; with `log` the heights are their decimal logarithms."""
    wide = GOAL_WIDTHS[width.name]
    shown = [(xs, np.log10(ys) if log else ys) for xs, ys in lines]
    last = max(float(xs.max()) for xs, _ in shown)
    x = Axis(0.0, max(last, 1.0), LEFT + 8, wide - RIGHT)
    heights = np.concatenate([ys for _, ys in shown])
    parts, y = heights_of(float(heights.min()), float(heights.max()), x, log=log)
    parts += ticks(x, y.start, "rounds")
    for xs, ys in shown:
        spots = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x.of(xs), y.of(ys), strict=True))
        parts.append(tag("path", class_="needle-line", d=f"M{spots}"))
    return frame(width, (wide, TALL), words, parts)


def heights_of(low: float, high: float, x: Axis, *, log: bool = False) -> tuple[list[Markup], Axis]:
    """Horizontal lines with their values, and the scale of the heights."""
    if log:
        low, high = math.floor(low), max(math.ceil(high), math.floor(low) + 1)
        step = float(max(1, math.ceil((high - low) / 5)))
    else:
        step = nice_step(max(high - low, 1e-6), 4)
        low, high = math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step
        high = max(high, low + step)
    y = Axis(low, high, TALL - 24, 24)
    parts: list[Markup] = []
    for k in range(round((high - low) / step) + 1):
        value = low + k * step
        text = f"{10.0**value:g}" if log else printed(value, step_digits(step))
        parts.append(tag("line", class_="grid" if k else "base", x1=x.start, x2=x.end, y1=y(value), y2=y(value)))
        parts.append(tag("text", text, class_="axis", x=x.start - 6, y=y(value) + 4, text_anchor="end"))
    return parts, y


def ticks(x: Axis, height: float, unit: str) -> list[Markup]:
    """Values under a chart, the first with the unit."""
    step = nice_step(max(x.high - x.low, 1e-9), max(2, int((x.end - x.start) / 64)))
    first, digits = math.ceil(x.low / step - 1e-9), step_digits(step)
    values = [k * step for k in range(first, math.floor(x.high / step + 1e-9) + 1)]
    parts = []
    for value in values:
        at = x(value)
        parts.append(tag("line", class_="tick", x1=at, x2=at, y1=height, y2=height + 4))
        first = value == values[0]
        text = f"{printed(value, digits)} {unit}" if first else printed(value, digits)
        left, anchor = (8.0, "start") if first else (0.0, "middle")
        parts.append(tag("text", text, class_="axis", x=at - left, y=height + 17, text_anchor=anchor))
    return parts


def front_chart(front: Sequence[Mapping[str, Any]]) -> Markup:
    """Danger over length; paths that end on the target are full, the others the paler the farther off they end."""
    goals = np.array([[p["length_mm"], p["danger"], p["error_mm"]] for p in front], float)
    words = (
        f"Pareto front: {len(goals)} paths, length {printed(goals[:, 0].min(), 1)} to {printed(goals[:, 0].max(), 1)} mm, "
        f"danger {printed(goals[:, 1].min(), 2)} to {printed(goals[:, 1].max(), 2)}"
    )
    return in_all_widths(partial(_front, goals, words))


def _front(goals: FloatArray, words: str, width: Width) -> Markup:
    wide = width.plot
    low, high = float(goals[:, 0].min()), float(goals[:, 0].max())
    room = max(0.05 * (high - low), 0.2)
    x = Axis(low - room, high + room, LEFT + 8, wide - RIGHT)
    parts, y = heights_of(float(goals[:, 1].min()), float(goals[:, 1].max()), x)
    parts += ticks(x, y.start, "mm")
    parts.append(tag("text", "danger over length", class_="axis", x=x.start - 8, y=11))
    for length, danger, error in goals[np.argsort(-goals[:, 2], kind="stable")]:
        full = error < 1e-6
        shade = 1.0 if full else float(np.clip(0.75 - 0.25 * error, 0.12, 0.75))
        parts.append(
            tag("circle", class_="needle-goal", cx=x(length), cy=y(danger), r=5.0 if full else 4.0, fill_opacity=f"{shade:.2f}")
        )
    return frame(width, (wide, TALL), words, parts)


def error_chart(errors: Sequence[float]) -> Markup:
    """Final tip errors of insertions at random as a histogram, with the median and what 95 % stay under."""
    values = np.asarray(errors, float)
    half, most = (float(v) for v in np.percentile(values, (50, 95)))
    words = f"Final tip errors of {len(values)} insertions: half under {printed(half, 3)} mm, 95 % under {printed(most, 3)} mm"
    return in_all_widths(partial(_errors, values, half, most, words))


def _errors(values: FloatArray, half: float, most: float, words: str, width: Width) -> Markup:
    wide = width.plot
    end = float(max(values.max(), 1e-3)) * 1.02
    counts, edges = np.histogram(values, bins=BINS, range=(0.0, end))
    x = Axis(0.0, end, LEFT + 8, wide - RIGHT)
    parts, y = heights_of(0.0, float(counts.max()), x)
    parts += ticks(x, y.start, "mm")
    parts.append(tag("text", "insertions by final tip error", class_="axis", x=x.start - 8, y=11))
    for count, left, right in zip(counts, edges[:-1], edges[1:], strict=True):
        if count:
            size = max(x(float(right)) - x(float(left)) - 1.0, 1.0)
            top = y(float(count))
            parts.append(tag("rect", class_="needle-bar", x=x(float(left)), y=top, width=size, height=y.start - top))
    for value, name in ((half, "half"), (most, "95 %")):
        parts.append(tag("line", class_="limit", x1=x(value), x2=x(value), y1=y.end, y2=y.start))
        parts.append(tag("text", name, class_="axis halo", x=x(value) + 4, y=y.end + 18))
    return frame(width, (wide, TALL), words, parts)
