"""tubeplan demo: the main job on a CT that the project makes itself."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from segmentation.synthetic import write_demo_series
from tubeplan_viz.case import make_case
from tubeplan_viz.cli.options import Force, Json, NoRecording, NoReport, Output, Quiet
from tubeplan_viz.cli.show import progress, report_plan
from tubeplan_viz.pipeline import run_case


def demo(
    output: Output = Path("tubeplan-demo"),
    goal: Annotated[str, typer.Option("--goal", help="upper, middle or lower calyx.")] = "lower",
    force: Force = False,
    open_report: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False,
    no_recording: NoRecording = False,
    no_report: NoReport = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Plan from the ureter to a calyx on a generated urography CT, from DICOM to report.

    The series is written beside the run folder, as NAME-ct.

    Example: tubeplan demo -o demo --open
    """
    series = output.resolve().parent / f"{output.resolve().name}-ct"
    with progress(quiet) as notify:
        notify("generate CT", 0, 0)
        truth = write_demo_series(series)
        case = make_case(
            {
                "input": {"ct": series, "case_id": "demo-urography", "anatomy": "urinary"},
                "planner": {"start": tuple(truth.start), "goal": tuple(truth.goals[goal])},
            },
            name="demo",
        )
        result = run_case(case, output, force=force, recording=not no_recording, report=not no_report, notify=notify)
    status = report_plan(result, output, as_json=json)
    if open_report and (output / "report.html").exists():
        webbrowser.open((output / "report.html").resolve().as_uri())
    raise typer.Exit(status)
