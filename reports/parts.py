"""Small parts that the pages of several planners are built from."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from reports.numbers import Phrase, Source, phrase
from reports.words import bend_key, margin_key


@dataclass(frozen=True)
class Key:
    """One figure under the verdict."""

    term: str
    value: Phrase
    more: Phrase
    tone: str = ""


def place_keys(source: Source) -> tuple[Key, ...]:
    """The tightest place and the sharpest bend of a path, each with its depth: on the first screen of every planner's page."""
    made = []
    for key in (margin_key(source), bend_key(source)):
        if key is not None:
            more = (part for k, line in enumerate(key.more) for part in (", " if k else "", line))
            made.append(Key(key.term, key.value, phrase(*more), key.tone))
    return tuple(made)


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


def with_article(name: str) -> str:
    """The name of a branch within a sentence: those that have no name of their own are only numbered."""
    return name if name.startswith("branch") else f"the {name}"
