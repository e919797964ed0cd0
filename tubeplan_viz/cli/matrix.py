"""tubeplan matrix: which instrument reaches which target."""

from __future__ import annotations

import json as json_text
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from segmentation.errors import CaseError
from tubeplan_viz.cases.tube import make_case
from tubeplan_viz.cli.options import LUMEN, Outputs, outputs_into, some_case_options
from tubeplan_viz.cli.show import EXIT_STATUS, name_pages, progress
from tubeplan_viz.instruments import apart, read_catalogue
from tubeplan_viz.matrix import run_matrix

SIGNS = {"feasible": "holds", "flagged": "flag", "impossible": "no"}
# Of a case: what makes the lumen and its tree, and how a path is found. One case's limits, goal and studies are none of these.
TAKEN = (*LUMEN, "case_id", "start", "start_direction", "method", "closed_ends", "scans", "max_rounds", "centerline_step")


@outputs_into("matrix")
@some_case_options(*TAKEN, unlisted=("curvature_max", "clearance_min", "goal"))
def matrix(
    *,
    given: dict[str, dict[str, Any]],
    goals: Annotated[
        str, typer.Option("--goals", help="Labels or names of `tubeplan endpoints`, comma-separated, or all.")
    ] = "all",
    catalogue: Annotated[Path | None, typer.Option("--catalogue", help="TOML file of instruments [typical ones].")] = None,
    before_start: Annotated[float, typer.Option("--before-start", help="Instrument used up before the start, mm.")] = 0.0,
    outputs: Outputs,
) -> None:
    """Judge every instrument of a catalogue for every target: holds, flagged, or proved impossible.

    Example: tubeplan matrix --mesh ureter.stl --start E1 --goals E2,E3,E4 -o matrix
    """
    for key in ("curvature_max", "clearance_min"):
        if key in given.get("limits", {}):
            raise CaseError(f"--{key.replace('_', '-')} does not apply here: limits come from the catalogue; leave it out")
    if "goal" in given.get("planner", {}):
        raise CaseError("--goal does not apply here; give --goals with labels, comma-separated")
    planner = {"name": "tube", "method": "optimal", **given.get("planner", {})}
    case = make_case({**given, "planner": planner}, name="options")
    instruments = read_catalogue(catalogue)
    with progress(outputs.quiet or outputs.json) as notify:
        document = run_matrix(
            case,
            outputs.output,
            goals=[part for part in goals.split(",") if part.strip()],
            instruments=instruments,
            before_start_mm=before_start,
            notify=notify,
            **outputs.written(),
        )
    if outputs.json:
        keys = ("status", "counts", "instruments", "targets", "cells", "timings_s")
        files = sorted(entry.name for entry in outputs.output.iterdir())
        typer.echo(json_text.dumps({**{key: document[key] for key in keys}, "folder": str(outputs.output), "files": files}))
    else:
        show(document, outputs.output)
    raise typer.Exit(EXIT_STATUS[document["status"]])


def show(document: Mapping[str, Any], folder: Path) -> None:
    """The table on standard output: verdict and worst margin in mm of each cell."""
    table = Table(box=None, pad_edge=False)
    table.add_column("instrument")
    table.add_column("diameter, bend mm")
    for target in document["targets"]:
        table.add_column("\n".join(filter(None, (target["label"], target["name"]))), justify="right", max_width=16)
    for one, row in zip(document["instruments"], document["cells"], strict=True):
        table.add_row(one["name"], f"{one['outer_diameter_mm']:.2f}, {one['bend_radius_min_mm']:g}", *map(cell_words, row))
    wide = 60 + 18 * len(document["targets"])
    Console(width=None if Console().is_terminal else wide).print(table)
    counts = document["counts"]
    typer.echo(f"{counts['feasible']} hold, {counts['flagged']} flagged, {counts['impossible']} proved impossible; margins in mm")
    if any(cell["short_mm"] is not None for row in document["cells"] for cell in row):
        typer.echo("short: mm of way left where an instrument is proved to come on the paths found")
    name_pages(folder)


def margin_words(margin: float | None) -> str:
    """A margin with its sign, in mm, behind a verdict; nothing where there is none."""
    return "" if margin is None else f" {'+' if margin >= 0.0 else ''}{apart(margin, 0.0)[0]}"


def cell_words(cell: Mapping[str, Any]) -> str:
    """Verdict and margin of one cell, and how far its instrument stays short of the target."""
    short = cell["short_mm"]
    return SIGNS[cell["verdict"]] + margin_words(cell["margin_mm"]) + ("" if short is None else f"\n{short:.1f} short")
