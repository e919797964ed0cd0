"""What a rigid run tells beside its path: instrument, head, sources, nodes, places; each held against its source."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tubeplan_viz.verify.alike import SAME, alike, same
from tubeplan_viz.verify.rigid_head import OwnHead
from tubeplan_viz.verify.rigid_sweep import ROUNDING_MM, WRITTEN_MM, Boxes, Pose, apart, points_of
from tubeplan_viz.verify.verification import Check

GOALS = ("brain", "orbit", "septum", "turbinate", "length", "tissue")
PROOF_PARTS = 64  # the proof halves the span between the limit and what is measured six times


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
