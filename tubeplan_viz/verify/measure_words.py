"""Stones and scores of a run, held against what follows from their own numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from tubeplan_viz.verify.verification import Check

# Points by the published tables, as (limits, points from below); at a limit itself the lower points hold.
BURDEN, DENSITY, LENGTH = ((10.0, 20.0), (1, 2, 3)), ((1000.0,), (1, 2)), ((25.0,), (1, 2))
SIZE = ((20.0,), (0, 1))
SAME = 0.06  # a part's words give one decimal


def check_stones(items: Mapping[tuple[str, str], float]) -> Iterator[Check]:
    """A stone is no larger than a ball of its diameter, and no denser on average than at its densest."""
    stones = sorted({of for key, of in items if key == "stone_volume_mm3"})
    for of in stones:
        volume, diameter = items["stone_volume_mm3", of], items["stone_diameter_mm", of]
        mean, most = items["stone_hu_mean", of], items["stone_hu_max", of]
        ball = np.pi / 6.0 * diameter**3
        yield Check(
            name=f"measures: {of}",
            ok=0.0 < volume <= ball and mean <= most,
            found=f"{volume:.0f} mm3 in {diameter:.1f} mm, mean {mean:.0f} HU, largest {most:.0f} HU",
            expected=f"at most the ball of that diameter, {ball:.0f} mm3, and a mean not above the largest",
            text="The stone's volume fits into its diameter, and its mean density under its largest.",
        )


def check_scores(told: Mapping[str, Any], items: Mapping[tuple[str, str], float]) -> Iterator[Check]:
    """Points of every score follow from the measures by its published table, and sum up to its total."""
    for score in told["scores"]:
        wrong = [part["name"] for part in score["parts"] if not part_follows(score["name"], part, items)]
        yield Check(
            name=f"measures: parts of {score['name']}",
            ok=not wrong,
            found=f"{len(wrong)} of {len(score['parts'])} parts that do not follow{': ' + ', '.join(wrong) if wrong else ''}",
            expected="none",
            text="Every part of the score has the points that its number gives, and the number is one of the measures.",
        )
        least = sum(part["lowest"] if part["points"] is None else part["points"] for part in score["parts"])
        most = sum(part["highest"] if part["points"] is None else part["points"] for part in score["parts"])
        known = all(part["points"] is not None for part in score["parts"])
        yield Check(
            name=f"measures: total of {score['name']}",
            ok=(score["low"], score["high"], score["total"]) == (least, most, least if known else None),
            found=f"{score['total']}, between {score['low']} and {score['high']}",
            expected=f"{least if known else None}, between {least} and {most}",
            text="The score is the sum of its parts.",
        )


def part_follows(score: str, part: Mapping[str, Any], items: Mapping[tuple[str, str], float]) -> bool:
    """Whether a part's points are those of its number, and its number one of the measures."""
    points, given = part["points"], str(part["given"])
    if points is None:
        return True
    if not part["lowest"] <= points <= part["highest"]:
        return False
    of_kind = {
        key: [value for (kind, _), value in items.items() if kind == key] for key in dict.fromkeys(key for key, _ in items)
    }
    burden = sum(of_kind.get("stone_diameter_mm", []))
    match part["name"]:
        case "Stone size":
            return bool(points == stepped(burden, SIZE))
        case "Stone burden":
            return bool(points == stepped(burden, BURDEN))
        case "Renal stone density":
            return bool(points == stepped(max(of_kind["stone_hu_mean"]), DENSITY))
        case "Renal infundibular length":
            length = number_in(given)
            near = [
                value for value in of_kind.get("infundibular_length_mm", []) if length is not None and abs(value - length) <= SAME
            ]
            return any(points == stepped(value, LENGTH) for value in near)
        case "Inferior pole stone" | "Lower pole with an angle below 45°":
            return pole_follows(score, points, given, items)
        case "Stones in several calyces":
            calyces = number_in(given)
            return calyces is not None and points == int(calyces > 1)
        case "Abnormal renal anatomy":
            return bool(points == int(given.endswith("yes")))
    return False


def pole_follows(score: str, points: int, given: str, items: Mapping[tuple[str, str], float]) -> bool:
    """Whether the points for the lower pole are those of its angle from the front."""
    first = 0 if score == "RUSS" else 1
    if given.startswith("no stone"):
        return points == first
    angle = items.get(("infundibulopelvic_angle_coronal_deg", "lower infundibulum"))
    said = number_in(given)
    if angle is None or said is None or abs(angle - said) > SAME:
        return False
    return points == (int(angle < 45.0) if score == "RUSS" else 3 if angle <= 30.0 else 2)


def stepped(value: float, table: tuple[tuple[float, ...], tuple[int, ...]]) -> int:
    """Points of a value by a table."""
    return table[1][int(np.searchsorted(np.array(table[0]), value, side="left"))]


def number_in(words: str) -> float | None:
    """The first number of some words."""
    found = re.search(r"\d+(\.\d+)?", words)
    return None if found is None else float(found[0])
