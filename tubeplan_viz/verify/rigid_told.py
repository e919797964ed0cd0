"""What a rigid run tells beside its path: instrument, head, entry region, candidates, places; each held against its source."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.rigid_head import OwnHead
from tubeplan_viz.verify.rigid_sweep import ROUNDING_MM, Boxes, Pose, apart, points_of
from tubeplan_viz.verify.verification import Check

SAME = 1e-6
WRITTEN_MM = 1e-4  # goals and nodes of candidates have four decimals
POINT_MM = 5e-3 + 1e-9  # entry voxels have two
PLACE_MM = 0.05 * np.sqrt(3.0) + 1e-9  # what blocks a push is told to a tenth of a millimetre
GRAZE_MM = 0.25  # the planner's envelope refuses up to this too early
BORDER = "nostril border"
GOALS = ("brain", "orbit", "septum", "turbinate", "length", "tissue")
PROOF_PARTS = 64  # the proof halves the span between the limit and what is measured six times
BEST_NAMES = {
    "overall": "overall best",
    "brain": "farthest from the brain",
    "length": "shortest",
    "tissue": "least tissue",
}


def same(name: str, told: Any, meant: Any, text: str) -> Check:
    """Whether two values are one, figures to `SAME`."""
    return Check(name=name, ok=alike(told, meant), found=brief(told), expected=brief(meant), text=text)


def alike(told: Any, meant: Any) -> bool:
    """The same value of the same kind; figures to `SAME`, lists and tables entry by entry."""
    if isinstance(meant, Mapping):
        return isinstance(told, Mapping) and told.keys() == meant.keys() and all(alike(told[k], meant[k]) for k in meant)
    if isinstance(meant, list | tuple):
        return isinstance(told, list | tuple) and len(told) == len(meant) and all(map(alike, told, meant))
    if isinstance(meant, float) and isinstance(told, int | float) and not isinstance(told, bool):
        return abs(told - meant) <= SAME * max(1.0, abs(meant))
    return type(told) is type(meant) and told == meant


def brief(value: Any) -> str:
    """A value in a few words."""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 160 else f"{text[:120]} ... {text[-30:]}"


def check_summary(result: Mapping[str, Any]) -> Iterator[Check]:
    """Metrics, certificate, features and unused keys follow from path, limits and nodes."""
    path, metrics, proof, details = result["path"], result["metrics"], result["certificate"], result["details"]
    gaps, s = np.array(path["clearance_mm"], float), np.array(path["s_mm"], float)
    turns = details.get("turn_clearance_mm")
    least = float(min(gaps.min(), np.inf if turns is None else turns))
    mean = float(np.sum(0.5 * (gaps[1:] + gaps[:-1]) * np.diff(s)) / s[-1])
    end = float(np.linalg.norm(np.array(path["points_mm"][-1], float) - np.array(details["goal_mm"], float)))
    wanted = {"clearance_min_mm": least, "clearance_mean_mm": mean, "tip_error_mm": end}
    told = {key: metrics[key] for key in wanted}
    yield same(
        "metrics: of the path", told, wanted, "Least and mean distance and the tip's error are those of the path and its turns."
    )
    straight = not np.any(path["curvature_per_mm"])
    unused = [metrics[key] for key in ("curvature_max_per_mm", "curvature_mean_per_mm", "centerline_distance_mean_mm")]
    unused += [result["limits"]["curvature_max_per_mm"], proof["curvature_upper_bound_per_mm"]]
    unused += [result[key] for key in ("spline", "centerline", "iterations")]
    yield Check(
        name="straight pieces",
        ok=straight and all(value is None for value in unused) and not result["flagged_intervals"],
        found="as for straight pieces" if straight else "a curvature",
        expected="no curvature, no limit of it, no flags",
        text="A path of straight pieces has no curvature, no spline and no flagged intervals.",
    )
    asked, lower = float(result["limits"]["clearance_min_mm"]), float(proof["clearance_lower_bound_mm"])
    share = PROOF_PARTS * (lower - asked) / max(least - asked, 1e-12)
    yield Check(
        name="certificate: as proved",
        ok=proof["holds"] is True
        and result["status"] == "ok"
        and abs(share - round(share)) <= 1e-3
        and -1e-9 <= share <= PROOF_PARTS,
        found=f"{lower:.6f} mm, {'holds' if proof['holds'] else 'does not hold'}",
        expected=f"a multiple of {(least - asked) / PROOF_PARTS:.6f} mm above {asked:g} mm, up to {least:.4f} mm; holds",
        text="The proved distance is one that halving the span from the limit to the measured distance can reach.",
    )
    nodes = np.array([feature["point_mm"] for feature in result["feature_points"]], float)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])
    meant = [{"kind": kind, "s_mm": float(place)} for kind, place in zip(kinds(len(nodes)), at, strict=True)]
    marks = [{"kind": feature["kind"], "s_mm": float(feature["s_mm"])} for feature in result["feature_points"]]
    yield same("nodes: kinds and places", marks, meant, "Start, nodes and goal stand at their distances along the path.")


def kinds(count: int) -> list[str]:
    """Kinds of the nodes of a path, in order."""
    return ["start", *["node"] * (count - 2), "goal"]


def check_instrument(folder: Path, case: Mapping[str, Any], result: Mapping[str, Any]) -> Iterator[Check]:
    """Names and lengths are those of the catalogue, how the parts stand to each other is that of the case."""
    own, tool = case["rigid"], result["details"]["instrument"]
    if own.get("catalogue"):
        text = (folder.resolve() / own["catalogue"]).read_text(encoding="utf-8")
    else:
        text = files("tubeplan_viz.instruments").joinpath("rigid.toml").read_text(encoding="utf-8")
    shelf = tomllib.loads(text)
    scope = next((row for row in shelf["endoscope"] if row["name"] == own.get("endoscope", row["name"])), None)
    shaver = next((row for row in shelf["shaver"] if row["name"] == own.get("shaver", row["name"])), None)
    if scope is None or shaver is None:
        names = f"{own.get('endoscope')} and {own.get('shaver')}"
        yield Check(
            name="instrument", ok=False, found=names, expected="in the catalogue", text="The case's instrument is unknown."
        )
        return
    offset = float(own["offset_mm"])
    meant = {
        "endoscope": scope["name"],
        "shaver": shaver["name"],
        "scope_diameter_mm": float(scope["diameter_mm"]),
        "scope_length_mm": float(scope["length_mm"]),
        "shaver_diameter_mm": float(shaver["diameter_mm"]),
        "shaver_length_mm": float(shaver["length_mm"]),
        "offset_mm": offset,
        "setback_mm": float(np.sqrt(scope["working_distance_mm"] ** 2 - offset**2)),
        "view_angle_deg": float(scope["view_angle_deg"]),
    }
    yield same("instrument", dict(tool), meant, "Endoscope and shaver are those of the catalogue, as far apart as the case says.")
    weights = {name: float(own[f"weight_{name}"]) for name in GOALS}
    total = sum(weights.values())
    told = {name: float(value) for name, value in result["details"]["weights"].items()}
    yield same("weights", told, {k: v / total for k, v in weights.items()}, "The weights are those of the case, adding up to 1.")


def check_head(result: Mapping[str, Any], head: OwnHead) -> Iterator[Check]:
    """Structures, lesion and shrinkage are those of the CT."""
    details, side = result["details"], str(result["details"]["side"])
    ml = head.scene.volume.voxel_ml
    labels: list[dict[str, Any]] = [
        {
            "name": name,
            "origin": head.scene.origin.get(name, "proposed"),
            "confidence": float(head.scene.confidence.get(name, 0.0)),
            "volume_ml": float(np.count_nonzero(mask)) * ml,
        }
        for name, mask in head.scene.structures.items()
    ]
    labels += [
        {
            "name": f"entry_{name}",
            "origin": region.origin,
            "confidence": float(region.confidence),
            "volume_ml": float(np.count_nonzero(region.widened)) * ml,
        }
        for name, region in head.scene.entries.items()
    ]
    told = [{**row, "confidence": float(row["confidence"]), "volume_ml": float(row["volume_ml"])} for row in details["labels"]]
    yield same(
        "labels", told, labels, "Names, origins, confidences and volumes of the structures are those of labels made again."
    )
    lesion = head.lesion
    off = np.inf if lesion is None else float(np.linalg.norm(np.array(details["goal_mm"], float) - lesion.center))
    yield Check(
        name="lesion: place and origin",
        ok=lesion is not None
        and off <= SAME
        and alike(dict(details["lesion"]), {"origin": lesion.origin, "confidence": float(lesion.confidence)}),
        found=f"{off:.3g} mm away, {details['lesion']['origin']}, confidence {details['lesion']['confidence']}",
        expected="none" if lesion is None else f"0 mm, {lesion.origin}, confidence {lesion.confidence:.4g}",
        text="The goal is the lesion as the case gives it or as it is proposed again.",
    )
    starts = int(np.count_nonzero(head.scene.entries[side].widened))
    rows, counts = details["shrinkage"], [row["feasible_starts"] for row in details["shrinkage"]]
    meant = [
        {
            "amount": amount,
            "planned": amount == head.amount,
            "starts": starts,
            "septum_mm": float(head.shrunk[amount].septum_mm),
            "turbinate_mm": float(head.shrunk[amount].turbinate_mm),
            "removed_ml": float(head.shrunk[amount].removed_ml),
        }
        for amount in sorted(head.shrunk)
    ]
    numbers = [
        {k: float(v) if k.endswith(("_mm", "_ml", "amount")) else v for k, v in row.items() if k != "feasible_starts"}
        for row in rows
    ]
    yield same(
        "shrinkage", numbers, meant, "Displacements and volumes of the shrunken mucosa are those of its simulation made again."
    )
    yield Check(
        name="shrinkage: feasible starts",
        ok=all(0 <= a <= b <= starts for a, b in pairwise([0, *counts])) and {0.0, 0.5, 1.0} <= {row["amount"] for row in rows},
        found=", ".join(map(str, counts)),
        expected=f"rising with the shrinkage, up to {starts}; 0, 50 and 100 % among them",
        text="With less tissue no start is lost.",
    )


def check_source(result: Mapping[str, Any], head: OwnHead) -> Iterator[Check]:
    """The inputs are those of the case, byte for byte, and what is told of the CT is what is read from it."""
    inputs = [[entry["name"], entry["sha256"]] for entry in result["provenance"]["inputs"]]
    yield same(
        "inputs", inputs, [list(pair) for pair in head.inputs], "Names and SHA-256 of the inputs are those of the case's files."
    )
    yield same("image", dict(result["details"]["image"]), dict(head.facts), "What is told of the CT is what is read from it.")
    missing = [text for text in head.notes if text not in result["details"]["warnings"]]
    yield Check(
        name="warnings",
        ok=not missing,
        found=f"without: {missing[0]}" if missing else "all told",
        expected=f"the {len(head.notes)} notes of CT and labels",
        text="Every doubt about the CT, its labels and the lesion is told.",
    )


def check_reason(result: Mapping[str, Any]) -> Iterator[Check]:
    """The numbers of a refusal are those of the entry region and of what was tried."""
    details, reason = result["details"], str(result["reason"])
    entry, goal, side = details["entry"], np.array(details["goal_mm"], float), details["side"]
    blocked, names = np.array(entry["blocked_by"], int), [name.replace("_", " ") for name in entry["structures"]]
    counts = np.bincount(blocked[blocked >= 0], minlength=len(names))
    worst = int(counts.argmax())
    places = np.array([place for place, k in zip(entry["blocked_at_mm"], blocked, strict=True) if k == worst], float)
    nearest = places[np.linalg.norm(places - goal, axis=1).argmin()]
    told = ", ".join(f"{names[k]} {counts[k]}" for k in np.argsort(-counts) if counts[k])
    tried = details["relief"]
    opening = next((row["change"] for row in tried[1:] if row["straight_starts"]), None)
    wanted = [
        f"from any of {len(blocked)} places of the {side} entry region",
        f"in none of {tried[0]['directions']} directions" if not tried[0]["free"] else f"{tried[0]['free']} directions are free",
        f"Straight pushes meet {told}; {names[worst]} stands in the way nearest to the lesion at",
        "None of the changes tried opens a straight way" if opening is None else f"A straight way opens with {opening}",
    ]
    missing = [part for part in wanted if part not in reason]
    place = [float(word) for word in reason.partition("lesion at (")[2].partition(")")[0].split(",") if word]
    off = float(np.abs(np.array(place) - nearest).max()) if len(place) == len(nearest) else np.inf
    yield Check(
        name="reason",
        ok=not missing and off <= 0.05 + 1e-9,
        found=f"without: {missing[0]}" if missing else f"the place {off:.3g} mm off",
        expected="the counts of the entry region, and its place nearest to the lesion",
        text="Counts, structure and place of the reason are those of the entry region.",
    )
    possible = all(
        row["free"] >= 0 and 0 <= row["straight_starts"] <= len(blocked) and 0 < sum(row["against"].values()) <= row["directions"]
        for row in tried
    )
    yield Check(
        name="what would open a way",
        ok=possible and tried[0]["change"] == "" and tried[0]["straight_starts"] == 0 and not any(entry["feasible"]),
        found=f"{len(tried)} changes, {tried[0]['straight_starts']} straight starts as planned",
        expected="the case as planned first, without a straight start; counts that can be",
        text="As planned no start has a straight way; directions and starts of the changes are counts that can be.",
    )


def check_entry(result: Mapping[str, Any], head: OwnHead) -> Iterator[Check]:
    """Entry voxels are those of the region; counts follow from them; what is told to block a push stands in its way."""
    details = result["details"]
    entry, side = details["entry"], str(details["side"])
    scene = head.planned
    own = scene.volume.to_lps(np.argwhere(scene.entries[side].widened))
    points = np.array(entry["points_mm"], float).reshape(-1, 3)
    off = float(np.abs(points - own).max()) if points.shape == own.shape else np.inf
    yield Check(
        name="entry: voxels",
        ok=off <= POINT_MM,
        found=f"{len(points)} places, {off:.3g} mm off at most",
        expected=f"{len(own)} voxels, told to 0.01 mm",
        text="The places that were tried are the voxels of the entry region.",
    )
    names, feasible, blocked = entry["structures"], np.array(entry["feasible"], bool), np.array(entry["blocked_by"], int)
    planned = next(row["feasible_starts"] for row in details["shrinkage"] if row["planned"])
    meant = {"starts": len(own), "feasible": planned}
    meant |= {f"blocked_by_{n.replace(' ', '_')}": int(((blocked == k) & ~feasible).sum()) for k, n in enumerate(names)}
    refused = np.array(entry["refused"], int).reshape(-1, len(names))
    meant |= {f"refused_by_{n.replace(' ', '_')}": int(refused[:, k].sum()) for k, n in enumerate(names)}
    yield same(
        "entry: counts", dict(entry["counts"]), meant, "The counts are those of the voxels, and of the shrinkage planned with."
    )
    shapes = len(feasible) == len(blocked) == len(entry["blocked_at_mm"]) == len(refused) == len(own)
    known = set(names) <= {*scene.structures, BORDER} and set(scene.structures) >= set(names) - {BORDER}
    whole = shapes and known and int(feasible.sum()) == planned and bool(feasible[blocked < 0].all())
    whole = whole and bool(((blocked >= -1) & (blocked < len(names))).all()) and bool((refused >= 0).all())
    whole = whole and bool((refused[~feasible].sum(axis=1) > 0).all())
    yield Check(
        name="entry: verdicts",
        ok=whole,
        found="whole" if whole else "not one for each voxel, or against each other",
        expected=f"one for each of {len(own)} voxels; {planned} feasible; whatever blocks nothing is feasible",
        text="Every voxel has a verdict, what blocks its straight push, and how many tries each structure refused.",
    )
    if whole:
        yield _blocking(result, head, blocked)


def _blocking(result: Mapping[str, Any], head: OwnHead, blocked: Any) -> Check:
    """Where a straight push is told to be blocked, the structure is there, and the instrument passes it."""
    details, scene = result["details"], head.planned
    entry, goal, tool = details["entry"], np.array(details["goal_mm"], float), details["instrument"]
    own = scene.volume.to_lps(np.argwhere(scene.entries[str(details["side"])].widened))
    half = 0.5 * float(np.linalg.norm(scene.volume.spacing))
    wrong = [k for k, place in enumerate(entry["blocked_at_mm"]) if (place is None) != (blocked[k] < 0)]
    far = 0.0
    for number, name in enumerate(entry["structures"]):
        rows = [k for k in np.flatnonzero(blocked == number) if entry["blocked_at_mm"][k] is not None]
        if not rows:
            continue
        places = np.array([entry["blocked_at_mm"][k] for k in rows], float)
        if name != BORDER:
            away, _ = cKDTree(scene.volume.to_lps(np.argwhere(scene.structures[name]))).query(places)
            wrong += [int(rows[k]) for k in np.flatnonzero(away > half + PLACE_MM)]
        for k, place in zip(rows, places, strict=True):
            run = float(np.linalg.norm(goal - own[k]))
            pose = Pose(goal, (goal - own[k]) / run, 0.0, tool, run)
            gap = float(apart(pose.local(place[None]), tool, run)[0]) - float(result["limits"]["clearance_min_mm"])
            far = max(far, gap)
            if gap > PLACE_MM + GRAZE_MM:
                wrong.append(int(k))
    return Check(
        name="entry: what blocks",
        ok=not wrong,
        found=f"{len(set(wrong))} places wrong, up to {far:.2f} mm from the instrument",
        expected=f"of the structure, within {GRAZE_MM:g} mm of the swept instrument, told to 0.1 mm",
        text="What is told to block a straight push is of that structure and in the instrument's way.",
    )


def check_candidates(result: Mapping[str, Any], case: Mapping[str, Any], head: OwnHead) -> Iterator[Check]:
    """Every candidate runs from its voxel to the lesion, at a roll that was allowed, as long as it says."""
    details, path = result["details"], result["path"]
    rows, feasible = details["candidates"], np.array(details["entry"]["feasible"], bool)
    goal, side = np.array(details["goal_mm"], float), str(details["side"])
    own = head.planned.volume.to_lps(np.argwhere(head.planned.entries[side].widened))
    most, count = float(case["rigid"]["roll_max_deg"]), int(case["rigid"]["rolls"])
    rolls = np.linspace(-most, most, count) if count > 1 else np.zeros(1)
    wrong: list[str] = []
    for number, row in enumerate(rows):
        nodes = np.array(row["nodes_mm"], float)
        length = float(np.linalg.norm(np.diff(nodes, axis=0), axis=1).sum())
        start = row["start"]
        good = 0 <= start < len(own) and bool(feasible[start]) and np.linalg.norm(nodes[0] - own[start]) <= 2.0 * WRITTEN_MM
        good = good and np.linalg.norm(nodes[-1] - goal) <= 2.0 * WRITTEN_MM and np.abs(rolls - row["roll_deg"]).min() <= SAME
        if not good or abs(length - row["length_mm"]) > 4.0 * WRITTEN_MM:
            wrong.append(str(number))
    yield Check(
        name="candidates",
        ok=not wrong,
        found=f"{len(rows)}, wrong: {', '.join(wrong[:8]) or 'none'}",
        expected="each from a feasible voxel to the lesion, its length that of its nodes, its roll one that is tried",
        text="Every ranked path begins at its voxel and ends at the lesion.",
    )
    chosen = rows[details["best"]["overall"]["path"]]
    corners = [feature["point_mm"] for feature in result["feature_points"]]
    off = (
        [float(np.abs(np.array(chosen["nodes_mm"], float) - np.array(corners, float)).max())]
        if len(corners) == len(chosen["nodes_mm"])
        else [np.inf]
    )
    turned = abs(chosen["roll_deg"] - details["nodes"][0]["beta_deg"])
    yield Check(
        name="path: the overall best",
        ok=off[0] <= WRITTEN_MM and turned <= 1e-5 and abs(path["s_mm"][-1] - chosen["length_mm"]) <= WRITTEN_MM,
        found=f"{off[0]:.3g} mm and {turned:.3g} degrees off",
        expected="the nodes and the roll of the overall best candidate",
        text="The path that the run gives is the overall best of its candidates.",
    )
    names = {key: choice["name"] for key, choice in details["best"].items()}
    yield same("best paths: names", names, BEST_NAMES, "The best paths are named for their goals.")
    worst = 0.0
    for line, choice in zip(details["best_paths"], details["best"].values(), strict=True):
        worst = max(worst, _off_line(np.array(line, float), np.array(rows[choice["path"]]["nodes_mm"], float)))
    yield Check(
        name="best paths: drawn",
        ok=worst <= 2.0 * WRITTEN_MM,
        found=f"{worst:.3g} mm off",
        expected=f"at most {2.0 * WRITTEN_MM:g} mm",
        text="What is drawn of the best paths lies on the segments between their nodes.",
    )


def _off_line(points: FloatArray, nodes: FloatArray) -> float:
    """Largest distance of points to a polyline, and of the first point to its beginning, mm."""
    away = np.full(len(points), np.inf)
    for a, b in pairwise(nodes):
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.minimum(away, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return float(max(away.max(), np.linalg.norm(points[0] - nodes[0])))


def check_directions(result: Mapping[str, Any]) -> Iterator[Check]:
    """Direction, upper side and the text's angles at each node follow from the segments and the roll."""
    nodes = np.array([feature["point_mm"] for feature in result["feature_points"]], float)
    told, meant = [], []
    for node, (a, b) in zip(result["details"]["nodes"], pairwise(nodes), strict=True):
        way = (b - a) / np.linalg.norm(b - a)
        pose = Pose(b, way, float(np.radians(node["beta_deg"])), result["details"]["instrument"])
        angles = {"alpha_deg": np.degrees(np.arctan2(-way[0], way[1])), "gamma_deg": np.degrees(np.arctan2(way[2], way[1]))}
        meant.append({"direction": way.tolist(), "up": pose.up.tolist(), **{key: float(angle) for key, angle in angles.items()}})
        told.append({key: node[key] for key in meant[-1]})
    rolls = {float(node["beta_deg"]) for node in result["details"]["nodes"]}
    yield same(
        "nodes: directions", told, meant, "At each node direction, upper side and the angles alpha and gamma are the segment's."
    )
    yield Check(
        name="nodes: roll",
        ok=len(rolls) == 1,
        found=f"{len(rolls)} rolls",
        expected="1",
        text="The instrument keeps its roll on all segments.",
    )


