"""The rows of a manifest, from TOML or CSV: what stands there, not yet whether it makes a case."""

from __future__ import annotations

import csv
import io
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tubeplan_viz.cases.lines import array_lines
from tubeplan_viz.cohort.columns import ROW_COLUMNS, TABLES, tables_of, unknown_columns
from tubeplan_viz.cohort.errors import ManifestError


@dataclass(frozen=True, kw_only=True)
class Row:
    """One case as the manifest gives it.

    Attributes
    ----------
    where : str
        Its line.
    id, case : object
        As they stand there: the id, and the path of a case file.
    own : mapping
        Tables of a case file, or the cells of a row by column.
    cells : bool
        Whether `own` are cells.
    """

    where: str
    id: Any
    case: Any
    own: Mapping[str, Any]
    cells: bool = False

    @property
    def planner(self) -> str:
        """The planner that the row names, or nothing."""
        return str(self.own.get("planner", "")) if self.cells else planner_of(self.own)

    def tables(self, planner: str) -> dict[str, Any]:
        """What the row gives of a case, as tables.

        Raises
        ------
        CaseError
            If a column is not one of the planner's.
        """
        return tables_of(self.own, planner) if self.cells else dict(self.own)

    @property
    def label(self) -> str:
        """Line and id, as a complaint begins."""
        return f"{self.where} ({self.id})" if isinstance(self.id, str) and self.id else self.where


def planner_of(tables: Mapping[str, Any]) -> str:
    """The planner that tables of a case file name, or nothing."""
    planner = tables.get("planner", {})
    return str(planner.get("name", "")) if isinstance(planner, Mapping) else ""


def read_rows(content: bytes, path: Path) -> tuple[dict[str, Any], list[Row]]:
    """Defaults and rows of a manifest.

    Parameters
    ----------
    content : bytes
    path : Path
        Where it came from: ``.csv`` is a table, anything else TOML.

    Raises
    ------
    ManifestError
        If it is not of that kind, with the line.
    """
    table = path.suffix.lower() == ".csv"
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ManifestError(f"{path.name}: is no UTF-8 text; save it as {'CSV' if table else 'TOML'} in UTF-8") from None
    return ({}, _csv_rows(text, path.name)) if table else _toml_rows(text, path.name)


def _toml_rows(text: str, name: str) -> tuple[dict[str, Any], list[Row]]:
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise ManifestError(f"{name}: not valid TOML: {fault}; a table needs the ending .csv") from None
    unknown = [key for key in document if key not in ("defaults", "cases")]
    if unknown:
        raise ManifestError(f"{name}: unknown table {unknown[0]!r}; expected [defaults] and [[cases]], each with id and case")
    cases, defaults = document.get("cases", []), document.get("defaults", {})
    if not isinstance(cases, list) or not all(isinstance(case, dict) for case in cases):
        raise ManifestError(f"{name}: cases is no array of tables; expected [[cases]], each with id and case")
    if not isinstance(defaults, dict):
        raise ManifestError(f"{name}: defaults is {defaults!r}, expected tables as [defaults.limits]")
    known = list(dict.fromkeys((*(table for tables in TABLES.values() for table in tables), "obstacles", "events")))
    for key in defaults:
        if key not in known:
            raise ManifestError(f"{name}: unknown table [defaults.{key}]; expected one of {', '.join(known)}")
    lines = array_lines(text, "cases")
    rows = []
    for index, case in enumerate(cases):
        where = f"line {lines[index]}" if len(lines) == len(cases) else f"case {index + 1}"
        own = {key: value for key, value in case.items() if key not in ("id", "case")}
        rows.append(Row(where=where, id=case.get("id"), case=case.get("case"), own=own))
    return defaults, rows


def _csv_rows(text: str, name: str) -> list[Row]:
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[Row] = []
    head: list[str] = []
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if not head:
                head = _head([cell.strip() for cell in cells], f"{name}, line {reader.line_num}")
                continue
            if len(cells) != len(head):
                raise ManifestError(
                    f"{name}, line {reader.line_num}: found {len(cells)} cells, expected {len(head)} as in the first line; "
                    "put quotes around a cell that holds commas, as a point does"
                )
            values = {column: cell.strip() for column, cell in zip(head, cells, strict=True)}
            where, own = f"line {reader.line_num}", {key: value for key, value in values.items() if key not in ("id", "case")}
            rows.append(Row(where=where, id=values["id"], case=values.get("case") or None, own=own, cells=True))
    except csv.Error as fault:
        raise ManifestError(f"{name}, line {reader.line_num}: is no CSV ({fault}); save the table again") from None
    return rows


def _head(columns: list[str], where: str) -> list[str]:
    doubled = sorted({column for column in columns if columns.count(column) > 1})
    if doubled:
        raise ManifestError(f"{where}: the column {doubled[0] or 'without a name'} stands twice; expected each once")
    if "id" not in columns:
        commas = "; put commas between cells" if len(columns) == 1 and set(columns[0]) & set(";\t") else ""
        raise ManifestError(f"{where}: there is no column id, which names each case; found {', '.join(columns)}{commas}")
    unknown = unknown_columns(columns)
    if unknown:
        raise ManifestError(
            f"{where}: unknown column {unknown[0]!r}; expected {', '.join(ROW_COLUMNS)}, an option of `tubeplan plan` "
            "without its dashes (clearance_min), or a key of the case file with its table (limits.clearance_min)"
        )
    return columns
