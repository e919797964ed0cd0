"""A needle's run checked by other means: its controls integrated as a rate model, its distances measured on dense places.

# Strategy: the pose is integrated by a Runge-Kutta method (the planner uses closed forms), and obstacles are built again
# from case.toml. The distance to an obstacle changes by no more than the way walked, so places `STEP_MM` apart bound it
# everywhere to half a step.
"""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import TubeplanError
from segmentation.faults import shortened
from tubeplan_viz.verify.files import CSV_HEADER, check_markups
from tubeplan_viz.verify.needle_bodies import TISSUE_HU, Distance, at_skin, distance_to, located, place
from tubeplan_viz.verify.needle_motion import STEP_MM, integrated
from tubeplan_viz.verify.needle_outcomes import check_chances, check_front, check_insertion
from tubeplan_viz.verify.needle_told import check_told_needle
from tubeplan_viz.verify.page import check_page
from tubeplan_viz.verify.verification import Check

SAME_MM = 1e-6
TIP_MM = {"forms": 1e-6, "swarm": 1e-3, "rrt": 1e-3, "printed": 0.1}


def check_needle(folder: Path, result: Mapping[str, Any]) -> Iterator[Check]:
    """All checks of a needle's run that has a path."""
    try:
        case = tomllib.loads((folder / "case.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError) as fault:
        yield Check(
            name="case.toml", ok=False, found=type(fault).__name__, expected="a TOML file", text="The case cannot be read."
        )
        return
    own = case.get(result["planner"]["name"], {})
    yield from check_asked(own, result)
    s, points = integrated(result["details"], result["details"]["controls"])
    yield from check_points(result, s, points)
    yield from check_tip(own, result, points)
    yield from check_entry(folder, case, own, result)
    yield from check_bends(result)
    try:
        bodies = [distance_to(row, folder, STEP_MM) for row in case.get("obstacles", [])]
    except (TubeplanError, OSError) as fault:
        yield Check(
            name="obstacles",
            ok=False,
            found=shortened(str(fault)),
            expected="files that can be read",
            text="An obstacle cannot be built again from its file.",
        )
        return
    yield from check_distances(case, result, s, points, bodies)
    yield from check_told_needle(case, own, result, points, bodies)
    yield from check_insertion(case, own, result, bodies)
    yield from check_front(own, case, result, bodies)
    yield from check_chances(case, result)
    yield from check_files(folder, result)
    page = folder / "report.html"
    if page.exists():
        yield from check_page(page.read_text(encoding="utf-8"), result)


def check_files(folder: Path, result: Mapping[str, Any]) -> Iterator[Check]:
    """path.csv and path.mrk.json say the same as result.json."""
    path = result["path"]
    gaps = path["clearance_mm"] or [""] * len(path["s_mm"])
    stated = [
        [repr(v) if v != "" else "" for v in (s, *p, k, gap)]
        for s, p, k, gap in zip(path["s_mm"], path["points_mm"], path["curvature_per_mm"], gaps, strict=True)
    ]
    try:
        rows = list(csv.reader((folder / "path.csv").read_text(encoding="utf-8").splitlines()))
        markups = json.loads((folder / "path.mrk.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as fault:
        name = "path.csv and path.mrk.json"
        yield Check(
            name=name, ok=False, found=type(fault).__name__, expected="two whole files", text="A file of the run cannot be read."
        )
        return
    whole = rows[:1] == [CSV_HEADER] and all(len(row) == len(CSV_HEADER) for row in rows)
    same = whole and [[row[c] for c in (0, 1, 2, 3, 7, 9)] for row in rows[1:]] == stated
    yield Check(
        name="path.csv: same numbers",
        ok=same,
        found="the same" if same else "other numbers",
        expected="every number as in result.json",
        text="Arc length, points, curvature and clearance of path.csv are those of result.json, to the last digit.",
    )
    yield from check_markups(markups, result)


def check_asked(own: Mapping[str, Any], result: Mapping[str, Any]) -> Iterator[Check]:
    """Limits and target are those of the case."""
    kappa = own["kappa"] if "kappa" in own else 1.0 / own["radius_mm"]
    limits = result["limits"]
    same = limits["curvature_max_per_mm"] == kappa and limits["clearance_min_mm"] == own["safety_mm"]
    yield Check(
        name="limits",
        ok=same,
        found=f"{limits['curvature_max_per_mm']:g} 1/mm, {limits['clearance_min_mm']:g} mm",
        expected=f"{kappa:g} 1/mm, {own['safety_mm']:g} mm",
        text="The limits of the result are those that the case asks for.",
    )


def check_points(result: Mapping[str, Any], s: FloatArray, points: FloatArray) -> Iterator[Check]:
    """The sampled path is that of the controls."""
    path = result["path"]
    stated = np.array(path["points_mm"], float)
    expected = np.column_stack([np.interp(path["s_mm"], s, points[:, axis]) for axis in range(3)])
    off = np.linalg.norm(stated - expected, axis=1)
    # Between places a chord leaves an arc by kappa h^2 / 8.
    slack = SAME_MM + result["limits"]["curvature_max_per_mm"] * STEP_MM**2 / 8.0
    worst = int(off.argmax())
    yield Check(
        name="path: from the controls",
        ok=bool(off.max() <= slack) and abs(path["s_mm"][-1] - s[-1]) <= SAME_MM,
        found=f"{off.max():.2g} mm off at most, at {path['s_mm'][worst]:.2f} mm",
        expected=f"at most {slack:.2g} mm, {s[-1]:.4f} mm long",
        text="The points of the path are where the controls lead when they are integrated as a rate model.",
    )
    length = result["metrics"]["length_mm"]
    yield Check(
        name="metrics: length_mm",
        ok=abs(length - s[-1]) <= SAME_MM,
        found=f"{length:.6f} mm",
        expected=f"{s[-1]:.6f} mm",
        text="The length is the sum of the pushes.",
    )


def check_tip(own: Mapping[str, Any], result: Mapping[str, Any], points: FloatArray) -> Iterator[Check]:
    """The needle starts where it may and ends on the target."""
    error = float(np.linalg.norm(points[-1] - place(own["target"])))
    allowed = TIP_MM.get(result["planner"]["method"], 0.0)
    yield Check(
        name="tip: on the target",
        ok=error <= allowed and abs(error - result["metrics"]["tip_error_mm"]) <= SAME_MM,
        found=f"{error:.3g} mm, stated {result['metrics']['tip_error_mm']:.3g} mm",
        expected=f"at most {allowed:g} mm, as stated",
        text="The integrated tip ends on the target of the case.",
    )


def check_entry(folder: Path, case: Mapping[str, Any], own: Mapping[str, Any], result: Mapping[str, Any]) -> Iterator[Check]:
    """The needle goes in where and along which direction the case allows it, through the skin where it says so."""
    start, free = np.array(result["path"]["points_mm"][0], float), own.get("entry_radius_mm", 0.0)
    off = start - place(own["entry"])
    skin = bool(own.get("skin", False))
    if skin:  # the skin's height along the direction is not the case's to say
        way = np.array(own["direction"], float) / np.linalg.norm(own["direction"])
        off = off - (off @ way) * way
    yield Check(
        name="entry",
        ok=bool(np.linalg.norm(off) <= free + SAME_MM),
        found=f"{np.linalg.norm(off):.4g} mm from the entry of the case{' across its direction' if skin else ''}",
        expected=f"at most {free:g} mm",
        text="The needle goes in where the case allows it.",
    )
    if skin:
        image = case["input"]
        try:
            ok, found = at_skin(located(image["ct"], folder), image.get("series"), start, way)
        except (TubeplanError, OSError) as fault:
            ok, found = False, shortened(str(fault))
        yield Check(
            name="entry: on the skin",
            ok=ok,
            found=found,
            expected=f"tissue from {TISSUE_HU:g} HU on behind the entry and air before it",
            text="The needle goes in where air and tissue of the CT meet.",
        )
    frame = np.array(result["details"]["entry_frame"], float)
    if "direction" in own:
        asked = np.array(own["direction"], float)
        tilt = np.degrees(np.arccos(np.clip(frame[:, 2] @ asked / np.linalg.norm(asked), -1.0, 1.0)))
        limit = own.get("cone_deg", 0.0)
    else:
        tilt, limit = np.degrees(abs(np.arctan2(frame[1, 2], frame[2, 2]))), own["angle_max_deg"]
    yield Check(
        name="direction",
        ok=bool(tilt <= limit + 1e-5) and bool(np.abs(frame.T @ frame - np.eye(3)).max() < 1e-9),
        found=f"{tilt:.4f} degrees",
        expected=f"at most {limit:g} degrees",
        text="The needle goes in along a direction that the case allows.",
    )


def check_bends(result: Mapping[str, Any]) -> Iterator[Check]:
    """No piece bends more than the needle can."""
    bends = [control["curvature_per_mm"] for control in result["details"]["controls"]]
    limit = result["limits"]["curvature_max_per_mm"]
    fixed = result["planner"]["name"] == "needle3d" and not result["provenance"]["settings"]["needle3d"]["duty_cycle"]
    exact = all(bend == limit for bend in bends) if fixed else all(bend in (0.0, limit) for bend in bends)
    if result["planner"]["name"] == "needle3d" and not fixed:
        exact = True
    yield Check(
        name="curvature",
        ok=max(bends) <= limit * (1.0 + 1e-12) and exact and max(result["path"]["curvature_per_mm"]) <= limit * (1.0 + 1e-12),
        found=f"{min(bends):g} to {max(bends):g} 1/mm",
        expected=f"{'always ' if fixed else 'at most '}{limit:g} 1/mm",
        text="Every piece bends as the needle does.",
    )
    off = max(abs(control["duty"] - (1.0 - control["curvature_per_mm"] / limit)) for control in result["details"]["controls"])
    yield Check(
        name="duty cycle",
        ok=off <= SAME_MM,
        found=f"{off:.2g} off at most",
        expected="1 less the share of the full curvature",
        text="Each piece spins for the share of its push that gives its curvature.",
    )


def check_distances(
    case: Mapping[str, Any], result: Mapping[str, Any], s: FloatArray, points: FloatArray, bodies: Sequence[Distance]
) -> Iterator[Check]:
    """Every obstacle of the case is kept away from, at every place of the path."""
    safety = result["limits"]["clearance_min_mm"]
    rows = list(case.get("obstacles", []))
    yield Check(
        name="obstacles",
        ok=len(rows) == len(result["details"]["obstacles"]),
        found=f"{len(result['details']['obstacles'])}",
        expected=f"{len(rows)} of the case",
        text="Every obstacle of the case is in the result.",
    )
    least = np.inf
    for k, (row, body) in enumerate(zip(rows, bodies, strict=True)):
        distance = body(points)
        worst = int(distance.argmin())
        least = min(least, float(distance[worst]))
        # Half a step between places; a thousandth for the planner's own limit of rounding.
        yield Check(
            name=f"obstacle {k + 1} ({row['kind']})",
            ok=bool(distance[worst] >= safety - 0.5 * STEP_MM * STEP_MM - SAME_MM),
            found=f"{distance[worst]:.4f} mm at {s[worst]:.2f} mm",
            expected=f"at least {safety:g} mm",
            text="The path keeps the safety distance from the obstacle at every place.",
        )
    stated = result["metrics"]["clearance_min_mm"]
    if rows:
        file_kinds = any(row["kind"] in ("mask", "mesh", "capsule") for row in rows)
        yield Check(
            name="metrics: clearance_min_mm",
            ok=stated is not None and stated <= least + SAME_MM and (file_kinds or abs(stated - least) <= 0.5 * STEP_MM),
            found=f"{stated} mm",
            expected=f"no more than {least:.4f} mm",
            text="The stated least clearance is not larger than the one measured.",
        )
