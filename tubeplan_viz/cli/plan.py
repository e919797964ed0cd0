"""tubeplan plan tube: plan without a case file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from tubeplan_viz.case import make_case
from tubeplan_viz.cli.options import Connect, Force, Json, NoRecording, NoReport, Output, Quiet, case_options
from tubeplan_viz.cli.show import progress, report_plan
from tubeplan_viz.pipeline import run_case


@case_options
def tube(
    *,
    given: dict[str, dict[str, Any]],
    output: Output = Path("run"),
    force: Force = False,
    no_recording: NoRecording = False,
    no_report: NoReport = False,
    connect: Connect = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Plan a curvature- and clearance-constrained path inside a curved tube.

    Example: tubeplan plan tube --ct chest/ --anatomy airway --start E1 --goal E3 --clearance-min 2.5 -o run
    """
    case = make_case({**given, "planner": {"name": "tube", **given.get("planner", {})}}, name="options")
    with progress(quiet) as notify:
        result = run_case(
            case, output, force=force, recording=not no_recording, report=not no_report, connect=connect, notify=notify
        )
    raise typer.Exit(report_plan(result, output, as_json=json))
