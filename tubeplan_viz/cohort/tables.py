"""Tables of several sources laid over one another, each with its own folder for relative paths."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tubeplan_viz.cohort.columns import TABLES


def layered(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """`above` laid over `below`: tables key by key, anything else as a whole.

    Examples
    --------
    >>> layered({"limits": {"clearance_min": 1.0, "curvature_max": 0.1}}, {"limits": {"clearance_min": 2.0}})
    {'limits': {'clearance_min': 2.0, 'curvature_max': 0.1}}
    """
    made = dict(below)
    for key, value in above.items():
        under = below.get(key)
        made[key] = layered(under, value) if isinstance(under, Mapping) and isinstance(value, Mapping) else value
    return made


def for_planner(defaults: Mapping[str, Any], planner: str) -> dict[str, Any]:
    """Defaults without the tables that belong to other planners alone."""
    others = {table for name, tables in TABLES.items() for table in tables if name != planner} - set(TABLES[planner])
    return {key: value for key, value in defaults.items() if key not in others}


def rebased(tables: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The tables of a case with every relative path made to start from `folder`.

    What is no path, or not what a reader expects there, is left as it is: the readers say what is wrong with it.
    """

    def located(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        path = os.path.expanduser(value)
        return path if os.path.isabs(path) or path.startswith("~") else os.path.normpath(folder / path)

    made = dict(tables)
    for table, keys in (("input", ("ct", "mesh")), ("rigid", ("lesion_mask", "catalogue"))):
        if isinstance(made.get(table), Mapping):
            made[table] = {key: located(value) if key in keys else value for key, value in made[table].items()}
    if isinstance(made.get("rigid"), Mapping) and isinstance(made["rigid"].get("masks"), Mapping):
        made["rigid"]["masks"] = {name: located(value) for name, value in made["rigid"]["masks"].items()}
    if isinstance(made.get("obstacles"), list):
        made["obstacles"] = [
            {**row, "file": located(row["file"])} if isinstance(row, Mapping) and "file" in row else row
            for row in made["obstacles"]
        ]
    if isinstance(made.get("measures"), Mapping):
        made["measures"] = {key: _measured(key, value, located) for key, value in made["measures"].items()}
    return made


def _measured(key: str, value: Any, located: Any) -> Any:
    """One value of the table [measures]; files stand there in lists, in rows, or in text with commas between."""
    if key == "stone_masks" and isinstance(value, str | list):
        return [located(part) for part in (value.split(",") if isinstance(value, str) else value)]
    if key == "structures" and isinstance(value, str):
        pairs = [part.partition("=") for part in value.split(",")]
        return ",".join(f"{name}{sign}{located(file.strip()) if file.strip() else file}" for name, sign, file in pairs)
    if key == "structures" and isinstance(value, list):
        return [{**row, "file": located(row["file"])} if isinstance(row, Mapping) and "file" in row else row for row in value]
    return value
