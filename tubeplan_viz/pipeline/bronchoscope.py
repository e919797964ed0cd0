"""The way through for the bronchoscope robot: case -> airway -> plan -> outputs, into the same run folder as every planner."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from reports import render_bronchoscope, write_page
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from segmentation.mesh_files import write_ply
from tubeplan_viz.bronchoscope.airway import AirwayTree, Entrance, airway_tree
from tubeplan_viz.bronchoscope.mover import Step
from tubeplan_viz.bronchoscope.robot_plan import Node, RobotPlan
from tubeplan_viz.bronchoscope.target import Target, branch_target, lesion_target, point_target
from tubeplan_viz.bronchoscope.track import tip_track, track_curve
from tubeplan_viz.bronchoscope.way import Way, make_simulator, plan_way
from tubeplan_viz.cases.bronchoscope import BronchoscopeCase, bronchoscope_case_table, bronchoscope_case_text
from tubeplan_viz.pipeline.lumen import Lumen, load_lumen
from tubeplan_viz.pipeline.options import RunOptions
from tubeplan_viz.pipeline.progress import Stopwatch
from tubeplan_viz.pipeline.tree import Tree, endpoint_details, grow_tree
from tubeplan_viz.pipeline.tube import surface_details
from tubeplan_viz.pipeline.walk import stage_stills
from tubeplan_viz.plan import FlagKind, Limits, NoPathError, Plan, PlanStatus
from tubeplan_viz.profile import certify, flag_stretches, measure_closely, measure_path, path_metrics, with_peaks
from tubeplan_viz.recording.bronchoscope import BronchoscopeRecording
from tubeplan_viz.result import Provenance, RunFolder, build_result, path_csv, slicer_markups

ACTUATION_COLUMNS = (
    "step",
    "stage",
    "phi_proximal_deg",
    "theta_proximal_deg",
    "phi_distal_deg",
    "theta_distal_deg",
    "push_mm",
    "tip_x_mm",
    "tip_y_mm",
    "tip_z_mm",
    "view_x",
    "view_y",
    "view_z",
    "disc_clearance_mm",
    "body_clearance_mm",
    "contacts",
    "largest_force_n",
)
STATE_COLUMNS = ("step", "x_mm", "y_mm", "z_mm")


@dataclass(frozen=True, eq=False, kw_only=True)
class Airway:
    """What a case gives: wall, tree, entrance."""

    lumen: Lumen
    tree: Tree
    airway: AirwayTree
    entrance: Entrance


def run_bronchoscope(case: BronchoscopeCase, target: Path, options: RunOptions) -> dict[str, Any]:
    """Plan one case of the bronchoscope robot and write its run folder; parameters as `tubeplan_viz.planners.run_case`.

    Returns
    -------
    dict
        The content of result.json; status "infeasible" with the best path found where the target was not reached.

    Raises
    ------
    TubeplanError
        If the input is bad or the target cannot be entered; then no folder is left.
    """
    watch = Stopwatch(options.notify)
    with RunFolder(target, force=options.force) as folder:
        given = load_airway(case, watch)
        goal = resolve_target(case, given.airway, given.lumen.warnings)
        simulator = make_simulator(given.airway, given.entrance, case.robot) if case.method == "dynamic" else None
        warnings = list(given.lumen.warnings)
        if given.entrance.offset > 0.0:
            warnings.append(f"the robot starts {given.entrance.offset:.0f} mm down the trachea, where it fits straight")
        if goal.note is not None:
            warnings.append(goal.note)
        stream = None
        if options.recording:
            stream = BronchoscopeRecording.open(
                folder.path("recording.rrd"),
                case_id=case_name(case),
                method=case.method,
                frame=given.tree.surface.frame,
                connect=options.connect,
                light=options.light,
            )
            warnings.extend(stream.warnings)
        with stream or nullcontext():
            if stream is not None:
                stream.log_airway(given.tree.surface, [(b.name, b.line.points) for b in given.airway.branches], case.robot.radius)
            with watch.stage("plan") as progress:
                way = plan_way(
                    given.airway,
                    given.entrance,
                    goal,
                    case.robot,
                    replace(case.settings, time_budget=case.time_budget),
                    rng=np.random.default_rng(case.rng_seed),
                    simulator=simulator,
                    watch=follow(stream, progress, folder),
                )
            with watch.stage("measure"):
                plan = path_plan(case, given, goal, way)
            written = write_ply(given.tree.surface, folder.path("mesh.ply"))
            provenance = Provenance(inputs=given.lumen.inputs, rng_seed=case.rng_seed, settings=bronchoscope_case_table(case))
            details = case_details(case, given, written, warnings)

            def document() -> dict[str, Any]:
                return build_result(plan, frame=written.frame, timings_s=watch.seconds, provenance=provenance, details=details)

            if stream is not None:
                with watch.stage("recording"):
                    stream.finish(document(), way.plan.steps)
                    stream.close()
        result = document()
        folder.write_text("case.toml", bronchoscope_case_text(case, target))
        folder.write_text("path.csv", path_csv(plan.profile))
        folder.write_text("actuation.csv", actuation_table(way.plan))
        folder.write_text("states.csv", states_table(way.plan))
        folder.write_json("path.mrk.json", slicer_markups(result))
        if options.report:
            with watch.stage("report"):
                stills = stage_stills(
                    given.tree.surface, plan.profile, way.plan.steps, [stage["goal_mm"] for stage in result["details"]["stages"]]
                )
                write_page(render_bronchoscope(case_name(case), result, written, stills), folder.path("report.html"))
        return folder.finish(result)


def case_name(case: BronchoscopeCase) -> str:
    """The case's own id."""
    return case.input.case_id or "case"


