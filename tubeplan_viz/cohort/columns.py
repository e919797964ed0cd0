"""One row of a CSV manifest as the tables of a case file: its columns have the names of options or keys.

The names are those of the case readers themselves: what they learn to read is a column at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from functools import cache
from typing import Any

from segmentation.errors import CaseError
from tubeplan_viz.cases.bronchoscope import KEYS as BRONCHOSCOPE_KEYS
from tubeplan_viz.cases.inputs import InputCase
from tubeplan_viz.cases.measures import MeasureCase
from tubeplan_viz.cases.needle import INPUTS, PLACES, PLANAR_KEYS, SPACE_KEYS
from tubeplan_viz.cases.needle_rows import MONTE_CARLO_KEYS
from tubeplan_viz.cases.rigid import OWN as RIGID_KEYS
from tubeplan_viz.cases.tube import TUBE_KEYS, PlannerCase

# Columns that name the row itself and not a value of its case.
ROW_COLUMNS = ("id", "case", "planner")
BOTH_LIMITS = ("curvature_max", "clearance_min")
UNITS = ("_mm", "_deg", "_percent", "_hu", "_mm_per_s")
NEEDLE_OWN = (*PLACES, "kappa", "radius_mm", "safety_mm", "frame")
# Options whose name is neither a key nor a key without its unit.
RENAMED = {"stone": "stones", "stone_mask": "stone_masks", "structure": "structures", "monte_carlo": "runs"}
# Values that stay text however much they look like a number.
TEXT_KEYS = frozenset({"series", "part", "case_id", "ct", "mesh", "robot", "endoscope", "shaver"})

Place = tuple[str, ...]

# Planner -> table of the case file -> keys that a cell can hold.
TABLES: dict[str, dict[str, tuple[str, ...]]] = {
    "tube": {
        "input": tuple(f.name for f in fields(InputCase)),
        "limits": BOTH_LIMITS,
        "planner": tuple(f.name for f in fields(PlannerCase) if f.name != "name"),
        "tube": tuple(TUBE_KEYS),
        "measures": tuple(f.name for f in fields(MeasureCase)),
    },
    "needle2d": {
        "input": ("case_id",),
        "limits": BOTH_LIMITS,
        "planner": ("method", "rng_seed", "time_budget"),
        "needle2d": tuple(dict.fromkeys((*PLANAR_KEYS, *NEEDLE_OWN))),
    },
    "needle3d": {
        "input": INPUTS,
        "limits": BOTH_LIMITS,
        "planner": ("method", "rng_seed", "time_budget"),
        "needle3d": tuple(dict.fromkeys((*SPACE_KEYS, *NEEDLE_OWN, "skin"))),
        "monte_carlo": tuple(MONTE_CARLO_KEYS),
    },
    "rigid": {
        "input": ("ct", "series", "case_id"),
        "limits": ("clearance_min",),
        "planner": ("method",),
        "rigid": tuple(key for key in RIGID_KEYS if key not in ("masks", "seeds", "boxes")),
    },
    "bronchoscope": {
        "input": tuple(f.name for f in fields(InputCase)),
        "limits": BOTH_LIMITS,
        "planner": ("method", "start", "goal", "lesion", "rng_seed", "time_budget"),
        "bronchoscope": tuple(BRONCHOSCOPE_KEYS),
    },
}


@cache
def columns_of(planner: str) -> Mapping[str, tuple[Place, ...]]:
    """Column name to where its value goes in the tables of a planner's case file.

    A key has its own name, its name without the unit, and ``table.key``.

    Examples
    --------
    >>> columns_of("tube")["clearance_min"], columns_of("tube")["centerline_step"]
    ((('limits', 'clearance_min'),), (('tube', 'centerline_step_mm'),))
    """
    columns: dict[str, tuple[Place, ...]] = {}
    for table, keys in TABLES[planner].items():
        for key in keys:
            unit = next((unit for unit in UNITS if key.endswith(unit)), "")
            for name in (key, key.removesuffix(unit), f"{table}.{key}"):
                columns.setdefault(name, ((table, key),))
    for option, key in RENAMED.items():
        if key in columns:
            columns[option] = columns[key]
    if planner == "bronchoscope":  # one option for the two sections, as on the command line
        columns["section"] = (("bronchoscope", "proximal_length_mm"), ("bronchoscope", "distal_length_mm"))
    return columns


def takes_seed(planner: str) -> bool:
    """Whether a planner draws random numbers."""
    return "rng_seed" in TABLES[planner]["planner"]


def unknown_columns(names: Iterable[str]) -> list[str]:
    """Columns that no planner's case has."""
    known = {*ROW_COLUMNS, *(name for planner in TABLES for name in columns_of(planner))}
    return [name for name in names if name not in known and not name.startswith(("rigid.masks.", "rigid.seeds.", "rigid.boxes."))]


def tables_of(row: Mapping[str, str], planner: str) -> dict[str, Any]:
    """The cells of one row as tables of a case file; an empty cell gives nothing.

    Raises
    ------
    CaseError
        If a cell is filled whose column is none of the planner's.
    """
    known = columns_of(planner)
    made: dict[str, Any] = {}
    for name, cell in row.items():
        if name in ROW_COLUMNS or not cell.strip():
            continue
        own_part = planner == "rigid" and name.startswith("rigid.") and name.count(".") == 2
        places = (tuple(name.split(".")),) if own_part else known.get(name)
        if places is None:
            raise CaseError(f"the column {name} is filled, but {planner} has none of that name; leave the cell empty")
        for *tables, key in places:
            inner = made
            for table in tables:
                inner = inner.setdefault(table, {})
            if key in inner:
                raise CaseError(f"the column {name} gives {key} a second time; fill one of its columns")
            inner[key] = cell_value(key, cell.strip())
    return made


def cell_value(key: str, cell: str) -> Any:
    """A cell as the case readers take it: true, false, a number, a list of names, otherwise text.

    Examples
    --------
    >>> cell_value("clearance_min", "1.5"), cell_value("start", "1,2,3"), cell_value("series", "3")
    (1.5, '1,2,3', '3')
    """
    if key in TEXT_KEYS:
        return cell
    if key == "scans":
        return [part.strip() for part in cell.split(",")]
    if cell.lower() in ("true", "false"):
        return cell.lower() == "true"
    try:
        value = float(cell)
    except ValueError:
        return cell
    return int(value) if math.isfinite(value) and value == int(value) and cell.lstrip("+-").isdigit() else value
