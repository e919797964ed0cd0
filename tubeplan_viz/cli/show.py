"""Progress on standard error and the outcome on standard output."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from tubeplan_viz.cli.options import Outputs
from tubeplan_viz.pipeline import Notify, silent
from tubeplan_viz.planners import run_case

EXIT_STATUS = {"ok": 0, "flagged": 3, "infeasible": 4}


@contextmanager
def progress(quiet: bool) -> Iterator[Notify]:
    """A progress bar on a terminal, a line per stage elsewhere, nothing when quiet."""
    if quiet:
        yield silent
    elif sys.stderr.isatty():
        with bar() as notify:
            yield notify
    else:
        with lines() as notify:
            yield notify


@contextmanager
def bar() -> Iterator[Notify]:
    """One rich bar that takes the name of the stage."""
    columns = (SpinnerColumn(), TextColumn("{task.description:<18}"), BarColumn(bar_width=30), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("starting", total=None)

        def notify(stage: str, done: int, total: int) -> None:
            shown.update(task, description=stage, completed=done, total=total or None)

        yield notify


@contextmanager
def lines() -> Iterator[Notify]:
    """A plain line at the end of each stage, with its seconds."""
    stage, begun = "", time.perf_counter()

    def close() -> None:
        if stage:
            typer.echo(f"{stage}: {time.perf_counter() - begun:.2f} s", err=True)

    def notify(name: str, done: int, total: int) -> None:
        nonlocal stage, begun
        if name != stage:
            close()
            stage, begun = name, time.perf_counter()

    yield notify
    close()


def plan_and_exit(case: Any, outputs: Outputs, *, light: bool = False) -> NoReturn:
    """Plan a case of any planner, print how it ended and exit with the status that the README lists."""
    with progress(outputs.quiet) as notify:
        result = run_case(case, outputs.output, outputs.run_options(notify, light=light))
    raise typer.Exit(report_plan(result, outputs.output, as_json=outputs.json))


def report_plan(result: Mapping[str, Any], folder: Path, *, as_json: bool) -> int:
    """Print how a plan ended and where its files are; return the exit status."""
    status = EXIT_STATUS[result["status"]]
    if as_json:
        keys = ("status", "reason", "planner", "frame", "limits", "metrics", "certificate", "flagged_intervals", "timings_s")
        files = sorted(entry.name for entry in folder.iterdir())
        typer.echo(json.dumps({**{key: result[key] for key in keys}, "folder": str(folder), "files": files}))
        return status
    metrics, limits = result["metrics"], result["limits"]
    limited = [limits[key] is not None for key in ("clearance_min_mm", "curvature_max_per_mm")]
    kept = "both limits are kept" if all(limited) else "the limit is kept" if any(limited) else "the path is free"
    words = {0: f"holds: {kept} and proved over the whole path", 3: "flagged", 4: "infeasible"}[status]
    typer.echo(words if result["reason"] is None else f"{words}: {result['reason']}")
    told = (
        ("path {:.1f} mm", metrics["length_mm"], ()),
        ("least clearance {:.2f} of {:g} mm", metrics["clearance_min_mm"], (limits["clearance_min_mm"],)),
        ("largest curvature {:.4f} of {:g} 1/mm", metrics["curvature_max_per_mm"], (limits["curvature_max_per_mm"],)),
        ("tip error {:.2g} mm", metrics["tip_error_mm"], ()),
    )
    shown = [form.format(value, *limit) for form, value, limit in told if value is not None]
    if shown:
        typer.echo(", ".join(shown))
    for flag in result["flagged_intervals"]:
        unit = "mm" if flag["kind"] == "clearance" else "1/mm"
        typer.echo(
            f"  {flag['kind']} from {flag['from_mm']:.1f} to {flag['to_mm']:.1f} mm, "
            f"worst {flag['worst']:.4g} {unit} at {flag['worst_at_mm']:.1f} mm"
        )
    name_pages(folder)
    return status


def name_pages(folder: Path) -> None:
    """Print where report and recording are, those that were written."""
    for name in ("report.html", "recording.rrd"):
        if (folder / name).exists():
            typer.echo(str(folder / name))
