"""The way through for the bronchoscope robot: case -> airway -> plan -> outputs, into the same run folder as every planner."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from reports import render_bronchoscope, write_page
from segmentation.mesh_files import write_ply
from tubeplan_viz.bronchoscope.robot_plan import Node
from tubeplan_viz.bronchoscope.target import Target
from tubeplan_viz.bronchoscope.track import tip_track, track_curve
from tubeplan_viz.bronchoscope.way import Way, make_simulator, plan_way
from tubeplan_viz.cases.bronchoscope import BronchoscopeCase, bronchoscope_case_table, bronchoscope_case_text
from tubeplan_viz.pipeline.airway import Airway, case_name, load_airway, resolve_target
from tubeplan_viz.pipeline.bronchoscope_details import case_details, plan_details
from tubeplan_viz.pipeline.bronchoscope_tables import actuation_table, states_table
from tubeplan_viz.pipeline.options import RunOptions
from tubeplan_viz.pipeline.progress import Stopwatch
from tubeplan_viz.pipeline.walk import stage_stills
from tubeplan_viz.plan import FlagKind, Limits, NoPathError, Plan, PlanStatus
from tubeplan_viz.profile import certify, flag_stretches, measure_closely, measure_path, path_metrics, with_peaks
from tubeplan_viz.recording.bronchoscope import BronchoscopeRecording
from tubeplan_viz.result import Provenance, RunFolder, build_result, path_csv, slicer_markups


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
                    watch=follow(stream, progress),
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


def follow(stream: BronchoscopeRecording | None, progress: Callable[[int, int], None]) -> Callable[[Node, int], None]:
    """What is done with each new pose of the tree."""

    def watch(node: Node, number: int) -> None:
        progress(number, 0)
        if stream is not None:
            stream.log_node(node, number)

    return watch


def path_plan(case: BronchoscopeCase, given: Airway, goal: Target, way: Way) -> Plan:
    """The tip's track measured and proved, and how the plan ended.

    Raises
    ------
    NoPathError
        If the tip's track has fewer than four places, through which no cubic goes.
    """
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
