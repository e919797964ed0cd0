"""Where on its path a result is worst, how far it keeps both limits, and what these places are called."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

WORTH_MM = 1.0  # a shorter stretch at the start helps nobody


def kept_until(result: Mapping[str, Any]) -> tuple[float, list[float]] | None:
    """The last sample of a path before its first flagged stretch: a goal there is reached within both limits.

    Parameters
    ----------
    result : mapping
        The content of result.json.

    Returns
    -------
    (float, list of float) or None
        Arc length and point, mm; None for a path without flags, or with one from its first `WORTH_MM` on.
    """
    flags, path = result.get("flagged_intervals") or [], result.get("path") or {}
    if not flags or not path.get("s_mm"):
        return None
    first = min(flag["from_mm"] for flag in flags)
    # Where the flagged stretch begins the limit is just met; the sample before is clear of it.
    before = [k for k, s in enumerate(path["s_mm"]) if s < first]
    if len(before) < 2 or path["s_mm"][before[-2]] < WORTH_MM:
        return None
    return float(path["s_mm"][before[-2]]), list(path["points_mm"][before[-2]])


def worst_at(result: Mapping[str, Any], kind: str) -> float | None:
    """Where clearance is least or curvature largest, mm along the path; None where the path does not tell.

    Parameters
    ----------
    result : mapping
        The content of result.json.
    kind : {"clearance", "curvature"}
    """
    sign = 1.0 if kind == "clearance" else -1.0
    mine = [flag for flag in result.get("flagged_intervals") or [] if flag["kind"] == kind]
    if mine:  # between the samples it may be worse than at any of them
        return float(min(mine, key=lambda flag: sign * flag["worst"])["worst_at_mm"])
    path = result.get("path") or {}
    values = path.get("clearance_mm" if kind == "clearance" else "curvature_per_mm") or []
    return float(path["s_mm"][min(range(len(values)), key=lambda k: sign * values[k])]) if values else None


def place_words(result: Mapping[str, Any], at: float) -> str:
    """A place on the path, with the part of the anatomy where it is known: "57.0 mm, ureter"."""
    parts = (result.get("details") or {}).get("parts") or ()
    return ", ".join([f"{at:.1f} mm", *[str(part["name"]) for part in parts if part["from_mm"] <= at <= part["to_mm"]][:1]])


def part_words(label: str, name: str | None) -> str:
    """The name of an end point's part without the label that stands beside it: "upper calyx" for "upper calyx E2"."""
    return " ".join(word for word in str(name or "").split() if word != label)
