"""Rows and tables of a needle's case beside its own: obstacles, events, the Monte Carlo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import brief, check_keys, coordinate, located, number, point, read_table, table_rows, text, whole
from tubeplan_viz.needle.monte_carlo import MonteCarloSettings

FLAT_KINDS, SPACE_KINDS = ("circle", "polygon"), ("sphere", "capsule", "mesh", "mask")
# What each kind must have, and what it may have.
NEEDED: dict[str, tuple[str, ...]] = {
    "circle": ("center", "radius_mm"),
    "sphere": ("center", "radius_mm"),
    "capsule": ("points", "radius_mm"),
    "polygon": ("points",),
    "mesh": ("file",),
    "mask": ("file",),
}
HU_KEYS = ("hu_min", "hu_max", "seed_point", "series")
# Key of the table [monte_carlo] -> attribute of MonteCarloSettings.
MONTE_CARLO_KEYS = {
    "runs": "runs",
    "curvature_error": "curvature_error",
    "tip_noise_mm": "noise",
    "target_motion_mm": "target_motion",
}


@dataclass(frozen=True, kw_only=True)
class ObstacleCase:
    """One ``[[obstacles]]``: lengths in mm.

    `file` is for a mesh or mask. With `hu_min` the file of a mask is a CT, of which the voxels from there on (up to `hu_max`)
    count; with `seed_point` only those that are connected to it.
    """

    kind: str
    center: tuple[float, ...] | None = None
    radius_mm: float | None = None
    points: tuple[tuple[float, ...], ...] | None = None
    file: Path | None = None
    hu_min: float | None = None
    hu_max: float | None = None
    seed_point: tuple[float, float, float] | None = None
    series: str | None = None


@dataclass(frozen=True, kw_only=True)
class EventCase:
    """One ``[[events]]``: an obstacle (from 1) moves to `center`, the target moves, or the true curvature is `kappa`."""

    at_mm: float
    obstacle: int | None = None
    center: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None
    kappa: float | None = None


def place(value: Any, size: int, where: str) -> tuple[float, ...]:
    """Two or three finite numbers, from a list or from text ``Y,Z``."""
    if isinstance(value, str):
        try:
            value = [float(part) for part in value.split(",")]
        except ValueError:
            raise CaseError(
                f"{where}: found {brief(value)}, expected {size} numbers in mm, like {'0,90' if size == 2 else '0,0,100'}"
            ) from None
    if not isinstance(value, Sequence) or len(value) != size:
        raise CaseError(f"{where}: found {brief(value)}, expected {size} numbers in mm")
    return tuple(coordinate(part, where) for part in value)


def obstacle_case(row: Any, flat: bool, folder: Path | None, where: str) -> ObstacleCase:
    """One obstacle, checked."""
    if not isinstance(row, Mapping):
        raise CaseError(f"{where}: found {type(row).__name__}, expected a table")
    check_keys(row, [f.name for f in fields(ObstacleCase)], where, "key")
    kinds, size = (FLAT_KINDS, 2) if flat else (SPACE_KINDS, 3)
    kind = str(row.get("kind"))
    if kind not in kinds:
        raise CaseError(
            f"{where} kind: found {brief(kind)}, expected {', '.join(kinds)} {'in the plane' if flat else 'in space'}"
        )
    for key in NEEDED[kind]:
        if key not in row:
            raise CaseError(f"{where}: a {kind} needs {key}")
    check_keys(row, (*NEEDED[kind], "kind", *(HU_KEYS if kind == "mask" else ())), f"{where} ({kind})", "key")
    if "points" in row and not table_rows(row, "points", where):
        raise CaseError(f"{where} points: found none, expected the corners or the line of a {kind}")
    if "hu_min" not in row and any(key in row for key in HU_KEYS):
        raise CaseError(f"{where}: hu_max, seed_point and series are for a CT; give hu_min too")
    lowest = number(row["hu_min"], f"{where} hu_min") if "hu_min" in row else None
    highest = number(row["hu_max"], f"{where} hu_max") if "hu_max" in row else None
    if lowest is not None and highest is not None and highest < lowest:
        raise CaseError(f"{where}: hu_max is {highest:g}, under hu_min {lowest:g}; expected it the other way round")
    return ObstacleCase(
        kind=kind,
        center=place(row["center"], size, f"{where} center") if "center" in row else None,
        radius_mm=number(row["radius_mm"], f"{where} radius_mm") if "radius_mm" in row else None,
        points=tuple(place(p, size, f"{where} points") for p in table_rows(row, "points", where)) if "points" in row else None,
        file=located(row["file"], folder, f"{where} file") if "file" in row else None,
        hu_min=lowest,
        hu_max=highest,
        seed_point=point(row["seed_point"], f"{where} seed_point") if "seed_point" in row else None,
        series=text(row["series"], f"{where} series") if "series" in row else None,
    )


def event_case(row: Any, where: str) -> EventCase:
    """One event, checked."""
    if not isinstance(row, Mapping):
        raise CaseError(f"{where}: found {type(row).__name__}, expected a table")
    check_keys(row, [f.name for f in fields(EventCase)], where, "key")
    if "at_mm" not in row:
        raise CaseError(f"{where}: an event needs at_mm")
    return EventCase(
        at_mm=number(row["at_mm"], f"{where} at_mm"),
        obstacle=whole(row["obstacle"], f"{where} obstacle") if "obstacle" in row else None,
        center=point(row["center"], f"{where} center") if "center" in row else None,
        target=point(row["target"], f"{where} target") if "target" in row else None,
        kappa=number(row["kappa"], f"{where} kappa") if "kappa" in row else None,
    )


def read_events(path: Path) -> list[Any]:
    """The ``[[events]]`` of a file of their own.

    Raises
    ------
    CaseError
        If it is no TOML file or holds anything else.
    """
    table = read_table(path, what="file of [[events]]")
    check_keys(table, ("events",), path.name, "table")
    events = table.get("events")
    if not isinstance(events, list) or not events:
        raise CaseError(f"{path.name}: found no [[events]]; expected one or more, each with at_mm and what happens")
    return events


def monte_carlo_settings(table: Any, where: str) -> MonteCarloSettings:
    """The table ``[monte_carlo]``, checked."""
    check_keys(table, list(MONTE_CARLO_KEYS), where, "key")
    found: dict[str, Any] = {MONTE_CARLO_KEYS[key]: number(value, f"{where} {key}") for key, value in table.items()}
    if "runs" not in found or found["runs"] != int(found["runs"]):
        raise CaseError(f"{where} runs: found {brief(table.get('runs'))}, expected a whole number of insertions")
    return MonteCarloSettings(**{**found, "runs": int(found["runs"])})
