"""tubeplan plan needle2d and needle3d: plan a flexible needle without a case file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from segmentation.errors import CaseError
from tubeplan_viz.cli.options import Outputs, output_options
from tubeplan_viz.cli.show import plan_and_exit
from tubeplan_viz.planners import make_case

Target = Annotated[str, typer.Option("--target", help="Where the tip should end, mm: Y,Z in the plane, X,Y,Z in space.")]
Entry = Annotated[str | None, typer.Option("--entry", help="Where the needle goes in, mm [the origin].")]
Kappa = Annotated[float | None, typer.Option("--kappa", help="Curvature of the needle in tissue, 1/mm [0.02].")]
Radius = Annotated[float | None, typer.Option("--radius", help="The same as a radius, mm [50].")]
Safety = Annotated[float | None, typer.Option("--safety", help="Least distance to any obstacle, mm.")]
CaseId = Annotated[str | None, typer.Option("--case-id", help="Name of the case in all outputs; no patient's name.")]
Seed = Annotated[int | None, typer.Option("--rng-seed", help="Seed of all randomness.")]
Degree = Annotated[int | None, typer.Option("--degree-max", help="Most pieces of a path, 1 to 4 [4].")]
Circle = Annotated[list[str] | None, typer.Option("--circle", help="An obstacle Y,Z,RADIUS in mm; may be given often.")]
Sphere = Annotated[list[str] | None, typer.Option("--sphere", help="An obstacle X,Y,Z,RADIUS in mm; may be given often.")]
Mesh = Annotated[list[Path] | None, typer.Option("--mesh", help="An obstacle as a mesh file; may be given often.")]
Mask = Annotated[list[Path] | None, typer.Option("--mask", help="An obstacle as a label volume; may be given often.")]
Direction = Annotated[str | None, typer.Option("--direction", help="X,Y,Z in which the needle goes in [0,0,1].")]
Pieces = Annotated[int | None, typer.Option("--pieces", help="Turns and pushes of the path [5].")]
Duty = Annotated[bool, typer.Option("--duty-cycle", help="Allow any curvature up to kappa by spinning a part of the time.")]
EntryRadius = Annotated[float | None, typer.Option("--entry-radius", help="Choose the entry within so many mm.")]
Cone = Annotated[float | None, typer.Option("--cone", help="Choose the direction within so many degrees.")]
Method = Annotated[str | None, typer.Option("--method", help="swarm (polished onto the target) or printed (Huo et al. 2015).")]
Budget = Annotated[float | None, typer.Option("--time-budget", help="Try swarms for so many s and keep the best.")]


@output_options
def needle2d(
    *,
    target: Target,
    entry: Entry = None,
    radius: Radius = None,
    kappa: Kappa = None,
    safety: Safety = None,
    circle: Circle = None,
    degree_max: Degree = None,
    case_id: CaseId = None,
    rng_seed: Seed = None,
    outputs: Outputs,
) -> None:
    """Plan a needle in the plane: lines and arcs, every form at its optimum.

    Example: tubeplan plan needle2d --target 0,90 --circle 0,40,10 --circle=-40,30,15 --circle 30,50,8 -o run
    """
    own = {"target": target, "entry": entry, "radius_mm": radius, "kappa": kappa, "safety_mm": safety, "degree_max": degree_max}
    bodies = [ball("circle", text, 3) for text in circle or []]
    run("needle2d", own, bodies, {"rng_seed": rng_seed}, case_id, outputs)


@output_options
def needle3d(
    *,
    target: Target,
    entry: Entry = None,
    direction: Direction = None,
    kappa: Kappa = None,
    radius: Radius = None,
    safety: Safety = None,
    sphere: Sphere = None,
    mesh: Mesh = None,
    mask: Mask = None,
    pieces: Pieces = None,
    duty_cycle: Duty = False,
    entry_radius: EntryRadius = None,
    cone: Cone = None,
    method: Method = None,
    time_budget: Budget = None,
    case_id: CaseId = None,
    rng_seed: Seed = None,
    outputs: Outputs,
) -> None:
    """Plan a flexible needle in space past obstacles, onto the target.

    Example: tubeplan plan needle3d --target 0,0,100 --sphere 0,5,40,5 --safety 1 -o run
    """
    own = {"target": target, "entry": entry, "direction": direction, "kappa": kappa, "radius_mm": radius, "safety_mm": safety}
    own |= {"pieces": pieces, "duty_cycle": duty_cycle or None, "entry_radius_mm": entry_radius, "cone_deg": cone}
    bodies = [ball("sphere", text, 4) for text in sphere or []]
    bodies += [{"kind": "mesh", "file": str(path)} for path in mesh or []]
    bodies += [{"kind": "mask", "file": str(path)} for path in mask or []]
    planner = {"rng_seed": rng_seed, "method": method, "time_budget": time_budget}
    run("needle3d", own, bodies, planner, case_id, outputs)


def run(
    name: str,
    own: dict[str, Any],
    bodies: list[dict[str, Any]],
    planner: dict[str, Any],
    case_id: str | None,
    outputs: Outputs,
) -> None:
    """Make the case of the options, plan it, print the outcome and exit."""
    table: dict[str, Any] = {
        "planner": {"name": name, **{key: value for key, value in planner.items() if value is not None}},
        name: {key: value for key, value in own.items() if value is not None},
        "obstacles": bodies,
    }
    if case_id is not None:
        table["input"] = {"case_id": case_id}
    plan_and_exit(make_case(table, name="options"), outputs)


def ball(kind: str, text: str, count: int) -> dict[str, Any]:
    """A round obstacle from text: its centre and radius, comma-separated."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise CaseError(f"--{kind} is {text!r}, expected {count} numbers in mm: the centre and the radius")
    return {"kind": kind, "center": values[:-1], "radius_mm": values[-1]}
