"""What a rigid plan puts into result.json: the best path sampled, candidates, refusals, shrinkage, labels."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from segmentation.anatomy.nasal import Lesion, NasalScene, Shrinkage
from segmentation.arrays import FloatArray
from tubeplan_viz.cases.rigid import RigidCase
from tubeplan_viz.result import CSV_COLUMNS
from tubeplan_viz.rigid import (
    BEST,
    BORDER,
    GOALS,
    Judge,
    Problem,
    Relief,
    RigidPath,
    RigidPlan,
    pose_angles,
    posed,
    reliefs,
    structure_distances,
    up_of,
)
from tubeplan_viz.rigid.collision import structure_gaps, to_frame
from tubeplan_viz.rigid.instrument import PARTS, unit
from tubeplan_viz.rigid.judge import between

SPACING = 0.2  # mm; result.json promises at most 0.25
TURN_STEP = np.radians(1.0)
PROOF_STEPS = 6
TOLD_CELLS = 64  # looked at for the distances of the chosen path, twice as many as for the ranking


def rigid_content(
    case: RigidCase,
    lesion: Lesion,
    scene: NasalScene,
    shrunk: Mapping[float, Shrinkage],
    plan: RigidPlan,
    warnings: list[str],
) -> dict[str, Any]:
    """The planner's part of result.json.

    Parameters
    ----------
    case : RigidCase
    lesion : Lesion
        As given, or as proposed.
    scene : NasalScene
        Before any shrinkage; in LPS.
    shrunk : mapping of a share of the full shrinkage to Shrinkage
        What was taken from the mucosa at each of the amounts judged.
    plan : RigidPlan
    warnings : list of str
        Notes of reading and planning, shown with the result.

    Returns
    -------
    dict
        Keys as `assemble_result` takes them; lengths in mm, angles in degrees where the key says so.
    """
    problem = plan.problem
    instrument, endoscope, shaver = case.instrument
    details: dict[str, Any] = {
        "case_id": case.case_id or "case",
        "side": case.side,
        "goal_mm": problem.goal,
        "lesion": {"origin": lesion.origin, "confidence": lesion.confidence},
        "instrument": {
            "endoscope": endoscope,
            "shaver": shaver,
            "scope_diameter_mm": instrument.scope_diameter,
            "scope_length_mm": instrument.scope_length,
            "shaver_diameter_mm": instrument.shaver_diameter,
            "shaver_length_mm": instrument.shaver_length,
            "offset_mm": instrument.offset,
            "setback_mm": instrument.setback,
            "view_angle_deg": float(np.degrees(instrument.view_angle)),
        },
        "labels": labels(scene),
        "shrinkage": [
            {
                "amount": amount,
                "planned": amount == case.shrinkage,
                "feasible_starts": int(plan.searches[amount].feasible.sum()),
                "starts": len(problem.starts),
                "septum_mm": shrunk[amount].septum_mm,
                "turbinate_mm": shrunk[amount].turbinate_mm,
                "removed_ml": shrunk[amount].removed_ml,
            }
            for amount in sorted(plan.searches)
        ],
        "entry": entry_details(plan),
        "weights": dict(zip(GOALS, case.weights.row.tolist(), strict=True)),
        "warnings": warnings,
    }
    content: dict[str, Any] = {
        "status": "infeasible",
        "reason": None,
        "planner": {"name": "rigid", "method": case.method},
        "frame": "LPS",
        "limits": {"curvature_max_per_mm": None, "clearance_min_mm": case.margin},
        "metrics": {},
        "details": details,
    }
    if plan.ranking is None:
        tried = list(reliefs(problem, case.search.roll_values, case.thinnest))
        content["reason"] = refusal(plan, tried)
        details["relief"] = [
            {"change": r.change, "directions": r.directions, "free": r.free, "straight_starts": r.starts, "against": r.against}
            for r in tried
        ]
        return content
    best = plan.paths[plan.ranking.best["overall"]]
    details["candidates"] = candidates(plan)
    details["best"] = {key: {"path": index, "name": BEST[key]} for key, index in plan.ranking.best.items()}
    details["best_paths"] = [sampled(plan.paths[index])[1][::10] for index in plan.ranking.best.values()]
    details["nodes"] = nodes(problem, best)
    return content | measured(problem, best, details)


def measured(problem: Problem, path: RigidPath, details: dict[str, Any]) -> dict[str, Any]:
    """Status, path, metrics and certificate of the chosen path; the distances along it go into `details`."""
    s, points, directions = sampled(path)
    at = structure_distances(problem.obstacles, posed(problem.instrument, points, directions, path.roll), cells=TOLD_CELLS)
    names = [name for name in problem.obstacles.names if name != BORDER]
    columns = [problem.obstacles.names.index(name) for name in names]
    near = np.where(np.isfinite(at[:, columns]), at[:, columns], np.nan)
    details["structure_distances_mm"] = {
        name: [None if np.isnan(v) else round(v, 4) for v in near[:, k].tolist()] for k, name in enumerate(names)
    }
    clearance = np.nanmin(near, axis=1)
    details["worst"] = worst_place(problem, path, s, points, directions, clearance)
    turns = turn_clearance(problem, path)
    least = float(min(clearance.min(), turns)) if turns is not None else float(clearance.min())
    if turns is not None:
        details["turn_clearance_mm"] = turns
    lower = proved_clearance(problem, path, least)
    return {
        "status": "ok",
        "path": {"s_mm": s, "points_mm": points, "curvature_per_mm": np.zeros(len(s)), "clearance_mm": clearance},
        "feature_points": [
            {"point_mm": point, "kind": kind, "s_mm": float(place)}
            for point, kind, place in zip(
                path.nodes,
                ["start", *["node"] * (len(path.nodes) - 2), "goal"],
                np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.nodes, axis=0), axis=1))]),
                strict=True,
            )
        ],
        "metrics": {
            "length_mm": path.length,
            "clearance_min_mm": least,
            "clearance_mean_mm": float(np.trapezoid(clearance, s) / s[-1]),
            "tip_error_mm": float(np.linalg.norm(points[-1] - problem.goal)),
        },
        "certificate": {
            "holds": lower >= problem.margin,
            "curvature_upper_bound_per_mm": None,
            "clearance_lower_bound_mm": lower,
            "method": "instrument grown by the clearance and pushed: cylinder envelope with strides that the distance allows, "
            "whole segments at once, turns in pieces bounded by their displacement; the border of the entry region at 0 mm",
        },
    }


def labels(scene: NasalScene) -> list[dict[str, Any]]:
    """What the front end made of the CT."""
    rows = [
        {
            "name": name,
            "origin": scene.origin.get(name, "proposed"),
            "confidence": float(scene.confidence.get(name, 0.0)),
            "volume_ml": float(mask.sum()) * scene.volume.voxel_ml,
        }
        for name, mask in scene.structures.items()
    ]
    for side, region in scene.entries.items():
        volume = float(region.widened.sum()) * scene.volume.voxel_ml
        name = f"entry_{side}"
        rows.append({"name": name, "origin": region.origin, "confidence": region.confidence, "volume_ml": volume})
    return rows


def entry_details(plan: RigidPlan) -> dict[str, Any]:
    """Every start: feasible or not, what blocks its straight push and where, and how many tries each structure refused."""
    found, names = plan.searched, plan.problem.obstacles.names
    blocked = found.blocked_by >= 0
    return {
        "structures": list(names),
        "points_mm": np.round(plan.problem.starts, 2),
        "feasible": found.feasible,
        "blocked_by": found.blocked_by,
        "blocked_at_mm": [
            None if not hit else np.round(place, 1).tolist() for hit, place in zip(blocked, found.blocked_at, strict=True)
        ],
        "refused": found.refused,
        "evaluations": {f"{amount:g}": searched.evaluations for amount, searched in plan.searches.items()},
        "counts": {
            "starts": len(found.feasible),
            "feasible": int(found.feasible.sum()),
            **{
                f"blocked_by_{name.replace(' ', '_')}": int(((found.blocked_by == k) & ~found.feasible).sum())
                for k, name in enumerate(names)
            },
            **{f"refused_by_{name.replace(' ', '_')}": int(found.refused[:, k].sum()) for k, name in enumerate(names)},
        },
    }


def refusal(plan: RigidPlan, tried: Sequence[Relief]) -> str:
    """Why there is no path: what stands against the instrument at the lesion, where, and what would open a way."""
    found, names = plan.searched, plan.problem.obstacles.names
    counts = np.bincount(found.blocked_by[found.blocked_by >= 0], minlength=len(names))
    told = ", ".join(f"{names[k].replace('_', ' ')} {counts[k]}" for k in np.argsort(-counts) if counts[k])
    worst = int(counts.argmax())
    places = found.blocked_at[found.blocked_by == worst]
    middle = places[np.linalg.norm(places - plan.problem.goal, axis=1).argmin()]
    now, changes = tried[0], tried[1:]
    at_goal = (
        f"with its tip on the lesion the instrument is free in none of {now.directions} directions through the nostril"
        if not now.free
        else f"{now.free} directions are free at the lesion, but none can be reached from the nostril"
    )
    opening = [change.change for change in changes if change.starts]
    least = f"A straight way opens with {opening[0]}" if opening else "None of the changes tried opens a straight way"
    return (
        f"no way in for this instrument from any of {len(found.feasible)} places of the {plan.problem.side} entry region: "
        f"{at_goal}. Straight pushes meet {told}; {names[worst].replace('_', ' ')} stands in the way nearest to the lesion at "
        f"({middle[0]:.1f}, {middle[1]:.1f}, {middle[2]:.1f}) mm. {least}"
    )


def candidates(plan: RigidPlan) -> list[dict[str, Any]]:
    """All ranked paths."""
    assert plan.ranking is not None
    rows = []
    for k, path in enumerate(plan.paths):
        goals = {
            f"{name}_{'voxels' if name == 'tissue' else 'mm'}": None if np.isinf(v) else float(v)
            for name, v in zip(GOALS, plan.goals[k], strict=True)
        }
        rows.append(
            {
                "start": path.start,
                "nodes_mm": np.round(path.nodes, 4),
                "roll_deg": round(float(np.degrees(path.roll)), 6),
                **goals,
                "normalised": np.round(plan.ranking.normalised[k], 6),
                "score": round(float(plan.ranking.score[k]), 6),
                "pareto": bool(plan.ranking.pareto[k]),
            }
        )
    return rows


def nodes(problem: Problem, path: RigidPath) -> list[dict[str, Any]]:
    """The instrument's state at each node after the start: angles of the text, tip and the endoscope's front."""
    rows = []
    for before, here in zip(path.nodes[:-1], path.nodes[1:], strict=True):
        direction = unit(here - before)
        up = up_of(direction[None], path.roll)[0]
        alpha, gamma = pose_angles(direction)
        front = here - problem.instrument.setback * direction + problem.instrument.offset * up
        rows.append(
            {
                "tip_mm": here,
                "direction": direction,
                "up": up,
                "alpha_deg": float(np.degrees(alpha)),
                "beta_deg": float(np.degrees(path.roll)),
                "gamma_deg": float(np.degrees(gamma)),
                "endoscope_front_mm": front,
            }
        )
    return rows


def sampled(path: RigidPath, spacing: float = SPACING) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arc length (n,), points (n, 3) and directions (n, 3) of one path, nodes included."""
    s, points, directions, done = [], [], [], 0.0
    last = len(path.nodes) - 2
    for k, (a, b) in enumerate(zip(path.nodes[:-1], path.nodes[1:], strict=True)):
        length = float(np.linalg.norm(b - a))
        count = max(int(np.ceil(length / spacing)), 1)
        share = np.arange(count + (1 if k == last else 0)) / count
        s.append(done + share * length)
        points.append(a + share[:, None] * (b - a))
        directions.append(np.broadcast_to(unit(b - a), (len(share), 3)))
        done += length
    return np.concatenate(s), np.vstack(points), np.vstack(directions)


