"""A needle's part of result.json: path, metrics, and what its planner has to say, as plain data."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.cases.needle import NeedleCase
from tubeplan_viz.cases.needle_rows import MONTE_CARLO_KEYS, ObstacleCase
from tubeplan_viz.needle.bodies import MaskObstacle, MeshObstacle, Obstacle
from tubeplan_viz.needle.insertion import Insertion
from tubeplan_viz.needle.kinematics import Arcs, Controls, Pose, cycled, duty_cycle, push
from tubeplan_viz.needle.monte_carlo import MonteCarlo
from tubeplan_viz.needle.path import NeedlePath, Tradeoff
from tubeplan_viz.needle.planar import PlanarPath
from tubeplan_viz.needle.spatial import SpatialProblem
from tubeplan_viz.pipeline.needle_ground import Ground, space
from tubeplan_viz.result import CSV_COLUMNS

SPACING = 0.2  # mm; result.json promises at most 0.25
DRAWN_SPACING = 2.0  # of the paths of forms, of the front and of insertions, which are drawn only
ROUNDS_KEPT = 150
CLOUDS_KEPT, CLOUD_PATHS = 4, 12
INSERTIONS_DRAWN = 24
OUTLINE_POINTS = 1500
CYCLE_MM = 0.25  # push of one revolution: 4 revolutions per mm, 8 per second at the 2 mm/s of needle drives
PERCENTILES = (50, 75, 90, 95, 100)


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a needle planner has to say: the path (None without one), the reason, and its part of result.json's details."""

    pose: Pose | None = None
    controls: Controls | None = None
    clearances: FloatArray | None = None
    reason: str | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)


def case_name(case: NeedleCase) -> str:
    """The case's own id."""
    return case.case_id or "case"


def finite(value: float) -> float | None:
    """A number, or None where there is nothing to measure."""
    return value if np.isfinite(value) else None


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


def controls_details(controls: Controls, kappa: float | None = None) -> list[dict[str, float]]:
    """Controls for result.json; with `kappa` the share of each push in which the needle spins too."""
    return [
        {"turn_rad": float(t), "turn_deg": float(np.degrees(t)), "length_mm": float(length), "curvature_per_mm": float(k)}
        | ({} if kappa is None else {"duty": duty_cycle(float(k), kappa)})
        for t, length, k in zip(controls.turns, controls.lengths, controls.curvatures, strict=True)
    ]


def form_details(path: PlanarPath) -> dict[str, Any]:
    """One form for result.json."""
    told: dict[str, Any] = {
        "form": path.form,
        "degree": path.degree,
        "feasible": path.feasible,
        "reason": path.reason,
        "tried": path.tried,
        "score_bound": path.bound if np.isfinite(path.bound) else None,
        "certain": bool(np.isinf(path.bound)),
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
        "points_mm": sampled(push(path.pose, path.controls), DRAWN_SPACING)[1],
    }


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
        "points_mm": sampled(push(made.pose, made.pushed), DRAWN_SPACING)[1],
    }


