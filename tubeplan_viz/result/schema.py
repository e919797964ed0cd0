"""Documents against the JSON Schemas that ship with the package; result.json, and what its schema cannot say."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Any

from jsonschema import Draft202012Validator

from segmentation.errors import TubeplanError
from segmentation.faults import shortened
from tubeplan_viz.result.errors import ResultError

PATH_SPACING_MAX_MM = 0.25  # promised to readers of result.json; a JSON Schema cannot say it
FARTHEST_MM = 2e6  # meshes and places are taken up to 1e6 mm from the origin
SPACING_ROUNDING_MM = 1e-9  # s_mm are differences of numbers near 1e3 mm


@cache
def shipped_schema(package: str, name: str) -> dict[str, Any]:
    """A schema that ships with the package (JSON Schema 2020-12): `name` of ``name.schema.json`` in one of its parts."""
    schema: dict[str, Any] = json.loads(files(package).joinpath(f"{name}.schema.json").read_text(encoding="utf-8"))
    return schema


def check_schema(
    document: Mapping[str, Any], schema: Mapping[str, Any], *, name: str, remedy: str, error: type[TubeplanError]
) -> None:
    """Hold a document, made of plain JSON values, against its schema.

    Raises
    ------
    error
        Naming the first key of ``name.json`` that is wrong, and the remedy.
    """
    faults = Draft202012Validator(schema).iter_errors(document)
    first = min(faults, key=lambda fault: (len(fault.absolute_path), [str(key) for key in fault.absolute_path]), default=None)
    if first is None:
        return
    place = ".".join(str(key) for key in first.absolute_path) or "the top level"
    raise error(f"{name}.json: at {place}: {shortened(first.message)}; expected as in {name}.schema.json, {remedy}")


def result_schema() -> dict[str, Any]:
    """The schema of result.json."""
    return shipped_schema("tubeplan_viz.result", "result")


def validate_result(result: Mapping[str, Any]) -> None:
    """Check a result, made of plain JSON values, against the schema and its own consistency.

    Beyond the schema: lists that belong together have one length, the path's arc
    length starts at 0 and rises by at most 0.25 mm, flagged intervals lie on the path.

    Raises
    ------
    ResultError
        Naming the first key that is wrong, what was found there and what is expected.
    """
    check_schema(result, result_schema(), name="result", remedy="plan the case again", error=ResultError)
    _check_path(result)
    _check_spline(result)


def _check_path(result: Mapping[str, Any]) -> None:
    path = result["path"]
    if path is None:
        if result["flagged_intervals"]:
            raise ResultError(
                "result.json: flagged_intervals is not empty, expected none where path is null; plan the case again"
            )
        return
    lengths = {key: len(values) for key, values in path.items() if values is not None}
    if len(set(lengths.values())) > 1:
        raise ResultError(f"result.json: the lists of path have the lengths {lengths}, expected one length; plan the case again")
    s = path["s_mm"]
    steps = [after - before for before, after in pairwise(s)]
    if s[0] != 0.0 or min(steps) <= 0.0 or max(steps) > PATH_SPACING_MAX_MM + SPACING_ROUNDING_MM:
        raise ResultError(
            f"result.json: path.s_mm starts at {s[0]:g} with steps of {min(steps):.4g} to {max(steps):.4g} mm, "
            f"expected to start at 0 and rise by at most {PATH_SPACING_MAX_MM} mm; plan the case again"
        )
    farthest = max(
        abs(x) for points in (path["points_mm"], (result["centerline"] or path)["points_mm"]) for p in points for x in p
    )
    if farthest > FARTHEST_MM:
        raise ResultError(
            f"result.json: path or centerline reach {farthest:g} mm from the origin, expected at most {FARTHEST_MM:g} mm; "
            "plan the case again"
        )
    for index, flag in enumerate(result["flagged_intervals"]):
        ordered = -1e-6 <= flag["from_mm"] <= flag["worst_at_mm"] <= flag["to_mm"] <= s[-1] + 1e-6
        if not ordered:
            raise ResultError(
                f"result.json: flagged_intervals.{index} runs from {flag['from_mm']:g} to {flag['to_mm']:g} mm with its worst at "
                f"{flag['worst_at_mm']:g} mm, expected an interval of 0 to {s[-1]:g} mm around its worst; plan the case again"
            )
    centerline = result["centerline"]
    if centerline is not None and len(centerline["points_mm"]) != len(centerline["radius_mm"]):
        raise ResultError(
            f"result.json: centerline has {len(centerline['points_mm'])} points and {len(centerline['radius_mm'])} radii, "
            "expected as many; plan the case again"
        )


def _check_spline(result: Mapping[str, Any]) -> None:
    spline = result["spline"]
    if spline is None:
        return
    degree, knots, count = spline["degree"], spline["knots"], len(spline["control_points_mm"])
    end = degree + 1
    if len(knots) != count + end or count < end:
        raise ResultError(
            f"result.json: spline has {len(knots)} knots for {count} control points, expected {count + end} (degree {degree}) "
            f"and at least {end} control points; plan the case again"
        )
    if any(knots[:end]) or any(knot != 1.0 for knot in knots[-end:]) or knots != sorted(knots) or knots[end : end + 1] == [0.0]:
        raise ResultError("result.json: spline.knots are not clamped and rising from 0 to 1 as expected; plan the case again")
