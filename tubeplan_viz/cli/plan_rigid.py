"""tubeplan plan rigid: plan a coupled endoscope and shaver through the nose without a case file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from segmentation.errors import CaseError
from tubeplan_viz.cli.options import Outputs, output_options
from tubeplan_viz.cli.show import plan_and_exit
from tubeplan_viz.planners import make_case

Ct = Annotated[Path, typer.Option("--ct", help="Head CT: DICOM folder, .nii, .nii.gz or .mha file.")]
Side = Annotated[str | None, typer.Option("--side", help="left or right, the patient's.")]
Lesion = Annotated[str | None, typer.Option("--lesion", help="X,Y,Z of the lesion, LPS mm [proposed: optic canal].")]
LesionMask = Annotated[Path | None, typer.Option("--lesion-mask", help="The lesion as a label volume; its centroid is the goal.")]
Series = Annotated[str | None, typer.Option("--series", help="Series of the folder, as `tubeplan inspect` lists them.")]
CaseId = Annotated[str | None, typer.Option("--case-id", help="Name of the case in all outputs; no patient's name.")]
Shrinkage = Annotated[
    float | None, typer.Option("--shrinkage", help="How far the mucosa is shrunk before surgery, percent [100].")
]
Clearance = Annotated[float | None, typer.Option("--clearance-min", help="Least distance of instrument to structures, mm [0].")]
Endoscope = Annotated[str | None, typer.Option("--endoscope", help="Name in the catalogue [its first].")]
Shaver = Annotated[str | None, typer.Option("--shaver", help="Name in the catalogue [its first].")]
Catalogue = Annotated[Path | None, typer.Option("--catalogue", help="TOML file of [[endoscope]] and [[shaver]] tables.")]
Offset = Annotated[float | None, typer.Option("--offset", help="Endoscope's axis above the shaver's, mm [6].")]
Roll = Annotated[float | None, typer.Option("--roll-max", help="Largest roll about the shaver, degrees [15].")]
Nodes = Annotated[int | None, typer.Option("--nodes", help="Most bends of a path [2].")]
Mask = Annotated[
    list[str] | None,
    typer.Option(
        "--mask",
        help="NAME=FILE: a label volume for brain, orbit_left, orbit_right, septum, turbinate_left, "
        "turbinate_right, entry_left or entry_right.",
    ),
]
Seed = Annotated[list[str] | None, typer.Option("--seed", help="NAME=X,Y,Z: a point of a structure, to correct its proposal.")]
Box = Annotated[list[str] | None, typer.Option("--box", help="NAME=X,Y,Z,X,Y,Z: a box that holds a structure or an entry.")]


@output_options
def rigid(
    *,
    ct: Ct,
    side: Side = None,
    lesion: Lesion = None,
    lesion_mask: LesionMask = None,
    shrinkage: Shrinkage = None,
    clearance_min: Clearance = None,
    endoscope: Endoscope = None,
    shaver: Shaver = None,
    catalogue: Catalogue = None,
    offset: Offset = None,
    roll_max: Roll = None,
    nodes: Nodes = None,
    mask: Mask = None,
    seed: Seed = None,
    box: Box = None,
    series: Series = None,
    case_id: CaseId = None,
    outputs: Outputs,
) -> None:
    """Plan a coupled endoscope and shaver from the nostril to a lesion at the skull base.

    Example: tubeplan plan rigid --ct head/ --side left --lesion 11.6,3,27 -o run
    """
    own: dict[str, Any] = {
        "side": side,
        "lesion": lesion,
        "lesion_mask": None if lesion_mask is None else str(lesion_mask),
        "shrinkage_percent": shrinkage,
        "endoscope": endoscope,
        "shaver": shaver,
        "catalogue": None if catalogue is None else str(catalogue),
        "offset_mm": offset,
        "roll_max_deg": roll_max,
        "nodes": nodes,
        "masks": named(mask, "--mask"),
        "seeds": named(seed, "--seed"),
        "boxes": named(box, "--box"),
    }
    inputs = {"ct": str(ct), "series": series, "case_id": case_id}
    table: dict[str, Any] = {
        "input": {key: value for key, value in inputs.items() if value is not None},
        "planner": {"name": "rigid"},
        "rigid": {key: value for key, value in own.items() if value is not None},
    }
    if clearance_min is not None:
        table["limits"] = {"clearance_min": clearance_min}
    case = make_case(table, name="options")
    _ = case.instrument  # names that no catalogue has and parts that do not fit are told before the CT is read
    plan_and_exit(case, outputs)


def named(texts: list[str] | None, option: str) -> dict[str, str] | None:
    """Texts ``NAME=VALUE`` as a table; None without any."""
    made: dict[str, str] = {}
    for told in texts or []:
        name, sign, value = told.partition("=")
        if not sign or not name or not value:
            raise CaseError(f"{option} is {told!r}, expected NAME=VALUE")
        if name in made:
            raise CaseError(f"{option} names {name} twice; give it once")
        made[name] = value
    return made or None