def worst_place(
    problem: Problem, path: RigidPath, s: FloatArray, points: FloatArray, directions: FloatArray, clearance: FloatArray
) -> dict[str, Any]:
    """Where along the way the instrument is nearest to a structure: to which, how near, and at which place of it."""
    k = int(clearance.argmin())
    obstacles = problem.obstacles
    structures = [j for j, name in enumerate(obstacles.names) if name != BORDER]
    pose = posed(problem.instrument, points[k : k + 1], directions[k : k + 1], path.roll)
    gaps = structure_gaps(obstacles, to_frame(pose, obstacles.frame), structures, cells=TOLD_CELLS)
    part, column = np.unravel_index(int(gaps.distance.argmin()), gaps.distance.shape)
    return {
        "s_mm": float(s[k]),
        "structure": obstacles.names[column],
        "part": PARTS[part],
        "distance_mm": float(clearance[k]),
        "place_mm": obstacles.frame.to_lps(gaps.place[part, column]),
    }


def turn_clearance(problem: Problem, path: RigidPath) -> float | None:
    """Least distance to a structure while the instrument turns at the nodes, mm; None without bends."""
    least = np.inf
    for a, b, c in zip(path.nodes[:-2], path.nodes[1:-1], path.nodes[2:], strict=True):
        before, after = unit(b - a)[None], unit(c - b)[None]
        count = max(int(np.ceil(np.arccos(np.clip((before @ after.T).item(), -1.0, 1.0)) / TURN_STEP)), 1) + 1
        share = np.linspace(0.0, 1.0, count)
        ways = between(np.repeat(before, count, axis=0), np.repeat(after, count, axis=0), share)
        bodies = posed(problem.instrument, np.repeat(b[None], count, axis=0), ways, path.roll)
        at = structure_distances(problem.obstacles, bodies, cells=TOLD_CELLS)
        least = min(least, float(at[:, [name != BORDER for name in problem.obstacles.names]].min()))
    return least if len(path.nodes) > 2 else None


