"""Small parts that the pages of several planners are built from."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from reports.numbers import Phrase


@dataclass(frozen=True)
class Key:
    """One figure under the verdict."""

    term: str
    value: Phrase
    more: Phrase


@dataclass(frozen=True)
class Drawing:
    """One drawing with its title, its unit and a line about it."""

    title: str
    drawing: Markup
    unit: str = ""
    line: str = ""


@dataclass(frozen=True)
class Table:
    """One section with a table."""

    id: str
    title: str
    line: str
    head: tuple[str, ...]
    rows: tuple[tuple[Phrase, ...], ...]
    note: str = ""
    drawing: Markup | None = None
