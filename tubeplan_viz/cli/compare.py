"""tubeplan compare: finished runs side by side."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from tubeplan_viz.cli.options import Outputs, outputs_into
from tubeplan_viz.cli.show import name_pages, progress
from tubeplan_viz.compare import compare_folders


@outputs_into("comparison")
def compare(
    *,
    runs: Annotated[list[Path], typer.Argument(metavar="RUN RUN...", help="Two to six run folders.")],
    outputs: Outputs,
) -> None:
    """Lay planners, limits, instruments or dates side by side: one page, one recording, compare.json.

    Paths are drawn into one picture where the runs share frame and mesh; other runs are
    compared in numbers. The better figure of each row is marked with *.

    Example: tubeplan compare run-a run-b -o comparison
    """
    with progress(outputs.quiet or outputs.json) as notify:
        comparison = compare_folders(runs, outputs.output, notify=notify, **outputs.written())
    document = comparison.document
    if outputs.json:
        keys = ("rows", "differences", "overlay", "notes")
        shown = [{"label": run.label, "name": run.name, "status": run.result["status"]} for run in comparison.runs]
        files = sorted(entry.name for entry in outputs.output.iterdir())
        told = {"runs": shown, **{key: document[key] for key in keys}, "folder": str(outputs.output), "files": files}
        typer.echo(json_text.dumps(told))
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
    name_pages(outputs.output)
