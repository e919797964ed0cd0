"""What the report says: verdict, key figures and the list of flagged stretches, in words with figures."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from reports.numbers import Figure, Phrase, Source, phrase, printed, sentence
from tubeplan_viz.result import STRAIGHT_MM, digits_apart, kept_until

COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
# Words of --objective other than the default.
AIMS = {"length": " for the shortest path", "curvature": " for the straightest path"}
EVEN = 1e-3  # of the curvature: less difference is none
ROWS_SHOWN = 6  # flagged stretches listed at once; the rest is one fold away

STATUS = {
    "ok": ("yes", "Holds"),
    "flagged": ("flag", "Flagged"),
    "infeasible": ("no", "No path"),
}


@dataclass(frozen=True)
class KeyFigure:
    """One of the four figures under the verdict; `tone` is a class of the style sheet or empty."""

    term: str
    value: Phrase
    more: tuple[Phrase, ...]
    tone: str = ""


@dataclass(frozen=True)
class FlagRow:
    """One flagged stretch."""

    kind: str
    name: str
    where: Phrase
    part: str
    worst: Phrase
    go: float


@dataclass(frozen=True)
class Verdict:
    """The first screen: does it hold, where not, by how much."""

    status: str
    icon: str
    word: str
    line: str
    title: Phrase
    lead: Phrase
    warnings: tuple[str, ...]
    keys: tuple[KeyFigure, ...]
    flags: tuple[FlagRow, ...]
    more_flags: tuple[FlagRow, ...]


def part_at(parts: Sequence[Mapping[str, Any]], at: float) -> str:
    """Name of the part of the anatomy at `at` mm, or an empty string."""
    return next((str(part["name"]) for part in parts if part["from_mm"] <= at <= part["to_mm"]), "")


def capitalised(words: str) -> str:
    """Words that stand alone, with a capital."""
    return words[:1].upper() + words[1:]


def count_of(number: int, one: str, many: str) -> str:
    """A count with its noun, small numbers as words.

    Examples
    --------
    >>> count_of(2, "stretch breaks", "stretches break")
    'two stretches break'
    """
    word = COUNTS[number] if number < len(COUNTS) else str(number)
    return f"{word} {one if number == 1 else many}"


def verdict(source: Source, parts: Sequence[Mapping[str, Any]]) -> Verdict:
    """The verdict of one result, in the status the result itself gives."""
    result = source.result
    status = str(result["status"])
    icon, word = STATUS[status]
    flags = list(result.get("flagged_intervals") or [])
    shown, folded = _flag_rows(source, flags, parts)
    details = result.get("details") or {}
    return Verdict(
        status=status,
        icon=icon,
        word=word,
        line=_line(source, status, len(flags)),
        title=_title(source, status, flags, parts),
        lead=_lead(source, status, parts),
        warnings=tuple(sentence(str(text)) for text in details.get("warnings") or ()),
        keys=tuple(
            key for key in (_instrument(source), margin_key(source, parts), bend_key(source, parts), _takes(source)) if key
        ),
        flags=shown,
        more_flags=folded,
    )


def worst_place(source: Source, kind: str) -> Figure | None:
    """Where along the path clearance is least, or curvature largest: as flagged, otherwise at the path's samples."""
    flags = source.result.get("flagged_intervals") or []
    mine = [k for k, flag in enumerate(flags) if flag["kind"] == kind]
    if mine:
        gravest = min(mine, key=lambda k: flags[k]["worst"] * (1.0 if kind == "clearance" else -1.0))
        return source.figure(f"flagged_intervals.{gravest}.worst_at_mm", 1, "mm")
    return source.figure("derived:clearance_min_at_mm" if kind == "clearance" else "derived:curvature_max_at_mm", 1, "mm")


def _has_path(source: Source) -> bool:
    return len((source.result.get("path") or {}).get("points_mm") or ()) > 1


def _line(source: Source, status: str, flags: int) -> str:
    if status == "infeasible":
        return (
            "The best path found is drawn for inspection; it is not a plan" if _has_path(source) else "Nothing could be planned"
        )
    aim = _aim(source)
    if status == "ok":
        return f"Planned from start to goal{aim}; nothing is flagged"
    return f"Planned to the end{aim}; {count_of(flags, 'stretch breaks', 'stretches break')} a limit"


