"""A case written out again: every default resolved, in the units of its keys, as TOML that reads back as the same case."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

NOTICE = "Research use, not for clinical decisions."


def case_file(kind: str, units: str, tables: Mapping[str, Any]) -> str:
    """The text of case.toml.

    Parameters
    ----------
    kind : str
        What the first line calls it, as "needle case".
    units : str
        The sentence on frames and units of the second line.
    tables : mapping
        As `written` gives them.
    """
    return f"# tubeplan {kind}, every default resolved. {NOTICE}\n# {units}\n\n{tomli_w.dumps(tables)}"


def written(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Named tables without their unset keys, tuples as lists."""
    return {name: without_unset(table) for name, table in tables.items()}


def without_unset(table: Mapping[str, Any]) -> dict[str, Any]:
    """One table without its unset keys, tuples as lists."""
    return {key: listed(value) for key, value in table.items() if value is not None}


def listed(value: Any) -> Any:
    """Tuples as lists, for TOML and JSON."""
    return [listed(v) for v in value] if isinstance(value, tuple) else value


def in_unit_of(key: str, value: Any) -> Any:
    """A setting in the unit of its key: under a key that ends with ``_deg`` degrees that are read back as the same radian."""
    if not key.endswith("_deg"):
        return value
    degrees = float(np.degrees(value))
    tidy = round(degrees, 9)
    return tidy if float(np.radians(tidy)) == value else degrees


def shown_path(path: Path, folder: Path | None) -> str:
    """A file as a case may show it: relative to `folder`, or its name only."""
    return path.name if folder is None else Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
