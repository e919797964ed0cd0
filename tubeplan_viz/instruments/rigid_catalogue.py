"""Rigid endoscopes and shavers by name, and the coupled instrument that two of them make."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.faults import shortened
from tubeplan_viz.instruments.catalogue import CatalogueError, catalogue_table, finite_number
from tubeplan_viz.rigid import CoupledInstrument

SHIPPED = "rigid.toml"
NUMBERS = {
    "endoscope": ("diameter_mm", "length_mm", "working_distance_mm", "view_angle_deg"),
    "shaver": ("diameter_mm", "length_mm"),
}


def read_rigid_catalogue(path: Path | None = None) -> dict[str, dict[str, dict[str, Any]]]:
    """Entries by kind (endoscope, shaver) and name, in the order of the file; without a path those that ship.

    Raises
    ------
    CatalogueError
        Naming the file, the entry and the key.
    """
    table, name = catalogue_table(path, shipped=SHIPPED)
    unknown = [key for key in table if key not in NUMBERS]
    if unknown:
        raise CatalogueError(f"{name}: unknown table {unknown[0]!r}; expected [[endoscope]] and [[shaver]]")
    return {kind: _entries(table.get(kind), kind, name) for kind in NUMBERS}


def _entries(rows: Any, kind: str, name: str) -> dict[str, dict[str, Any]]:
    """The checked entries of one kind."""
    if not isinstance(rows, list) or not rows:
        raise CatalogueError(f"{name}: holds no {kind}; expected at least one [[{kind}]] table")
    made: dict[str, dict[str, Any]] = {}
    for number, row in enumerate(rows, start=1):
        where = f"{name}: {kind} {number}"
        if not isinstance(row, Mapping) or not isinstance(row.get("name"), str) or not row["name"].strip():
            raise CatalogueError(f"{where}: has no name; give it text that tells it from the others")
        where = f"{where} ({row['name']})"
        known = ("name", "source", *NUMBERS[kind])
        for key in row:
            if key not in known:
                raise CatalogueError(f"{where}: unknown key {key!r}; expected one of {', '.join(known)}")
        for key in NUMBERS[kind]:
            value = row.get(key)
            if not finite_number(value):
                raise CatalogueError(f"{where}: {key} is {shortened(repr(value), 80)}, expected a number")
        if row["name"] in made:
            raise CatalogueError(f"{where}: the name stands twice; expected each name once")
        made[row["name"]] = dict(row)
    return made


def coupled_instrument(
    catalogue: Mapping[str, Mapping[str, Mapping[str, Any]]], endoscope: str | None, shaver: str | None, *, offset: float
) -> tuple[CoupledInstrument, str, str]:
    """The instrument of two named entries, and their names; without a name the first entry of the kind.

    Parameters
    ----------
    offset : float, mm
        How far the endoscope's axis lies above the shaver's.

    Raises
    ------
    CatalogueError
        If there is no entry of that name.
    CaseError
        If the two do not fit together.
    """
    chosen = {}
    for kind, name in (("endoscope", endoscope), ("shaver", shaver)):
        known = catalogue[kind]
        if name is not None and name not in known:
            raise CatalogueError(f"there is no {kind} {name!r}; expected one of {', '.join(map(repr, known))}")
        chosen[kind] = known[name if name is not None else next(iter(known))]
    scope, tool = chosen["endoscope"], chosen["shaver"]
    made = CoupledInstrument(
        scope_diameter=float(scope["diameter_mm"]),
        scope_length=float(scope["length_mm"]),
        shaver_diameter=float(tool["diameter_mm"]),
        shaver_length=float(tool["length_mm"]),
        working_distance=float(scope["working_distance_mm"]),
        view_angle=float(np.radians(scope["view_angle_deg"])),
        offset=offset,
    )
    return made, str(scope["name"]), str(tool["name"])


def thinnest_pair(catalogue: Mapping[str, Mapping[str, Mapping[str, Any]]], *, offset: float) -> CoupledInstrument:
    """The thinnest endoscope with the thinnest shaver of a catalogue."""
    scope, shaver = (min(catalogue[kind].values(), key=lambda row: float(row["diameter_mm"])) for kind in ("endoscope", "shaver"))
    made, _, _ = coupled_instrument(catalogue, str(scope["name"]), str(shaver["name"]), offset=offset)
    return made