def _aim(source: Source) -> str:
    """What the path was to be best in, where that is not its clearance: it then is nearer to the wall than it need be."""
    settings = (source.result.get("provenance") or {}).get("settings") or {}
    return AIMS.get((settings.get("tube") or {}).get("objective", ""), "")


def _margin_figure(source: Source, *, signed: bool = False, strong: bool = False) -> Figure | None:
    return source.figure("derived:margin_mm", _margin_digits(source), "mm", signed=signed, strong=strong)


def _margin_digits(source: Source) -> int:
    margin = source.value("derived:margin_mm")
    return 2 if margin is None else digits_apart(margin, 0.0, 2)


def _radii(source: Source) -> tuple[Figure | None, Figure | None]:
    """Sharpest bend's radius and the least allowed, with as many digits as tell them apart."""
    reached, allowed = source.value("derived:bend_radius_mm"), source.value("derived:bend_radius_limit_mm")
    digits = 1 if reached is None or allowed is None else digits_apart(reached, allowed, 1)
    return source.figure("derived:bend_radius_mm", digits, "mm"), source.figure("derived:bend_radius_limit_mm", 1, "mm")


def goal_words(source: Source, parts: Sequence[Mapping[str, Any]]) -> str:
    """The goal by the part of the anatomy in which it lies, else by its label."""
    details = source.result.get("details") or {}
    label = details.get("goal_label")
    of_end = [tip.get("name") for tip in details.get("endpoints") or () if label and tip["label"] == label]
    name = str(parts[-1]["name"]) if parts else next(iter(of_end), None)
    if not name:
        return f"goal {label}" if label else "the goal"
    return f"the {name}" if not label or str(label) in re.findall(r"\w+", name) else f"the {name} ({label})"


def _title(source: Source, status: str, flags: Sequence[Mapping[str, Any]], parts: Sequence[Mapping[str, Any]]) -> Phrase:
    if status == "ok":
        return phrase(f"The path reaches {goal_words(source, parts)} and keeps both limits")
    if status == "flagged":
        broken = count_of(len(flags), "stretch breaks", "stretches break")
        return phrase(f"The path reaches {goal_words(source, parts)}, but {broken} a limit")
    narrow = min((i for i, f in enumerate(flags) if f["kind"] == "clearance"), key=lambda i: flags[i]["worst"], default=None)
    sharp = max((i for i, f in enumerate(flags) if f["kind"] == "curvature"), key=lambda i: flags[i]["worst"], default=None)
    way = (source.result.get("details") or {}).get("bottleneck") or {}
    bend = way.get("bend") or {}
    narrow_by = source.figure("derived:narrow_by_mm", 2, "mm")
    if not bend.get("proves_impossible") and way.get("proves_impossible") and narrow_by is not None:
        narrow_by = source.need("derived:narrow_by_mm", digits_apart(narrow_by.value, 0.0, 2), "mm")
        if way.get("end"):
            return phrase(f"No path: the {way['end']} itself lies too near the wall by ", narrow_by)
        return phrase("No path: the lumen is too narrow by ", narrow_by)
    if bend.get("proves_impossible"):
        left = source.need("details.bottleneck.bend.clearance_upper_bound_mm", 2, "mm")
        return phrase("No path: the bend leaves less than ", left, " for this bend radius")
    if narrow is not None and sharp is None:
        return phrase("No path: the lumen is too narrow by ", source.need(f"derived:flag.{narrow}.short_mm", 2, "mm"))
    if sharp is not None and narrow is None:
        radius, allowed = (
            source.figure(f"derived:flag.{sharp}.radius_mm", 1, "mm"),
            source.figure("derived:bend_radius_limit_mm", 1, "mm"),
        )
        if radius is not None and allowed is not None:
            return phrase("No path: the bend needs a radius of ", radius, ", the instrument allows ", allowed)
    return phrase("No path keeps both limits") if flags else phrase("No path from start to goal")


