"""tubeplan verify: check a finished plan by other means than those that made it."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

import typer

from tubeplan_viz.cli.options import Json
from tubeplan_viz.verify import Check, verify_run


def verify(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="A run folder, or one that `tubeplan matrix` made.")],
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only the checks that do not hold, and how many do.")] = False,
) -> None:
    """Check curvature, clearance, inside-ness, ends, frame and every printed number again.

    Exit status 0 when every check holds, 3 when one does not.

    Example: tubeplan verify run
    """

    def show(check: Check) -> None:
        if not (json or (quiet and check.ok)):
            typer.echo(f"{'ok  ' if check.ok else 'FAIL'}  {check.name}: {check.sentence}")

    verification = verify_run(run_folder, seen=show)
    if json:
        typer.echo(json_text.dumps(verification.as_dict(), indent=1))
    else:
        holding = sum(check.ok for check in verification.checks)
        typer.echo(f"{holding} of {len(verification.checks)} checks hold")
    raise typer.Exit(0 if verification.holds else 3)
