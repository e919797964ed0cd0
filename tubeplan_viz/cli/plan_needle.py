"""tubeplan plan needle2d and needle3d: plan a flexible needle without a case file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from segmentation.errors import CaseError
from tubeplan_viz.cases.needle_rows import read_events
from tubeplan_viz.cli.options import Outputs, output_options
from tubeplan_viz.cli.show import plan_and_exit
from tubeplan_viz.planners import make_case

Target = Annotated[str, typer.Option("--target", help="Where the tip should end, mm: Y,Z in the plane, X,Y,Z in space.")]
Entry = Annotated[str | None, typer.Option("--entry", help="Where the needle goes in, mm [the origin].")]
Kappa = Annotated[
    float | None, typer.Option("--kappa", "--curvature-max", help="Curvature of the needle in tissue, 1/mm [0.02].")
]
Radius = Annotated[float | None, typer.Option("--radius", help="The same as a radius, mm [50].")]
Safety = Annotated[
    float | None,
    typer.Option("--safety", "--clearance-min", help="Least distance to any obstacle, mm [0 in the plane, 1 in space]."),
]
CaseId = Annotated[str | None, typer.Option("--case-id", help="Name of the case in all outputs; no patient's name.")]
Seed = Annotated[int | None, typer.Option("--rng-seed", help="Seed of all randomness [0].")]
Degree = Annotated[int | None, typer.Option("--degree-max", help="Most pieces of a path, 1 to 4 [4].")]
Angle = Annotated[float | None, typer.Option("--angle-max", help="Largest insertion angle to either side, degrees [90].")]
Circle = Annotated[list[str] | None, typer.Option("--circle", help="An obstacle Y,Z,RADIUS in mm; may be given often.")]
Polygon = Annotated[
    list[str] | None, typer.Option("--polygon", help="An obstacle Y,Z,Y,Z,Y,Z,... by its corners in mm; may be given often.")
]
Sphere = Annotated[list[str] | None, typer.Option("--sphere", help="An obstacle X,Y,Z,RADIUS in mm; may be given often.")]
Capsule = Annotated[
    list[str] | None,
    typer.Option("--capsule", help="An obstacle X,Y,Z,X,Y,Z,...,RADIUS in mm around a line, as a rib; may be given often."),
]
Mesh = Annotated[list[Path] | None, typer.Option("--mesh", help="An obstacle as a mesh file; may be given often.")]
Mask = Annotated[list[Path] | None, typer.Option("--mask", help="An obstacle as a label volume; may be given often.")]
Ct = Annotated[
    Path | None, typer.Option("--ct", help="DICOM folder, .nii, .nii.gz or .mha file: pictures, skin, and obstacles by HU.")
]
Series = Annotated[str | None, typer.Option("--series", help="Series of the folder, as `tubeplan inspect` lists them.")]
HuMin = Annotated[float | None, typer.Option("--hu-min", help="The CT's voxels from here on are an obstacle: bone from 180.")]
HuMax = Annotated[float | None, typer.Option("--hu-max", help="... up to here.")]
SeedPoint = Annotated[
    str | None, typer.Option("--seed-point", help="X,Y,Z in mm: only voxels connected to it are the obstacle, a vessel.")
]
Skin = Annotated[bool, typer.Option("--skin", help="The entry lies on the skin of the CT, along the direction.")]
Direction = Annotated[str | None, typer.Option("--direction", help="X,Y,Z in which the needle goes in [0,0,1].")]
Pieces = Annotated[int | None, typer.Option("--pieces", help="Turns and pushes of the path [5].")]
Duty = Annotated[bool, typer.Option("--duty-cycle", help="Allow any curvature up to kappa by spinning a part of the time.")]
EntryRadius = Annotated[float | None, typer.Option("--entry-radius", help="Choose the entry within so many mm [0].")]
Cone = Annotated[float | None, typer.Option("--cone", help="Choose the direction within so many degrees [0].")]
Method = Annotated[
    str | None,
    typer.Option("--method", help="swarm (polished onto the target), printed (Huo et al. 2015) or rrt (a random tree) [swarm]."),
]
Budget = Annotated[float | None, typer.Option("--time-budget", help="Search for so many s and keep the best.")]
Restarts = Annotated[int | None, typer.Option("--restarts", help="Swarms at most, until one gives a path [8].")]
Rounds = Annotated[int | None, typer.Option("--rounds", help="Rounds of a swarm at most [1000].")]
Events = Annotated[
    Path | None,
    typer.Option("--events", help="TOML file with [[events]]: at_mm, and obstacle with center, target, or kappa; replans."),
]
MonteCarlo = Annotated[int | None, typer.Option("--monte-carlo", help="Simulate so many insertions at random.")]
CurvatureError = Annotated[
    float | None, typer.Option("--curvature-error", help="Their true curvature's standard deviation, a share of kappa [0.05].")
]
TipNoise = Annotated[float | None, typer.Option("--tip-noise", help="Standard deviation of the measured tip, mm [0.5].")]
Motion = Annotated[float | None, typer.Option("--target-motion", help="How far the target moves, mm [3].")]


@output_options
def needle2d(
    *,
    target: Target,
    entry: Entry = None,
    radius: Radius = None,
    kappa: Kappa = None,
    safety: Safety = None,
    circle: Circle = None,
    polygon: Polygon = None,
    degree_max: Degree = None,
    angle_max: Angle = None,
    case_id: CaseId = None,
    rng_seed: Seed = None,
    outputs: Outputs,
) -> None:
    """Plan a needle in the plane: lines and arcs, every form at its optimum.

    Example: tubeplan plan needle2d --target 0,90 --circle 0,40,10 --circle=-40,30,15 --polygon 20,60,40,60,40,80 -o run
    """
    own = {"target": target, "entry": entry, "radius_mm": radius, "kappa": kappa, "safety_mm": safety, "degree_max": degree_max}
    bodies = [(f"--circle {text}", ball("circle", text, 3)) for text in circle or []]
    bodies += [(f"--polygon {text}", {"kind": "polygon", "points": places("polygon", text, 2, 6)}) for text in polygon or []]
    run("needle2d", own | {"angle_max_deg": angle_max}, bodies, {"rng_seed": rng_seed}, {"case_id": case_id}, outputs)


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
    capsule: Capsule = None,
    mesh: Mesh = None,
    mask: Mask = None,
    ct: Ct = None,
    series: Series = None,
    hu_min: HuMin = None,
    hu_max: HuMax = None,
    seed_point: SeedPoint = None,
    skin: Skin = False,
    pieces: Pieces = None,
    duty_cycle: Duty = False,
    entry_radius: EntryRadius = None,
    cone: Cone = None,
    method: Method = None,
    restarts: Restarts = None,
    rounds: Rounds = None,
    time_budget: Budget = None,
    events: Events = None,
    monte_carlo: MonteCarlo = None,
    curvature_error: CurvatureError = None,
    tip_noise: TipNoise = None,
    target_motion: Motion = None,
    case_id: CaseId = None,
    rng_seed: Seed = None,
    outputs: Outputs,
) -> None:
    """Plan a flexible needle in space past obstacles, onto the target.

    Example: tubeplan plan needle3d --target 0,0,100 --sphere 0,5,40,5 --safety 1 --monte-carlo 200 -o run

    Example: tubeplan plan needle3d --ct chest/ --hu-min 180 --target=-107.5,10.9,-139 --entry=-188,10.9,-139
    --direction 1,0,0 --skin --entry-radius 12 --cone 20 --kappa 0.01 --safety 1.5 -o run
    """
    own: dict[str, Any] = {"target": target, "entry": entry, "direction": direction, "kappa": kappa, "radius_mm": radius}
    own |= {"safety_mm": safety, "pieces": pieces, "duty_cycle": duty_cycle or None, "skin": skin or None}
    own |= {"entry_radius_mm": entry_radius, "cone_deg": cone, "restarts": restarts, "rounds": rounds}
    if hu_min is None and (hu_max is not None or seed_point is not None):
        option = "--seed-point" if hu_max is None else "--hu-max"
        raise CaseError(f"{option} is for an obstacle of the CT's voxels, which begins at --hu-min; give --hu-min too")
    bodies = [(f"--sphere {text}", ball("sphere", text, 4)) for text in sphere or []]
    bodies += [(f"--capsule {text}", rod(text)) for text in capsule or []]
    bodies += [(f"--mesh {path.name}", {"kind": "mesh", "file": str(path)}) for path in mesh or []]
    bodies += [(f"--mask {path.name}", {"kind": "mask", "file": str(path)}) for path in mask or []]
    image = {"ct": ct, "series": series, "hu_min": hu_min, "hu_max": hu_max, "seed_point": seed_point, "case_id": case_id}
    planner = {"rng_seed": rng_seed, "method": method, "time_budget": time_budget}
    chances = {"runs": monte_carlo, "curvature_error": curvature_error, "tip_noise_mm": tip_noise}
    chances |= {"target_motion_mm": target_motion}
    idle = [key for key, value in chances.items() if value is not None] if monte_carlo is None else []
    if idle:
        option = f"--{idle[0].removesuffix('_mm').replace('_', '-')}"
        raise CaseError(f"{option} is for simulated insertions, of which none was asked for; give --monte-carlo too")
    more = {"events": read_events(events)} if events is not None else {}
    run("needle3d", own, bodies, planner, image, outputs, monte_carlo=chances, **more)


def run(
    name: str,
    own: dict[str, Any],
    bodies: list[tuple[str, dict[str, Any]]],
    planner: dict[str, Any],
    given: dict[str, Any],
    outputs: Outputs,
    *,
    monte_carlo: dict[str, Any] | None = None,
    events: list[Any] | None = None,
) -> None:
    """Make the case of the options, plan it, print the outcome and exit; `bodies` are obstacles, each with its option."""
    tables = {"planner": {"name": name, **planner}, name: own, "input": given, "monte_carlo": monte_carlo or {}}
    made: dict[str, Any] = {
        key: {option: value for option, value in table.items() if value is not None} for key, table in tables.items()
    }
    made = {key: table for key, table in made.items() if table} | {"obstacles": [body for _, body in bodies]}
    try:
        case = make_case(made if events is None else made | {"events": events}, name="options")
    except CaseError as fault:
        place = re.fullmatch(r"options \[\[obstacles\]\] (\d+):? ?(.*)", str(fault), re.DOTALL)
        if place is None or int(place[1]) > len(bodies):  # one that the CT's own options ask for comes last
            raise
        raise CaseError(f"{bodies[int(place[1]) - 1][0]}: {place[2]}") from None
    plan_and_exit(case, outputs)


def numbers(option: str, text: str, expected: str) -> list[float]:
    """Numbers from text, comma-separated."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise CaseError(f"--{option}: found {text!r}, expected {expected}") from None


