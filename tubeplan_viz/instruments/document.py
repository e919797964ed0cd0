"""matrix.json checked against the schema that ships with the package."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from jsonschema import Draft202012Validator

from segmentation.errors import TubeplanError


class MatrixError(TubeplanError):
    """A matrix.json that does not follow its schema."""


@cache
def matrix_schema() -> dict[str, Any]:
    """The schema of matrix.json (JSON Schema 2020-12)."""
    schema: dict[str, Any] = json.loads(
        files("tubeplan_viz.instruments").joinpath("matrix.schema.json").read_text(encoding="utf-8")
    )
    return schema


def validate_matrix(document: Mapping[str, Any]) -> None:
    """Check a matrix, made of plain JSON values.

    Beyond the schema: one row of cells per instrument, one cell per target, and paths that are there.

    Raises
    ------
    MatrixError
        Naming the first key that is wrong.
    """
    faults = Draft202012Validator(matrix_schema()).iter_errors(document)
    first = min(faults, key=lambda fault: (len(fault.absolute_path), [str(key) for key in fault.absolute_path]), default=None)
    if first is not None:
        place = ".".join(str(key) for key in first.absolute_path) or "the top level"
        raise MatrixError(f"matrix.json: at {place}: {first.message[:200]}; expected as in matrix.schema.json, make it again")
    rows, columns = len(document["instruments"]), len(document["targets"])
    widths = {len(row) for row in document["cells"]}
    if len(document["cells"]) != rows or widths != {columns} or len(document["paths"]) != columns:
        raise MatrixError(
            f"matrix.json: {len(document['cells'])} rows of {sorted(widths)} cells for {rows} instruments and {columns} targets; "
            "expected a row per instrument and a cell per target, make it again"
        )
    for i, row in enumerate(document["cells"]):
        for j, cell in enumerate(row):
            if cell["path"] is not None and cell["path"] >= len(document["paths"][j]):
                raise MatrixError(f"matrix.json: cells.{i}.{j}.path is {cell['path']}, expected one of the target's paths")
