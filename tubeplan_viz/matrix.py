"""tubeplan matrix: from a case and a catalogue to a folder with matrix.json, table, page and surface."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from reports import render_matrix, write_page
from segmentation.errors import CaseError
from segmentation.mesh_files import write_ply
from tubeplan_viz.cases.fields import end_place
from tubeplan_viz.cases.tube import Case, case_table
from tubeplan_viz.centerline import Endpoint
from tubeplan_viz.instruments import (
    Cell,
    Instrument,
    Matrix,
    ReachSettings,
    Verdict,
    Witness,
    find_targets,
    instrument_matrix,
    validate_matrix,
)
from tubeplan_viz.pipeline import (
    Notify,
    Stopwatch,
    Tree,
    case_end_names,
    case_tree,
    find_end,
    listing,
    load_lumen,
    resolve_end,
    silent,
)
from tubeplan_viz.recording import record_matrix
from tubeplan_viz.result import Provenance, RunFolder, plain
from tubeplan_viz.tube.explain import bend_details

MATRIX_FILES = ("matrix.json", "matrix.csv", "report.html", "recording.rrd", "mesh.ply")
# Spacing of the paths' points in matrix.json, mm; the splines are there too.
POINT_SPACING = 0.5
RULE = (
    "Holds: a path is proved to keep the clearance of the instrument's radius, its bend radius and its working length, and its "
    "rigid tip, taken as a straight chord at every place of the path, keeps the same clearance. Flagged: the best path found "
    "breaks a limit; that none exists is not proved. Impossible: proved, no path can keep the limits, since the lumen is too "
    "narrow on every way, a bend too sharp for the bend radius, or the target too far. Short: of an instrument that does not "
    "hold, the way that is left where it is proved to come along the best of the paths found; it may come farther on others."
)


def run_matrix(
    case: Case,
    target: Path,
    *,
    goals: Sequence[str] = (),
    instruments: Sequence[Instrument],
    before_start_mm: float = 0.0,
    jobs: int | None = None,
    force: bool = False,
    recording: bool = True,
    report: bool = True,
    notify: Notify = silent,
) -> dict[str, Any]:
    """Judge every instrument for every target and write the folder.

    Parameters
    ----------
    case : Case
        Its start (by default the first end point) and planner settings count, its goal and limits do not.
    target : Path
        The folder to make.
    goals : sequence of str
        Labels of end points or names of their parts; none for all but the start.
    instruments : sequence of Instrument
    before_start_mm : float
        Length of instrument used up before the start.
    jobs : int, optional
        Processes; by default two where there are two processors.

    Returns
    -------
    dict
        The content of matrix.json.

    Raises
    ------
    TubeplanError
        If the input is bad or a label is not there; then no folder is left.
    """
    watch = Stopwatch(notify)
    settings = ReachSettings(method=case.planner.method, before_start_mm=before_start_mm, tube=case.tube_settings)
    with RunFolder(target, force=force, files=MATRIX_FILES) as folder:
        lumen = load_lumen(case.input, near=case.planner.start, watch=watch)
        with watch.stage("centerlines"):
            tree = case_tree(case, lumen)
            names = case_end_names(case, lumen, tree)
            start = resolve_end("start", case.planner.start or "E1", tree.endpoints, names)
            chosen = choose_goals(goals, start, tree, names)
            targets = find_targets(tree.wall, tree.graph, start, chosen, settings)
        with watch.stage("instruments") as progress:
            matrix = instrument_matrix(
                tree.wall, start, targets, instruments, settings, jobs=jobs or min(2, os.cpu_count() or 1), progress=progress
            )
        written = write_ply(tree.surface, folder.path("mesh.ply"))
        provenance = Provenance(
            inputs=lumen.inputs, rng_seed=None, settings=case_table(case) | {"matrix": {"before_start_mm": before_start_mm}}
        )
        document = matrix_document(matrix, settings, start, names, provenance, watch.seconds)
        document |= {"frame": written.frame, "case_id": case.input.case_id or "case", "warnings": list(lumen.warnings)}
        document = plain(document)
        if recording:
            with watch.stage("recording"):
                record_matrix(document, written, folder.path("recording.rrd"))
        validate_matrix(document)
        folder.write_text("matrix.csv", matrix_csv(document))
        if report:
            write_page(render_matrix(document, written), folder.path("report.html"))
        folder.write_json("matrix.json", document)
        folder.appear()
    return document


def choose_goals(goals: Sequence[str], start: np.ndarray, tree: Tree, names: Mapping[str, str]) -> list[Endpoint]:
    """End points by label or by the name of their part, in the order asked for; all but the start without any.

    Raises
    ------
    CaseError
        If one is not there, fits more than one end point, stands twice, or is the start.
    """
    at_start = [tip.label for tip in tree.endpoints if np.linalg.norm(tip.point - start) < 1e-3]
    if not goals or [goal.strip().casefold() for goal in goals] == ["all"]:
        found = [tip for tip in tree.endpoints if tip.label not in at_start]
        if not found:
            raise CaseError("the lumen has no end point beside the start; give a start at another place")
        return found
    wanted = [find_end("goal", str(end_place(goal, "--goals")), tree.endpoints, names) for goal in goals]
    labels = [tip.label for tip in wanted]
    for label in labels:
        if label in at_start:
            raise CaseError(f"the goal {label} is the start; give other end points: {listing(tree.endpoints, names)}")
        if labels.count(label) > 1:
            raise CaseError(f"the goal {label} stands {labels.count(label)} times; give each once")
    return wanted


def matrix_status(matrix: Matrix) -> str:
    """``ok`` when every cell holds, ``infeasible`` when no path was found or can be for any, otherwise ``flagged``."""
    cells = [cell for row in matrix.cells for cell in row]
    if all(cell.verdict is Verdict.FEASIBLE for cell in cells):
        return "ok"
    return "infeasible" if all(cell.path is None for cell in cells) else "flagged"


def matrix_document(
    matrix: Matrix,
    settings: ReachSettings,
    start: np.ndarray,
    names: Mapping[str, str],
    provenance: Provenance,
    timings: Mapping[str, float],
) -> dict[str, Any]:
    """The content of matrix.json but for the case's own facts; `names` are those of the end points' parts by label."""
    return {
        "schema_version": 1,
        "use": "research use, not for clinical decisions",
        "status": matrix_status(matrix),
        "rule": RULE,
        "method": settings.method,
        "start_mm": start,
        "before_start_mm": settings.before_start_mm,
        "counts": {verdict.value: matrix.count(verdict) for verdict in Verdict},
        "instruments": [{key: getattr(one, key) for key in Instrument.__dataclass_fields__} for one in matrix.instruments],
        "targets": [
            {
                "label": target.label,
                "name": names.get(target.label),
                "point_mm": target.point,
                "way_mm": None if target.centerline is None else target.centerline.arc_length[-1],
                "ceiling_mm": target.ceiling.bound,
                "ceiling_point_mm": target.ceiling.place,
                "ceiling_end": target.ceiling.end,
            }
            for target in matrix.targets
        ],
        "cells": [[cell_entry(cell, one) for cell in row] for one, row in zip(matrix.instruments, matrix.cells, strict=True)],
        "paths": [[path_entry(path) for path in paths] for paths in matrix.paths],
        "bends": [[bend_details(bend.bound, bend.limits) for bend in bends] for bends in matrix.bends],
        "timings_s": dict(timings),
        "provenance": provenance.details(),
    }


def cell_entry(cell: Cell, instrument: Instrument) -> dict[str, Any]:
    """One cell of matrix.json."""
    return {
        "verdict": cell.verdict,
        "reason": cell.reason,
        "required_mm": instrument.radius,
        "available_mm": None if cell.margin is None else instrument.radius + cell.margin,
        "margin_mm": cell.margin,
        "margin_at_mm": cell.margin_at,
        "margin_point_mm": cell.margin_point,
        "margin_of": cell.margin_of,
        "bend_radius_mm": cell.bend_radius,
        "bend_at_mm": cell.bend_at,
        "length_mm": cell.length,
        "tip_clearance_mm": None if cell.tip is None else cell.tip.sampled,
        "tip_deviation_mm": None if cell.tip is None else cell.tip.deviation,
        "reached_mm": None if cell.advance is None else cell.advance.arc_length,
        "reached_point_mm": None if cell.advance is None else cell.advance.point,
        "short_mm": None if cell.advance is None else cell.advance.short,
        "reached_path": None if cell.advance is None else cell.advance.path,
        "inferred_from": cell.inferred_from,
        "path": cell.path,
        "bend": cell.bend,
    }


def path_entry(path: Witness) -> dict[str, Any]:
    """One path of matrix.json."""
    return {
        "length_mm": path.length,
        "clearance_min_mm": path.clearance,
        "clearance_lower_bound_mm": path.clearance_bound,
        "curvature_max_per_mm": path.curvature,
        "curvature_upper_bound_per_mm": path.curvature_bound,
        "points_mm": path.curve(path.curve.uniform_parameters(POINT_SPACING)),
        "spline": {"degree": path.curve.degree, "knots": path.curve.knots, "control_points_mm": path.curve.control_points},
    }


def matrix_csv(document: Mapping[str, Any]) -> str:
    """One line per cell, for a spreadsheet; numbers in the shortest form that reads back to the same double."""
    margin = ("required_mm", "available_mm", "margin_mm", "margin_at_mm", "margin_of")
    keys = ("verdict", *margin, "bend_radius_mm", "length_mm", "tip_clearance_mm", "short_mm", "reason")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["instrument", "outer_diameter_mm", "bend_radius_min_mm", "target", "target_name", *keys])
    for one, row in zip(document["instruments"], document["cells"], strict=True):
        for goal, cell in zip(document["targets"], row, strict=True):
            figures = (one["outer_diameter_mm"], one["bend_radius_min_mm"])
            writer.writerow([one["name"], *figures, goal["label"], goal["name"], *(cell[key] for key in keys)])
    return text.getvalue()
