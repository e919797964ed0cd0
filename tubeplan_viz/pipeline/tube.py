"""One case from its input to its run folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from reports import render_report, write_page
from segmentation.mesh import Surface
from segmentation.mesh_files import write_ply
from tubeplan_viz.cases.tube import Case, case_table, case_text
from tubeplan_viz.endoluminal import Film
from tubeplan_viz.measures import path_parts
from tubeplan_viz.pipeline.ends import pose_case
from tubeplan_viz.pipeline.lumen import Lumen, load_lumen
from tubeplan_viz.pipeline.measures import measure_run
from tubeplan_viz.pipeline.options import RunOptions
from tubeplan_viz.pipeline.parts import end_names
from tubeplan_viz.pipeline.progress import Stopwatch
from tubeplan_viz.pipeline.tree import Tree, branches_on_way, end_label, endpoint_details
from tubeplan_viz.pipeline.walk import film_of, walk_details
from tubeplan_viz.plan import Plan, PlanStep
from tubeplan_viz.profile import sharpest_place
from tubeplan_viz.recording import Recording
from tubeplan_viz.result import Provenance, Review, RunFolder, build_result, path_csv, slicer_markups
from tubeplan_viz.tolerance import ToleranceSettings, path_tolerance, preset_tolerances
from tubeplan_viz.tube import TubeProblem, conclude, tube_steps


def run_tube(case: Case, target: Path, options: RunOptions) -> dict[str, Any]:
    """Plan one case of a tube and write its run folder.

    Parameters
    ----------
    case : Case
    target : Path
        The run folder; refused if it exists, unless `options.force` is set.
    options : RunOptions

    Returns
    -------
    dict
        The content of result.json.

    Raises
    ------
    TubeplanError
        If the input is bad or no path can be begun; then no folder is left.
    """
    watch = Stopwatch(options.notify)
    with RunFolder(target, force=options.force) as folder:
        lumen = load_lumen(case.input, near=case.planner.start, watch=watch)
        with watch.stage("centerline"):
            problem, tree = pose_case(case, lumen)
        warnings = list(lumen.warnings)
        stream = None
        if options.recording:
            stream = Recording.open(
                folder.path("recording.rrd"),
                case_id=case_name(case),
                limits=case.limits,
                planner=case.planner.name,
                method=case.planner.method,
                frame=problem.surface.frame,
                connect=options.connect,
                light=options.light,
            )
            warnings.extend(stream.warnings)
        with stream or nullcontext():
            if stream is not None:
                with watch.stage("recording"):
                    record_anatomy(stream, lumen, problem, light=options.light)
            with watch.stage("plan") as progress:
                rounds = tube_steps(problem, time_budget=case.planner.time_budget)
                steps = follow(rounds, stream, case, progress)
            with watch.stage("verify and prove"):
                plan = conclude(problem, steps)
            # mesh.ply holds wall faces first and then the caps; result.json counts on that order.
            written = write_ply(problem.surface, folder.path("mesh.ply"))
            details = case_details(case, lumen, problem, tree, written, warnings)
            with watch.stage("walk"):
                grown, at_goal = branches_on_way(tree, problem.start, problem.goal)
                walk = walk_details(plan.profile, grown.branches, at_goal, problem.surface.frame)
            with watch.stage("measures"):
                measured = measure_run(
                    case.measures,
                    anatomy=case.input.anatomy,
                    tree=tree,
                    volume=lumen.volume,
                    path={
                        "s_mm": plan.profile.arc_length,
                        "points_mm": plan.profile.points,
                        "curvature_per_mm": plan.profile.curvature,
                    },
                    curvature_max=plan.metrics["curvature_max_per_mm"],
                    sharpest_at=sharpest_place(plan.curve),
                )
            details["measures"] = measured.details
            names = end_names(measured.parts, tree)
            details["endpoints"] = [endpoint_details(tip, names.get(tip.label)) for tip in tree.endpoints]
            details["parts"] = path_parts(measured.parts, problem.centerline.points, plan.profile.arc_length, plan.profile.points)
            inputs = (*lumen.inputs, *measured.inputs)
            provenance = Provenance(inputs=inputs, rng_seed=case.planner.rng_seed, settings=case_table(case))
            details["walk"] = walk
            film = None
            if (options.recording or options.report) and not options.light:
                with watch.stage("views from the tip") as progress:
                    film = film_of(problem.surface, plan, progress)
            if case.planner.tolerance is not None:
                with watch.stage("tolerance"):
                    details["tolerance"] = tolerance_details(case, problem, plan)

            def document() -> dict[str, Any]:
                return build_result(plan, frame=written.frame, timings_s=watch.seconds, provenance=provenance, details=details)

            if stream is not None:
                with watch.stage("recording"):
                    if film is not None:
                        stream.log_film(film)
                    stream.finish(document())
                    stream.close()
        result = document()
        folder.write_text("case.toml", case_text(case, target))
        folder.write_text("path.csv", path_csv(plan.profile))
        folder.write_json("path.mrk.json", slicer_markups(result))
        if options.report:
            with watch.stage("report"):
                write_page(render_report(review_of(case, lumen, written, plan, result, film)), folder.path("report.html"))
        return folder.finish(result)


def follow(
    steps: Iterator[PlanStep],
    stream: Recording | None,
    case: Case,
    progress: Callable[[int, int], None],
) -> list[PlanStep]:
    """Run the iteration, feeding each step to the recording as it happens."""
    done: list[PlanStep] = []
    for step in steps:
        done.append(step)
        progress(step.index, case.refine.max_rounds)
        if stream is not None:
            stream.log_step(step)
    return done


def record_anatomy(stream: Recording, lumen: Lumen, problem: TubeProblem, *, light: bool) -> None:
    """What stays the same over the iterations."""
    if lumen.volume is not None and not light:
        stream.log_volume(lumen.volume, lumen.region)
    stream.log_surface(problem.surface)
    stream.log_centerline(problem.centerline)
    if lumen.region is not None and lumen.region.curve is not None:
        stream.log_growth(lumen.region.curve)
    for warning in lumen.warnings:
        stream.log_decision(warning, level="WARN")


def case_name(case: Case) -> str:
    """The case's own id; never taken from the data, which may hold a name."""
    return case.input.case_id or "case"


