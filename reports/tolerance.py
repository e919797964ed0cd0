"""How the path bears errors of pose: the chance that it stays clear, by size of error and place by place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.numbers import Phrase, Source, phrase, printed
from reports.svg import LEFT, RIGHT, Axis, Width, frame, grid, in_all_widths, path_axis, tag, trace
from reports.tables import or_dash

KEY = "details.tolerance"
# Series of the presets: name, and whether shift and turn are there. The marks tell them apart without colour.
SERIES = (("shift and turn", True, True), ("shift alone", True, False), ("turn alone", False, True))


@dataclass(frozen=True)
class Sizes:
    """One size of error: the chance with each kind of error, and where the path fails with both."""

    size: Phrase
    chances: tuple[Phrase, ...]
    weakest: Phrase
    first: Phrase


@dataclass(frozen=True)
class PoseErrors:
    """The section of a run that was asked how it bears errors of pose."""

    lead: Phrase
    kinds: tuple[str, ...]
    rows: tuple[Sizes, ...]
    by_size: Markup
    along: Markup
    along_words: Phrase


def pose_errors(source: Source) -> PoseErrors | None:
    """The section on errors of pose, or None for a run that was not asked."""
    told = (source.result.get("details") or {}).get("tolerance")
    if not told:
        return None
    presets = told.get("presets")
    return _presets(source, presets) if presets else _single(source, told)


def _single(source: Source, told: Mapping[str, Any]) -> PoseErrors:
    size = phrase(source.need(f"{KEY}.translation_mm", 1, "mm"), ", ", source.need(f"{KEY}.rotation_deg", 1, "°"))
    return PoseErrors(
        lead=_lead(source, KEY, told, failing=told["probability"] < 1.0),
        kinds=("Stays clear",),
        rows=(
            Sizes(size, (_chance(source, KEY),), _place(source, f"{KEY}.weakest_mm"), _place(source, f"{KEY}.first_breach_mm")),
        ),
        by_size=Markup(""),
        along=clear_chart((told,), ("",)),
        along_words=phrase("share of the errors under which each place stays clear"),
    )


def _presets(source: Source, presets: Sequence[Mapping[str, Any]]) -> PoseErrors:
    """Shift and turn by the same number of mm and degrees, and each alone."""
    table: dict[tuple[bool, bool], dict[float, int]] = {(shift, turn): {} for _, shift, turn in SERIES}
    for k, entry in enumerate(presets):
        shift, turn = entry["translation_mm"], entry["rotation_deg"]
        table[shift > 0.0, turn > 0.0][max(shift, turn)] = k
    both = table[True, True]
    rows = []
    for size, k in sorted(both.items()):
        chances = tuple(_chance(source, f"{KEY}.presets.{table[shift, turn][size]}") for _, shift, turn in SERIES)
        key = f"{KEY}.presets.{k}"
        amount = phrase(source.need(f"{key}.translation_mm", 0, "mm"), ", ", source.need(f"{key}.rotation_deg", 0, "°"))
        rows.append(Sizes(amount, chances, _place(source, f"{key}.weakest_mm"), _place(source, f"{key}.first_breach_mm")))
    # The first size that fails is where the reader's question begins; without any, the largest.
    failing = [k for _, k in sorted(both.items()) if presets[k]["probability"] < 1.0]
    shown = failing[0] if failing else max(both.items())[1]
    lines = [[(size, presets[k]) for size, k in sorted(table[shift, turn].items())] for _, shift, turn in SERIES]
    along = [presets[k] for _, k in sorted(both.items())]
    return PoseErrors(
        lead=_lead(source, f"{KEY}.presets.{shown}", presets[shown], failing=bool(failing)),
        kinds=tuple(name[:1].upper() + name[1:] for name, _, _ in SERIES),
        rows=tuple(rows),
        by_size=in_all_widths(partial(_draw_by_size, lines)),
        along=clear_chart(along, tuple(printed(entry["translation_mm"], 0) for entry in along)),
        along_words=phrase("share of the errors, shift and turn, under which each place stays clear; a line for each size"),
    )


def _lead(source: Source, key: str, told: Mapping[str, Any], *, failing: bool) -> Phrase:
    """What the first failing size does, where it fails first, and how the errors were drawn."""
    drawn = phrase(
        " Sizes are root mean square, the turn is about the middle of the path; ",
        source.need(f"{key}.samples", 0),
        " errors were drawn for each size.",
    )
    size = phrase(source.need(f"{key}.translation_mm", 1, "mm"), " and ", source.need(f"{key}.rotation_deg", 1, "°"))
    if not failing:
        return phrase("Under an error of ", size, " the path stayed clear in every draw.", drawn)
    first = source.figure(f"{key}.first_breach_mm", 1, "mm")
    where = phrase(", most often first at ", first) if first is not None else phrase()
    share = phrase(source.need(f"{key}.probability", 3), " (", source.need(f"{key}.probability_low", 3), " to ")
    share = phrase(share, source.need(f"{key}.probability_high", 3), ", 95 %)")
    return phrase("Under an error of ", size, " the path stays clear with probability ", share, where, ".", drawn)


def _chance(source: Source, key: str) -> Phrase:
    return phrase(source.need(f"{key}.probability", 3))


def _place(source: Source, key: str) -> Phrase:
    return or_dash(source.figure(key, 1, "mm"))


def clear_chart(entries: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Markup:
    """Share of the errors under which each place stays clear, over arc length; a line for each size of error."""

    def draw(width: Width) -> Markup:
        tall = 170.0
        length = float(entries[0]["s_mm"][-1])
        wide = width.half
        x, y = Axis(0.0, length, LEFT, wide - RIGHT - 16), Axis(0.0, 1.0, tall - 24.0, 10.0)
        parts = grid((LEFT, wide - RIGHT), y, 0.25)
        parts += path_axis(length, x, y.start, wide - LEFT - RIGHT)
        last = -np.inf
        for entry, name in zip(entries, names, strict=True):
            arc, clear = np.asarray(entry["s_mm"], float), np.asarray(entry["clear"], float)
            parts.append(tag("path", class_="after thin" if name else "after", d=trace(arc, clear, x, y)))
            at = max(y(float(clear[-1])) + 4.0, last + 11.0)
            last = at
            if name:
                parts.append(tag("text", name, class_="axis", x=x.end + 4, y=at))
        words = "Share of errors of pose under which each place of the path stays clear"
        return frame(width, (wide, tall), words + (", by size in mm and degrees" if names[0] else ""), parts)

    return in_all_widths(draw)


def _draw_by_size(lines: Sequence[Sequence[tuple[float, Mapping[str, Any]]]], width: Width) -> Markup:
    """Chance that the whole path stays clear, against the size of the error, with 95 % intervals where both errors act."""
    wide, tall, left = width.half, 210, 40
    sizes = [size for size, _ in lines[0]]
    x = Axis(0.0, max(sizes) * 1.04, left, wide - RIGHT)
    y = Axis(0.0, 1.0, tall - 36, 12)
    parts = grid((left, wide - RIGHT), y, 0.25)
    for size in sizes:
        parts.append(tag("line", class_="tick", x1=x(size), x2=x(size), y1=y.start, y2=y.start + 4))
        parts.append(tag("text", printed(size, 0), class_="axis", x=x(size), y=y.start + 16, text_anchor="middle"))
    parts.append(tag("text", "error, mm and degrees", class_="axis", x=wide - RIGHT, y=tall - 4, text_anchor="end"))
    for (name, _, _), line, style in zip(SERIES, lines, ("after", "before", "limit"), strict=True):
        corners = [(x(0.0), y(1.0)), *((x(size), y(entry["probability"])) for size, entry in line)]
        # Without any error the verdict is the plan's own: the line begins at the first size when the plan itself fails.
        if all(entry["probability"] == 0.0 for _, entry in line):
            corners = corners[1:]
        parts.append(tag("path", class_=style, fill="none", d="M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in corners)))
        if name == SERIES[0][0]:
            for size, entry in line:
                at = x(size)
                low, high = y(entry["probability_low"]), y(entry["probability_high"])
                parts.append(tag("line", class_="sample-bar", x1=at, x2=at, y1=low, y2=high))
                parts.append(tag("circle", class_="sample", cx=at, cy=y(entry["probability"]), r=3))
    told = ", ".join(f"{printed(entry['probability'], 2)} at {printed(size, 0)}" for size, entry in lines[0])
    words = f"Chance that the path stays clear, by size of the error in mm and degrees, shift and turn: {told}."
    return frame(width, (wide, tall), words, parts)
