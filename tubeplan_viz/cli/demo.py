"""tubeplan demo: the main job on a CT that the project makes itself."""

from __future__ import annotations

import os
import shutil
import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from segmentation.errors import CaseError
from segmentation.synthetic import CollectingSystem, urography, write_demo_series
from tubeplan_viz.cases.tube import make_case
from tubeplan_viz.cli.options import Outputs, outputs_into
from tubeplan_viz.cli.show import progress, report_plan
from tubeplan_viz.pipeline import run_tube


@outputs_into("tubeplan-demo")
def demo(
    *,
    goal: Annotated[str, typer.Option("--goal", help='Calyx, e.g. "upper 1", "middle 1", "lower 1".')] = "lower 2",
    open_report: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False,
    outputs: Outputs,
) -> None:
    """Plan from the ureter to a calyx on a generated urography CT, from DICOM to report.

    The series is written beside the run folder, as NAME-ct.

    Example: tubeplan demo -o demo --open
    """
    output = outputs.output
    series = output.resolve().parent / f"{output.resolve().name}-ct"
    with progress(outputs.quiet) as notify:
        check_room(series, outputs.force)
        notify("generate CT", 0, 0)
        truth = urography().truth
        ends = {"start": tuple(truth.start.tolist()), "goal": goal_of(truth, goal)}
        with keeping_if_done(series) as partial:
            write_demo_series(partial, progress=lambda done, total: notify("generate CT", done, total))
            partial.rename(series)
            inputs = {"ct": series, "case_id": "demo-urography", "anatomy": "urinary"}
            result = run_tube(make_case({"input": inputs, "planner": ends}, name="demo"), output, outputs.run_options(notify))
    status = report_plan(result, output, as_json=outputs.json)
    if open_report and (output / "report.html").exists():
        webbrowser.open((output / "report.html").resolve().as_uri())
    raise typer.Exit(status)


def check_room(series: Path, force: bool) -> None:
    """Refuse what is in the way of the series, but with `force` a folder that holds nothing but DICOM slices."""
    if not os.path.lexists(series):
        return
    if series.is_symlink() or not series.is_dir():
        raise CaseError(f"{series.name} exists and is no folder; choose another name with -o")
    if not force and any(series.iterdir()):
        raise CaseError(f"{series.name} exists already; choose another name with -o, or replace it with --force")
    files = list(series.iterdir())
    if any(file.suffix != ".dcm" or not file.is_file() for file in files):
        raise CaseError(f"{series.name} holds more than DICOM slices and is not replaced; choose another name with -o")


@contextmanager
def keeping_if_done(series: Path) -> Iterator[Path]:
    """A hidden folder in which the series is made, to be renamed; what was there before comes back unless all succeeds."""
    old: Path | None = None
    with new_neighbour(series, "partial") as made, new_neighbour(series, "replaced") as place:
        try:
            if series.exists():
                old = series.rename(place / series.name)
            yield made / series.name
        except BaseException:
            shutil.rmtree(series, ignore_errors=True)
            if old is not None:
                old.rename(series)
            raise


@contextmanager
def new_neighbour(folder: Path, kind: str) -> Iterator[Path]:
    """A hidden folder beside another one, removed afterwards with all that is in it."""
    try:
        made = Path(tempfile.mkdtemp(prefix=f".{folder.name}.{kind}-", dir=folder.parent))
    except OSError as fault:
        reason = (fault.strerror or "the system refuses").lower()
        raise CaseError(f"{folder.name}: no folder can be made there ({reason}); choose another place with -o") from None
    try:
        yield made
    finally:
        shutil.rmtree(made, ignore_errors=True)


def goal_of(truth: CollectingSystem, name: str) -> tuple[float, ...]:
    """The goal point of a calyx by its name."""
    goals = dict(truth.goals)
    if name not in goals:
        raise CaseError(f"the demo has no calyx {name!r}, expected one of {', '.join(goals)}")
    return tuple(goals[name].tolist())
