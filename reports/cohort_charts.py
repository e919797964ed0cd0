"""Charts of a cohort's page: how the worst margins are spread, planner by planner, and the time that the cases took."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from markupsafe import Markup

from reports.numbers import printed
from reports.parts import Drawing
from reports.svg import LEFT, RIGHT, Axis, Width, frame, grid, in_all_widths, nice_step, step_digits, tag

TALL = 190
BINS = 18
# Narrowest bin: margins are planned to about a hundredth of a mm, times vary by more than a tenth of a second.
FINEST = {"mm": 0.02, "s": 0.1}
FEWEST = 6
# Status of a run -> class of its bars and word of the legend, from below.
KINDS = {"ok": ("ok", "holds"), "flagged": ("flagged", "flagged"), "infeasible": ("infeasible", "no path")}


def cohort_charts(cases: Sequence[Mapping[str, Any]]) -> tuple[Drawing, ...]:
    """A histogram of the worst margins for each planner that has any, and one of the times."""
    made = []
    for planner in dict.fromkeys(str(case["planner"]) for case in cases):
        mine = [case for case in cases if case["planner"] == planner and case["margin_mm"] is not None]
        if mine:
            values = [(float(case["margin_mm"]), str(case["status"])) for case in mine]
            made.append(_chart(f"Worst margin, {planner}", "mm", values, "least clearance less its limit", zero="limit"))
    times = [(float(case["wall_s"]), str(case["status"])) for case in cases if case["wall_s"] is not None]
    if times:
        made.append(_chart("Time of a case", "s", times, "wall time of its process"))
    return tuple(made)


def _chart(title: str, unit: str, values: Sequence[tuple[float, str]], line: str, *, zero: str = "") -> Drawing:
    plain = [value for value, _ in values]
    words = f"{title}: {len(plain)} cases from {printed(min(plain), 2)} to {printed(max(plain), 2)} {unit}"
    return Drawing(title, in_all_widths(partial(histogram, values, words, unit, zero=zero)), unit, line)


def histogram(values: Sequence[tuple[float, str]], words: str, unit: str, width: Width, *, zero: str = "") -> Markup:
    """Counts of values by bins of a round width that begin at 0, stacked by status; `zero` names the line at 0.

    Parameters
    ----------
    values : sequence of (value, status)
    words : str
        What the drawing shows, for those who do not see it.
    """
    plain = [value for value, _ in values]
    low, high = min(0.0, *plain), max(0.0, *plain)
    step = max(nice_step(max(high - low, FINEST[unit]), BINS), FINEST[unit])
    first = math.floor(low / step + 1e-9)
    last = max(math.floor(high / step + 1e-9) + 1, first + FEWEST)
    bins: dict[int, dict[str, int]] = {}
    for value, status in values:
        counts = bins.setdefault(math.floor(value / step + 1e-9), {})
        counts[status if status in KINDS else "other"] = counts.get(status if status in KINDS else "other", 0) + 1
    tallest = max(sum(counts.values()) for counts in bins.values())
    rung = math.ceil(nice_step(float(max(tallest, 4)), 4))  # cases are counted in whole numbers
    x = Axis(first * step, last * step, LEFT, width.half - RIGHT)
    y = Axis(0.0, math.ceil(tallest / rung) * rung, TALL - 22.0, 18.0)
    parts = grid((LEFT, width.half - RIGHT), y, rung)
    for place, counts in sorted(bins.items()):
        left, right, base = x(place * step), x((place + 1) * step), 0
        for status in (*KINDS, "other"):
            count = counts.get(status, 0)
            if count:
                top, foot = y(base + count), y(base)
                kind = KINDS[status][0] if status in KINDS else status
                parts.append(
                    tag("rect", class_=f"pile {kind}", x=left + 1.0, width=max(right - left - 2.0, 1.0), y=top, height=foot - top)
                )
                base += count
    parts += _marks(x, y.start, step, first, last, unit)
    if zero and first < 0 < last:
        at = x(0.0)
        parts.append(tag("line", class_="limit", x1=at, x2=at, y1=y.start, y2=y.end - 6.0))
        parts.append(tag("text", zero, class_="limit-label halo", x=at + 4.0, y=y.end - 6.0))
    return frame(width, (width.half, TALL), words, parts)


def _marks(x: Axis, level: float, step: float, first: int, last: int, unit: str) -> list[Markup]:
    """Ticks at every bin and figures at as many as there is room for, the last one with the unit."""
    digits = step_digits(step)
    every = max(1, math.ceil((last - first) * 46.0 / (x.end - x.start)))
    parts = []
    for k in range(first, last + 1):
        at = x(k * step)
        parts.append(tag("line", class_="tick", x1=at, x2=at, y1=level, y2=level + 4.0))
        if k % every == 0:
            parts.append(tag("text", printed(k * step, digits), class_="axis", x=at, y=level + 16.0, text_anchor="middle"))
    return parts
