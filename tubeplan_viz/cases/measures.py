"""Table ``[measures]`` of a case file: stones, structures near the path, and what the image does not show."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import brief, check_keys, located, number, point, subtable, text
from tubeplan_viz.cases.writing import shown_path
from tubeplan_viz.measures import UrinarySettings

Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class MeasureCase:
    """Table ``[measures]``.

    Attributes
    ----------
    stones : tuple of (3,) float tuple, mm, LPS
        A point in each stone that is to be grown.
    stone_masks : tuple of Path
        Label volumes on the CT's grid, one for each stone.
    structures : tuple of (name, Path)
        Label volumes of what the path should keep away from.
    abnormal_anatomy : bool or None
        Horseshoe or pelvic kidney; None where nobody has said.
    ureter_level_mm : float
    """

    stones: tuple[Point, ...] = ()
    stone_masks: tuple[Path, ...] = ()
    structures: tuple[tuple[str, Path], ...] = ()
    abnormal_anatomy: bool | None = None
    ureter_level_mm: float = field(default=UrinarySettings().ureter_level)

    def __post_init__(self) -> None:
        UrinarySettings(ureter_level=self.ureter_level_mm)
        names = [name for name, _ in self.structures]
        doubled = next((name for name in names if names.count(name) > 1), None)
        if doubled is not None:
            raise CaseError(f"two structures are called {doubled!r}; give each a name of its own")


def measure_case(table: Mapping[str, Any], *, folder: Path | None, name: str) -> MeasureCase:
    """The table ``[measures]`` of a case file, checked; relative paths start from `folder`.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    given = subtable(table, "measures", name)
    where = f"{name} [measures]"
    check_keys(given, [f.name for f in fields(MeasureCase)], where, "key")
    if "stones" in given:
        given["stones"] = stone_points(given["stones"], f"{where} stones")
    if "stone_masks" in given:
        masks = given["stone_masks"]
        if isinstance(masks, str | os.PathLike):
            masks = os.fspath(masks).split(",")
        if not isinstance(masks, Sequence):
            raise CaseError(f"{where} stone_masks: found {brief(masks)}, expected a list of files")
        given["stone_masks"] = tuple(located(mask, folder, f"{where} stone_masks") for mask in masks)
    if "structures" in given:
        given["structures"] = tuple(
            (label, located(file, folder, f"{where} structures"))
            for label, file in structure_files(given["structures"], f"{where} structures")
        )
    if not isinstance(given.get("abnormal_anatomy", False), bool):
        raise CaseError(f"{where} abnormal_anatomy: found {brief(given['abnormal_anatomy'])}, expected true or false")
    if "ureter_level_mm" in given:
        given["ureter_level_mm"] = number(given["ureter_level_mm"], f"{where} ureter_level_mm")
    return MeasureCase(**given)


def stone_points(value: Any, where: str) -> tuple[Point, ...]:
    """Points from a list of points, or from text ``X,Y,Z;X,Y,Z``."""
    if isinstance(value, str):
        value = [part for part in value.split(";") if part.strip()]
    if not isinstance(value, Sequence):
        raise CaseError(f"{where}: found {brief(value)}, expected a list of points in mm")
    return tuple(point(one, where) for one in value)


def structure_files(value: Any, where: str) -> list[tuple[str, str]]:
    """Names and files from a list of tables with `name` and `file`, or from text ``NAME=FILE,NAME=FILE``."""
    if isinstance(value, str):
        pairs = [part.partition("=") for part in value.split(",") if part.strip()]
        if any(not sign or not label.strip() or not file.strip() for label, sign, file in pairs):
            raise CaseError(f"{where}: found {brief(value)}, expected NAME=FILE, several with commas between")
        return [(label.strip(), file.strip()) for label, _, file in pairs]
    if not isinstance(value, Sequence):
        raise CaseError(f"{where}: found {brief(value)}, expected a list of tables with name and file")
    found = []
    for one in value:
        check_keys(one, ("name", "file"), where, "key")
        if "name" not in one or "file" not in one:
            raise CaseError(f"{where}: found {brief(dict(one))}, expected both name and file")
        found.append((text(one["name"], where), text(one["file"], where)))
    return found


def measure_table(case: MeasureCase, *, folder: Path | None) -> dict[str, Any]:
    """The table again, without keys that are unset; paths relative to `folder`, or names only without one."""
    table: dict[str, Any] = {"ureter_level_mm": case.ureter_level_mm}
    if case.abnormal_anatomy is not None:
        table["abnormal_anatomy"] = case.abnormal_anatomy
    if case.stones:
        table["stones"] = [list(stone) for stone in case.stones]
    if case.stone_masks:
        table["stone_masks"] = [shown_path(mask, folder) for mask in case.stone_masks]
    if case.structures:
        table["structures"] = [{"name": name, "file": shown_path(file, folder)} for name, file in case.structures]
    return table
