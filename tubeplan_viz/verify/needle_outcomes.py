"""What a needle's run says besides its path: the insertion with its events, the Pareto front, the insertions at random."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.needle_bodies import Distance, distance_to, place
from tubeplan_viz.verify.needle_motion import STEP_MM, integrated
from tubeplan_viz.verify.verification import Check

SAME_MM = 1e-6
FRONT_STEP_MM = 0.1
EXACT_KINDS = ("sphere", "circle", "polygon")
FACTOR = 1e-6  # of a bend: what the sum of rounding may be


def check_insertion(
    case: Mapping[str, Any], own: Mapping[str, Any], result: Mapping[str, Any], bodies: Sequence[Distance]
) -> Iterator[Check]:
    """What was pushed in the simulated insertion ends where it is said to, past obstacles where they stood by then."""
    insertion = result["details"].get("insertion")
    events = sorted(case.get("events", []), key=lambda event: float(event["at_mm"]))
    yield Check(
        name="insertion: asked for",
        ok=(insertion is not None) == bool(events) or result["path"] is None or result["status"] != "ok",
        found="an insertion" if insertion is not None else "none",
        expected=f"{'an insertion for' if events else 'none without'} events",
        text="An insertion is simulated when the case has events.",
    )
    if insertion is None or not insertion["controls"]:
        return
    s, points = integrated(result["details"], insertion["controls"])
    happened = [event for event in events if event["at_mm"] <= s[-1] + SAME_MM]
    target = place(next((event["target"] for event in reversed(happened) if "target" in event), own["target"]))
    error = float(np.linalg.norm(points[-1] - target))
    yield Check(
        name="insertion: tip and length",
        ok=abs(error - insertion["error_mm"]) <= SAME_MM
        and abs(s[-1] - insertion["length_mm"]) <= SAME_MM
        and bool(np.abs(target - insertion["target_mm"]).max() <= SAME_MM),
        found=f"stated {insertion['error_mm']:.6g} mm from the target after {insertion['length_mm']:.4f} mm",
        expected=f"{error:.6g} mm after {s[-1]:.4f} mm",
        text="The pushes of the insertion, integrated, end where the result says, measured from where the target is by then.",
    )
    yield from check_true_bends(own, result, insertion, happened)
    yield from check_causes(insertion, happened)
    rows = list(case.get("obstacles", []))
    if rows:
        least = moved_distance(rows, bodies, happened, s, points)
        stated = insertion["clearance_min_mm"]
        exact = all(row["kind"] in EXACT_KINDS for row in rows)
        yield Check(
            name="insertion: obstacles where they stood",
            ok=least > 0.0 and stated <= least + SAME_MM and (not exact or least - stated <= 0.5 * STEP_MM),
            found=f"{least:.4f} mm at least, stated {stated:.4f} mm",
            expected="more than 0 mm, and no less than stated",
            text="The pushed path touches no obstacle, each where it stood when the tip passed.",
        )


def moved_distance(
    rows: Sequence[Mapping[str, Any]],
    bodies: Sequence[Distance],
    events: Sequence[Mapping[str, Any]],
    s: FloatArray,
    points: FloatArray,
) -> float:
    """Least distance, mm, of the pushed path to all obstacles, each where the events have put it."""
    least = np.inf
    for k, (row, body) in enumerate(zip(rows, bodies, strict=True)):
        moves = [event for event in events if event.get("obstacle") == k + 1]
        begins = [0.0, *(float(event["at_mm"]) for event in moves), np.inf]
        for stage, (begin, end) in enumerate(pairwise(begins)):
            here = points[(s >= begin - SAME_MM) & (s <= end + SAME_MM)]
            if not len(here) or (stage > 0 and s[-1] <= begin + SAME_MM):  # nothing was pushed after this motion
                continue
            distance = body if stage == 0 else distance_to(displaced(row, moves[stage - 1]["center"]), Path(), STEP_MM)
            least = min(least, float(distance(here).min()))
    return least


def displaced(row: Mapping[str, Any], to: Any) -> dict[str, Any]:
    """A sphere with another centre, a capsule with another first point."""
    if row["kind"] == "sphere":
        return {**row, "center": to}
    line = np.array(row["points"], float)
    return {**row, "points": line - line[0] + np.array(to, float)}


def check_true_bends(
    own: Mapping[str, Any], result: Mapping[str, Any], insertion: Mapping[str, Any], events: Sequence[Mapping[str, Any]]
) -> Iterator[Check]:
    """Every push of the insertion bends as the needle then truly does."""
    kappa = result["limits"]["curvature_max_per_mm"]
    changes = [(0.0, kappa), *((float(event["at_mm"]), float(event["kappa"])) for event in events if "kappa" in event)]
    worst, done = 0.0, 0.0
    for control in insertion["controls"]:
        true = [value for begin, value in changes if begin <= done + SAME_MM][-1]
        over = control["curvature_per_mm"] / true - 1.0
        worst = max(worst, over if own.get("duty_cycle", False) else abs(over))
        done += control["length_mm"]
    yield Check(
        name="insertion: curvature",
        ok=worst <= FACTOR,
        found=f"{100.0 * worst:.3g} % off at most",
        expected="the true curvature of the events at each depth" + (" or less" if own.get("duty_cycle", False) else ""),
        text="What was pushed bends as the events say that the needle truly does.",
    )


def check_causes(insertion: Mapping[str, Any], events: Sequence[Mapping[str, Any]]) -> Iterator[Check]:
    """Each motion of an obstacle or the target has its entry in the log, where it happened."""
    log = [(float(step["at_mm"]), str(step["cause"])) for step in insertion["replans"]]
    missing = []
    for event in events:
        if "kappa" in event or event["at_mm"] >= insertion["length_mm"] - SAME_MM:
            continue
        word = f"obstacle {event['obstacle']} has moved" if "obstacle" in event else "the target has moved"
        if not any(abs(at - event["at_mm"]) <= 0.1 and word in cause for at, cause in log):
            missing.append(f"{word} at {event['at_mm']:g} mm")
    yield Check(
        name="insertion: causes",
        ok=not missing,
        found=", ".join(missing) + " not in the log" if missing else f"{len(log)} entries",
        expected="an entry for each motion, at its depth",
        text="The log of the insertion names every motion of the case's events.",
    )


def check_front(
    own: Mapping[str, Any], case: Mapping[str, Any], result: Mapping[str, Any], bodies: Sequence[Distance]
) -> Iterator[Check]:
    """The paths of the Pareto front are what they are said to be, and none beats another."""
    front = result["details"].get("pareto")
    if not front:
        return
    target, safety = place(own["target"]), float(own["safety_mm"])
    rows = list(case.get("obstacles", []))
    exact = all(row["kind"] in EXACT_KINDS for row in rows)
    worst, nearest, off = 0.0, np.inf, 0.0
    for point in front:
        s, points = integrated(point, point["controls"], step=FRONT_STEP_MM)
        error = float(np.linalg.norm(points[-1] - target))
        worst = max(worst, abs(error - point["error_mm"]), abs(s[-1] - point["length_mm"]))
        gaps = np.array([body(points).min() for body in bodies])
        if len(gaps):
            nearest = min(nearest, float(gaps.min()))
        if exact and len(gaps) and safety > 0.0:
            # Places FRONT_STEP_MM apart may miss the nearest by h^2 / 8 r, far under half of it.
            slack = 0.5 * FRONT_STEP_MM * safety / float(gaps.min()) ** 2 * len(gaps)
            off = max(off, abs(float((safety / gaps).sum()) - point["danger"]) - slack)
    yield Check(
        name="front: errors and lengths",
        ok=worst <= SAME_MM,
        found=f"{worst:.2g} mm off at most, {len(front)} paths",
        expected=f"at most {SAME_MM:g} mm",
        text="The paths of the Pareto front, integrated, end as far from the target and are as long as stated.",
    )
    if rows:
        yield Check(
            name="front: obstacles",
            ok=nearest >= safety - 0.5 * FRONT_STEP_MM and off <= 0.0,
            found=f"{nearest:.4f} mm at least",
            expected=f"{safety:g} mm, and the stated dangers",
            text="The paths of the Pareto front keep the safety distance, and their dangers are those stated.",
        )
    goals = [(point["error_mm"], point["length_mm"], point["danger"]) for point in front]
    beaten = [
        k
        for k, mine in enumerate(goals)
        if any(all(a <= b for a, b in zip(other, mine, strict=True)) and other != mine for other in goals)
    ]
    yield Check(
        name="front: none is beaten",
        ok=not beaten,
        found=f"{len(beaten)} beaten" if beaten else "none",
        expected="none",
        text="No path of the front is as good as another in error, length and danger and better in one.",
    )


def check_chances(case: Mapping[str, Any], result: Mapping[str, Any]) -> Iterator[Check]:
    """The insertions at random are counted and summed up as they were drawn."""
    found, asked = result["details"].get("monte_carlo"), case.get("monte_carlo")
    if found is None or asked is None:
        yield Check(
            name="Monte Carlo: asked for",
            ok=found is None and (asked is None or result["status"] != "ok"),
            found="none" if found is None else "insertions",
            expected="none" if asked is None else "insertions",
            text="Insertions at random are simulated when the case asks for them.",
        )
        return
    errors = np.array(found["errors_mm"], float)
    offsets = np.linalg.norm(np.array(found["offsets_mm"], float).reshape(-1, 3), axis=1)
    counts = (
        found["runs"] == asked["runs"] == len(found["clearances_mm"]) == found["ended"] + found["withdrawn"]
        and len(errors) == found["ended"]
        and sum(found["withdrawn_causes"].values()) == found["withdrawn"]
        and found["touched"] == sum(gap is not None and gap <= 0.0 for gap in found["clearances_mm"])
    )
    yield Check(
        name="Monte Carlo: counts",
        ok=counts,
        found=f"{found['ended']} ended, {found['withdrawn']} withdrawn, {found['touched']} touched, of {found['runs']}",
        expected=f"{asked['runs']} in all, as in the lists",
        text="Insertions that ended, were withdrawn and touched an obstacle are counted as the lists have them.",
    )
    ordered = np.sort(errors)
    off = max((abs(share_of(ordered, float(share)) - value) for share, value in found["percentiles_mm"].items()), default=0.0)
    same = len(offsets) == len(errors) and bool(np.abs(offsets - errors).max(initial=0.0) <= SAME_MM)
    yield Check(
        name="Monte Carlo: errors",
        ok=same and off <= SAME_MM,
        found=f"percentiles {off:.2g} mm off at most",
        expected="those of the listed errors, which are the lengths of the listed offsets",
        text="The final errors are summed up as they are listed.",
    )


def share_of(ordered: FloatArray, share: float) -> float:
    """The value under which `share` percent lie, by the straight line between neighbours."""
    at = share / 100.0 * (len(ordered) - 1)
    low = int(np.floor(at))
    high = min(low + 1, len(ordered) - 1)
    return float(ordered[low] + (at - low) * (ordered[high] - ordered[low]))
