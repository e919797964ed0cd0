"""tubeplan plan bronchoscope: plan the two-section robot without a case file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tubeplan_viz.cli.options import Outputs, output_options
from tubeplan_viz.cli.show import plan_and_exit
from tubeplan_viz.planners import make_case

Ct = Annotated[Path | None, typer.Option("--ct", help="DICOM folder, .nii, .nii.gz or .mha file.")]
Mesh = Annotated[Path | None, typer.Option("--mesh", help="STL, PLY, OBJ or GLB file of the airway.")]
Start = Annotated[str | None, typer.Option("--start", help="End point where the robot goes in, from `tubeplan endpoints` [E1].")]
Seed = Annotated[str | None, typer.Option("--seed-point", help="X,Y,Z in mm (LPS): where region growing begins.")]
HuMax = Annotated[float | None, typer.Option("--hu-max", help="Upper HU limit [found by leak control].")]
CaseId = Annotated[str | None, typer.Option("--case-id", help="Name of the case in all outputs; no patient's name.")]
RngSeed = Annotated[int | None, typer.Option("--rng-seed", help="Seed of all randomness.")]
Diameter = Annotated[float | None, typer.Option("--diameter", help="Outer diameter of the robot, mm [3.5].")]
Section = Annotated[float | None, typer.Option("--section", help="Length of each active section, mm [13].")]
Bend = Annotated[float | None, typer.Option("--bend-max", help="Largest bend of each active section, degrees [90].")]


@output_options
def bronchoscope(
    *,
    ct: Ct = None,
    mesh: Mesh = None,
    goal: Annotated[
        str | None, typer.Option("--goal", help="A branch's name, a label from `tubeplan endpoints`, or X,Y,Z in mm.")
    ] = None,
    lesion: Annotated[
        str | None, typer.Option("--lesion", help="X,Y,Z in mm of a place beside the airway: as near as the robot comes.")
    ] = None,
    start: Start = None,
    method: Annotated[
        str | None,
        typer.Option("--method", help="kinematic, or dynamic: in the MuJoCo simulator [dynamic with the extra `dynamics`]."),
    ] = None,
    diameter: Diameter = None,
    section: Section = None,
    bend_max: Bend = None,
    seed_point: Seed = None,
    hu_max: HuMax = None,
    time_budget: Annotated[float | None, typer.Option("--time-budget", help="No further sample after this many s.")] = None,
    rng_seed: RngSeed = None,
    case_id: CaseId = None,
    outputs: Outputs,
) -> None:
    """Plan a bronchoscope robot of two bending sections along the airway, command by command.

    Example: tubeplan plan bronchoscope --ct chest/ --goal "right upper lobe" -o run
    """
    table = robot_table(ct=ct, mesh=mesh, case_id=case_id, seed_point=seed_point, hu_max=hu_max)
    own = {"diameter_mm": diameter, "proximal_length_mm": section, "distal_length_mm": section, "bend_max_deg": bend_max}
    planner = {"start": start, "goal": goal, "lesion": lesion, "method": method, "rng_seed": rng_seed, "time_budget": time_budget}
    table["planner"] = {"name": "bronchoscope", **given(planner)}
    table["bronchoscope"] = given(own)
    plan_and_exit(make_case(table, name="options"), outputs)


def robot_table(**inputs: Any) -> dict[str, Any]:
    """The tables of a case with its input."""
    return {"input": given(inputs)}


def given(values: dict[str, Any]) -> dict[str, Any]:
    """The options that were set."""
    return {key: value for key, value in values.items() if value is not None}
