"""The report's section "Measures": tables by group, scores with their parts, definitions, and the picture they are read from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.measures_sketches import Sketch, sketches
from reports.numbers import Phrase, Source, phrase
from reports.svg import tag
from segmentation.arrays import FloatArray

KEY = "details.measures"
# Decimals that mean something, by the unit; diameters and widths are better than lengths.
DIGITS = {"mm": 1, "°": 1, "HU": 0, "mm³": 0, "": 3}
FINE = ("width", "diameter", "radius", "distance", "ball")
TITLES = {
    "path": "Path",
    "urinary": "Collecting system",
    "airway": "Airway",
    "stone": "Stones",
    "structure": "Structures near the path",
}
PARTS = {"infundibulopelvic_angle_deg": "Infundibula", "infundibular_length_mm": "Calyces", "generation": "Branches"}
PICTURE = 340.0  # drawing units of the longer side
ROOM = 34.0
LABEL_WIDE, LABEL_TALL = 24.0, 12.0


@dataclass(frozen=True)
class Row:
    """One part of the anatomy with its values, in the order of the table's columns."""

    name: str
    cells: tuple[Phrase, ...]


@dataclass(frozen=True)
class Group:
    """One table: columns with name and unit, a row for each part or what `of` says; `notes` say why a dash stands where."""

    title: str
    head: tuple[str, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    of: str = "Part"


@dataclass(frozen=True)
class ScoreTable:
    """One score: its total in words and figures, its parts, its source."""

    name: str
    total: Phrase
    rows: tuple[tuple[str, str, str, Phrase], ...]
    source: str


@dataclass(frozen=True)
class Meaning:
    """What a measure means and who defined it."""

    name: str
    text: str
    source: str


@dataclass(frozen=True)
class Section:
    """Everything the section shows."""

    groups: tuple[Group, ...]
    scores: tuple[ScoreTable, ...]
    meanings: tuple[Meaning, ...]
    sketches: tuple[Sketch, ...]
    picture: Markup | None
    caption: str


def measures_section(source: Source) -> Section | None:
    """The section of a run, or None where nothing was measured."""
    told = (source.result.get("details") or {}).get("measures")
    if not told or not told["items"]:
        return None
    drawing = told.get("drawing")
    frame = str(source.result.get("frame"))
    return Section(
        groups=tuple(group for name in TITLES for group in groups_of(source, told["items"], name)),
        scores=tuple(score_of(source, k, score) for k, score in enumerate(told["scores"])),
        meanings=tuple(Meaning(one["name"], one["text"], one["source"]) for one in told["definitions"].values()),
        sketches=sketches(told["items"], lambda k: value_of(source, k, told["items"][k], unit=True)),
        picture=None if drawing is None else picture_of(drawing),
        caption="Seen from the front: the patient’s left is on the right." if frame == "LPS" else "Seen along the mesh’s y axis.",
    )


def groups_of(source: Source, items: Sequence[Mapping[str, Any]], group: str) -> list[Group]:
    """The measures of one group: what holds for the whole as a list, parts of one kind as rows of one table."""
    mine = [(k, item) for k, item in enumerate(items) if item["group"] == group]
    made = []
    whole = [(k, item) for k, item in mine if not item["of"]]
    if whole:
        made.append(listed(source, whole, group))
    kinds: dict[tuple[str, ...], list[str]] = {}
    for of in dict.fromkeys(item["of"] for _, item in mine if item["of"]):
        kinds.setdefault(tuple(item["key"] for _, item in mine if item["of"] == of), []).append(of)
    place = {(item["of"], item["key"]): (k, item) for k, item in mine}
    for keys, parts in kinds.items():
        names = [place[parts[0], key][1] for key in keys]
        head = tuple(item["name"] + (f", {item['unit']}" if item["unit"] else "") for item in names)
        rows = tuple(Row(of, tuple(value_of(source, *place[of, key]) for key in keys)) for of in parts)
        title = PARTS.get(keys[0], TITLES[group])
        made.append(Group(title, head, rows, reasons([place[of, key] for of in parts for key in keys])))
    return made


def listed(source: Source, mine: Sequence[tuple[int, Mapping[str, Any]]], group: str) -> Group:
    """The measures of a group one below the other, with their units."""
    rows = tuple(
        Row(f"{item['of']}: {item['name']}" if item["of"] else item["name"], (value_of(source, k, item, unit=True),))
        for k, item in mine
    )
    return Group(TITLES[group], ("Value",), rows, reasons(mine), of="Measure")


def value_of(source: Source, k: int, item: Mapping[str, Any], *, unit: bool = False) -> Phrase:
    """A value as a figure that can be checked, or a dash."""
    if item["value"] is None:
        return phrase("–")
    digits = 0 if item["key"] == "generation" else DIGITS[item["unit"]]
    if item["unit"] == "mm" and any(word in item["name"].lower() for word in FINE) and "where" not in item["name"]:
        digits = 2
    return phrase(source.need(f"{KEY}.items.{k}.value", digits, item["unit"] if unit else ""))


def reasons(mine: Sequence[tuple[int, Mapping[str, Any]]]) -> tuple[str, ...]:
    """Why values are lacking, each reason once with what it holds for."""
    found: dict[str, list[str]] = {}
    for _, item in mine:
        if item["reason"]:
            name = f"{item['of']}: {item['name'].lower()}" if item["of"] else item["name"].lower()
            found.setdefault(item["reason"], []).append(name)
    return tuple(f"Not computable, {', '.join(names)}: {reason}." for reason, names in found.items())


def score_of(source: Source, k: int, score: Mapping[str, Any]) -> ScoreTable:
    """One score with its parts."""
    key = f"{KEY}.scores.{k}"
    if score["total"] is not None:
        total = phrase(source.need(f"{key}.total", 0))
    else:
        total = phrase("between ", source.need(f"{key}.low", 0), " and ", source.need(f"{key}.high", 0), ", parts are lacking")
    rows = tuple(
        (
            part["name"],
            part["rule"],
            part["given"],
            phrase("–") if part["points"] is None else phrase(source.need(f"{key}.parts.{n}.points", 0)),
        )
        for n, part in enumerate(score["parts"])
    )
    return ScoreTable(score["name"], total, rows, score["source"])


def picture_of(drawing: Mapping[str, Any]) -> Markup:
    """Middle lines, axes and marked places as a drawing of x against z; what the measures were read from."""
    lines = {name: np.asarray(line, float)[:, [0, 2]] for name, line in drawing["lines"].items()}
    points = {name: np.asarray(point, float)[[0, 2]] for name, point in drawing["points"].items()}
    every = np.vstack([*lines.values(), *points.values()])
    low, high = every.min(axis=0), every.max(axis=0)
    scale = (PICTURE - 2.0 * ROOM) / float((high - low).max())
    size = (high - low) * scale + 2.0 * ROOM

    def at(place: FloatArray) -> FloatArray:
        return np.column_stack([ROOM + (place[..., 0] - low[0]) * scale, size[1] - ROOM - (place[..., 1] - low[1]) * scale])

    parts = []
    for name, line in lines.items():
        kind = "measure-axis" if name.startswith("axis") else "measure-line"
        parts.append(tag("path", class_=kind, d=path_data(at(line))))
    if {"pelvis", "ureter level"} <= points.keys():
        parts.append(tag("path", class_="measure-axis", d=path_data(at(np.array([points["pelvis"], points["ureter level"]])))))
    words: list[tuple[float, float, str, str]] = []
    for name, point in points.items():
        x, y = at(point[None])[0]
        parts.append(tag("circle", class_="measure-dot", cx=float(x), cy=float(y), r=2.5))
        label = name.removeprefix("bottom of ") if name.startswith("bottom of ") else "" if name.startswith("lip of ") else name
        if label:
            side = "end" if x > 0.6 * size[0] and not name.startswith("bottom") else "start"
            words.append((float(x) + (-6.0 if side == "end" else 6.0), float(y) + 4.0, side, label))
    told = "Middle lines of the lumen with the axes and places of the measures"
    return Markup('<svg class="measure" viewBox="0 0 {:.0f} {:.0f}" role="img" aria-label="{}">{}</svg>').format(
        float(size[0]), float(size[1]), told, Markup("").join([*parts, *apart(words)])
    )


def apart(words: Sequence[tuple[float, float, str, str]]) -> list[Markup]:
    """Labels as (x, y, anchor, text), those that would lie on each other moved down."""
    placed: list[tuple[float, float, str, str]] = []
    for x, y, anchor, label in sorted(words, key=lambda word: word[1]):
        near = [other for other in placed if abs(other[0] - x) < LABEL_WIDE]
        lowest = max((other[1] for other in near), default=-LABEL_TALL)
        placed.append((x, max(y, lowest + LABEL_TALL), anchor, label))
    return [tag("text", label, class_="axis halo", x=x, y=y, text_anchor=anchor) for x, y, anchor, label in placed]


def path_data(points: FloatArray) -> str:
    """A polyline as path data."""
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
