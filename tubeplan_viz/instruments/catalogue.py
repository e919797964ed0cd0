"""Instruments and the catalogue file that lists them."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from segmentation.faults import shortened
from tubeplan_viz.plan import Limits

SHIPPED = "catalogue.toml"
# Key of a catalogue entry -> least and largest value, mm. Wide: they catch units, not unusual instruments.
RANGES: dict[str, tuple[float, float]] = {
    "outer_diameter_mm": (0.1, 50.0),
    "bend_radius_min_mm": (0.1, 10_000.0),
    "rigid_tip_mm": (0.0, 500.0),
    "working_length_mm": (1.0, 10_000.0),
}


class CatalogueError(CaseError):
    """A catalogue of instruments that cannot be used."""


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """One flexible instrument.

    Attributes
    ----------
    name : str
    kind : str
        Class of instrument in words, e.g. ``ureteroscope``.
    outer_diameter_mm : float
        Of the widest part that enters the lumen.
    bend_radius_min_mm : float
        Least radius of its centre line.
    rigid_tip_mm : float
        Straight length at the tip; 0 for an instrument that bends up to its end.
    working_length_mm : float
        Length that can be inserted.
    source : str
        Where the values come from, in words.
    """

    name: str
    kind: str
    outer_diameter_mm: float
    bend_radius_min_mm: float
    rigid_tip_mm: float = 0.0
    working_length_mm: float = RANGES["working_length_mm"][1]
    source: str = ""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise CatalogueError("an instrument has an empty name, expected text that tells it from the others")
        for key, (low, high) in RANGES.items():
            value = getattr(self, key)
            if not low <= value <= high:
                raise CatalogueError(f"{self.name!r}: {key} is {value:g}, expected {low:g} to {high:g} mm")

    @property
    def radius(self) -> float:
        """Half the outer diameter: the clearance it needs, mm."""
        return 0.5 * self.outer_diameter_mm

    @property
    def limits(self) -> Limits:
        """What a path must keep for it."""
        return Limits(curvature_max=1.0 / self.bend_radius_min_mm, clearance_min=self.radius)

    def is_no_harder_than(self, other: Instrument) -> bool:
        """Whether this one can take every shape that the other can: no thicker, no stiffer, tip no longer, reach no shorter."""
        return (
            self.outer_diameter_mm <= other.outer_diameter_mm
            and self.bend_radius_min_mm <= other.bend_radius_min_mm
            and self.rigid_tip_mm <= other.rigid_tip_mm
            and self.working_length_mm >= other.working_length_mm
        )


def read_catalogue(path: Path | None = None) -> tuple[Instrument, ...]:
    """Instruments of a catalogue file, in its order.

    Parameters
    ----------
    path : Path, optional
        A TOML file of ``[[instrument]]`` tables; by default the one that ships with the package.

    Raises
    ------
    CatalogueError
        Naming the file, the entry and the key.
    """
    table, name = catalogue_table(path, shipped=SHIPPED)
    return make_catalogue(table, name=name)


def catalogue_table(path: Path | None, *, shipped: str) -> tuple[dict[str, Any], str]:
    """The tables of a catalogue file and its name; without a path those of the file `shipped` of this package.

    Raises
    ------
    CatalogueError
        If the file cannot be read or is no TOML.
    """
    if path is None:
        text, name = files("tubeplan_viz.instruments").joinpath(shipped).read_text(encoding="utf-8"), shipped
    else:
        text, name = read_text(path), path.name
    try:
        return tomllib.loads(text), name
    except tomllib.TOMLDecodeError as fault:
        raise CatalogueError(f"{name}: not valid TOML: {fault}") from None


def read_text(path: Path) -> str:
    """The text of a catalogue file."""
    try:
        return path.read_text(encoding="utf-8-sig")  # some editors begin a file with a mark of its encoding
    except FileNotFoundError:
        raise CatalogueError(f"{path.name}: no such catalogue file") from None
    except (OSError, UnicodeDecodeError) as fault:
        reason = str(getattr(fault, "strerror", None) or "no UTF-8 text").lower()
        raise CatalogueError(f"{path.name}: cannot be read ({reason}); expected a catalogue file in TOML") from None


def make_catalogue(table: Mapping[str, Any], *, name: str = "catalogue") -> tuple[Instrument, ...]:
    """Instruments of a catalogue's tables.

    Raises
    ------
    CatalogueError
        If a key is unknown or missing, a value of the wrong kind, or a name stands twice.
    """
    unknown = [key for key in table if key != "instrument"]
    if unknown:
        raise CatalogueError(f"{name}: unknown table {unknown[0]!r}; expected [[instrument]] tables only")
    entries = table.get("instrument")
    if not isinstance(entries, list) or not entries:
        raise CatalogueError(f"{name}: holds no instrument; expected at least one [[instrument]] table")
    made = tuple(make_instrument(entry, f"{name}: instrument {number}") for number, entry in enumerate(entries, start=1))
    names = [instrument.name for instrument in made]
    for twice in (found for found in names if names.count(found) > 1):
        raise CatalogueError(f"{name}: the name {twice!r} stands {names.count(twice)} times; expected each name once")
    return made


def finite_number(value: Any) -> bool:
    """Whether a value of a catalogue is a number that can be computed with; a whole one of TOML may have any number of digits."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def make_instrument(entry: Any, where: str) -> Instrument:
    """One entry, checked."""
    if not isinstance(entry, Mapping):
        raise CatalogueError(f"{where}: found {type(entry).__name__}, expected a table")
    known = [field.name for field in fields(Instrument)]
    if isinstance(entry.get("name"), str):
        where = f"{where} ({entry['name']})"
    for key in entry:
        if key not in known:
            raise CatalogueError(f"{where}: unknown key {key!r}; expected one of {', '.join(known)}")
    for key in ("name", "kind", "outer_diameter_mm", "bend_radius_min_mm"):
        if key not in entry:
            raise CatalogueError(f"{where}: the key {key} is missing; expected {', '.join(known[:4])}")
    for key, value in entry.items():
        if key in RANGES and not finite_number(value):
            raise CatalogueError(f"{where}: {key} is {shortened(repr(value), 80)}, expected a number in mm")
        if key not in RANGES and not isinstance(value, str):
            raise CatalogueError(f"{where}: {key} is {shortened(repr(value), 80)}, expected text")
    try:
        return Instrument(**entry)
    except CatalogueError as fault:
        raise CatalogueError(f"{where.split(' (')[0]}, {fault}") from None
