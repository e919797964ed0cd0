"""tubeplan reach: which branches of an airway the bronchoscope robot reaches."""

from __future__ import annotations

import json as json_text
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from tubeplan_viz.cases.bronchoscope import make_bronchoscope_case
from tubeplan_viz.cli.options import Outputs, outputs_into
from tubeplan_viz.cli.plan_bronchoscope import Bend, CaseId, Ct, Diameter, HuMax, Mesh, RngSeed, Section, Seed, Start, given
from tubeplan_viz.cli.show import name_pages, progress
from tubeplan_viz.reach import run_reach

# Not reached and not proved impossible: as a plan with flags.
ALL_DECIDED, UNDECIDED = 0, 3


@outputs_into("reach")
def reach(
    *,
    ct: Ct = None,
    mesh: Mesh = None,
    start: Start = None,
    method: Annotated[str, typer.Option("--method", help="kinematic, or dynamic: plans in the MuJoCo simulator.")] = "kinematic",
    diameter: Diameter = None,
    section: Section = None,
    bend_max: Bend = None,
    seed_point: Seed = None,
    hu_max: HuMax = None,
    rng_seed: RngSeed = None,
    case_id: CaseId = None,
    time_budget: Annotated[float | None, typer.Option("--time-budget", help="Seconds of sampling per branch [no limit].")] = None,
    outputs: Outputs,
) -> None:
    """Judge every branch of an airway: reached by the robot, too narrow (proved), or no way found and what stopped it.

    Example: tubeplan reach --ct chest/ -o reach
    """
    inputs = {"ct": ct, "mesh": mesh, "case_id": case_id, "seed_point": seed_point, "hu_max": hu_max}
    planner = {"name": "bronchoscope", "method": method, "start": start, "rng_seed": rng_seed, "time_budget": time_budget}
    own = {"diameter_mm": diameter, "proximal_length_mm": section, "distal_length_mm": section, "bend_max_deg": bend_max}
    case = make_bronchoscope_case({"input": given(inputs), "planner": given(planner), "bronchoscope": given(own)}, name="options")
    with progress(outputs.quiet or outputs.json) as notify:
        document = run_reach(case, outputs.output, notify=notify, **outputs.written())
    if outputs.json:
        rows = [{key: value for key, value in row.items() if key not in ("points_mm", "body_mm")} for row in document["branches"]]
        files = sorted(entry.name for entry in outputs.output.iterdir())
        keys = ("counts", "method", "robot", "timings_s")
        told = {**{key: document[key] for key in keys}, "branches": rows, "folder": str(outputs.output), "files": files}
        typer.echo(json_text.dumps(told))
    else:
        show(document, outputs.output)
    raise typer.Exit(ALL_DECIDED if all(row["proved"] for row in document["branches"]) else UNDECIDED)


def show(document: Mapping[str, Any], folder: Path) -> None:
    """The table on standard output."""
    table = Table(box=None, pad_edge=False)
    for heading in ("branch", "label", "gen.", "diameter mm", "length mm", "reached mm", "verdict"):
        table.add_column(heading, justify="left" if heading in ("branch", "label", "verdict") else "right")
    for row in document["branches"]:
        figures = (f"{row['diameter_mm']:.1f}", f"{row['length_mm']:.1f}", f"{row['depth_mm']:.1f}")
        why = row["verdict"] + ("" if row["reason"] is None else f": {row['reason']}")
        table.add_row(row["name"], row["label"] or "", str(row["generation"]), *figures, why)
    Console(width=None if Console().is_terminal else 160).print(table)
    counts = document["counts"]
    open_ones = counts["bend"] + counts["collision"]
    typer.echo(f"{counts['reached']} reached, {counts['diameter']} proved too narrow, {open_ones} without a way found")
    name_pages(folder)
