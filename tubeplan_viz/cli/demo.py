"""tubeplan demo: the main job on a CT that the project makes itself."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from segmentation.errors import CaseError
from segmentation.synthetic import CollectingSystem, write_demo_series
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
        make_room(series, outputs.force)
        truth = write_demo_series(series, progress=lambda done, total: notify("generate CT", done, total))
        case = make_case(
            {
                "input": {"ct": series, "case_id": "demo-urography", "anatomy": "urinary"},
                "planner": {"start": tuple(truth.start.tolist()), "goal": goal_of(truth, goal)},
            },
            name="demo",
        )
        result = run_tube(case, output, outputs.run_options(notify))
    status = report_plan(result, output, as_json=outputs.json)
    if open_report and (output / "report.html").exists():
        webbrowser.open((output / "report.html").resolve().as_uri())
    raise typer.Exit(status)


def make_room(series: Path, force: bool) -> None:
    """Refuse a folder that is in the way; with `force` empty it, if it holds nothing but DICOM slices."""
    if not series.exists() or not any(series.iterdir()):
        return
    if not force:
        raise CaseError(f"{series.name} exists already; choose another name with -o, or replace it with --force")
    files = list(series.iterdir())
    if any(file.suffix != ".dcm" or not file.is_file() for file in files):
        raise CaseError(f"{series.name} holds more than DICOM slices and is not replaced; choose another name with -o")
    for file in files:
        file.unlink()


def goal_of(truth: CollectingSystem, name: str) -> tuple[float, ...]:
    """The goal point of a calyx by its name."""
    goals = dict(truth.goals)
    if name not in goals:
        raise CaseError(f"the demo has no calyx {name!r}, expected one of {', '.join(goals)}")
    return tuple(goals[name].tolist())
