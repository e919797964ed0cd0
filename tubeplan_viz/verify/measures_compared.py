"""Stated measures beside own ones: the check that tells the worst of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.verification import Check

Items = Mapping[tuple[str, str], float]


def compared(name: str, pairs: Iterable[tuple[str, float, float]], limit: float, unit: str, text: str) -> Check:
    """One check of stated values against own ones, as (part, stated, own); the worst is told."""
    rows = list(pairs)
    part, stated, mine = max(rows, key=lambda row: abs(row[1] - row[2]) if np.isfinite(row[2]) else np.inf)
    return Check(
        name=f"measures: {name}",
        ok=bool(abs(stated - mine) <= limit),
        found=f"{stated:.3g} {unit} stated{f' of {part}' if part else ''}, {len(rows)} compared",
        expected=f"{mine:.3g} {unit} within {limit:.2g}",
        text=text,
    )


def degrees(one: FloatArray, other: FloatArray) -> float:
    """Angle between two vectors, degrees."""
    cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
