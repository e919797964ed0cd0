"""matrix.json checked against the schema that ships with the package."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from segmentation.errors import TubeplanError
from tubeplan_viz.result import check_schema, shipped_schema


class MatrixError(TubeplanError):
    """A matrix.json that does not follow its schema."""


def matrix_schema() -> dict[str, Any]:
    """The schema of matrix.json (JSON Schema 2020-12)."""
    return shipped_schema("tubeplan_viz.instruments", "matrix")


def validate_matrix(document: Mapping[str, Any]) -> None:
    """Check a matrix, made of plain JSON values.

    Beyond the schema: one row of cells per instrument, one cell per target, and paths and bends that are there.

    Raises
    ------
    MatrixError
        Naming the first key that is wrong.
    """
    check_schema(document, matrix_schema(), name="matrix", remedy="make it again", error=MatrixError)
    rows, columns = len(document["instruments"]), len(document["targets"])
    widths = {len(row) for row in document["cells"]}
    lists = {len(document[key]) for key in ("paths", "bends")}
    if len(document["cells"]) != rows or widths != {columns} or lists != {columns}:
        raise MatrixError(
            f"matrix.json: {len(document['cells'])} rows of {sorted(widths)} cells for {rows} instruments and {columns} targets; "
            "expected a row per instrument and a cell per target, make it again"
        )
    for i, row in enumerate(document["cells"]):
        for j, cell in enumerate(row):
            for key, listed in (("path", "paths"), ("reached_path", "paths"), ("bend", "bends")):
                if cell[key] is not None and cell[key] >= len(document[listed][j]):
                    raise MatrixError(f"matrix.json: cells.{i}.{j}.{key} is {cell[key]}, expected one of the target's {listed}")
