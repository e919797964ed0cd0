"""The way through for needles: case -> obstacles -> plan -> outputs, into the same run folder as every planner."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reports import render_needle, write_page
from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from segmentation.images import read_ct
from segmentation.mesh_files import read_surface
from segmentation.volume import Volume
from segmentation.volume_files import read_volume_file
from tubeplan_viz.cases.needle import NeedleCase, ObstacleCase, needle_case_table, needle_case_text
from tubeplan_viz.needle.events import Event
from tubeplan_viz.needle.insertion import Insertion, insert
from tubeplan_viz.needle.kinematics import Arcs, Controls, Pose, insertion_pose, push
from tubeplan_viz.needle.obstacles import Capsule, MaskObstacle, MeshObstacle, Obstacle, Polygon, Scene, Sphere
from tubeplan_viz.needle.path import NeedlePath, SwarmRound
from tubeplan_viz.needle.planar import PlanarPath, PlanarProblem, best, plan_planar
from tubeplan_viz.needle.spatial import SpatialProblem
from tubeplan_viz.needle.swarm import plan_printed, plan_spatial
from tubeplan_viz.pipeline.options import RunOptions
from tubeplan_viz.pipeline.progress import Stopwatch
from tubeplan_viz.recording.needle import NeedleRecording
from tubeplan_viz.result import CSV_COLUMNS, Provenance, RunFolder, assemble_result, slicer_markups

SPACING = 0.2  # mm; spec 0.4 asks for at most 0.25
FORM_SPACING = 2.0  # of the paths of forms and of the Pareto front, which are drawn only
ROUNDS_KEPT = 150
OUTLINE_POINTS = 1500
CORRIDOR_MM = 60.0  # how far around the straight way a label volume is searched for obstacles


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a needle planner has to say: the path (None without one), the reason, and its part of result.json's details."""

    pose: Pose | None
    controls: Controls | None
    clearances: FloatArray | None
    reason: str | None
    details: Mapping[str, Any]
    metrics: Mapping[str, float]


def run_needle(case: NeedleCase, target: Path, options: RunOptions) -> dict[str, Any]:
    """Plan one needle case and write its run folder; parameters as `tubeplan_viz.planners.run_case`.

    Returns
    -------
    dict
        The content of result.json; status "infeasible" with a reason where there is no path.

    Raises
    ------
    TubeplanError
        If the input is bad; then no folder is left.
    """
    watch = Stopwatch(options.notify)
    with RunFolder(target, force=options.force) as folder:
        with watch.stage("obstacles"):
            scene, inputs, warnings = load_scene(case)
        stream = None
        if options.recording:
            stream = NeedleRecording.open(
                folder.path("recording.rrd"),
                case_id=case_name(case),
                planner=case.name,
                frame=case.frame,
                connect=options.connect,
                light=options.light,
            )
            warnings.extend(stream.warnings)
        try:
            if stream is not None:
                stream.log_scene(space(case.entry), space(case.target), scene.obstacles, case.safety)
            with watch.stage("plan") as progress:
                outcome = planned_flat(case, scene, progress) if case.flat else planned_in_space(case, scene, progress, stream)
            content = content_of(case, scene, outcome, warnings)
            provenance = Provenance(inputs=tuple(inputs), rng_seed=case.rng_seed, settings=needle_case_table(case))
            if stream is not None:
                with watch.stage("recording"):
                    stream.finish(assemble_result(content, timings_s=watch.seconds, provenance=provenance))
                    stream.close()
        except BaseException:
            if stream is not None:
                stream.abort()
            raise
        result = assemble_result(content, timings_s=watch.seconds, provenance=provenance)
        folder.write_text("case.toml", needle_case_text(case, target))
        if result["path"] is not None:
            folder.write_text("path.csv", path_table(result, outcome))
            folder.write_json("path.mrk.json", slicer_markups(result))
        if options.report:
            with watch.stage("report"):
                result = assemble_result(content, timings_s=watch.seconds, provenance=provenance)
                write_page(render_needle(case_name(case), result), folder.path("report.html"))
        return folder.finish(result)


