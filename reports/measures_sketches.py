"""A small drawing for each definition of a measure, with the case's value marked on it.

The sketches show what is measured between what, in one neutral anatomy; angles are drawn as wide as they were measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from reports.numbers import Phrase, phrase
from reports.parts import Drawing
from reports.svg import tag

WIDE, TALL = 220, 150
Point = tuple[float, float]
# Of several parts the one that is drawn: what scores ask for, else the first that was measured.
FIRST_CHOICE = ("lower infundibulum", ", lower")


@dataclass(frozen=True)
class Sketch:
    """One definition as a drawing with the value of the case, or why there is none."""

    drawing: Drawing
    value: Phrase


@dataclass(frozen=True)
class Subject:
    """What one sketch shows.

    Attributes
    ----------
    key : str
        Of the measure whose value is marked.
    says : str
        What is measured between what, for readers who do not see the drawing and for the line below it.
    draw : callable
        From the value (or None) and its text to the parts of the drawing.
    """

    key: str
    says: str
    draw: Callable[[float | None, str], list[Markup]]


def sketches(items: Sequence[Mapping[str, Any]], value_of: Callable[[int], Phrase]) -> tuple[Sketch, ...]:
    """Sketches of the definitions that a run uses, in the order of the tables."""
    made = []
    for subject in SUBJECTS:
        mine = [(k, item) for k, item in enumerate(items) if item["key"] == subject.key]
        if not mine:
            continue
        k, item = chosen(mine)
        known = item["value"] is not None
        told = value_of(k)
        text = str(told) if known else "not computable"
        says = subject.says + (f" Here {str(item['of']).removesuffix(' ...')}." if item["of"] else "")
        label = f"{item['name']}. {says} {text}{'' if known else ': ' + str(item['reason'])}."
        drawn = Markup('<svg class="sketch" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
            WIDE, TALL, label, Markup("").join(subject.draw(item["value"], text))
        )
        value = told if known else phrase("not computable: ", str(item["reason"]))
        made.append(Sketch(Drawing(item["name"], drawn, line=says), value))
    return tuple(made)


def chosen(mine: Sequence[tuple[int, Mapping[str, Any]]]) -> tuple[int, Mapping[str, Any]]:
    """The part that stands for all: one that could be measured, of the lower pole where there is one."""
    known = [row for row in mine if row[1]["value"] is not None] or list(mine)
    return next((row for row in known if str(row[1]["of"]).endswith(FIRST_CHOICE)), known[0])


def outline(*points: Point, closed: bool = False, kind: str = "measure-line") -> Markup:
    """A polyline."""
    return tag("path", class_=kind, d="M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + ("Z" if closed else ""))


def ring(at: Point, radius: float, kind: str = "measure-line") -> Markup:
    """A circle."""
    return tag("circle", class_=kind, cx=at[0], cy=at[1], r=radius, fill="none")


def dot(at: Point) -> Markup:
    """A place that is measured from or to."""
    return tag("circle", class_="measure-dot", cx=at[0], cy=at[1], r=3.0)


def words(at: Point, text: str, anchor: str = "start", kind: str = "axis") -> Markup:
    """A label."""
    return tag("text", text, class_=kind, x=at[0], y=at[1], text_anchor=anchor)


def span(one: Point, other: Point) -> list[Markup]:
    """A measured distance: a line with a bar at either end."""
    long = math.dist(one, other)
    beside = (-(other[1] - one[1]) / long * 5.0, (other[0] - one[0]) / long * 5.0)
    bars = [outline((x - beside[0], y - beside[1]), (x + beside[0], y + beside[1]), kind="measure-span") for x, y in (one, other)]
    return [outline(one, other, kind="measure-span"), *bars]


def turned(at: Point, reach: float, angle: float) -> Point:
    """The place `reach` away at an angle from straight down towards the right, degrees."""
    return at[0] + reach * math.sin(math.radians(angle)), at[1] + reach * math.cos(math.radians(angle))


def arc(at: Point, radius: float, begin: float, end: float) -> Markup:
    """The arc of an angle, from straight down towards the right, degrees."""
    count = max(int(abs(end - begin) / 4.0), 1)
    return outline(*(turned(at, radius, begin + (end - begin) * k / count) for k in range(count + 1)), kind="measure-span")


def tube(begin: Point, end: Point, half: float) -> list[Markup]:
    """The two walls of a straight lumen."""
    long = math.dist(begin, end)
    side = (-(end[1] - begin[1]) / long * half, (end[0] - begin[0]) / long * half)
    return [
        outline((begin[0] + s * side[0], begin[1] + s * side[1]), (end[0] + s * side[0], end[1] + s * side[1]))
        for s in (1.0, -1.0)
    ]


PELVIS: Point = (74.0, 56.0)
LOW_PELVIS = 94.0  # leaves room for a calyx that points up


def kidney(angle: float, pelvis: Point = PELVIS) -> list[Markup]:
    """Ureter, pelvis, one infundibulum at an angle and its calyx."""
    neck, cup = turned(pelvis, 66.0, angle), turned(pelvis, 84.0, angle)
    across = (math.cos(math.radians(angle)), -math.sin(math.radians(angle)))
    sides = []
    for s in (1.0, -1.0):
        sides.append(
            outline(
                (neck[0] + 7 * s * across[0], neck[1] + 7 * s * across[1]),
                (cup[0] + 16 * s * across[0], cup[1] + 16 * s * across[1]),
            )
        )
    tip = turned(pelvis, 78.0, angle)
    rim = outline((cup[0] + 16 * across[0], cup[1] + 16 * across[1]), tip, (cup[0] - 16 * across[0], cup[1] - 16 * across[1]))
    return [
        *tube((pelvis[0], pelvis[1] + 19.0), (pelvis[0], TALL), 6.0),
        ring(pelvis, 20.0),
        *tube(turned(pelvis, 19.0, angle), neck, 7.0),
        *sides,
        rim,
    ]


def angle_sketch(value: float | None, text: str) -> list[Markup]:
    """Two axes and the angle between them, as wide as it was measured."""
    angle = min(max(60.0 if value is None else value, 20.0), 160.0)
    pelvis = PELVIS if angle <= 100.0 else (PELVIS[0], LOW_PELVIS)
    return [
        *kidney(angle, pelvis),
        outline(pelvis, (pelvis[0], TALL - 8.0), kind="measure-axis"),
        outline(pelvis, turned(pelvis, 78.0, angle), kind="measure-axis"),
        arc(pelvis, 34.0, 0.0, angle),
        dot(pelvis),
        words((pelvis[0] - 26.0, pelvis[1] + 4.0), text, "end", "sketch-value"),
        words((pelvis[0] - 12.0, TALL - 10.0), "ureter", "end"),
        words((pelvis[0] - 24.0, pelvis[1] - 16.0), "pelvis", "end"),
    ]


def length_sketch(_: float | None, text: str) -> list[Markup]:
    """From the lip of the pelvis to the bottom of the calyx."""
    lip, bottom = turned(PELVIS, 20.0, 70.0), turned(PELVIS, 78.0, 70.0)
    return [
        *kidney(70.0),
        *span(lip, bottom),
        *labelled(lip, "lip", (8.0, -14.0)),
        *labelled(bottom, "bottom", (6.0, -26.0)),
        value_at(text),
    ]


def width_sketch(_: float | None, text: str) -> list[Markup]:
    """Across the narrowest place of the infundibulum."""
    one, other = turned(turned(PELVIS, 44.0, 70.0), 7.0, 160.0), turned(turned(PELVIS, 44.0, 70.0), 7.0, -20.0)
    return [*kidney(70.0), *span(one, other), *labelled(one, "narrowest place", (26.0, -14.0)), value_at(text)]


def calyx_sketch(_: float | None, text: str) -> list[Markup]:
    """Across the calyx at its widest."""
    middle = turned(PELVIS, 74.0, 70.0)
    return [*kidney(70.0), *span(turned(middle, 11.0, 160.0), turned(middle, 11.0, -20.0)), value_at(text)]


def ureter_sketch(_: float | None, text: str) -> list[Markup]:
    """Across the ureter."""
    level = PELVIS[1] + 56.0
    return [
        *kidney(70.0),
        *span((PELVIS[0] - 6.0, level), (PELVIS[0] + 6.0, level)),
        words((PELVIS[0] + 16.0, level + 4.0), text, kind="sketch-value"),
    ]


def pelvis_sketch(_: float | None, text: str) -> list[Markup]:
    """The largest ball in the pelvis."""
    return [
        *kidney(70.0),
        ring(PELVIS, 18.0, "measure-axis"),
        *span((PELVIS[0] - 18.0, PELVIS[1]), (PELVIS[0] + 18.0, PELVIS[1])),
        value_at(text),
    ]


FORK: Point = (110.0, 62.0)


def airway(left: float, right: float) -> list[Markup]:
    """A parent from above with two daughters at angles from straight on."""
    return [
        *tube((FORK[0], 0.0), (FORK[0], FORK[1] - 6.0), 14.0),
        *tube(turned(FORK, 12.0, -left), turned(FORK, 92.0, -left), 9.0),
        *tube(turned(FORK, 12.0, right), turned(FORK, 92.0, right), 9.0),
    ]


def branch_sketch(value: float | None, text: str) -> list[Markup]:
    """A daughter's direction against its parent's."""
    angle = min(max(35.0 if value is None else value, 8.0), 80.0)
    return [
        *airway(30.0, angle),
        outline((FORK[0], 0.0), (FORK[0], TALL - 8.0), kind="measure-axis"),
        outline(FORK, turned(FORK, 84.0, angle), kind="measure-axis"),
        arc(FORK, 52.0, 0.0, angle),
        dot(FORK),
        words((FORK[0] + 20.0, 20.0), text, kind="sketch-value"),
        words((FORK[0] - 20.0, 20.0), "parent", "end"),
    ]


def carina_sketch(value: float | None, text: str) -> list[Markup]:
    """Between the two main bronchi."""
    half = 0.5 * min(max(70.0 if value is None else value, 16.0), 140.0)
    return [
        *airway(half, half),
        outline(FORK, turned(FORK, 84.0, half), kind="measure-axis"),
        outline(FORK, turned(FORK, 84.0, -half), kind="measure-axis"),
        arc(FORK, 46.0, -half, half),
        dot(FORK),
        words((FORK[0] + 20.0, 20.0), text, kind="sketch-value"),
        words((FORK[0] - 20.0, 20.0), "trachea", "end"),
    ]


def bore_sketch(_: float | None, text: str) -> list[Markup]:
    """Across the middle half of a branch."""
    return [
        *tube((20.0, 70.0), (200.0, 70.0), 22.0),
        outline((20.0, 70.0), (200.0, 70.0), kind="measure-axis"),
        *(outline((x, 44.0), (x, 96.0), kind="measure-axis") for x in (65.0, 155.0)),
        *span((110.0, 48.0), (110.0, 92.0)),
        words((110.0, 34.0), text, "middle", "sketch-value"),
        words((110.0, 116.0), "middle half", "middle"),
    ]


def generation_sketch(_: float | None, text: str) -> list[Markup]:
    """Branchings counted from the trachea."""
    second = turned(FORK, 50.0, 40.0)
    return [
        outline((FORK[0], 4.0), FORK),
        outline(turned(FORK, 70.0, -40.0), FORK, second),
        outline(turned(second, 44.0, 10.0), second, turned(second, 44.0, 75.0)),
        dot(FORK),
        dot(second),
        words((FORK[0] + 8.0, 30.0), "0"),
        words((FORK[0] + 30.0, FORK[1] + 14.0), "1"),
        words((second[0] + 26.0, second[1] + 10.0), "2"),
    ]


CURVE = [
    (18.0 + 184.0 * k / 60.0, 92.0 - 44.0 * math.sin(math.pi * k / 60.0) * math.sin(1.4 * math.pi * k / 60.0)) for k in range(61)
]


def tortuosity_sketch(_: float | None, text: str) -> list[Markup]:
    """The path's length over the straight distance."""
    return [
        outline(*CURVE),
        outline(CURVE[0], CURVE[-1], kind="measure-axis"),
        dot(CURVE[0]),
        dot(CURVE[-1]),
        words((110.0, 40.0), "length of the path", "middle"),
        words((110.0, 108.0), "straight distance", "middle"),
        words((110.0, 136.0), text, "middle", "sketch-value"),
    ]


