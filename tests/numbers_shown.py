"""Numbers as files show them: those of a document, and those that a page marks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html.parser import HTMLParser
from typing import Any


def numbers(value: Any) -> Iterator[float]:
    """Every number in a document of objects and lists; truth values are none."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for item in value:
            yield from numbers(item)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield float(value)


def at(document: Any, key: str) -> Any:
    """What stands at a dotted path; positions in lists are numbers."""
    for name in key.split("."):
        document = document[int(name)] if isinstance(document, list) else document[name]
    return document


class Page(HTMLParser):
    """A page's marked figures as (key, exact value, printed text), and its scripts by their id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, str, str]] = []
        self.scripts: dict[str, str] = {}
        self._open: list[str] | None = None
        self._script: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value or "" for key, value in attrs}
        if tag == "data" and given.get("class") == "v":
            self._open = [given["data-key"], given["value"], ""]
        self._script = given.get("id", "") if tag == "script" else None

    def handle_data(self, data: str) -> None:
        if self._open is not None:
            self._open[2] += data
        if self._script is not None:
            self.scripts[self._script] = self.scripts.get(self._script, "") + data

    def handle_endtag(self, tag: str) -> None:
        if tag == "data" and self._open is not None:
            self.found.append((self._open[0], self._open[1], self._open[2]))
            self._open = None
        if tag == "script":
            self._script = None

    def faults(self, document: Any, derived: Mapping[str, float]) -> list[str]:
        """Figures that are not the document's own, or printed otherwise than they round."""
        wrong = []
        for key, value, text in self.found:
            exact = derived[key] if key in derived else at(document, key)
            digits = len(text.partition(".")[2])
            shown = float(text.replace("\u2212", "-"))
            # Half a unit in the last printed place is what rounding may change.
            if float(value) != exact or abs(shown - exact) > 0.5 * 10.0**-digits * (1 + 1e-9):
                wrong.append(f"{key}: {value}, printed {text}, is {exact}")
        return wrong