def proved_clearance(problem: Problem, path: RigidPath, measured_mm: float) -> float:
    """The largest clearance of the whole way that the search's own proof gives, by bisection, mm."""
    low, high = problem.margin, measured_mm
    obstacles = problem.structures_only()
    for _ in range(PROOF_STEPS):
        middle = 0.5 * (low + high)
        judge = Judge(obstacles, problem.instrument, problem.starts, margin=middle)
        roll = np.full(len(path.nodes) - 1, path.roll)
        label, _ = judge.push(path.nodes[:-1], path.nodes[1:], roll)
        ways = unit(np.diff(path.nodes, axis=0))
        free = bool((label < 0).all())
        if free and len(path.nodes) > 2:
            free = bool(judge.turn(path.nodes[1:-1], ways[:-1], ways[1:], roll[1:]).all())
        low, high = (middle, high) if free else (low, middle)
    return low


def path_table(result: Mapping[str, Any]) -> str:
    """path.csv; a straight segment has neither curvature nor torsion."""
    path = result["path"]
    points = np.array(path["points_mm"])
    tangents = unit(np.diff(points, axis=0))
    tangents = np.vstack([tangents, tangents[-1:]])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for s, p, t, gap in zip(path["s_mm"], path["points_mm"], tangents.tolist(), path["clearance_mm"], strict=True):
        writer.writerow([repr(v) for v in (s, *p, *t, 0.0, 0.0, gap)])
    return text.getvalue()