def case_name(case: NeedleCase) -> str:
    """The case's own id."""
    return case.case_id or "case"


def space(place: tuple[float, ...]) -> FloatArray:
    """A place in space: (y, z) of the plane is (0, y, z)."""
    return np.array(place if len(place) == 3 else (0.0, *place), dtype=float)


def load_scene(case: NeedleCase) -> tuple[Scene, list[tuple[str, str]], list[str]]:
    """The obstacles of a case, the files they came from with their digests, and warnings."""
    bodies: list[Obstacle] = []
    inputs: list[tuple[str, str]] = []
    warnings: list[str] = []
    for body in case.obstacles:
        bodies.append(made_obstacle(body, case, inputs, warnings))
    return Scene(tuple(bodies)), inputs, warnings


def made_obstacle(body: ObstacleCase, case: NeedleCase, inputs: list[tuple[str, str]], warnings: list[str]) -> Obstacle:
    """One obstacle as planners use it."""
    if body.kind in ("circle", "sphere"):
        assert body.center is not None
        assert body.radius_mm is not None
        return Sphere(space(body.center), body.radius_mm, body.kind)
    if body.kind == "capsule":
        assert body.points is not None
        assert body.radius_mm is not None
        return Capsule(np.array(body.points), body.radius_mm)
    if body.kind == "polygon":
        assert body.points is not None
        return Polygon(np.array(body.points))
    assert body.file is not None
    if body.kind == "mesh":
        given = read_surface(body.file)
        inputs.extend(given.inputs)
        warnings.extend(given.warnings)
        return MeshObstacle(given.surface)
    mask, digests, notes = read_mask(body)
    inputs.extend(digests)
    warnings.extend(notes)
    return MaskObstacle(around(mask, case))


def read_mask(body: ObstacleCase) -> tuple[Volume, tuple[tuple[str, str], ...], tuple[str, ...]]:
    """A label volume, or the voxels of a CT from `hu_min` on as one."""
    assert body.file is not None
    if body.hu_min is None:
        labels = read_volume_file(body.file)
        return Volume(labels.voxels, labels.index_to_lps), labels.inputs, ()
    image = read_ct(body.file)
    voxels = (np.asarray(image.volume.voxels) >= body.hu_min).astype(np.int16)
    return Volume(voxels, image.volume.index_to_lps), image.inputs, image.warnings


def around(mask: Volume, case: NeedleCase) -> Volume:
    """The part of a label volume within `CORRIDOR_MM` of the box of entry and target.

    Raises
    ------
    CaseError
        If entry or target lie outside the volume.
    """
    ends = np.array([space(case.entry), space(case.target)])
    index = mask.to_index(ends)
    for name, place in zip(("entry", "target"), ends, strict=True):
        if not mask.contains(place):
            raise CaseError("the {} ({:g}, {:g}, {:g}) mm lies outside the label volume of an obstacle".format(name, *place))
    margin = np.ceil(CORRIDOR_MM / np.asarray(mask.spacing))
    low = np.maximum(np.floor(index.min(axis=0) - margin), 0).astype(int)
    high = np.minimum(np.ceil(index.max(axis=0) + margin) + 1, mask.voxels.shape).astype(int)
    return mask.crop(low, high)


