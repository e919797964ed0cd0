"""Every figure that comes from result.json, printed in one way that can be checked.

A `Figure` knows where its value stands in result.json (or its derived key) and the
value itself; the page prints it as ``<data class="v" value=... data-key=...>`` with
the exact number beside the rounded text. A `Phrase` is a sentence with figures in it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup, escape

MINUS = "\u2212"
NARROW = "\u00a0"  # between a figure and its unit: never broken across lines


def printed(value: float, digits: int, *, signed: bool = False) -> str:
    """`value` with `digits` decimals and a true minus sign; `signed` adds a plus."""
    text = f"{value:{'+' if signed else ''}.{digits}f}".replace("-", MINUS)
    return text[1:] if text[:1] == MINUS and not text.strip(f"{MINUS}0.") else text


@dataclass(frozen=True)
class Figure:
    """One number of result.json as the page prints it.

    Attributes
    ----------
    key : str
        Dotted path into result.json, or a key of `reports.derived.DERIVED`.
    value : float
        The exact number.
    digits : int
        Decimals printed.
    unit : str
        Printed behind the figure, outside the checked element; may be empty.
    signed, strong : bool
    """

    key: str
    value: float
    digits: int
    unit: str = ""
    signed: bool = False
    strong: bool = False

    @property
    def text(self) -> str:
        """The figure as printed, without its unit."""
        return printed(self.value, self.digits, signed=self.signed)

    @property
    def _tail(self) -> str:
        """The unit as it stands behind the figure: the degree sign close by, all others after a space."""
        return self.unit if self.unit in ("", "°") else f"{NARROW}{self.unit}"

    def __str__(self) -> str:
        return self.text + self._tail

    def __html__(self) -> str:
        data = Markup('<data class="v" value="{}" data-key="{}">{}</data>').format(json.dumps(self.value), self.key, self.text)
        unit = escape(self._tail)
        return Markup("<strong>{}{}</strong>").format(data, unit) if self.strong else data + unit


@dataclass(frozen=True)
class Phrase:
    """Words and figures in reading order; words are escaped, figures can be checked."""

    parts: tuple[str | Figure, ...]

    def __str__(self) -> str:
        return "".join(str(part) for part in self.parts)

    def __html__(self) -> str:
        return Markup("").join(escape(part) for part in self.parts)


def typeset(text: str) -> str:
    """Words of another module with true minus and multiplication signs.

    Examples
    --------
    >>> typeset("0.750 x 0.750 mm, from -3 HU, at -0.0 mm")
    '0.750 × 0.750 mm, from −3 HU, at 0.0 mm'
    """
    text = re.sub(r"(?<![\w.])-(?=0(\.0+)?(?![\d.]))", "", text)
    return re.sub(r"(?<=\d) x (?=\d)", " \u00d7 ", re.sub(r"(?<![\w.])-(?=\d)", MINUS, text))


def sentence(text: str) -> str:
    """A planner's words as a sentence of the page: capital letter, full stop, true minus signs.

    Examples
    --------
    >>> sentence("the wall is -0.5 mm away")
    'The wall is −0.5 mm away.'
    """
    text = typeset(text.strip())
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) or not text else ".")


def phrase(*parts: str | Figure | Phrase | None) -> Phrase:
    """Join words, figures and phrases; `None` is left out."""
    flat: list[str | Figure] = []
    for part in parts:
        flat.extend(part.parts if isinstance(part, Phrase) else () if part is None else (part,))
    return Phrase(tuple(flat))


@dataclass(frozen=True, eq=False)
class Source:
    """Where figures come from: result.json by dotted path, and the derived values.

    `prefix` stands before the keys that are printed, for a result that is a part of a larger file.
    """

    result: Mapping[str, Any]
    derived: Mapping[str, float] = field(default_factory=dict)
    prefix: str = ""

    def value(self, key: str) -> float | None:
        """The number at `key`, or None where the result has none."""
        found: Any = self.derived.get(key) if key.startswith("derived:") else self._walk(key)
        return found if isinstance(found, (int, float)) and not isinstance(found, bool) else None

    def figure(self, key: str, digits: int, unit: str = "", *, signed: bool = False, strong: bool = False) -> Figure | None:
        """The figure at `key`, or None where the result has none."""
        value = self.value(key)
        return None if value is None else Figure(self.prefix + key, value, digits, unit, signed, strong)

    def need(self, key: str, digits: int, unit: str = "", *, signed: bool = False, strong: bool = False) -> Figure:
        """The figure at `key`, which the caller knows to be there.

        Raises
        ------
        KeyError
            If the result has no number there.
        """
        figure = self.figure(key, digits, unit, signed=signed, strong=strong)
        if figure is None:
            raise KeyError(key)
        return figure

    def _walk(self, key: str) -> Any:
        found: Any = self.result
        for name in key.split("."):
            if isinstance(found, Mapping):
                found = found.get(name)
            elif isinstance(found, (list, tuple)) and name.isdigit() and int(name) < len(found):
                found = found[int(name)]
            else:
                return None
        return found
