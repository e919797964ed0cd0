"""tubeplan compare: finished runs side by side."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from tubeplan_viz.cli.options import Force, Json, NoRecording, NoReport, Output, Quiet
from tubeplan_viz.cli.show import progress
from tubeplan_viz.compare import compare_folders


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN RUN...", help="Two to six run folders.")],
    output: Output = Path("comparison"),
    force: Force = False,
    no_recording: NoRecording = False,
    no_report: NoReport = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Lay planners, limits, instruments or dates side by side: one page, one recording, compare.json.

    Paths are drawn into one picture where the runs share frame and mesh; other runs are
    compared in numbers. The better figure of each row is marked with *.

    Example: tubeplan compare run-a run-b -o comparison
    """
    with progress(quiet or json) as notify:
        comparison = compare_folders(runs, output, force=force, recording=not no_recording, report=not no_report, notify=notify)
    document = comparison.document
    if json:
        keys = ("rows", "differences", "overlay", "notes")
        shown = [{"label": run.label, "name": run.name, "status": run.result["status"]} for run in comparison.runs]
        files = sorted(entry.name for entry in output.iterdir())
        typer.echo(
            json_text.dumps({"runs": shown, **{key: document[key] for key in keys}, "folder": str(output), "files": files})
        )
        return
    for run in comparison.runs:
        planner = run.result["planner"]
        typer.echo(f"{run.label}  {run.name}: {planner['name']}, {planner['method']}: {run.result['status']}")
    table = Table(box=None, pad_edge=False)
    table.add_column("measure")
    table.add_column("better")
    for run in comparison.runs:
        table.add_column(run.label, justify="right")
    for row in document["rows"]:
        cells = [
            "" if value is None else f"{value:.{row['digits']}f}{'*' if k in row['best'] else ' '}"
            for k, value in enumerate(row["values"])
        ]
        table.add_row(f"{row['title']}, {row['unit']}", row["better"] or "", *cells)
    Console(width=None if Console().is_terminal else 120).print(table)
    if not comparison.overlaid:
        typer.echo(f"not overlaid: {document['overlay']['reason']}")
    for note in document["notes"]:
        typer.echo(f"note: {note}")
    for name in ("report.html", "recording.rrd"):
        if (output / name).exists():
            typer.echo(str(output / name))