def check_worst(
    result: Mapping[str, Any], boxes: Mapping[str, Boxes], told: Mapping[str, Sequence[float | None]]
) -> Iterator[Check]:
    """The place of the least distance lies on the structure that is nearest then, as far from the part that is named."""
    worst, path = result["details"]["worst"], result["path"]
    gaps = np.array(path["clearance_mm"], float)
    k = int(np.abs(np.array(path["s_mm"], float) - worst["s_mm"]).argmin())
    own = told.get(worst["structure"])
    nearest = own is not None and own[k] is not None and abs(own[k] - gaps.min()) <= WRITTEN_MM
    place = np.array(worst["place_mm"], float)
    off = gap = np.inf
    if nearest:
        some = boxes[worst["structure"]]
        near = some.middles[np.linalg.norm(some.middles - place, axis=1) <= 2.0 * some.half]
        if len(near):
            off = float(np.linalg.norm(points_of(some, near) - place, axis=1).min())
        nodes = np.array([feature["point_mm"] for feature in result["feature_points"]], float)
        lengths = np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))
        n = min(int(np.searchsorted(lengths, path["s_mm"][k] + SAME)), len(lengths) - 1)
        way = (nodes[n + 1] - nodes[n]) / np.linalg.norm(nodes[n + 1] - nodes[n])
        tool = result["details"]["instrument"]
        pose = Pose(
            np.array(path["points_mm"][k], float), way, float(np.radians(result["details"]["nodes"][n]["beta_deg"])), tool
        )
        gap = float(apart(pose.local(place[None]), _only(tool, str(worst["part"])), 0.0)[0])
        off -= some.unseen
    # The place is the middle of a piece of a face of at most 0.3 mm.
    spare = 0.22
    yield Check(
        name="worst place",
        ok=bool(nearest)
        and abs(path["s_mm"][k] - worst["s_mm"]) <= SAME
        and abs(worst["distance_mm"] - gaps.min()) <= SAME
        and off <= ROUNDING_MM
        and -ROUNDING_MM <= gap - worst["distance_mm"] + ROUNDING_MM <= spare,
        found=f"{worst['structure']} at {worst['s_mm']:.3f} mm, {gap:.3f} mm from the {worst['part']}",
        expected=f"the nearest structure where the distance is least, {gaps.min():.3f} mm",
        text="The place of the least distance lies on the structure that is nearest then.",
    )


def _only(tool: Mapping[str, Any], part: str) -> dict[str, Any]:
    """The instrument with the other part far away."""
    other = {"shaver": {"offset_mm": 1e6}, "endoscope": {"shaver_length_mm": -1e6, "shaver_diameter_mm": 0.0}}
    return {**tool, **other[part]}
