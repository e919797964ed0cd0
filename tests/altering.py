"""One value of a document changed, as somebody would who hopes that nobody looks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def more(value: Any) -> Any:
    """Another value of the same kind: numbers grow by a tenth of themselves and 0.05 at least."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return value + "x"
    return value + 1 if isinstance(value, int) else value + 0.05 + 0.1 * abs(value)


def plant(document: Any, way: str, change: Callable[[Any], Any] | None = None) -> None:
    """Change the value at a dotted way in place, by `more` without a change of its own; it must be another one then."""
    *above, last = way.split(".")
    for name in above:
        document = document[int(name) if isinstance(document, list) else name]
    key: Any = int(last) if isinstance(document, list) else last
    before = document[key]
    document[key] = (change or more)(before)
    assert document[key] != before
