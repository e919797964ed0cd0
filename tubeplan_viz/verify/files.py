"""The other files of a run say the same as result.json."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.spline import Samples
from tubeplan_viz.verify.verification import Check

CSV_HEADER = ["s_mm", "x_mm", "y_mm", "z_mm", "tx", "ty", "tz", "curvature_per_mm", "torsion_per_mm", "clearance_mm"]
SAME_TANGENT = 1e-6
SAME_TORSION = 1e-5  # relative and 1/mm
ROUNDING = 1e4  # torsion is a quotient of products of three derivatives, each with its own rounding
SEAM_MM = 1e-6  # how well a place is known by its arc length; the torsion of a cubic jumps at its knots, both sides are right
CURVE_OFF_MM = 0.1  # the curve's control points may be thinned, but not so far that the curve leaves the path


def check_outputs(result: Mapping[str, Any], folder: Path) -> Iterator[Check]:
    """The bytes of every other file are those that the run wrote."""
    stated = result["provenance"].get("outputs")
    if stated is None:
        return
    faults = []
    for entry in stated:
        try:
            digest = hashlib.sha256((folder / entry["name"]).read_bytes()).hexdigest()
        except OSError as fault:
            faults.append(f"{entry['name']} cannot be read ({(fault.strerror or 'unknown reason').lower()})")
            continue
        if digest != entry["sha256"]:
            faults.append(f"{entry['name']} has been changed")
    known = {entry["name"] for entry in stated} | {"result.json"}
    faults += [f"{name} was added" for name in sorted(entry.name for entry in folder.iterdir()) if name not in known]
    yield Check(
        name="files: digests",
        ok=not faults,
        found="; ".join(faults) or f"{len(stated)} files unchanged",
        expected="the SHA-256 of provenance.outputs for every file",
        text="The files of the folder are byte for byte those that the run wrote.",
    )


def check_table(text: str, result: Mapping[str, Any], samples: Samples) -> Iterator[Check]:
    """path.csv holds the numbers of result.json, and the spline's tangents and torsion."""
    rows = list(csv.reader(text.splitlines()))
    path = result["path"]
    numbers: FloatArray | None = None
    if rows and rows[0] == CSV_HEADER and len(rows) == len(path["s_mm"]) + 1 and all(len(row) == len(CSV_HEADER) for row in rows):
        try:
            numbers = np.array([[float(cell) for cell in row] for row in rows[1:]])
        except ValueError:
            numbers = None
    if numbers is None:
        yield Check(
            name="path.csv: table",
            ok=False,
            found=f"{len(rows)} lines that begin with {', '.join(rows[0][:10]) if rows else 'nothing'}"[:200],
            expected=f"{len(path['s_mm']) + 1} lines of numbers under {', '.join(CSV_HEADER)}",
            text="path.csv is the table of the sampled path.",
        )
        return
    stated = np.column_stack([path["s_mm"], path["points_mm"], path["curvature_per_mm"], path["clearance_mm"]])
    columns = [0, 1, 2, 3, 7, 9]
    differ = np.argwhere(numbers[:, columns] != stated)
    place = f"{CSV_HEADER[columns[differ[0, 1]]]} in line {differ[0, 0] + 2}" if len(differ) else ""
    yield Check(
        name="path.csv: same numbers",
        ok=len(differ) == 0,
        found=f"{len(differ)} numbers differ, first {place}" if len(differ) else f"{stated.size} numbers agree",
        expected="every number as in result.json",
        text="Arc length, points, curvature and clearance of path.csv are those of result.json, to the last digit.",
    )
    yield from _tangent_and_torsion(numbers, samples)


