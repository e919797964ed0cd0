"""tubeplan batch: a cohort from a manifest."""

from __future__ import annotations

import json as json_text
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from tubeplan_viz.cli.options import Json, NoRecording, NoReport, Quiet
from tubeplan_viz.cli.show import bar
from tubeplan_viz.cohort import CohortEvent, CohortSettings, read_manifest, run_cohort
from tubeplan_viz.cohort.run import Watch, nobody

WORDS = {
    "ok": "hold",
    "flagged": "flagged",
    "infeasible": "without a path",
    "time_limit": "hit the time limit",
    "bad_input": "with bad input",
    "died": "died",
    "fault": "met a fault of the program",
}
SUMMARY = ("exit_status", "counts", "reasons", "cases", "others", "pass")


def batch(
    manifest: Annotated[
        Path, typer.Argument(metavar="MANIFEST", help="TOML with [[cases]] (id, case = FILE or tables), or CSV, a row a case.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The cohort's folder: new, or that of an earlier call, which goes on.")
    ] = Path("cohort"),
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", help="Cases at a time [as many as processors this process may use].")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", help="Address of a Dask scheduler, as tcp://host:8786, whose workers take the cases."),
    ] = None,
    time_limit: Annotated[float | None, typer.Option("--time-limit", help="End a case after this many s.")] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Run again what had bad input, died, hit the time limit or met a fault.")
    ] = False,
    verify: Annotated[bool, typer.Option("--verify", help="Verify each run, as `tubeplan verify` does.")] = False,
    rng_seed: Annotated[
        int | None, typer.Option("--rng-seed", help="Gives each case without a seed of its own one that hangs on its id alone.")
    ] = None,
    no_recording: NoRecording = False,
    no_report: NoReport = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a cohort: many cases of any planner, side by side, on this machine or on a Dask cluster.

    Each case becomes a run folder below the output; beside them stand index.html, cohort.csv and cohort.json. The same command
    again goes on where it stopped: it does what is missing, and what changed in case, input or version of the software.

    Exit status of the gravest case, in this order: 1 a process died or met a fault of the program; 2 bad input (in the manifest:
    nothing runs); 4 no path, or the time limit; 3 flagged, or a verification that does not hold; 0 all hold. 130 interrupted.

    Example: tubeplan batch cohort.toml -o cohort --jobs 8 --time-limit 600 --verify
    """
    settings = CohortSettings(
        jobs=jobs,
        scheduler=scheduler,
        time_limit=time_limit,
        retry_failed=retry_failed,
        verify=verify,
        recording=not no_recording,
        report=not no_report,
    )
    with progress(quiet or json) as watch:
        document = run_cohort(read_manifest(manifest, rng_seed=rng_seed), output, settings, watch=watch)
    if json:
        typer.echo(json_text.dumps({**{key: document[key] for key in SUMMARY}, "folder": str(output)}))
    else:
        show(document, output)
    raise typer.Exit(document["exit_status"])


@contextmanager
def progress(quiet: bool) -> Iterator[Watch]:
    """One bar over all cases on a terminal, a line for each settled case elsewhere, nothing when quiet."""
    if quiet:
        yield nobody
    elif sys.stderr.isatty():
        with bar() as notify:
            lock = threading.Lock()

            def move(event: CohortEvent) -> None:
                with lock:
                    notify(f"{event.id}: {event.stage or event.status}", event.done, event.total)

            yield move
    else:
        yield line


def line(event: CohortEvent) -> None:
    """How a settled case ended, on standard error."""
    if event.status is None:
        return
    told = "" if event.wall_s is None or event.kept else f", {event.wall_s:.1f} s"
    why = "" if event.reason is None else f": {event.reason}"
    typer.echo(f"[{event.done}/{event.total}] {event.id}: {event.status}{' (kept)' if event.kept else told}{why}", err=True)


def show(document: Mapping[str, Any], folder: Path) -> None:
    """The cases as a table on standard output, and how many ended how."""
    table = Table(box=None, pad_edge=False)
    for name in ("case", "planner", "status", "margin mm", "time s", "memory MB"):
        table.add_column(name, justify="right" if name[-1] in "msB" and " " in name else "left", no_wrap=name == "case")
    for row in document["cases"]:
        figures = (("margin_mm", "+.2f"), ("wall_s", ".1f"), ("peak_memory_mb", ".0f"))
        cells = ["" if row[key] is None else f"{row[key]:{form}}" for key, form in figures]
        table.add_row(row["id"], row["planner"], row["status"], *cells)
    Console(width=None if Console().is_terminal else 120).print(table)
    counts = [f"{count} {WORDS[status]}" for status, count in document["counts"].items() if count]
    typer.echo(f"{', '.join(counts)}; {document['pass']['done']} done, {document['pass']['kept']} kept from before")
    for reason in document["reasons"]:
        typer.echo(f"  {reason['count']} {WORDS[reason['status']]}: {reason['reason']}")
    checked = [row for row in document["cases"] if row["verification"] is not None]
    if checked:
        typer.echo(f"{sum(row['verification']['holds'] for row in checked)} of {len(checked)} runs verified")
    if document["others"]:
        typer.echo(f"not of this manifest, left as they are: {', '.join(document['others'])}")
    typer.echo(str(folder / "index.html"))
