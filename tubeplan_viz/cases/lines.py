"""Where in a case file a fault stands: the line of its key."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from segmentation.errors import TubeplanError

HEADER = re.compile(r"\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(?:#.*)?$")
KEY = re.compile(r"""\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""")
PART = re.compile(r"""[\w-]+|"[^"]*"|'[^']*'""")
TEXT = re.compile(r'\"\"\"|\'\'\'|"(?:\\.|[^"\\])*"|\'[^\']*\'|#.*')


def key_lines(text: str) -> dict[tuple[str, ...], int]:
    """Line of every table and key of a TOML text, by its full name; the first where it stands more than once.

    Parameters
    ----------
    text : str
        Valid TOML.

    Returns
    -------
    dict
        ``("limits",)`` or ``("limits", "clearance_min")`` to the line, counted from 1.

    Examples
    --------
    >>> key_lines("[limits]\\nclearance_min = 1.2\\n")
    {('limits',): 1, ('limits', 'clearance_min'): 2}
    """
    lines: dict[tuple[str, ...], int] = {}
    for number, name, _ in _statements(text):
        lines.setdefault(name, number)
    return lines


def array_lines(text: str, name: str) -> list[int]:
    """The line of each ``[[name]]`` of a TOML text, in order.

    Examples
    --------
    >>> array_lines('[[cases]]\\nid = "a"\\n\\n[[cases]]\\nid = "b"\\n', "cases")
    [1, 4]
    """
    return [number for number, full, opens in _statements(text) if opens and full == (name,)]


def _statements(text: str) -> Iterator[tuple[int, tuple[str, ...], bool]]:
    """Line, full name, and whether it opens a row of an array, of every table and key."""
    table: tuple[str, ...] = ()
    depth, quotes = 0, ""
    for number, line in enumerate(text.splitlines(), start=1):
        if not depth and not quotes:
            header, key = HEADER.match(line), KEY.match(line)
            if header:
                table = _names(header[2])
                yield number, table, header[1] == "[["
                continue
            if key:
                yield number, (*table, *_names(key[1])), False
        depth, quotes = _after(line, depth, quotes)


def _names(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip("\"'") for part in PART.findall(dotted))


def _after(line: str, depth: int, quotes: str) -> tuple[int, str]:
    """Open brackets and open multi-line quotes at the end of a line."""
    rest = line
    while True:
        if quotes:
            _, found, rest = rest.partition(quotes)
            if not found:
                return depth, quotes
            quotes = ""
        token = TEXT.search(rest)
        plain = rest if token is None else rest[: token.start()]
        depth += plain.count("[") + plain.count("{") - plain.count("]") - plain.count("}")
        if token is None or token[0].startswith("#"):
            return max(depth, 0), ""
        rest = rest[token.end() :]
        if token[0] in ('"""', "'''"):
            quotes = token[0]


@contextmanager
def naming_lines(path: Path, given: Mapping[str, Mapping[str, Any]] | None = None) -> Iterator[None]:
    """Add the line of the key to a complaint about a value that a case file holds.

    Parameters
    ----------
    path : Path
        The case file.
    given : mapping of table to key to value, optional
        Options of the command line, which took the place of the file's values: a fault of
        theirs is none of the file.

    Raises
    ------
    TubeplanError
        The same one with ``NAME, line N:`` before it, where the key can be told.
    """
    try:
        yield
    except TubeplanError as fault:
        place = _place(str(fault), path, given or {})
        if place is None:
            raise
        line, told = place
        raise type(fault)(f"{path.name}, line {line}: {told}") from None


def _place(message: str, path: Path, given: Mapping[str, Mapping[str, Any]]) -> tuple[int, str] | None:
    """Line of the key that a message is about, and the message without the file's name."""
    try:
        lines = key_lines(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError):
        return None
    told = message.removeprefix(path.name).removeprefix(":").strip()
    table = re.match(r"\[(\w+)\]", told)
    named = re.search(r"unknown (?:key|table) '([^']*)'", told) or re.match(r"(?:\[\w+\] )?(\w+)\b", told)
    found = [
        full
        for full in lines
        if named is not None
        and full[-1] == named[1]
        and len(full) <= 2
        and (table is None or full[0] == table[1] or "unknown table" in told)
    ]
    if not found:  # a message that quotes the value and not the key
        values = _texts(path)
        found = [full for full in lines if full in values and repr(values[full]) in told]
    if len(found) != 1:
        return None
    full = found[0]
    if len(full) == 2 and full[1] in given.get(full[0], {}):
        return None
    shown = told if table is not None or len(full) == 1 else f"[{full[0]}] {told}"
    return lines[full], shown


def _texts(path: Path) -> dict[tuple[str, ...], str]:
    """The text values of the file's tables."""
    tables = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    return {
        (name, key): value
        for name, table in tables.items()
        if isinstance(table, dict)
        for key, value in table.items()
        if isinstance(value, str)
    }
