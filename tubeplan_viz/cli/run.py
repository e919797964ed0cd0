"""tubeplan run: one case, all from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tubeplan_viz.cases.fields import read_table
from tubeplan_viz.cases.lines import naming_lines
from tubeplan_viz.cases.needle_rows import read_events
from tubeplan_viz.cli.options import Outputs, case_options, merged, output_options
from tubeplan_viz.cli.show import plan_and_exit
from tubeplan_viz.planners import make_case


@output_options
@case_options
def run(
    *,
    case_file: Annotated[Path, typer.Argument(metavar="CASE.toml", help="The case file.")],
    given: dict[str, dict[str, Any]],
    outputs: Outputs,
    events: Annotated[
        Path | None, typer.Option("--events", help="Needles in space: a TOML file with [[events]], in place of the case's own.")
    ] = None,
    light: Annotated[bool, typer.Option("--light", help="A small recording: no CT, a thin mesh.")] = False,
) -> None:
    """Plan one case from a case file; options given here take the place of the file's.

    Example: tubeplan run case.toml --clearance-min 1.5 -o run
    """
    table = read_table(case_file)
    if events is not None:
        table = {**table, "events": read_events(events)}
    with naming_lines(case_file, given):
        case = make_case(merged(table, given), folder=case_file.resolve().parent, name=case_file.name)
    plan_and_exit(case, outputs, light=light)
