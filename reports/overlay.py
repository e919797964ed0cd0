"""One quantity of several runs in one chart: over arc length, or over the share of each path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from reports.figures import free_place
from reports.numbers import printed
from reports.svg import LEFT, RIGHT, Axis, Width, chart, grid, nice_step, path_axis, tag, trace
from segmentation.arrays import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Line:
    """One run in a chart.

    `number` counts the runs from 0 and chooses colour and dashes; `worst` are the flagged
    worst places as (arc length in mm, value).
    """

    number: int
    label: str
    arc: FloatArray
    values: FloatArray
    limit: float | None
    worst: Sequence[tuple[float, float]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Overlay:
    """A chart of several runs; `axis` is ``mm`` or ``share``, `kind` ``clearance`` or ``curvature``."""

    kind: str
    axis: str
    lines: Sequence[Line]
    words: str

    @property
    def longest(self) -> float:
        """Arc length of the longest path, mm."""
        return max(float(line.arc[-1]) for line in self.lines)

    def along(self, line: Line, arc: FloatArray | float) -> FloatArray:
        """Places on a path in the unit of the horizontal axis: mm, or percent of that path."""
        return np.asarray(arc, float) * (1.0 if self.axis == "mm" else 100.0 / float(line.arc[-1]))


def overlay_chart(spec: Overlay, width: Width, *, room: str) -> Markup:
    """Each run's curve in its colour and dashes, its letter at its end, limits as thin lines, worst places ringed.

    `room` names the inner width to draw for, an attribute of `reports.svg.Width`.
    """
    wide, tall = int(getattr(width, room)), 190
    low, high, step = _value_range(spec)
    end = spec.longest if spec.axis == "mm" else 100.0
    x, y = Axis(0.0, end, LEFT, wide - RIGHT), Axis(low, high, tall - 22, 16)
    parts = grid((LEFT, wide - RIGHT), y, step)
    parts += path_axis(end, x, y.start, wide - LEFT - RIGHT, unit="mm" if spec.axis == "mm" else "%")
    letters = _letters(spec, x, y)
    parts += _limits(spec, x, y, [at for at, _ in letters], short=wide < 500)
    for line in spec.lines:
        parts.append(
            tag("path", class_=f"run-line run-{line.number + 1}", d=trace(spec.along(line, line.arc), line.values, x, y))
        )
    for line in spec.lines:
        parts += [
            tag("circle", class_=f"worst {spec.kind}", cx=x(float(spec.along(line, at))), cy=y(value), r=4.0)
            for at, value in line.worst
        ]
    parts += [
        tag("text", line.label, class_=f"run-name run-{line.number + 1}", x=at, y=height, text_anchor="middle")
        for line, (at, height) in zip(spec.lines, letters, strict=True)
    ]
    dots = Markup("").join(tag("circle", class_=f"run-{line.number + 1}", r=4.0, data_run=line.number) for line in spec.lines)
    return chart(width, (wide, tall), spec.words, parts, kind=spec.kind, y=y, marks=dots, data_axis=spec.axis)


def _value_range(spec: Overlay) -> tuple[float, float, float]:
    values = np.concatenate([line.values for line in spec.lines])
    limits = [line.limit for line in spec.lines if line.limit is not None]
    high = max([float(values.max()), *limits, 1e-6]) * 1.06
    low = min(0.0, float(values.min()))
    step = nice_step(high - low, 4)
    return math.floor(low / step) * step, math.ceil(high / step - 1e-9) * step, step


def _limits(spec: Overlay, x: Axis, y: Axis, letters: Sequence[float], *, short: bool) -> list[Markup]:
    """One line for a limit that all runs share, one per run otherwise."""
    given = [(line, line.limit) for line in spec.lines if line.limit is not None]
    parts: list[Markup] = []
    taken = [(at - 8.0, at + 8.0) for at in letters]
    curves = [(spec.along(line, line.arc), line.values) for line in spec.lines]
    for limit in dict.fromkeys(limit for _, limit in given):
        holders = [line for line, own in given if own == limit]
        figure = f"{printed(limit, 2)} mm" if spec.kind == "clearance" else f"{printed(limit, 3)} 1/mm"
        bound = "least" if spec.kind == "clearance" else "at most"
        everybody = len(holders) == len(spec.lines)
        whose = "" if everybody else f"{', '.join(line.label for line in holders)}: "
        words = f"{whose}{figure}" if short and whose else f"{whose}{bound} {figure}"
        level = y(limit)
        parts.append(tag("line", class_="limit", x1=x.start, x2=x.end, y1=level, y2=level))
        across = np.linspace(x.low, x.high, 200)
        lines = [(across, np.full(200, other)) for _, other in given if other != limit]
        at, height = free_place(words, level, [*curves, *lines], taken, x, y)
        taken.append((at, at + 6.4 * len(words)))
        parts.append(tag("text", words, class_="limit-label halo", x=at, y=height))
    return parts


def _letters(spec: Overlay, x: Axis, y: Axis) -> list[tuple[float, float]]:
    """Where each run's letter stands: beside its curve, where that is farthest from all others."""
    drawn = [(x.of(spec.along(line, line.arc)), y.of(line.values)) for line in spec.lines]
    columns = np.linspace(x.start + 12, x.end - 12, 120)
    heights = np.array([np.interp(columns, px, py, left=np.nan, right=np.nan) for px, py in drawn])
    places = []
    for k in range(len(spec.lines)):
        others = np.delete(heights, k, axis=0)
        gap = np.where(np.isnan(others), 60.0, np.abs(others - heights[k])).min(axis=0) if len(others) else np.ones(len(columns))
        best = int(np.argmax(np.where(np.isnan(heights[k]), -1.0, np.minimum(gap, 40.0))))
        own = float(heights[k, best])
        below = len(others) > 0 and bool(np.nanmean(np.append(others[:, best], own)) < own)
        places.append((float(columns[best]), min(max(own + (13.0 if below else -7.0), y.end + 4), y.start - 3)))
    return places
