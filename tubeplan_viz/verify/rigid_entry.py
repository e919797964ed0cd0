"""The entry region of a rigid run, what blocks the way from there, and the reason of a refusal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tubeplan_viz.verify.alike import same
from tubeplan_viz.verify.rigid_head import OwnHead
from tubeplan_viz.verify.rigid_sweep import Pose, apart
from tubeplan_viz.verify.verification import Check

POINT_MM = 5e-3 + 1e-9  # entry voxels have two decimals
PLACE_MM = 0.05 * np.sqrt(3.0) + 1e-9  # what blocks a push is told to a tenth of a millimetre
GRAZE_MM = 0.25  # the planner's envelope refuses up to this too early
BORDER = "nostril border"


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
