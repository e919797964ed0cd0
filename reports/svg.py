"""Parts of the drawings: elements, scales, axes, and the three widths each chart is drawn for."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from reports.numbers import printed
from segmentation.arrays import FloatArray

LEFT, RIGHT = 40, 12  # margins shared by everything that has the path along x: one cursor runs through all


@dataclass(frozen=True)
class Width:
    """One drawing of a chart: the class that shows it and its inner widths in CSS px."""

    name: str
    plot: int
    strip: int
    half: int


WIDTHS = (Width("wide", 740, 1190, 600), Width("narrow", 340, 332, 350), Width("print", 450, 756, 372))


def nice_step(span: float, count: int) -> float:
    """The least of 1, 2, 2.5, 5 times a power of ten that cuts `span` into at most `count` parts.

    Examples
    --------
    >>> nice_step(124.9, 13), nice_step(0.2, 4)
    (10.0, 0.05)
    """
    rough = span / count
    power = 10.0 ** math.floor(math.log10(rough))
    return float(next(power * m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if power * m >= rough * (1.0 - 1e-9)))


def step_digits(step: float) -> int:
    """Decimals that print every multiple of `step` exactly."""
    return next(digits for digits in range(9) if abs(round(step, digits) - step) < 1e-9 * max(step, 1e-9) or digits == 8)


def tag(_name: str, _text: str | None = None, **attributes: object) -> Markup:
    """One SVG element; ``class_`` and ``_`` in names are written ``class`` and ``-``."""
    inside = "".join(f' {key.rstrip("_").replace("_", "-")}="{_attribute(value)}"' for key, value in attributes.items())
    return Markup(f"<{_name}{inside}/>" if _text is None else f"<{_name}{inside}>{escape(_text)}</{_name}>")


def _attribute(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.1f}".removesuffix(".0")
    return str(value) if isinstance(value, int) else str(escape(value))


@dataclass(frozen=True)
class Axis:
    """A linear scale from values to drawing units."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        """The drawing coordinate of a value."""
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    def of(self, values: FloatArray) -> FloatArray:
        """The drawing coordinates of many values."""
        return np.asarray(self.start + (values - self.low) / (self.high - self.low) * (self.end - self.start))


def trace(xs: FloatArray, ys: FloatArray, x: Axis, y: Axis) -> str:
    """Path data of a polyline; points closer than half a unit apart keep only their extremes."""
    px, py = x.of(xs), y.of(np.clip(ys, min(y.low, y.high), max(y.low, y.high)))
    keep = np.zeros(len(px), bool)
    column = np.floor(px / 1.5).astype(int)
    for rows in np.split(np.arange(len(px)), np.flatnonzero(np.diff(column)) + 1):
        keep[[rows[0], rows[-1], rows[py[rows].argmin()], rows[py[rows].argmax()]]] = True
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(px[keep], py[keep], strict=True))


def in_all_widths(draw: Callable[[Width], Markup]) -> Markup:
    """The drawing for each of the three widths, one after the other."""
    return Markup("\n").join(draw(width) for width in WIDTHS)


def frame(width: Width, size: tuple[float, float], label: str, parts: Sequence[Markup], **attributes: object) -> Markup:
    """An <svg> that says in words what it shows."""
    box = f"0 0 {size[0]:g} {size[1]:g}"
    more = Markup("").join(Markup(' {}="{}"').format(key.replace("_", "-"), value) for key, value in attributes.items())
    return Markup('<svg class="for-{}" viewBox="{}" role="img" aria-label="{}"{}>{}</svg>').format(
        width.name, box, label, more, Markup("").join(parts)
    )


def chart(
    width: Width,
    size: tuple[float, float],
    label: str,
    parts: Sequence[Markup],
    *,
    kind: str,
    y: Axis,
    marks: Markup,
    **more: object,
) -> Markup:
    """A picture with the path along x, which the page's cursor runs through; `marks` are moved along with its line.

    What the cursor needs stands in the picture's data: where x begins and ends, and what heights mean.
    """
    cursor = Markup('<g class="cursor"><line y1="{}" y2="{}"/>{}</g>').format(f"{y.end - 6:.0f}", f"{y.start:.0f}", marks)
    scale = {"data_low": y.low, "data_high": y.high, "data_y0": y.start, "data_y1": y.end}
    return frame(width, size, label, [*parts, cursor], data_chart=kind, **more, data_left=LEFT, data_right=RIGHT, **scale)


def path_axis(length: float, x: Axis, y: float, room: float, *, unit: str = "mm") -> list[Markup]:
    """Ticks and figures under a picture that has the path along x, in mm or in another unit."""
    step = nice_step(length, max(2, int(room / 52)))
    digits = step_digits(step)
    parts: list[Markup] = []
    for k in range(int(length / step + 1e-9) + 1):
        at = x(k * step)
        parts.append(tag("line", class_="tick", x1=at, x2=at, y1=y, y2=y + 4))
        text = f"{k * step:.{digits}f}" + ("" if k else f" {unit}")
        parts.append(tag("text", text, class_="axis", x=at, y=y + 16, text_anchor="middle" if k else "start"))
    return parts


def grid(x: tuple[float, float], y: Axis, step: float) -> list[Markup]:
    """Horizontal lines at every step between two x, with their figures on the left."""
    digits = step_digits(step)
    first = math.ceil(y.low / step - 1e-9)
    parts: list[Markup] = []
    for k in range(first, math.floor(y.high / step + 1e-9) + 1):
        at = y(k * step)
        parts.append(tag("line", class_="grid" if k else "base", x1=x[0], x2=x[1], y1=at, y2=at))
        parts.append(tag("text", printed(k * step, digits if k else 0), class_="axis", x=x[0] - 8, y=at + 4, text_anchor="end"))
    return parts