def planned_flat(case: NeedleCase, scene: Scene, progress: Any) -> Outcome:
    """The planar planner's outcome."""
    problem = PlanarProblem(np.array(case.entry), np.array(case.target), scene, case.planar)
    paths = plan_planar(problem, rng=np.random.default_rng(case.rng_seed), progress=progress)
    chosen = best(paths)
    per_degree = {str(n): one.form for n in range(1, case.planar.degree_max + 1) if (one := best(paths, n)) is not None}
    details = {
        "forms": [form_details(path) for path in paths],
        "chosen_form": None if chosen is None else chosen.form,
        "best_per_degree": per_degree,
        "insertion_angle_deg": None if chosen is None else float(np.degrees(chosen.angle)),
    }
    if chosen is None:
        nearest = [path for path in paths if path.tried]
        most, safety = case.planar.degree_max, case.planar.safety
        reason = f"no form of up to {most} pieces reaches the target and keeps {safety:g} mm from all obstacles"
        return Outcome(
            pose=None,
            controls=None,
            clearances=None,
            reason=reason if nearest else str(paths[0].reason),
            details=details,
            metrics={},
        )
    return Outcome(
        pose=chosen.pose,
        controls=chosen.controls,
        clearances=chosen.clearances,
        reason=None,
        details=details,
        metrics={"tip_error_mm": chosen.tip_error, "score": chosen.score, "danger": chosen.danger},
    )


def form_details(path: PlanarPath) -> dict[str, Any]:
    """One form for result.json."""
    told: dict[str, Any] = {
        "form": path.form,
        "degree": path.degree,
        "feasible": path.feasible,
        "reason": path.reason,
        "tried": path.tried,
    }
    if path.controls is None or path.pose is None or path.clearances is None:
        return told
    return told | {
        "length_mm": path.length,
        "lengths_mm": path.controls.lengths,
        "sides": list(path.sides),
        "insertion_angle_deg": float(np.degrees(path.angle)),
        "score": path.score,
        "danger": path.danger,
        "clearance_min_mm": float(path.clearances.min()) if len(path.clearances) else None,
        "tip_error_mm": path.tip_error,
        "points_mm": sampled(push(path.pose, path.controls), FORM_SPACING)[1],
    }


def planned_in_space(case: NeedleCase, scene: Scene, progress: Any, stream: NeedleRecording | None) -> Outcome:
    """The swarm's outcome, and how the insertion goes if events are given."""
    problem = SpatialProblem(insertion_pose(case.entry, case.direction), np.array(case.target), scene, case.needle)
    problem.check_places()

    def watched(state: SwarmRound) -> None:
        progress(state.index, case.swarm.rounds)
        if stream is not None and state.index % 10 == 0:
            stream.log_round(
                state.index + state.restart * case.swarm.rounds,
                sampled(problem.arcs(state.best), FORM_SPACING)[1],
                None if state.cloud is None else cloud_paths(problem, state.cloud),
                {"error": state.error, "length": state.length, "danger": state.danger},
            )

    rng = np.random.default_rng(case.rng_seed)
    if case.method == "printed":
        found = plan_printed(problem, case.swarm, rng=rng, watch=watched)
    else:
        found = plan_spatial(problem, case.swarm, rng=rng, time_budget=case.time_budget, watch=watched)
    details: dict[str, Any] = {
        "swarms": found.swarms,
        "rounds": len(found.rounds),
        "convergence": convergence(found),
        "pareto": [
            {"error_mm": p.error, "length_mm": p.length, "danger": p.danger, "clearance_mm": finite(p.clearance)}
            for p in found.front
        ],
    }
    if found.controls is None or found.pose is None:
        return Outcome(pose=None, controls=None, clearances=None, reason=found.reason, details=details, metrics={})
    reason = unknown_ground(push(found.pose, found.controls), scene)
    if case.events and reason is None:
        made = insert(problem, found.pose, found.controls, tuple(event_of(event) for event in case.events))
        details["insertion"] = insertion_details(made)
        reason = made.withdrawn
    return Outcome(
        pose=found.pose,
        controls=found.controls,
        clearances=found.clearances,
        reason=reason,
        details=details,
        metrics={"tip_error_mm": found.error, "danger": found.danger},
    )