def bending_sketch(_: float | None, text: str) -> list[Markup]:
    """Turns of the path's direction, summed up."""
    ways = []
    for k in (8, 24, 40, 54):
        (ax, ay), (bx, by) = CURVE[k - 1], CURVE[k + 1]
        long = math.hypot(bx - ax, by - ay)
        ways.append(
            outline(CURVE[k], (CURVE[k][0] + 26.0 * (bx - ax) / long, CURVE[k][1] + 26.0 * (by - ay) / long), kind="measure-span")
        )
    return [
        outline(*CURVE),
        *ways,
        *(dot(CURVE[k]) for k in (8, 24, 40, 54)),
        words((110.0, 132.0), text, "middle", "sketch-value"),
    ]


def bend_sketch(_: float | None, text: str) -> list[Markup]:
    """The circle that fits the sharpest place."""
    at, radius = (96.0, 84.0), 44.0
    way = [(at[0] + radius * math.cos(t), at[1] - radius * math.sin(t)) for t in (math.radians(a) for a in range(30, 141, 5))]
    return [
        ring(at, radius, "measure-axis"),
        outline((196.0, 96.0), *way, (14.0, 110.0)),
        *span(at, turned(at, radius, 180.0)),
        dot(at),
        words((at[0], at[1] + 22.0), text, "middle", "sketch-value"),
    ]


