"""tubeplan init: a first case file from a CT or a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from segmentation.errors import CaseError
from tubeplan_viz.cli.inspect import MESHES
from tubeplan_viz.cli.options import Quiet, case_options
from tubeplan_viz.cli.show import progress
from tubeplan_viz.initial_case import initial_case, write_case


@case_options
def init(
    *,
    source: Annotated[Path, typer.Argument(metavar="PATH", help="DICOM folder, volume file or mesh file.")],
    given: dict[str, dict[str, Any]],
    output: Annotated[Path, typer.Option("--output", "-o", help="Case file to write.")] = Path("case.toml"),
    instrument: Annotated[
        str | None, typer.Option("--instrument", help='Limits by a name of the catalogue, e.g. "ureteroscope, 6.3 Fr".')
    ] = None,
    catalogue: Annotated[Path | None, typer.Option("--catalogue", help="Catalogue file in place of the shipped one.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier file of that name.")] = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented case file: anatomy with its reason, end points with their labels, limits.

    `tubeplan run` accepts it as it is. Every other option is taken over into the file.

    Example: tubeplan init chest/ -o case.toml
    """
    if not source.exists():
        raise CaseError(f"{source.name}: there is no such file or folder; check the path")
    if output.exists() and not force:
        raise CaseError(f"{output.name} exists already; choose another name with -o, or replace it with --force")
    inputs = given.get("input", {})
    if {"ct", "mesh"} & set(inputs):
        raise CaseError("name the CT or mesh as the argument PATH, without --ct or --mesh")
    kind = "mesh" if source.suffix.lower() in MESHES else "ct"
    with progress(quiet) as notify:
        made = initial_case(
            {**given, "input": {**inputs, kind: source.resolve()}},
            output.resolve().parent,
            instrument=instrument,
            catalogue=catalogue,
            notify=notify,
        )
    write_case(made.text, output, force=force)
    typer.echo(f"anatomy: {made.anatomy or 'none'} ({made.anatomy_reason})")
    for name, tip in (("start", made.start), ("goal", made.goal)):
        if tip is not None:
            typer.echo("{}: {} at {:.1f}, {:.1f}, {:.1f} mm, radius {:.2f} mm".format(name, tip.label, *tip.point, tip.radius))
    typer.echo(f"limits: {made.limits_reason}")
    typer.echo(str(output))
