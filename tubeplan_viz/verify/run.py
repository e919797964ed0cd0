"""All checks of one run folder."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.faults import shortened
from tubeplan_viz.result import RESULT, ResultError, RunFolderError, is_run, not_a_run, validate_result
from tubeplan_viz.verify.bronchoscope import check_bronchoscope
from tubeplan_viz.verify.claims import (
    check_features_and_centerline,
    check_metrics,
    check_profile,
    check_spline_and_path,
    check_verdict,
)
from tubeplan_viz.verify.files import check_markups, check_outputs, check_table
from tubeplan_viz.verify.matrix import check_matrix
from tubeplan_viz.verify.measures import check_measures
from tubeplan_viz.verify.mesh_file import MeshFile, MeshFileError, read_mesh
from tubeplan_viz.verify.needle import check_needle
from tubeplan_viz.verify.no_path import check_no_path
from tubeplan_viz.verify.page import check_page
from tubeplan_viz.verify.profile import OwnProfile, measure
from tubeplan_viz.verify.rigid import check_rigid
from tubeplan_viz.verify.setting import check_ends, check_frame, check_limits, check_surface, check_unit
from tubeplan_viz.verify.spline import BezierPath
from tubeplan_viz.verify.told import check_ground, check_told
from tubeplan_viz.verify.verification import Check, Verification
from tubeplan_viz.verify.wall import Lumen, Triangles

NEEDLE_PLANNERS = ("needle2d", "needle3d")
LONGEST_MM = 5000.0
MATRIX = "matrix.json"
Content = TypeVar("Content")


def verify_run(folder: Path, *, seen: Callable[[Check], None] = lambda _: None) -> Verification:
    """Check a finished plan again by other means than those that made it.

    Nothing of the planners, their curves or their distances is used: the spline is
    evaluated as Bezier pieces, distances are to mesh.ply's triangles directly, insides are
    found by solid angles, and limits are tested between the samples of the file. Every other file of
    the folder is compared with result.json. A missing or unreadable file is a check that
    does not hold.

    Parameters
    ----------
    folder : Path
        A run folder, or one of instruments against targets, whole.
    seen : callable
        Called with each check when it is done.

    Returns
    -------
    Verification

    Raises
    ------
    RunFolderError
        If the folder has no result.json or matrix.json that tubeplan wrote.
    """
    of_matrix = not (folder / RESULT).exists() and is_run(folder, MATRIX)
    document = _read_document(folder, MATRIX if of_matrix else RESULT)
    checks = []
    for check in _whole((check_matrix if of_matrix else _checks)(folder, document)):
        seen(check)
        checks.append(check)
    return Verification(run=folder.resolve().name, checks=tuple(checks))


def _whole(checks: Iterator[Check]) -> Iterator[Check]:
    """The checks; where a value is of another kind than its check needs, which the schema leaves open, one that does not hold."""
    try:
        yield from checks
    except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError, OSError) as fault:
        yield Check(
            name="values",
            ok=False,
            found=f"{type(fault).__name__}: {shortened(str(fault))}",
            expected="values of their kind in every file of the run",
            text="A value of the run is of another kind than what it stands for, so that what follows could not be checked.",
        )


def _read_document(folder: Path, file: str) -> dict[str, Any]:
    name = folder.resolve().name
    try:
        text = (folder / file).read_text(encoding="utf-8")
        document = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_no_doubles)
    except OSError as fault:
        raise not_a_run(folder) from fault
    except ValueError as fault:
        raise RunFolderError(f"{name}: {file} is no JSON ({fault}); the run is damaged, plan the case again") from fault
    if not isinstance(document, dict):
        raise RunFolderError(f"{name}: {file} is no table of keys; name the folder that `tubeplan plan` made")
    return document


def _no_constant(word: str) -> NoReturn:
    raise ValueError(f"it holds {word}, which is no number")


def _no_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key {next(key for key in keys if keys.count(key) > 1)} stands twice")
    return table


def _checks(folder: Path, result: dict[str, Any]) -> Iterator[Check]:
    schema = Check(
        name="schema",
        ok=True,
        found="valid",
        expected="result.schema.json, version 1",
        text="result.json has every key that is relied on, each with a value of its kind.",
    )
    try:
        validate_result(result)
    except ResultError as fault:
        yield Check(name=schema.name, ok=False, found="not valid", expected=schema.expected, text=f"{fault}.")
        return
    yield schema
    yield from check_outputs(result, folder)
    if result["path"] is None:
        yield Check(
            name="status",
            ok=result["status"] == "infeasible",
            found=result["status"],
            expected="infeasible",
            text="There is no path.",
        )
        if result["planner"]["name"] == "rigid":
            yield from _path_checks(folder, result)
        return
    yield from _path_checks(folder, result)


def _path_checks(folder: Path, result: dict[str, Any]) -> Iterator[Check]:
    name = result["planner"]["name"]
    case = yield from _opened("case.toml", folder, lambda text: tomllib.loads(text))
    asked = ((case or {}).get("planner") or {}).get("name", "tube")
    if case is not None and asked != name:
        yield Check(name="planner", ok=False, found=name, expected=str(asked), text="The planner is that of the case.")
        return
    if case is not None:
        yield from check_told(result, case)
    if name in NEEDLE_PLANNERS:
        yield from check_needle(folder, result)
        return
    if name == "rigid":
        yield from check_rigid(folder, result)
        return
    markups = yield from _opened("path.mrk.json", folder, _markups)
    table = yield from _opened("path.csv", folder, lambda text: text)
    page = None
    if _written("report.html", folder, result):
        page = yield from _opened("report.html", folder, lambda text: text)
    if result["planner"]["name"] == "tube":
        yield from check_ends(result, case)
    yield from check_limits(result, case)
    path = _path_of(result)
    try:
        mesh: MeshFile | None = read_mesh(folder / "mesh.ply")
    except MeshFileError as fault:
        mesh = None
        yield Check(name="mesh.ply", ok=False, found="not readable", expected="a binary PLY of triangles", text=f"{fault}.")
    if mesh is not None:
        yield from check_frame(result, mesh, markups)
        yield from check_unit(result, mesh, path.pieces.reshape(-1, 3))
        yield from check_surface(result, mesh)
        length = float(np.linalg.norm(np.diff(path.pieces, axis=1), axis=2).sum())
        if length <= LONGEST_MM:
            yield from _measured_checks(result, path, mesh, table, case)
            if result["planner"]["name"] == "bronchoscope":
                yield from check_bronchoscope(folder, result, _lumen(result, mesh))
        else:
            yield Check(
                name="path: measured",
                ok=False,
                found=f"a control polygon of {length:.4g} mm",
                expected=f"at most {LONGEST_MM:g} mm",
                text="The spline is too long for a path in a body and was not measured.",
            )
    if markups is not None:
        yield from check_markups(markups, result)
    if page is not None:
        yield from check_page(page, result)


def _measured_checks(
    result: dict[str, Any], path: BezierPath, mesh: MeshFile, table: str | None, case: dict[str, Any] | None
) -> Iterator[Check]:
    lumen = _lumen(result, mesh)
    own = measure(path, lumen)
    yield from _claims(result, own)
    yield from check_ground(result, mesh, own)
    yield from check_no_path(result, own, lumen)
    yield from check_measures(result, case, mesh, own)
    if table is not None:
        yield from check_table(table, result, own.samples)


def check_path(result: Mapping[str, Any], wall: FloatArray, ends: FloatArray) -> tuple[Check, ...]:
    """What result.json says of its path, held against the surface: the part of `verify_run` that measures.

    Parameters
    ----------
    result : mapping
        The content of a result.json that follows its schema.
    wall, ends : (m, 3, 3) float array, mm
        Triangles that count for clearance, and those of the end caps, which do not.
    """
    path = _path_of(result)
    return tuple(_claims(result, measure(path, Lumen(Triangles(wall), Triangles(ends)))))


def _claims(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    for check in (check_spline_and_path, check_profile, check_metrics, check_verdict, check_features_and_centerline):
        yield from check(result, own)


def _path_of(result: Mapping[str, Any]) -> BezierPath:
    spline = result["spline"]
    return BezierPath.from_spline(spline["degree"], np.array(spline["knots"]), np.array(spline["control_points_mm"], dtype=float))


def _lumen(result: Mapping[str, Any], mesh: MeshFile) -> Lumen:
    """The surface as the run counts it: caps are wall only with ``details.closed_ends``."""
    corners = mesh.vertices[mesh.faces]
    details = result["details"]
    wall = len(corners) if details.get("closed_ends") or "surface" not in details else details["surface"]["wall_faces"]
    return Lumen(Triangles(corners[:wall]), Triangles(corners[wall:]))


def _written(name: str, folder: Path, result: Mapping[str, Any]) -> bool:
    """Whether a file that may be left out on demand is part of this run."""
    stated = result["provenance"].get("outputs")
    return stated is None or (folder / name).exists() or any(entry["name"] == name for entry in stated)


def _markups(text: str) -> dict[str, Any]:
    document = json.loads(text, parse_constant=_no_constant)
    try:
        for markup in document["markups"]:
            np.array([control["position"] for control in markup["controlPoints"]], dtype=float).reshape(-1, 3)
    except (KeyError, TypeError) as fault:
        raise ValueError("it has no markups with control points") from fault
    return dict(document)


def _opened(name: str, folder: Path, parse: Callable[[str], Content]) -> Generator[Check, None, Content | None]:
    """The parsed content of a text file; a check that does not hold, and None, if it has none."""
    try:
        return parse((folder / name).read_text(encoding="utf-8"))
    except OSError as fault:
        found = (fault.strerror or "not readable").lower()
    except ValueError as fault:  # not UTF-8, not TOML, not JSON
        found = f"not as expected ({shortened(str(fault))})"
    yield Check(name=name, ok=False, found=found, expected="a whole file", text=f"{name} of the run cannot be read.")
    return None
