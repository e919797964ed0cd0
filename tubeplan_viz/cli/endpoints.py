"""tubeplan endpoints: labelled proposals for start and goal."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from segmentation.errors import CaseError
from tubeplan_viz.cases.tube import make_case
from tubeplan_viz.cli.options import LUMEN, Json, Quiet, some_case_options
from tubeplan_viz.cli.show import progress
from tubeplan_viz.pipeline import Stopwatch, case_end_names, case_tree, endpoint_details, load_lumen
from tubeplan_viz.result import is_run, read_result


@some_case_options(*LUMEN, "closed_ends", "centerline_step")
def endpoints(
    *,
    source: Annotated[Path | None, typer.Argument(metavar="MESH_OR_RUN", help="Mesh file or run folder; or use --ct.")] = None,
    given: dict[str, dict[str, Any]],
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """List the tips of the lumen's tree, for --start and --goal; with an anatomy E1 is the way in and --goal takes names too.

    Example: tubeplan endpoints ureter.stl
    """
    inputs = dict(given.get("input", {}))
    if source is not None:
        if source.is_dir() and not (source / "mesh.ply").exists():
            raise CaseError(
                f"{source.resolve().name} holds no mesh.ply; name a mesh file or a run folder, or give a CT with --ct"
            )
        inputs["mesh"] = source / "mesh.ply" if source.is_dir() else source
        inputs = run_anatomy(source) | inputs
    if not inputs.get("mesh") and not inputs.get("ct"):
        raise CaseError("name a mesh file or run folder, or give a CT with --ct")
    case = make_case({**given, "input": inputs}, name="options")
    with progress(quiet or json) as notify:
        watch = Stopwatch(notify)
        lumen = load_lumen(case.input, watch=watch)
        with watch.stage("end points"):
            tree = case_tree(case, lumen)
            names = case_end_names(case, lumen, tree)
    tips = [endpoint_details(tip, names.get(tip.label)) for tip in tree.endpoints]
    if json:
        typer.echo(json_text.dumps({"frame": tree.surface.frame, "endpoints": tips}, indent=1))
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("label", "x mm", "y mm", "z mm", "radius mm", "branch mm", "confidence", "cap", *(["name"] if names else [])):
        table.add_column(heading, justify="left" if heading in ("label", "cap", "name") else "right")
    for tip in tips:
        x, y, z = (f"{v:.1f}" for v in tip["point_mm"])
        table.add_row(
            tip["label"],
            x,
            y,
            z,
            f"{tip['radius_mm']:.2f}",
            f"{tip['branch_length_mm']:.1f}",
            f"{tip['confidence']:.2f}",
            tip["cap"] or "",
            *([tip["name"]] if names else []),
        )
    Console(width=None if Console().is_terminal else 120).print(table)
    if case.input.anatomy == "airway" and len(tips) < 3:
        typer.echo("the airway does not divide in this image: no carina and no bronchi to name")


def run_anatomy(source: Path) -> dict[str, str]:
    """What the lumen of a run folder is, as an input's table; empty for a mesh file or where it is not known."""
    if not is_run(source):
        return {}
    settings = read_result(source)["provenance"]["settings"] or {}
    anatomy = settings.get("input", {}).get("anatomy")
    return {"anatomy": anatomy} if isinstance(anatomy, str) else {}