def load_airway(case: BronchoscopeCase, watch: Stopwatch) -> Airway:
    """Wall, named tree and entrance of a case."""
    lumen = load_lumen(case.input, watch=watch)
    with watch.stage("centerline"):
        tree = grow_tree(lumen.surface)
        airway = airway_tree(tree.graph, tree.wall, tree.endpoints, root=case.start, frame=tree.surface.frame)
        entrance = airway.entrance_for(case.robot)
    return Airway(lumen=lumen, tree=tree, airway=airway, entrance=entrance)


def resolve_target(case: BronchoscopeCase, airway: AirwayTree, warnings: Sequence[str] = ()) -> Target:
    """The place that a case asks for.

    Raises
    ------
    CaseError
        If it asks for none or for two, or for a place that is none of the airway's; with what was told of the lumen while it
        was read (`warnings`), since a part that was left out may be the one that is meant.
    """
    if (case.goal is None) == (case.lesion is None):
        names = ", ".join(branch.name for branch in airway.branches[1:9])
        raise CaseError(
            "give either a goal (--goal: a branch's name, an end point's label, or X,Y,Z in mm) or a lesion beside the airway "
            f"(--lesion X,Y,Z), exactly one of them; branches are {names}"
        )
    if case.lesion is not None:
        return lesion_target(airway, np.array(case.lesion), case.robot)
    if isinstance(case.goal, str):
        return branch_target(airway, case.goal, case.robot)
    try:
        return point_target(airway, np.array(case.goal), case.robot)
    except CaseError as fault:
        if not warnings:
            raise
        raise CaseError(f"{fault} (of the airway: {'; '.join(warnings)})") from None


def follow(
    stream: BronchoscopeRecording | None, progress: Callable[[int, int], None], folder: RunFolder
) -> Callable[[Node, int], None]:
    """What is done with each new pose of the tree."""

    def watch(node: Node, number: int) -> None:
        progress(number, 0)
        if stream is not None:
            stream.log_node(node, number)
        folder.check_interrupted()

    return watch


