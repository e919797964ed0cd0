"""tubeplan run: one case, all from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tubeplan_viz.case import read_table
from tubeplan_viz.case_lines import naming_lines
from tubeplan_viz.cli.options import Connect, Force, Json, NoRecording, NoReport, Output, Quiet, case_options, merged
from tubeplan_viz.cli.show import progress, report_plan
from tubeplan_viz.planners import make_case, run_case


@case_options
def run(
    *,
    case_file: Annotated[Path, typer.Argument(metavar="CASE.toml", help="The case file.")],
    given: dict[str, dict[str, Any]],
    output: Output = Path("run"),
    force: Force = False,
    no_recording: NoRecording = False,
    no_report: NoReport = False,
    light: Annotated[bool, typer.Option("--light", help="A small recording: no CT, a thin mesh.")] = False,
    connect: Connect = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Plan one case from a case file; options given here take the place of the file's.

    Example: tubeplan run case.toml --clearance-min 1.5 -o run
    """
    table = read_table(case_file)
    with naming_lines(case_file, given):
        case = make_case(merged(table, given), folder=case_file.resolve().parent, name=case_file.name)
    with progress(quiet) as notify:
        result = run_case(
            case,
            output,
            force=force,
            recording=not no_recording,
            report=not no_report,
            light=light,
            connect=connect,
            notify=notify,
        )
    raise typer.Exit(report_plan(result, output, as_json=json))
