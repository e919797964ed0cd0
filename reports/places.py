"""The two critical places, the tightest and the sharpest, as static cuts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from reports.numbers import Phrase, Source, phrase, printed
from reports.slices import FIELD_MM, Window, cut, png
from reports.svg import tag
from reports.words import worst_place
from reports.workspace import Course
from segmentation.arrays import FloatArray
from segmentation.volume import Volume
from tubeplan_viz.result import STRAIGHT_MM

PLANES = (
    ("axial", "Axial", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("R", "L", "A", "P")),
    ("coronal", "Coronal", (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), ("R", "L", "S", "I")),
    ("sagittal", "Sagittal", (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), ("A", "P", "S", "I")),
)


@dataclass(frozen=True)
class Thumbnail:
    """One static cut at a critical place, ready to print."""

    name: str
    picture: Markup


@dataclass(frozen=True)
class Place:
    """A critical place with its cuts."""

    title: str
    where: Phrase
    go: float
    field: str
    cuts: tuple[Thumbnail, ...]


def critical_places(course: Course, source: Source, volume: Volume | None, window: Window | None) -> tuple[Place, ...]:
    """The tightest place and the sharpest bend, each across the path and, where there is a CT, in three planes."""
    found: list[tuple[str, int, Phrase]] = []
    if course.clearance is not None and (least := source.figure("metrics.clearance_min_mm", 2, "mm")) is not None:
        index = int(course.clearance.argmin())
        found.append(("Tightest place", index, phrase("at ", worst_place(source, "clearance"), ", clearance ", least)))
    radius = source.figure("derived:bend_radius_mm", 1, "mm")
    if radius is not None and radius.value < STRAIGHT_MM:
        index = int(course.curvature.argmax())
        found.append(("Sharpest bend", index, phrase("at ", worst_place(source, "curvature"), ", radius ", radius)))
    asked = source.value("limits.clearance_min_mm")
    return tuple(
        Place(
            title,
            where,
            float(course.arc[index]),
            printed(cut_field(course, course.place_at(index), with_ct=volume is not None), 0),
            _cuts(course, index, volume, window, asked),
        )
        for title, index, where in found
    )


def cut_field(course: Course, place: int, *, with_ct: bool) -> float:
    """Side of the static cuts in mm: the lumen with its surroundings in a CT, the lumen alone without one."""
    if course.rims is None:
        return FIELD_MM
    if not with_ct:
        return float(np.clip(np.ceil(2.8 * np.quantile(course.rims[place], 0.9)), 3.0, 2 * FIELD_MM))
    return float(np.clip(np.ceil(11.0 * np.median(course.rims[place]) / 2) * 2, 20.0, FIELD_MM))


def _cuts(course: Course, index: int, volume: Volume | None, window: Window | None, asked: float | None) -> tuple[Thumbnail, ...]:
    place = course.place_at(index)
    origin, normal, down = course.points[index], course.normal[place], -course.binormal[place]
    tight = course.clearance is not None and asked is not None and float(course.clearance[index]) < asked
    circle = tag("circle", class_="asked bad" if tight else "asked", r=f"{asked:.3f}") if asked else Markup("")
    wall = Markup("")
    field = cut_field(course, place, with_ct=volume is not None)
    if course.rims is not None:
        angle = 2.0 * np.pi * np.arange(course.rims.shape[1]) / course.rims.shape[1]
        rim = course.rims[place]
        wall = tag(
            "path",
            class_="rim",
            d="M" + "L".join(f"{r * np.cos(a):.2f} {-r * np.sin(a):.2f}" for r, a in zip(rim, angle, strict=True)) + "Z",
        )
    across = Thumbnail("Across", _picture(volume, window, origin, normal, down, [wall, circle], "Cut across the path", field, ()))
    if volume is None or window is None:
        return (across,) if course.rims is not None else ()
    near = course.points[max(0, index - 80) : index + 81] - origin
    cuts = [across]
    for _, name, right_axis, down_axis, letters in PLANES:
        right, below = np.array(right_axis), np.array(down_axis)
        line = tag(
            "path",
            class_="path-line",
            d="M" + "L".join(f"{a:.2f} {b:.2f}" for a, b in zip(near @ right, near @ below, strict=True)),
        )
        cuts.append(
            Thumbnail(name, _picture(volume, window, origin, right, below, [line, circle], f"CT, {name.lower()}", field, letters))
        )
    return tuple(cuts)


def _picture(
    volume: Volume | None,
    window: Window | None,
    origin: FloatArray,
    right: FloatArray,
    down: FloatArray,
    overlay: Sequence[Markup],
    words: str,
    field: float,
    letters: Sequence[str],
) -> Markup:
    half = field / 2
    parts = []
    if volume is not None and window is not None:
        grey = png(cut(volume, origin, right, down, window, field=field))
        parts.append(Markup('<image x="{}" y="{}" width="{}" height="{}" href="{}"/>').format(-half, -half, field, field, grey))
    parts += overlay
    parts.append(tag("circle", class_="here", r=f"{field / 90:.2f}"))
    spots = ((-0.94, 0.03, "start"), (0.94, 0.03, "end"), (0.0, -0.86, "middle"), (0.0, 0.94, "middle"))
    for letter, (x, y, anchor) in zip(letters, spots, strict=False):
        parts.append(
            tag(
                "text",
                letter,
                class_="side",
                x=x * half,
                y=y * half,
                text_anchor=anchor,
                style=f"font-size:{field * 0.075:.2f}px",
            )
        )
    kind = "cut" if volume is not None else "cut no-ct"
    return Markup('<svg class="{}" viewBox="{} {} {} {}" role="img" aria-label="{}">{}</svg>').format(
        kind, -half, -half, field, field, words, Markup("").join(parts)
    )