def _lead(source: Source, status: str, parts: Sequence[Mapping[str, Any]]) -> Phrase:
    reason = source.result.get("reason")
    if status == "infeasible":
        return phrase(sentence(str(reason)) if reason else "", *_kept_until(source, parts))
    said: list[Phrase] = []
    margin, at = source.value("derived:margin_mm"), worst_place(source, "clearance")
    asked = source.figure("limits.clearance_min_mm", 2, "mm")
    if margin is not None and at is not None and asked is not None:
        place = part_at(parts, at.value)
        where = phrase("At ", at, f", in the {place}," if place else "")
        least = source.need(
            "metrics.clearance_min_mm",
            digits_apart(source.need("metrics.clearance_min_mm", 2).value, asked.value, 2),
            "mm",
            strong=True,
        )
        total = source.figure("derived:flagged_clearance_mm", 1, "mm")
        if margin < 0.0:
            said.append(
                phrase(
                    where,
                    " the path has only ",
                    least,
                    " to the wall where ",
                    asked,
                    " are asked for; it is short over ",
                    total,
                    " in all. ",
                )
            )
        else:
            said.append(phrase(where, " the path comes closest to the wall: ", least, " where ", asked, " are asked for. "))
    radius, allowed = _radii(source)
    if radius is not None and allowed is not None and radius.value >= STRAIGHT_MM:
        said.append(phrase("It is straight. "))
    elif radius is not None and allowed is not None:
        strong = Figure(radius.key, radius.value, radius.digits, radius.unit, strong=True)
        over = (source.value("derived:curvature_excess_percent") or 0.0) > 0.0
        span = phrase(", over ", source.figure("derived:flagged_curvature_mm", 1, "mm"), " in all") if over else phrase()
        said.append(phrase("The sharpest bend has a radius of ", strong, " where the instrument allows ", allowed, span, ". "))
    certificate = source.result.get("certificate") or {}
    if certificate.get("holds") and status == "ok":
        said.append(phrase("Both are proved for every point of the path, between the samples too."))
    elif status == "flagged":
        said.append(phrase("Everywhere else both limits hold."))
    return phrase(*said)


def _kept_until(source: Source, parts: Sequence[Mapping[str, Any]]) -> tuple[Phrase, ...]:
    """How far along the best path found both limits hold, where they do for a stretch worth a word."""
    kept, length = kept_until(source.result), source.figure("metrics.length_mm", 1, "mm")
    if kept is None or length is None:
        return ()
    place = part_at(parts, kept[0])
    where = (f", in the {place}" if place else "") + f", at ({', '.join(printed(v, 1) for v in kept[1])})\u00a0mm."
    until = source.need("derived:kept_until_mm", 1, "mm")
    return (phrase(" The best path found keeps both limits up to ", until, " of ", length, where),)


def _instrument(source: Source) -> KeyFigure | None:
    diameter = source.figure("derived:instrument_diameter_mm", 2, "mm")
    asked, allowed = source.figure("limits.clearance_min_mm", 2, "mm"), source.figure("derived:bend_radius_limit_mm", 1, "mm")
    named = (source.result.get("details") or {}).get("instrument")
    name = named.get("name") if isinstance(named, Mapping) else named
    if diameter is None and allowed is None:
        return None
    value = (
        phrase(str(name))
        if name
        else phrase("⌀\u00a0", diameter)
        if diameter is not None and diameter.value > 0
        else phrase("centre line only")
    )
    more = [phrase("least clearance ", asked)] if asked is not None else []
    if allowed is not None:
        more.append(phrase("least bend radius ", allowed, " (", source.need("limits.curvature_max_per_mm", 4, "1/mm"), ")"))
    return KeyFigure("Instrument", value, tuple(more))


def margin_key(source: Source, parts: Sequence[Mapping[str, Any]] = ()) -> KeyFigure | None:
    """The tightest place: how much is left of the clearance asked for, and where."""
    margin = _margin_figure(source, signed=True)
    if margin is None:
        return None
    least, asked = source.need("metrics.clearance_min_mm", 2), source.need("limits.clearance_min_mm", 2, "mm")
    least = source.need("metrics.clearance_min_mm", digits_apart(least.value, asked.value, 2))
    at = worst_place(source, "clearance")
    place = part_at(parts, at.value) if at is not None else ""
    more = [phrase(least, " of ", asked, " clearance")]
    if at is not None:
        more.append(phrase("at ", at, f", {place}" if place else ""))
    return KeyFigure("Worst margin", phrase(margin), tuple(more), "clearance" if margin.value < 0 else "")