def ball(kind: str, text: str, count: int) -> dict[str, Any]:
    """A round obstacle from text: its centre and radius, comma-separated."""
    expected = f"{count} numbers in mm: the centre and the radius"
    values = numbers(kind, text, expected)
    if len(values) != count:
        raise CaseError(f"--{kind}: found {text!r}, expected {expected}")
    return {"kind": kind, "center": values[:-1], "radius_mm": values[-1]}


def places(option: str, text: str, size: int, least: int) -> list[list[float]]:
    """Places from text, `size` numbers each, at least `least` numbers."""
    expected = f"{least} numbers in mm or more, {size} for each corner"
    values = numbers(option, text, expected)
    if len(values) < least or len(values) % size:
        raise CaseError(f"--{option}: found {text!r}, expected {expected}")
    return [values[k : k + size] for k in range(0, len(values), size)]


def rod(text: str) -> dict[str, Any]:
    """A capsule from text: the points of its line, then its radius."""
    expected = "X,Y,Z of two points or more and the radius, in mm"
    values = numbers("capsule", text, expected)
    if len(values) < 7 or len(values) % 3 != 1:
        raise CaseError(f"--capsule: found {text!r}, expected {expected}")
    points = [values[k : k + 3] for k in range(0, len(values) - 1, 3)]
    return {"kind": "capsule", "points": points, "radius_mm": values[-1]}
