"""How far a path that breaks a limit keeps both."""

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