def tolerance_details(case: Case, problem: TubeProblem, plan: Plan) -> dict[str, Any]:
    """How the path bears the error of pose that the case names, or each of the presets."""
    least, seed = case.limits.clearance_min, case.planner.rng_seed
    asked = case.planner.tolerance
    if not isinstance(asked, tuple):
        return {"presets": [found.details() for found in preset_tolerances(plan.profile, problem.wall, least, seed=seed)]}
    settings = ToleranceSettings(translation=asked[0], rotation=asked[1])
    return path_tolerance(plan.profile, problem.wall, least, settings, rng=np.random.default_rng(seed)).details()


def case_details(
    case: Case, lumen: Lumen, problem: TubeProblem, tree: Tree, surface: Surface, warnings: list[str]
) -> dict[str, Any]:
    """The planner-independent part of result.json's details."""
    details = dict(lumen.details)
    deviation = details.pop("deviation_mm", None)
    return {
        **details,
        "case_id": case_name(case),
        "surface": surface_details(surface) | {"deviation_mm": deviation},
        "start_label": end_label(tree, problem.start),
        "goal_label": end_label(tree, problem.goal),
        "image": dict(lumen.facts),
        "warnings": warnings,
    }


def surface_details(surface: Surface) -> dict[str, Any]:
    """Faces and caps as they stand in mesh.ply: wall first, then each cap."""
    first = len(surface.wall_faces)
    caps = []
    for index, cap in enumerate(surface.caps):
        count = int(np.count_nonzero(surface.face_cap == index))
        caps.append(
            {
                "label": cap.label,
                "origin": cap.origin,
                "center_mm": cap.center,
                "normal": cap.normal,
                "area_mm2": cap.area,
                "first_face": first,
                "faces": count,
            }
        )
        first += count
    return {"faces": len(surface.faces), "wall_faces": len(surface.wall_faces), "volume_ml": surface.volume_ml, "caps": caps}


def review_of(case: Case, lumen: Lumen, surface: Surface, plan: Plan, result: Mapping[str, Any], film: Film | None) -> Review:
    """The run as the report sees it."""
    return Review(
        case_id=case_name(case),
        result=result,
        surface=surface,
        volume=lumen.volume,
        region=lumen.region,
        facts=lumen.facts,
        first=profile_lists(plan.steps[0]),
        last=profile_lists(plan.steps[-1]),
        film=film,
    )


def profile_lists(step: PlanStep) -> dict[str, Any]:
    """A profile under the names of result.json."""
    profile = step.profile
    return {
        "s_mm": profile.arc_length.tolist(),
        "points_mm": profile.points.tolist(),
        "curvature_per_mm": profile.curvature.tolist(),
        "clearance_mm": profile.clearance.tolist(),
    }
