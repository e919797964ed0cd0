"""tubeplan reach: from an airway's case to a folder with reach.json, table, page and recording."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from reports import render_reach, write_page
from segmentation.mesh_files import write_ply
from tubeplan_viz.bronchoscope.airway import AirwayTree
from tubeplan_viz.bronchoscope.way import make_simulator
from tubeplan_viz.cases.bronchoscope import BronchoscopeCase, bronchoscope_case_table
from tubeplan_viz.pipeline import Notify, Stopwatch, silent
from tubeplan_viz.pipeline.airway import case_name, load_airway
from tubeplan_viz.pipeline.bronchoscope_details import branch_rows
from tubeplan_viz.reach_map import HALF, BranchReach, Verdict, reach_map
from tubeplan_viz.recording import record_reach
from tubeplan_viz.result import Provenance, RunFolder, plain

REACH_FILES = ("reach.json", "reach.csv", "report.html", "recording.rrd", "mesh.ply")
# Samples for one branch before all commands are laid at once: a number, no time, so that the map is the same on every machine.
SAMPLES = 12
RULE = (
    "Reached: a plan by the stated method ends there, or passes through. Too narrow: proved, the widest way from the entrance "
    "to the branch's middle is narrower than the robot, whatever the bends. Bend and collision: wide enough, but no plan was "
    "found; what stopped the robot is named, and that there is no way is not proved."
)


def run_reach(
    case: BronchoscopeCase,
    target: Path,
    *,
    force: bool = False,
    recording: bool = True,
    report: bool = True,
    notify: Notify = silent,
) -> dict[str, Any]:
    """Judge every branch of a case's airway and write the folder.

    Parameters
    ----------
    case : BronchoscopeCase
        Its goal does not count.
    target : Path
        The folder to make.

    Returns
    -------
    dict
        The content of reach.json.

    Raises
    ------
    TubeplanError
        If the input is bad; then no folder is left.
    """
    watch = Stopwatch(notify)
    with RunFolder(target, force=force, files=REACH_FILES) as folder:
        given = load_airway(case, watch)
        simulator = make_simulator(given.airway, given.entrance, case.robot) if case.method == "dynamic" else None
        samples = case.settings.samples_max if simulator is not None else min(SAMPLES, case.settings.samples_max)
        with watch.stage("plan") as progress:
            reach = reach_map(
                given.airway,
                given.entrance,
                case.robot,
                replace(case.settings, samples_max=samples, time_budget=case.time_budget),
                rng_seed=case.rng_seed,
                simulator=simulator,
                progress=progress,
            )
        written = write_ply(given.tree.surface, folder.path("mesh.ply"))
        provenance = Provenance(inputs=given.lumen.inputs, rng_seed=case.rng_seed, settings=bronchoscope_case_table(case))
        document = plain(reach_document(case, given.airway, reach, provenance, watch.seconds))
        document |= {"frame": written.frame, "warnings": list(given.lumen.warnings)}
        if recording:
            with watch.stage("recording"):
                record_reach(document, written, folder.path("recording.rrd"))
        folder.write_text("reach.csv", reach_csv(document))
        if report:
            write_page(render_reach(document, written), folder.path("report.html"))
        folder.write_json("reach.json", document)
        folder.appear()
    return document


def reach_document(
    case: BronchoscopeCase,
    airway: AirwayTree,
    reach: tuple[BranchReach, ...],
    provenance: Provenance,
    timings_s: Mapping[str, float],
) -> dict[str, Any]:
    """The content of reach.json."""
    rows = []
    for number, (row, judged) in enumerate(zip(branch_rows(airway), reach, strict=True)):
        line = airway.branches[number].line
        rows.append(
            row
            | {
                "verdict": judged.verdict,
                "proved": judged.verdict in (Verdict.REACHED, Verdict.DIAMETER),
                "reason": judged.reason,
                "leaf": not airway.children[number],
                "depth_mm": judged.depth,
                "tip_error_mm": judged.tip_error,
                "clearance_bound_mm": judged.bound,
                "middle_mm": airway.place(number, HALF * airway.branches[number].length),
                "deepest_mm": airway.place(number, judged.depth) if judged.depth > 0.0 else None,
                "points_mm": line.points,
                "body_mm": None if judged.plan is None else judged.plan.steps[-1].body[::2],
            }
        )
    return {
        "software": provenance.software,
        "provenance": provenance.details(),
        "case_id": case_name(case),
        "method": case.method,
        "robot": {
            "name": case.robot.name,
            "diameter_mm": case.robot.diameter,
            "active_length_mm": case.robot.active_length,
            "bend_max_deg": float(np.degrees(case.robot.bend_max)),
        },
        "rule": RULE,
        "counts": {verdict.value: sum(judged.verdict is verdict for judged in reach) for verdict in Verdict},
        "branches": rows,
        "timings_s": timings_s,
    }


CSV_COLUMNS = (
    "name",
    "label",
    "generation",
    "diameter_mm",
    "least_diameter_mm",
    "length_mm",
    "turn_deg",
    "verdict",
    "proved",
    "depth_mm",
    "tip_error_mm",
    "clearance_bound_mm",
    "confidence",
    "reason",
)


def reach_csv(document: Mapping[str, Any]) -> str:
    """reach.csv: one row for each branch."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for row in document["branches"]:
        writer.writerow(["" if row[key] is None else row[key] for key in CSV_COLUMNS])
    return text.getvalue()
