"""The walk from inside: pictures from the tip, and in words which way to turn where."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from reports.numbers import Figure, Phrase, Source, phrase, printed
from tubeplan_viz.endoluminal import Film, Still

BEFORE_MM = 3.0  # a fork is seen best from a little before it


@dataclass(frozen=True)
class Card:
    """One picture of the strip with what to do there; `go` is the arc length that its button shows."""

    title: str
    where: Phrase
    told: Phrase
    picture: str
    words: str
    go: float


@dataclass(frozen=True)
class Walk:
    """The strip and how it was made."""

    cards: tuple[Card, ...]
    line: str


def walk_of(source: Source, film: Film | None) -> Walk | None:
    """Start, each fork and bend, the tightest place and the goal; None without pictures.

    Parameters
    ----------
    source : Source
        Of result.json; steps stand in ``details.walk.steps``.
    film : Film or None
    """
    length = source.figure("metrics.length_mm", 1, "mm")
    if film is None or length is None:
        return None
    steps = ((source.result.get("details") or {}).get("walk") or {}).get("steps") or []
    cards = [(-1.0, card(film, "Start", phrase("0 mm"), phrase("The picture’s top: ", top_words(film, source)), 0.0, 0.0))]
    for k, step in enumerate(steps):
        at = source.need(f"details.walk.steps.{k}.s_mm", 1, "mm")
        title = "Fork" if step["kind"] == "junction" else "Bend"
        cards.append((at.value, card(film, title, phrase(at), step_words(source, k, step), at.value - BEFORE_MM, at.value)))
    at_least = source.figure("derived:clearance_min_at_mm", 1, "mm")
    least = source.figure("metrics.clearance_min_mm", 2, "mm")
    if at_least is not None and least is not None:
        told = phrase("Least clearance, ", least)
        cards.append((at_least.value, card(film, "Tightest", phrase(at_least), told, at_least.value - BEFORE_MM, at_least.value)))
    last = card(film, "Goal", phrase(length), phrase("End of the path"), length.value, length.value)
    cards.append((length.value + 1.0, last))
    step = printed(film.step, 1)
    line = f"Drawn from the wall mesh, one picture every {step} mm; blue is the way ahead. 12 o’clock is the picture’s top."
    return Walk(tuple(one for _, one in sorted(cards, key=lambda pair: pair[0])), line)


def stages_walk(source: Source, stills: Sequence[Still]) -> Walk | None:
    """What the camera in the robot's tip sees at the start and where each stage of its plan ends.

    Parameters
    ----------
    source : Source
        Of result.json; stages stand in ``details.stages``.
    stills : sequence of Still
        One picture at the start and one at the end of each stage; none for no walk.
    """
    if not stills:
        return None
    names = ["start", *(str(stage["name"]) for stage in source.result["details"]["stages"])]
    cards = tuple(
        Card(
            name.capitalize(),
            phrase(f"{printed(still.arc_length, 1)}\u00a0mm"),
            phrase("where the robot begins" if k == 0 else f"end of stage {k}"),
            data_uri(still.jpeg),
            f"View from the robot's tip, {name}",
            still.arc_length,
        )
        for k, (name, still) in enumerate(zip(names, stills, strict=True))
    )
    return Walk(cards, "What a camera in the robot’s tip sees, drawn from the wall mesh; blue is the way ahead.")


def card(film: Film, title: str, where: Phrase, told: Phrase, seen_from: float, go: float) -> Card:
    """One card with the picture nearest to `seen_from`, mm."""
    still = film.stills[film.nearest(seen_from)]
    words = f"View from the tip at {printed(still.arc_length, 1)} mm: {title.lower()}"
    return Card(title, where, told, data_uri(still.jpeg), words, go)


def step_words(source: Source, k: int, step: dict[str, Any]) -> Phrase:
    """Which way to turn: ``Go on at 3 o'clock (inferior and right), turn 40 deg ...``."""
    key = f"details.walk.steps.{k}"
    parts: list[str | Figure | None] = ["Go on at ", source.figure(f"{key}.clock_h", 0, "o’clock")]
    parts += [f" ({step['toward']})" if step.get("toward") else "", ", turn ", source.figure(f"{key}.turn_deg", 0), "°"]
    roll = source.figure(f"{key}.roll_deg", 0, signed=True)
    parts += ["; roll ", roll, "°"] if k and roll is not None else []
    hours = step["other_openings_clock_h"]
    others = [source.figure(f"{key}.other_openings_clock_h.{j}", 0) for j, hour in enumerate(hours) if hour != step["clock_h"]]
    if len(others) < len(hours):
        parts.append(". Another opening lies the same way")
    if others:
        parts.append(". Other opening at " if len(others) == 1 else ". Other openings at ")
        for j, other in enumerate(others):
            parts += [", " if j else "", other]
        parts.append("\u00a0o’clock")
    return phrase(*parts, ".")


def top_words(film: Film, source: Source) -> str:
    """Where the first picture's top points."""
    up = film.stills[0].camera.up
    if source.result.get("frame") != "LPS":
        return f"along {', '.join(printed(float(v), 1, signed=True) for v in up)} of the mesh’s axes"
    names: Sequence[tuple[str, str]] = (("left", "right"), ("posterior", "anterior"), ("superior", "inferior"))
    k = max(range(3), key=lambda axis: abs(float(up[axis])))
    return names[k][0 if up[k] > 0 else 1]


def film_data(film: Film | None) -> dict[str, Any] | None:
    """The film for the page's script: arc lengths and pictures in base64."""
    if film is None:
        return None
    return {
        "s": [round(still.arc_length, 2) for still in film.stills],
        "pictures": [base64.b64encode(still.jpeg).decode("ascii") for still in film.stills],
    }


def data_uri(jpeg: bytes) -> str:
    """A picture as the page embeds it."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode("ascii")
