"""tubeplan inspect: what is in a DICOM folder, volume or mesh."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from segmentation.errors import CaseError
from segmentation.images import inspect_path
from segmentation.mesh_files import inspect_mesh
from tubeplan_viz.cli.options import Json, Quiet
from tubeplan_viz.cli.show import progress

MESHES = (".stl", ".ply", ".obj", ".glb")


def inspect(
    path: Annotated[Path, typer.Argument(help="DICOM folder, volume file or mesh file.")],
    pixels: Annotated[bool, typer.Option("--pixels", help="Decode every DICOM slice too and name damaged ones.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """List what is in a DICOM folder, volume or mesh: series, geometry, faults.

    Example: tubeplan inspect chest/ --json
    """
    if not path.exists():
        raise CaseError(f"{path.name}: no such file or folder")
    with progress(quiet or json) as notify:

        def read(done: int, count: int) -> None:
            notify("read headers", done, count)

        found = inspect_mesh(path) if path.suffix.lower() in MESHES else inspect_path(path, pixels=pixels, progress=read)
    if json:
        typer.echo(json_text.dumps(found, indent=1))
        return
    # Square brackets are text here, such as the name of an extra to install, and not rich's markup.
    console = Console(markup=False)
    for title, rows in sections(found):
        table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
        for key, value in rows:
            table.add_row(key.replace("_", " "), value)
        console.print(table)


def sections(found: dict[str, Any]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Title and rows: the whole first, then each series."""
    whole = [(key, words(value)) for key, value in found.items() if key != "series"]
    series = [
        (f"Series {number}", [(key, words(value)) for key, value in one.items()])
        for number, one in enumerate(found.get("series", []), start=1)
    ]
    return [(str(found.get("kind", "input")), whole), *series]


# Sentences and groups have lines of their own, rows of a matrix stand apart.
BETWEEN: dict[type, str] = {str: "\n", dict: "\n", list: " | "}


def words(value: Any) -> str:
    """A JSON value for a reader."""
    if isinstance(value, dict):
        # What does not apply is left out of a group.
        return "; ".join(f"{key.replace('_', ' ')} {words(item)}" for key, item in value.items() if item is not None)
    if isinstance(value, list):
        between = BETWEEN.get(type(value[0]) if value else str, ", ")
        return "none" if not value else between.join(words(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    return "unknown" if value is None else str(value)