def bend_key(source: Source, parts: Sequence[Mapping[str, Any]] = ()) -> KeyFigure | None:
    """The sharpest bend: its radius, its share of the limit, and where."""
    reached = source.figure("metrics.curvature_max_per_mm", 4, "1/mm")
    if reached is None:
        return None
    radius, _ = _radii(source)
    over = source.figure("derived:curvature_excess_percent", 0)
    at = worst_place(source, "curvature")
    place = part_at(parts, at.value) if at is not None else ""
    allowed = source.figure("limits.curvature_max_per_mm", 4)
    more = [phrase(reached, *((" of ", allowed) if allowed is not None else ()))]
    if over is not None and over.value > 0:
        over = source.need("derived:curvature_excess_percent", digits_apart(over.value, 0.0, 0))
        more = [phrase(reached, ", ", over, "\u00a0% over ", allowed)]
    if at is not None:
        more.append(phrase("at ", at, f", {place}" if place else "", " and as sharp all along" if _even(source) else ""))
    value = phrase("radius ", radius) if radius is not None and radius.value < STRAIGHT_MM else phrase("straight")
    return KeyFigure("Sharpest bend", value, tuple(more), "curvature" if over is not None and over.value > 0 else "")


def _even(source: Source) -> bool:
    """Whether the path bends alike from end to end, as that of a needle does that is never spun."""
    bends = (source.result.get("path") or {}).get("curvature_per_mm") or (0.0,)
    return min(bends) > 0.0 and max(bends) - min(bends) <= EVEN * max(bends)


def _takes(source: Source) -> KeyFigure | None:
    """What this very path would hold for: an instrument as wide as twice its least clearance."""
    diameter = source.figure("derived:path_diameter_mm", 2, "mm")
    radius, _ = _radii(source)
    if diameter is None:
        return None
    if diameter.value <= 0:
        return KeyFigure("This path takes", phrase("no instrument"), (phrase("its centre line touches the wall"),), "never")
    more = [phrase("the width its least clearance leaves")]
    if radius is not None and radius.value < STRAIGHT_MM:
        more.append(phrase("if it bends to a radius of ", radius))
    return KeyFigure(
        "This path takes", phrase("⌀\u00a0", diameter), tuple(more), "holds" if source.result["status"] == "ok" else ""
    )


def _flag_rows(
    source: Source, flags: Sequence[Mapping[str, Any]], parts: Sequence[Mapping[str, Any]]
) -> tuple[tuple[FlagRow, ...], tuple[FlagRow, ...]]:
    """Rows in path order: the gravest `ROWS_SHOWN`, and the rest."""
    limits = source.result.get("limits") or {}

    def gravity(index: int) -> float:
        flag = flags[index]
        if flag["kind"] == "clearance":
            asked = limits.get("clearance_min_mm") or 1.0
            return float(asked - flag["worst"]) / max(asked, 1e-9)
        return float(flag["worst"]) / max(limits.get("curvature_max_per_mm") or 1.0, 1e-9) - 1.0

    grave = set(sorted(range(len(flags)), key=gravity, reverse=True)[:ROWS_SHOWN])
    order = sorted(range(len(flags)), key=lambda index: flags[index]["from_mm"])
    rows = {index: _flag_row(source, index, flags[index], parts) for index in order}
    return tuple(rows[i] for i in order if i in grave), tuple(rows[i] for i in order if i not in grave)


def _flag_row(source: Source, index: int, flag: Mapping[str, Any], parts: Sequence[Mapping[str, Any]]) -> FlagRow:
    key = f"flagged_intervals.{index}"
    start, end, at = (source.need(f"{key}.{name}", 1) for name in ("from_mm", "to_mm", "worst_at_mm"))
    where = phrase(
        start, " to ", Figure(end.key, end.value, 1, "mm"), ", ", source.need(f"derived:flag.{index}.length_mm", 1, "mm"), " long"
    )
    if flag["kind"] == "clearance":
        asked = source.figure("limits.clearance_min_mm", 2, "mm")
        digits = 2 if asked is None else digits_apart(flag["worst"], asked.value, 2)
        worst = phrase(source.need(f"{key}.worst", digits, "mm", strong=True), *((" of ", asked) if asked else ()))
        name = "Clearance short"
    else:
        limit = source.value("derived:bend_radius_limit_mm")
        radius = source.figure(f"derived:flag.{index}.radius_mm", 1)
        digits = 1 if radius is None or limit is None else digits_apart(radius.value, limit, 1)
        worst = phrase(
            "radius ",
            source.figure(f"derived:flag.{index}.radius_mm", digits, "mm", strong=True),
            " of ",
            source.figure("derived:bend_radius_limit_mm", 1, "mm"),
        )
        name = "Bend too sharp"
    worst = phrase(worst, ", at ", Figure(at.key, at.value, 1, "mm"))
    return FlagRow(flag["kind"], name, where, capitalised(part_at(parts, at.value)), worst, at.value)
