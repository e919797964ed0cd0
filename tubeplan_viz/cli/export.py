"""tubeplan export: a finished run for other programs."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

import typer

from tubeplan_viz.cli.options import Force, Json, Quiet
from tubeplan_viz.cli.show import progress
from tubeplan_viz.exports import FORMATS, export_run


def export(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="A run folder.")],
    to: Annotated[str, typer.Option("--to", help=f"all, or some of {','.join(FORMATS)} with commas between.")] = "all",
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to make.", show_default=True)] = Path("export"),
    keep_identifiers: Annotated[
        bool,
        typer.Option("--keep-identifiers", help="Copy the patient's and study's attributes into the DICOM files."),
    ] = False,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a run for 3D Slicer, DICOM viewers, slides and spreadsheets, without planning again.

    slicer: path.mrk.json, flags.mrk.json, lumen.seg.nrrd. seg: lumen-seg.dcm (DICOM SEG). stl:
    lumen.stl and lumen-stl.dcm (DICOM Encapsulated STL). gltf: scene.glb. csv: path, flags,
    features, centerline, metrics and measures. single-file: viewer.html, the recording with its
    viewer inside, opens from disk. Mask and DICOM files need the CT where case.toml says it is;
    they lie in its frame of reference and name no patient unless --keep-identifiers is given.

    Example: tubeplan export run --to slicer,gltf -o export
    """
    with progress(quiet or json) as notify:
        formats = [name.strip() for name in to.split(",") if name.strip()]
        document = export_run(run_folder, output, formats, keep_identifiers=keep_identifiers, force=force, notify=notify)
    if json:
        typer.echo(json_text.dumps({**document, "folder": str(output)}, indent=1))
        return
    for entry in document["files"]:
        typer.echo(str(output / entry["name"]))
    for note in document["notes"]:
        typer.echo(f"left out: {note}")