def stone_sketch(_: float | None, text: str) -> list[Markup]:
    """The largest distance between two points of a stone."""
    stone = [
        (110 + (48 + 6 * math.sin(3 * a)) * math.cos(a), 66 + 30 * math.sin(a)) for a in (0.1 * math.pi * k for k in range(20))
    ]
    return [outline(*stone, closed=True), *span(stone[0], stone[10]), words((110.0, 128.0), text, "middle", "sketch-value")]


def structure_sketch(_: float | None, text: str) -> list[Markup]:
    """From the path to the nearest voxel of a structure."""
    box = [(120.0, 96.0), (190.0, 96.0), (190.0, 140.0), (120.0, 140.0)]
    return [
        outline(*CURVE),
        outline(*box, closed=True),
        *span((140.0, 67.0), (140.0, 96.0)),
        words((150.0, 88.0), text, kind="sketch-value"),
    ]


def labelled(at: Point, text: str, shift: Point) -> list[Markup]:
    """A place with its name."""
    return [dot(at), words((at[0] + shift[0], at[1] + shift[1]), text, "middle")]


def value_at(text: str) -> Markup:
    """The value at the foot of the drawing, on the side where nothing is drawn."""
    return words((150.0, 134.0), text, "middle", "sketch-value")


SUBJECTS = (
    Subject("tortuosity", "Length of the path over the straight distance between its ends.", tortuosity_sketch),
    Subject("total_bending_deg", "Turns of the path's direction along its way, summed up.", bending_sketch),
    Subject("bend_radius_min_mm", "Radius of the circle that fits the path where it is most curved.", bend_sketch),
    Subject(
        "infundibulopelvic_angle_deg",
        "Between the line from the pelvis down the ureter and the axis of the infundibulum.",
        angle_sketch,
    ),
    Subject("infundibular_length_mm", "From the lip of the pelvis straight to the bottom of the calyx.", length_sketch),
    Subject("infundibular_width_mm", "Across the infundibulum at its narrowest place.", width_sketch),
    Subject("calyx_diameter_mm", "Across the calyx at its widest place.", calyx_sketch),
    Subject("ureter_diameter_mean_mm", "Across the ureter, mean from its end in the image to the pelvis.", ureter_sketch),
    Subject("pelvis_diameter_mm", "The largest ball that fits into the pelvis.", pelvis_sketch),
    Subject("trachea_diameter_mm", "Across the middle half of the trachea.", bore_sketch),
    Subject("carinal_angle_deg", "Between the directions of the two main bronchi.", carina_sketch),
    Subject("generation", "Branchings between the trachea and the branch.", generation_sketch),
    Subject("branch_diameter_mm", "Across the middle half of the branch.", bore_sketch),
    Subject("branch_angle_deg", "Between a branch's direction and its parent's.", branch_sketch),
    Subject("stone_diameter_mm", "The largest distance between two points of the stone.", stone_sketch),
    Subject("structure_distance_min_mm", "From the path to the nearest part of the structure.", structure_sketch),
)