def _tangent_and_torsion(numbers: FloatArray, samples: Samples) -> Iterator[Check]:
    path, s = samples.path, numbers[:, 0]
    piece, t = samples.at_length(s)
    first = path.evaluate(piece, t, 1)
    tangent = first / np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    off = np.linalg.norm(numbers[:, 4:7] - tangent, axis=1)
    yield Check(
        name="path.csv: tangents",
        ok=bool(off.max() <= SAME_TANGENT),
        found=f"{off.max():.2g} off at most, at {s[int(off.argmax())]:.2f} mm",
        expected=f"at most {SAME_TANGENT:g}",
        text="The tangents of path.csv are unit vectors along the spline towards the goal.",
    )
    around = [path.torsion(*samples.at_length(s + shift)) for shift in (-SEAM_MM, 0.0, SEAM_MM)]
    low, high = (choose([torsion for torsion, _ in around], axis=0) for choose in (np.min, np.max))
    slack = SAME_TORSION * (1.0 + np.maximum(np.abs(low), np.abs(high))) + ROUNDING * np.max(
        [noise for _, noise in around], axis=0
    )
    # Near an inflection torsion runs through hundreds of 1/mm within a thousandth of a mm: any value between counts.
    excess = np.maximum(low - numbers[:, 8], numbers[:, 8] - high) - slack
    # Where the path is straight to rounding its torsion is a quotient of noise; there 0 is written.
    curvature = path.curvature(piece, t)
    excess[(numbers[:, 8] == 0.0) & (curvature < 1e-6)] = 0.0
    worst = int(excess.argmax())
    yield Check(
        name="path.csv: torsion",
        ok=bool(excess[worst] <= 0.0),
        found=f"{numbers[worst, 8]:.6g} 1/mm at {s[worst]:.2f} mm",
        expected=f"{path.torsion(piece[[worst]], t[[worst]])[0][0]:.6g} 1/mm",
        text="The torsion of path.csv agrees with that of the spline's derivatives; the largest gap is shown.",
    )


def check_markups(markups: Mapping[str, Any], result: Mapping[str, Any]) -> Iterator[Check]:
    """path.mrk.json draws the path and its features."""
    points = np.array(result["path"]["points_mm"], dtype=float)
    curves = [markup for markup in markups["markups"] if markup.get("type") == "Curve"]
    controls = (
        np.array([control["position"] for control in curves[0]["controlPoints"]], dtype=float)
        if len(curves) == 1
        else np.empty((0, 3))
    )
    rows = {tuple(point): index for index, point in enumerate(points.tolist())}
    order = [rows.get(tuple(control), -1) for control in controls.tolist()]
    ordered = len(order) > 1 and order[0] == 0 and order[-1] == len(points) - 1 and all(a < b for a, b in pairwise(order))
    off = _off_polyline(points, controls, order) if ordered else np.inf
    yield Check(
        name="path.mrk.json: curve",
        ok=bool(ordered and off <= CURVE_OFF_MM),
        found=f"{len(curves)} curves, {order.count(-1)} of {len(order)} points not of the path, {off:.3g} mm off the path",
        expected=f"one curve of the path's own points from end to end, at most {CURVE_OFF_MM} mm off",
        text="The markups curve is the path of result.json.",
    )
    lists = [markup for markup in markups["markups"] if markup.get("type") == "Fiducial"]
    drawn = [list(control["position"]) for markup in lists for control in markup["controlPoints"]]
    stated = [feature["point_mm"] for feature in result["feature_points"] or []]
    yield Check(
        name="path.mrk.json: features",
        ok=drawn == stated,
        found=f"{len(drawn)} points" + ("" if drawn == stated else " that are not all the same"),
        expected=f"the {len(stated)} feature points of result.json",
        text="The markups points are the feature points of result.json, in their order.",
    )


def _off_polyline(points: FloatArray, controls: FloatArray, order: list[int]) -> float:
    segment = np.clip(np.searchsorted(order, np.arange(len(points)), side="right") - 1, 0, len(controls) - 2)
    a, b = controls[segment], controls[segment + 1]
    share = np.einsum("ij,ij->i", points - a, b - a) / np.maximum(np.einsum("ij,ij->i", b - a, b - a), 1e-300)
    return float(np.linalg.norm(points - a - np.clip(share, 0.0, 1.0)[:, None] * (b - a), axis=1).max())