def path_plan(case: BronchoscopeCase, given: Airway, goal: Target, way: Way) -> Plan:
    """The tip's track measured and proved, and how the plan ended."""
    wall, limits = given.tree.wall, Limits(curvature_max=case.curvature_max, clearance_min=case.clearance_min)
    plan = way.plan
    if len(tip_track(plan.steps)) < 4:
        raise NoPathError(f"{plan.reason}; check the airway at its entrance")
    curve, off = track_curve(plan.steps)
    fine = measure_closely(curve, wall, limits)
    flagged = with_peaks(flag_stretches(fine, limits), curve, wall)
    certificate = certify(curve, wall, limits)
    profile = measure_path(curve, wall)
    metrics = path_metrics(profile, way.centerline)
    sharpest = [flag.worst for flag in flagged if flag.kind is FlagKind.CURVATURE]
    tightest = [flag.worst for flag in flagged if flag.kind is FlagKind.CLEARANCE]
    metrics["curvature_max_per_mm"] = float(max(fine.curvature.max(), profile.curvature.max(), *sharpest, 0.0))
    metrics["clearance_min_mm"] = float(min(fine.clearance.min(), profile.clearance.min(), *tightest))
    metrics["tip_error_mm"] = plan.tip_error
    metrics["disc_clearance_end_mm"] = plan.steps[-1].disc_clearance
    metrics["body_clearance_min_mm"] = min(step.body_clearance for step in plan.steps)
    reason = plan.reason
    status = PlanStatus.INFEASIBLE if reason is not None else PlanStatus.OK
    if reason is None and flagged:
        worst = flagged[0]
        unit, limit = ("1/mm", limits.curvature_max) if worst.kind is FlagKind.CURVATURE else ("mm", limits.clearance_min)
        status = PlanStatus.FLAGGED
        reason = (
            f"the target is reached, but the {worst.kind} of the tip's track is {worst.worst:.3f} {unit} "
            f"at {worst.worst_at:.1f} mm where {limit:g} {unit} are asked for"
        )
    elif reason is None and not certificate.holds:
        status, reason = PlanStatus.FLAGGED, "every sample keeps both limits, but the bounds between the samples were not proved"
    return Plan(
        planner="bronchoscope",
        method=case.method,
        status=status,
        reason=reason,
        limits=limits,
        curve=curve,
        profile=profile,
        features=(),
        centerline=way.centerline,
        steps=(),
        flagged=flagged,
        certificate=certificate,
        metrics=metrics,
        details=plan_details(case, given, goal, way, off),
    )


def plan_details(case: BronchoscopeCase, given: Airway, goal: Target, way: Way, off: float) -> dict[str, Any]:
    """Route, stages, steps and tree for result.json."""
    plan, branches = way.plan, given.airway.branches
    return {
        "robot": {
            "name": case.robot.name,
            "diameter_mm": case.robot.diameter,
            "proximal_length_mm": case.robot.proximal_length,
            "distal_length_mm": case.robot.distal_length,
            "bend_max_deg": float(np.degrees(case.robot.bend_max)),
            "curvature_max_per_mm": case.robot.curvature_max,
        },
        "reached": plan.reached,
        "target": {
            "branch": branches[goal.branch].name,
            "depth_mm": goal.depth,
            "point_mm": goal.point,
            "lesion_mm": goal.lesion,
            "lesion_distance_mm": None if goal.lesion is None else float(np.linalg.norm(goal.lesion - goal.point)),
        },
        "entrance": given.entrance.pose,
        "route": [
            {
                "name": branches[k].name,
                "confidence": branches[k].confidence,
                "generation": branches[k].generation,
                "diameter_mm": 2.0 * branches[k].median_radius,
                "length_mm": branches[k].length,
                "turn_deg": float(np.degrees(branches[k].angle)),
            }
            for k in way.route
        ],
        "stages": [
            {
                "name": stage.name,
                "goal_mm": stage.goal,
                "sphere_radius_mm": stage.radius,
                "samples": tally.samples,
                "pushes": tally.pushes,
                "collided": tally.refused,
                "foreseen": tally.foreseen,
                "seconds": round(tally.seconds, 4),
            }
            for stage, tally in zip(plan.stages, plan.tallies, strict=True)
        ],
        "steps": [step_details(k, step, plan) for k, step in enumerate(plan.steps)],
        "contacts": contact_details(plan),
        "tree": {
            "poses": len(plan.nodes),
            "collided": sum(not node.accepted for node in plan.nodes),
            "samples": len(plan.samples),
        },
        "foreplan": None
        if way.foreplan is None
        else {"reached": way.foreplan.reached, "tip_error_mm": way.foreplan.tip_error, "poses": len(way.foreplan.nodes)},
        "track_fit_mm": off,
        "assumption": ASSUMPTIONS[case.method],
    }


