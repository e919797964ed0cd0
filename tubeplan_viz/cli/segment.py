"""tubeplan segment: CT to mask and mesh."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Any

import typer

from segmentation.errors import CaseError
from tubeplan_viz.cases.tube import make_case
from tubeplan_viz.cli.options import LUMEN_OF_CT, Force, Json, Output, Quiet, some_case_options
from tubeplan_viz.cli.show import progress
from tubeplan_viz.pipeline import segment_case


@some_case_options(*LUMEN_OF_CT)
def segment(
    *,
    given: dict[str, dict[str, Any]],
    output: Output = Path("segmentation"),
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Grow the lumen of a CT and write its mask (NIfTI) and mesh (PLY).

    Example: tubeplan segment --ct chest/ --anatomy airway -o airway
    """
    if "ct" not in given.get("input", {}):
        raise CaseError("segmenting needs a CT; give --ct")
    case = make_case(given, name="options")
    with progress(quiet or json) as notify:
        summary = segment_case(case.input, output, force=force, notify=notify)
    if json:
        typer.echo(json_text.dumps(summary, indent=1))
        return
    for label, value in summary["facts"].items():
        typer.echo(f"{label}: {value}")
    for note in summary["warnings"]:
        typer.echo(f"note: {note}")
    typer.echo(str(output))