def unknown_ground(arcs: Arcs, scene: Scene) -> str | None:
    """Why a path cannot count: it leaves the part of a label volume that is known; None if it does not."""
    points = sampled(arcs, SPACING)[1]
    for k, body in enumerate(scene.obstacles):
        if isinstance(body, MaskObstacle):
            index = body.volume.to_index(points)
            if (index < -0.5).any() or (index > np.array(body.volume.voxels.shape) - 0.5).any():
                where = f"obstacle {k + 1}'s label volume, or its part around entry and target"
                return f"the best path leaves {where}; nothing is known there"
    return None


def cloud_paths(problem: SpatialProblem, cloud: FloatArray) -> list[FloatArray]:
    """A dozen of the population's paths, each as points."""
    return [sampled(problem.arcs(row), 4.0)[1] for row in cloud[:: max(1, len(cloud) // 12)]]


def event_of(event: Any) -> Event:
    """An event of the case file as the simulation uses it."""
    return Event(
        at=event.at_mm,
        obstacle=None if event.obstacle is None else event.obstacle - 1,
        place=None if event.center is None else np.array(event.center),
        target=None if event.target is None else np.array(event.target),
        kappa=event.kappa,
    )


def insertion_details(made: Insertion) -> dict[str, Any]:
    """How the insertion went, for result.json."""
    return {
        "withdrawn": made.withdrawn,
        "length_mm": made.length,
        "error_mm": made.error,
        "clearance_min_mm": float(made.clearances.min()) if len(made.clearances) else None,
        "target_mm": made.problem.target,
        "controls": controls_details(made.pushed),
        "replans": [
            {"at_mm": step.at, "cause": step.cause, "found": step.found, "length_mm": step.length} for step in made.replans
        ],
        "points_mm": sampled(push(made.pose, made.pushed), FORM_SPACING)[1],
    }


def convergence(found: NeedlePath) -> list[dict[str, Any]]:
    """The swarm's best path by round, thinned; rounds without any path that keeps its distance are left out."""
    rounds = [state for state in found.rounds if np.isfinite(state.danger)]
    step = max(1, len(rounds) // ROUNDS_KEPT)
    kept = rounds[::step] + (rounds[-1:] if (len(rounds) - 1) % step else [])
    return [
        {"swarm": s.restart + 1, "round": s.index, "error_mm": s.error, "length_mm": s.length, "danger": s.danger} for s in kept
    ]


def finite(value: float) -> float | None:
    """A number, or None where there is nothing to measure."""
    return value if np.isfinite(value) else None


def controls_details(controls: Controls) -> list[dict[str, float]]:
    """Controls for result.json."""
    return [
        {"turn_rad": float(t), "turn_deg": float(np.degrees(t)), "length_mm": float(length), "curvature_per_mm": float(k)}
        for t, length, k in zip(controls.turns, controls.lengths, controls.curvatures, strict=True)
    ]


def sampled(arcs: Arcs, spacing: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Arc length (n,), points (n, 3), curvature (n,) and tangents (n, 3) of one path, at most `spacing` mm apart."""
    s, points, curvature, tangents = [], [], [], []
    done = 0.0
    last = len(arcs.lengths) - 1
    for k, length in enumerate(arcs.lengths):
        count = max(int(np.ceil(length / spacing)), 1)
        here = length * np.arange(count + (1 if k == last else 0)) / count
        s.append(done + here)
        single = Arcs(*(getattr(arcs, f)[k : k + 1] for f in Arcs.__dataclass_fields__))
        points.append(single.points(here[None])[0])
        angle = (here * arcs.curvatures[k])[:, None]
        tangents.append(np.cos(angle) * arcs.tangents[k] + np.sin(angle) * arcs.normals[k])
        curvature.append(np.full(len(here), arcs.curvatures[k]))
        done += length
    return np.concatenate(s), np.vstack(points), np.concatenate(curvature), np.vstack(tangents)


def content_of(case: NeedleCase, scene: Scene, outcome: Outcome, warnings: list[str]) -> dict[str, Any]:
    """The planner's part of result.json."""
    details: dict[str, Any] = {
        "case_id": case_name(case),
        "entry_mm": space(case.entry),
        "target_mm": space(case.target),
        "obstacles": [obstacle_details(given, body) for given, body in zip(case.obstacles, scene.obstacles, strict=True)],
        "warnings": warnings,
        **outcome.details,
    }
    content: dict[str, Any] = {
        "status": "ok" if outcome.reason is None else "infeasible",
        "reason": outcome.reason,
        "planner": {"name": case.name, "method": case.method},
        "frame": case.frame,
        "limits": {"curvature_max_per_mm": case.kappa, "clearance_min_mm": case.safety},
        "metrics": {},
        "details": details,
    }
    if outcome.controls is None or outcome.pose is None:
        return content
    arcs = push(outcome.pose, outcome.controls)
    s, points, curvature, _ = sampled(arcs, SPACING)
    clearance = scene.distances(points) if len(scene) else None
    details["entry_mm"] = outcome.pose.position
    details["entry_frame"] = outcome.pose.frame
    details["controls"] = controls_details(outcome.controls)
    lower = float(outcome.clearances.min()) if outcome.clearances is not None and len(outcome.clearances) else None
    content["path"] = {"s_mm": s, "points_mm": points, "curvature_per_mm": curvature, "clearance_mm": clearance}
    content["metrics"] = {
        "length_mm": outcome.controls.length,
        "curvature_max_per_mm": float(outcome.controls.curvatures.max()),
        "curvature_mean_per_mm": float(outcome.controls.curvatures @ outcome.controls.lengths / outcome.controls.length),
        "clearance_min_mm": lower,
        "clearance_mean_mm": None if clearance is None else float(clearance.mean()),
        **outcome.metrics,
    }
    content["certificate"] = {
        "holds": lower is None or lower >= case.safety - 1e-9,
        "curvature_upper_bound_per_mm": float(outcome.controls.curvatures.max()),
        "clearance_lower_bound_mm": lower,
        "method": "curvature: by construction; clearance: closed forms of arc against sphere and polygon, "
        "for other obstacles bisection with the distance's own rate of change",
    }
    return content


def obstacle_details(given: ObstacleCase, body: Obstacle) -> dict[str, Any]:
    """One obstacle for result.json, as in the case file, files by name."""
    told = {
        "kind": given.kind,
        "center_mm": None if given.center is None else space(given.center),
        "radius_mm": given.radius_mm,
        "points_mm": None if given.points is None else [space(p) for p in given.points],
        "file": None if given.file is None else given.file.name,
        "hu_min": given.hu_min,
        "distance_bound_mm": body.bound if isinstance(body, MaskObstacle) else None,
        "outline_mm": outline(body),
    }
    return {key: value for key, value in told.items() if value is not None}


def outline(body: Obstacle) -> FloatArray | None:
    """Some points of the rim of an obstacle that came from a file, for drawings, (k, 3) mm; None for others."""
    if isinstance(body, MaskObstacle):
        points = body.rim()
    elif isinstance(body, MeshObstacle):
        points = np.asarray(body.surface.vertices)
    else:
        return None
    return np.round(points[:: max(1, len(points) // OUTLINE_POINTS)], 2)


def path_table(result: Mapping[str, Any], outcome: Outcome) -> str:
    """path.csv; torsion is 0 within every piece, and clearance is empty without obstacles."""
    assert outcome.pose is not None
    assert outcome.controls is not None
    path = result["path"]
    tangents = sampled(push(outcome.pose, outcome.controls), SPACING)[3]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    gaps = path["clearance_mm"] or [""] * len(path["s_mm"])
    for s, p, t, k, gap in zip(path["s_mm"], path["points_mm"], tangents.tolist(), path["curvature_per_mm"], gaps, strict=True):
        writer.writerow([*(repr(v) for v in (s, *p, *t, k, 0.0)), gap if gap == "" else repr(gap)])
    return text.getvalue()
