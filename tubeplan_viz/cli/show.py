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
from tubeplan_viz.result import kept_until, place_words, worst_at

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
    for line in outcome_lines(result):
        typer.echo(line)
    name_pages(folder)
    return status


def outcome_lines(result: Mapping[str, Any]) -> list[str]:
    """How a plan ended, its figures with their limits and places, the flagged stretches, and what a reader must know."""
    limits, details = result["limits"], result["details"]
    limited = [limits[key] is not None for key in ("clearance_min_mm", "curvature_max_per_mm")]
    kept = "both limits are kept" if all(limited) else "the limit is kept" if any(limited) else "the path is free"
    status = EXIT_STATUS[result["status"]]
    words = {0: f"holds: {kept} and proved over the whole path", 3: "flagged", 4: "infeasible"}[status]
    lines = [words if result["reason"] is None else f"{words}: {result['reason']}"]
    lines += figure_lines(result)
    for flag in result["flagged_intervals"]:
        unit = "mm" if flag["kind"] == "clearance" else "1/mm"
        lines.append(
            f"  {flag['kind']} from {flag['from_mm']:.1f} to {flag['to_mm']:.1f} mm, "
            f"worst {flag['worst']:.4g} {unit} at {place_words(result, flag['worst_at_mm'])}"
        )
    reached = kept_until(result) if result["status"] == "infeasible" else None
    if reached is not None:
        goal = ",".join(f"{value:.2f}" for value in reached[1])
        lines.append(f"both limits are kept up to {place_words(result, reached[0])}: a goal at {goal} is reached")
    return lines + relief_lines(details) + [f"note: {text}" for text in details.get("warnings") or ()]


def figure_lines(result: Mapping[str, Any]) -> list[str]:
    """Length, least clearance, largest curvature and error of the tip, those that the planner has."""
    metrics, limits, details = result["metrics"], result["limits"], result["details"]
    lines = []
    if metrics["length_mm"] is not None:
        parts = [str(part["name"]) for part in details.get("parts") or ()]
        through = f", through {', '.join(parts)}" if parts else ""
        lines.append(f"path {metrics['length_mm']:.1f} mm{through}")
    for name, kind, key, form, asked in (
        ("least clearance", "clearance", "clearance_min_mm", "{:.2f} mm", "{:g} mm asked for"),
        ("largest curvature", "curvature", "curvature_max_per_mm", "{:.4f} 1/mm", "{:g} 1/mm allowed"),
    ):
        if metrics[key] is None:
            continue
        told = [f"{name} {form.format(metrics[key])}"]
        at = worst_at(result, kind)
        if at is not None:
            told.append(f" at {place_words(result, at)}")
        if limits[key] is not None:
            told.append(f"; {asked.format(limits[key])}")
        lines.append("".join(told))
    if metrics["tip_error_mm"] is not None:
        lines.append(f"tip error {metrics['tip_error_mm']:.2g} mm")
    return lines


def relief_lines(details: Mapping[str, Any]) -> list[str]:
    """The smallest change of a limit that lets a path through, where one was looked for."""
    told = details.get("relaxation")
    if not told:
        return []
    rows = (("instrument radius", "clearance"), ("bend radius", "bend_radius"))
    found = [
        f"{name} {told[f'{key}_mm']:.3f} mm ({told[f'{key}_change_percent']:+.1f} %)"
        for name, key in rows
        if told[f"{key}_mm"] is not None
    ]
    return [f"would do: {' or '.join(found)}" if found else "no single change of a limit was found that would do"]


def name_pages(folder: Path) -> None:
    """Print where report and recording are, those that were written."""
    for name in ("report.html", "recording.rrd"):
        if (folder / name).exists():
            typer.echo(str(folder / name))
