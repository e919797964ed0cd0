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
class PlanPage:
    """The head that the pages of planners share: what the template prints first, in its order."""

    title: str
    case_id: str
    status: str
    word: str
    line: str
    headline: Phrase
    lead: Phrase
    warnings: tuple[str, ...]
    keys: tuple[Key, ...]


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