def convergence(found: NeedlePath) -> list[dict[str, Any]]:
    """The swarm's best path by round, thinned; rounds without any path that keeps its distance are left out."""
    rounds = [state for state in found.rounds if np.isfinite(state.danger)]
    step = max(1, len(rounds) // ROUNDS_KEPT)
    kept = rounds[::step] + (rounds[-1:] if (len(rounds) - 1) % step else [])
    return [
        {"swarm": s.restart + 1, "round": s.index, "error_mm": s.error, "length_mm": s.length, "danger": s.danger} for s in kept
    ]


def population(problem: SpatialProblem, found: NeedlePath) -> list[dict[str, Any]]:
    """Some paths of the swarm's population at a few rounds of its last restart, from the first to the last."""
    clouds = [state for state in found.rounds if state.cloud is not None and state.restart == found.rounds[-1].restart]
    chosen = sorted({round(share * (len(clouds) - 1)) for share in np.linspace(0.0, 1.0, CLOUDS_KEPT)}) if clouds else []
    return [
        {"round": clouds[k].index, "paths_mm": [np.round(line, 2) for line in cloud_paths(problem, cloud)]}
        for k in chosen
        if (cloud := clouds[k].cloud) is not None
    ]


def cloud_paths(problem: SpatialProblem, cloud: FloatArray) -> list[FloatArray]:
    """A dozen of the population's paths, each as points."""
    rows = cloud[:: max(1, len(cloud) // CLOUD_PATHS)]
    return [sampled(problem.arcs(row), 2.0 * DRAWN_SPACING)[1] for row in rows]


def front_details(point: Tradeoff) -> dict[str, Any]:
    """One path of the Pareto front for result.json, with all that is needed to push it again."""
    return {
        "error_mm": point.error,
        "length_mm": point.length,
        "danger": point.danger,
        "clearance_mm": finite(point.clearance),
        "entry_mm": point.pose.position,
        "entry_frame": point.pose.frame,
        "controls": controls_details(point.controls),
        "points_mm": np.round(sampled(push(point.pose, point.controls), 2.0 * DRAWN_SPACING)[1], 3),
    }


def monte_carlo_details(case: NeedleCase, found: MonteCarlo) -> dict[str, Any]:
    """How many insertions at random went, for result.json."""
    errors = found.errors
    causes = Counter(made.replans[-1].cause for made in found.insertions if made.withdrawn is not None)
    lines = [sampled(push(made.pose, made.pushed), 2.0 * DRAWN_SPACING)[1] for made in found.insertions[:INSERTIONS_DRAWN]]
    return {
        "settings": {key: getattr(case.monte_carlo, name) for key, name in MONTE_CARLO_KEYS.items()},
        "runs": len(found.insertions),
        "ended": len(found.ended),
        "withdrawn": found.withdrawn,
        "withdrawn_causes": dict(causes),
        "touched": found.touched,
        "errors_mm": errors,
        "percentiles_mm": {str(p): float(np.percentile(errors, p)) for p in PERCENTILES} if len(errors) else {},
        "offsets_mm": [made.pushed_tip - made.problem.target for made in found.ended],
        "clearances_mm": [finite(float(gap)) for gap in found.clearances],
        "replans": [len(made.replans) for made in found.insertions],
        "paths_mm": [np.round(line, 2) for line in lines],
    }


def content_of(case: NeedleCase, ground: Ground, outcome: Outcome, warnings: list[str]) -> dict[str, Any]:
    """The planner's part of result.json.

    Parameters
    ----------
    case : NeedleCase
    ground : Ground
        Obstacles, CT and digests of what was read.
    outcome : Outcome
        Path or reason, with what was simulated besides.
    warnings : list of str
        Notes of reading and planning, shown with the result.

    Returns
    -------
    dict
        Keys as `assemble_result` takes them; points in mm in the case's frame.
    """
    scene = ground.scene
    details: dict[str, Any] = {
        "case_id": case_name(case),
        "entry_mm": space(case.entry),
        "target_mm": space(case.target),
        "obstacles": [obstacle_details(given, body) for given, body in zip(case.obstacles, scene.obstacles, strict=True)],
        "warnings": warnings,
        **({"image": dict(ground.facts)} if ground.facts else {}),
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
    details["controls"] = controls_details(outcome.controls, case.kappa)
    if (outcome.controls.curvatures < case.kappa).any():
        details["duty_cycle"] = duty_details(outcome.pose, outcome.controls, case.kappa)
    lower = float(outcome.clearances.min()) if outcome.clearances is not None and len(outcome.clearances) else None
    if outcome.clearances is not None:
        for told, gap in zip(details["obstacles"], outcome.clearances, strict=True):
            told["clearance_mm"] = float(gap)
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
        "hu_max": given.hu_max,
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


def duty_details(pose: Pose, controls: Controls, kappa: float) -> dict[str, float]:
    """How far the tip ends from the plan when curvatures are held by whole revolutions, `CYCLE_MM` of push each."""
    tip = cycled(pose, controls, kappa, cycle=CYCLE_MM).position
    return {"cycle_mm": CYCLE_MM, "tip_deviation_mm": float(np.linalg.norm(tip - push(pose, controls).tips))}


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
