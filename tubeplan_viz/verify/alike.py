"""Two values held against each other as one check."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tubeplan_viz.verify.verification import Check

SAME = 1e-6


def same(name: str, told: Any, meant: Any, text: str) -> Check:
    """Whether two values are one, figures to `SAME`."""
    return Check(name=name, ok=alike(told, meant), found=brief(told), expected=brief(meant), text=text)


def alike(told: Any, meant: Any) -> bool:
    """The same value of the same kind; figures to `SAME`, lists and tables entry by entry."""
    if isinstance(meant, Mapping):
        return isinstance(told, Mapping) and told.keys() == meant.keys() and all(alike(told[k], meant[k]) for k in meant)
    if isinstance(meant, list | tuple):
        return isinstance(told, list | tuple) and len(told) == len(meant) and all(map(alike, told, meant))
    if isinstance(meant, float) and isinstance(told, int | float) and not isinstance(told, bool):
        return abs(told - meant) <= SAME * max(1.0, abs(meant))
    return type(told) is type(meant) and told == meant


def brief(value: Any) -> str:
    """A value in a few words."""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 160 else f"{text[:120]} ... {text[-30:]}"