ASSUMPTIONS = {
    "kinematic": "The passive section lies on the track of the proximal section's base; the wall forces that hold it there "
    "are not computed, and no part of the robot may meet the wall.",
    "dynamic": "Links, motors, gravity and contact with the wall are simulated; the body leans on the wall, only the front disc "
    "may not meet it.",
}


def contact_details(plan: RobotPlan) -> dict[str, Any]:
    """How the robot touches the wall while it rests after its steps, and where it presses most."""
    forces = [float(step.forces.max(initial=0.0)) for step in plan.steps]
    worst = int(np.argmax(forces))
    touching = forces[worst] > 0.0
    return {
        "most": max(len(step.contacts) for step in plan.steps),
        "largest_force_n": forces[worst],
        "largest_force_step": worst if touching else None,
        "largest_force_mm": plan.steps[worst].contacts[int(np.argmax(plan.steps[worst].forces))] if touching else None,
        "at_end": len(plan.steps[-1].contacts),
        "disc_brushes": sum(step.disc_clearance < 0.0 for step in plan.steps),
    }


def step_details(number: int, step: Step, plan: RobotPlan) -> dict[str, Any]:
    """One step for result.json."""
    command = step.command
    angles = (
        None
        if command is None
        else {
            "phi_proximal_deg": float(np.degrees(command.phi_proximal)),
            "theta_proximal_deg": float(np.degrees(command.theta_proximal)),
            "phi_distal_deg": float(np.degrees(command.phi_distal)),
            "theta_distal_deg": float(np.degrees(command.theta_distal)),
            "push_mm": command.push,
        }
    )
    return {
        "stage": plan.stages[plan.step_stages[number]].name,
        "command": angles,
        "base": step.base,
        "tip_mm": step.tip[:3, 3],
        "view": step.tip[:3, 2],
        "disc_clearance_mm": step.disc_clearance,
        "body_clearance_mm": step.body_clearance,
        "contacts_mm": step.contacts,
        "forces_n": step.forces,
    }


def case_details(case: BronchoscopeCase, given: Airway, surface: Surface, warnings: list[str]) -> dict[str, Any]:
    """What result.json says of the case beside the plan."""
    details = dict(given.lumen.details)
    deviation = details.pop("deviation_mm", None)
    return {
        **details,
        "case_id": case_name(case),
        "surface": surface_details(surface) | {"deviation_mm": deviation},
        "endpoints": [endpoint_details(tip) for tip in given.tree.endpoints],
        "branches": branch_rows(given.airway),
        "image": dict(given.lumen.facts),
        "closed_ends": False,
        "warnings": warnings,
    }


def branch_rows(airway: AirwayTree) -> list[dict[str, Any]]:
    """The named tree for result.json and reach.json."""
    return [
        {
            "name": branch.name,
            "confidence": branch.confidence,
            "label": branch.label,
            "parent": branch.parent,
            "generation": branch.generation,
            "length_mm": branch.length,
            "diameter_mm": 2.0 * branch.median_radius,
            "least_diameter_mm": 2.0 * branch.least_radius,
            "turn_deg": float(np.degrees(branch.angle)),
        }
        for branch in airway.branches
    ]


def actuation_table(plan: RobotPlan) -> str:
    """actuation.csv: what the robot's drive does step by step, and what came of it."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(ACTUATION_COLUMNS)
    for number, step in enumerate(plan.steps):
        row: Mapping[str, Any] = step_details(number, step, plan)
        angles = row["command"] or dict.fromkeys(ACTUATION_COLUMNS[2:7], 0.0)
        numbers = [angles[key] for key in ACTUATION_COLUMNS[2:7]]
        numbers += [*step.tip[:3, 3], *step.tip[:3, 2], step.disc_clearance, step.body_clearance]
        force = float(step.forces.max()) if len(step.forces) else 0.0
        writer.writerow([number, row["stage"], *(repr(float(v)) for v in numbers), len(step.contacts), repr(force)])
    return text.getvalue()


def states_table(plan: RobotPlan) -> str:
    """states.csv: the robot's axis after every step, from the entrance to the tip."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(STATE_COLUMNS)
    for number, step in enumerate(plan.steps):
        for place in step.body:
            writer.writerow([number, *(repr(round(float(v), 6)) for v in place)])
    return text.getvalue()
