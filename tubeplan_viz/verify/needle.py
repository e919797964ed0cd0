"""A needle's run checked by other means: its controls integrated as a rate model, its distances measured on dense places.

# Strategy: the pose is integrated with the body twist of Webster's unicycle model by a Runge-Kutta method of order 8
# (the planner uses closed forms), and obstacles are built again from case.toml. The distance to an obstacle changes by no
# more than the way walked, so places `STEP_MM` apart bound it everywhere to half a step.
"""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from segmentation.errors import TubeplanError
from segmentation.images import read_ct
from segmentation.mesh_files import read_surface
from segmentation.volume_files import read_volume_file
from tubeplan_viz.verify.files import CSV_HEADER, check_markups
from tubeplan_viz.verify.page import check_page
from tubeplan_viz.verify.verification import Check
from tubeplan_viz.verify.wall import Lumen, Triangles

STEP_MM = 0.02
SAME_MM = 1e-6
TIP_MM = {"forms": 1e-6, "swarm": 1e-3, "printed": 0.1}
Distance = Callable[[FloatArray], FloatArray]


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
    s, points = integrated(result, result["details"]["controls"])
    yield from check_points(result, s, points)
    yield from check_tip(own, result, points)
    yield from check_bends(result)
    yield from check_distances(folder, case, result, s, points)
    yield from check_insertion(result)
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
    same = rows[:1] == [CSV_HEADER] and [[row[c] for c in (0, 1, 2, 3, 7, 9)] for row in rows[1:]] == stated
    yield Check(
        name="path.csv: same numbers",
        ok=same,
        found="the same" if same else "other numbers",
        expected="every number as in result.json",
        text="Arc length, points, curvature and clearance of path.csv are those of result.json, to the last digit.",
    )
    yield from check_markups(markups, result)


def place(values: Any) -> FloatArray:
    """A place of the case in space: (y, z) is (0, y, z)."""
    return np.array(values if len(values) == 3 else [0.0, *values], dtype=float)


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


def integrated(result: Mapping[str, Any], controls: list[dict[str, float]]) -> tuple[FloatArray, FloatArray]:
    """Arc lengths (n,), mm, and tips (n, 3), mm, by integrating the controls from the entry, `STEP_MM` apart or less."""
    details = result["details"]
    position, frame = np.array(details["entry_mm"], float), np.array(details["entry_frame"], float)
    s, points, done = [0.0], [position], 0.0
    for control in controls:
        c, si = np.cos(control["turn_rad"]), np.sin(control["turn_rad"])
        frame = frame @ np.array([[c, -si, 0.0], [si, c, 0.0], [0.0, 0.0, 1.0]])
        length, k = control["length_mm"], control["curvature_per_mm"]
        spin = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -k], [0.0, k, 0.0]])

        def rate(_: float, state: FloatArray, spin: FloatArray = spin) -> FloatArray:
            turned = state[3:].reshape(3, 3)
            return np.concatenate([turned[:, 2], (turned @ spin).ravel()])

        places = np.linspace(0.0, length, max(int(np.ceil(length / STEP_MM)), 1) + 1)
        start = np.concatenate([position, frame.ravel()])
        path = solve_ivp(rate, (0.0, max(length, 1e-12)), start, method="DOP853", rtol=1e-12, atol=1e-13, t_eval=places).y
        s.extend(done + places[1:])
        points.extend(path[:3, 1:].T)
        position, frame, done = path[:3, -1], path[3:, -1].reshape(3, 3), done + length
    return np.array(s), np.array(points)


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
    allowed = TIP_MM[result["planner"]["method"]]
    yield Check(
        name="tip: on the target",
        ok=error <= allowed and abs(error - result["metrics"]["tip_error_mm"]) <= SAME_MM,
        found=f"{error:.3g} mm, stated {result['metrics']['tip_error_mm']:.3g} mm",
        expected=f"at most {allowed:g} mm, as stated",
        text="The integrated tip ends on the target of the case.",
    )
    off = float(np.linalg.norm(points[0] - place(own["entry"])))
    free = own.get("entry_radius_mm", 0.0)
    yield Check(
        name="entry",
        ok=off <= free + SAME_MM,
        found=f"{off:.4g} mm from the entry of the case",
        expected=f"at most {free:g} mm",
        text="The needle goes in where the case allows it.",
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


def check_insertion(result: Mapping[str, Any]) -> Iterator[Check]:
    """What was pushed in the simulated insertion ends where it is said to end."""
    insertion = result["details"].get("insertion")
    if insertion is None or not insertion["controls"]:
        return
    s, points = integrated(result, insertion["controls"])
    error = float(np.linalg.norm(points[-1] - np.array(insertion["target_mm"], float)))
    yield Check(
        name="insertion: tip and length",
        ok=abs(error - insertion["error_mm"]) <= SAME_MM and abs(s[-1] - insertion["length_mm"]) <= SAME_MM,
        found=f"stated {insertion['error_mm']:.6g} mm from the target after {insertion['length_mm']:.4f} mm",
        expected=f"{error:.6g} mm after {s[-1]:.4f} mm",
        text="The pushes of the insertion, integrated, end where the result says.",
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


def check_distances(
    folder: Path, case: Mapping[str, Any], result: Mapping[str, Any], s: FloatArray, points: FloatArray
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
    for k, row in enumerate(rows):
        try:
            distance = own_distance(row, folder, points)
        except (TubeplanError, OSError) as fault:
            yield Check(
                name=f"obstacle {k + 1}",
                ok=False,
                found=str(fault)[:120],
                expected="a file that can be read",
                text="The obstacle cannot be built again from its file.",
            )
            return
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


def own_distance(row: Mapping[str, Any], folder: Path, points: FloatArray) -> FloatArray:
    """Distance, mm, of (k, 3) points to one obstacle of the case file, negative inside."""
    kind = row["kind"]
    if kind in ("sphere", "circle"):
        return np.asarray(np.linalg.norm(points - place(row["center"]), axis=1) - row["radius_mm"])
    if kind == "capsule":
        return along_lines(points, np.array(row["points"], float), closed=False) - row["radius_mm"]
    if kind == "polygon":
        corners = np.array(row["points"], float)
        gap = along_lines(points[:, 1:], corners, closed=True)
        return np.where(wound(points[:, 1:], corners), -gap, gap)
    file = Path(row["file"])
    file = file if file.is_absolute() else folder.resolve() / file
    if kind == "mesh":
        surface = read_surface(file).surface
        empty = np.zeros((0, 3, 3))
        gap, inside = Lumen(Triangles(surface.vertices[surface.faces]), Triangles(empty)).clearance(points[::10], on_surface=0.0)
        # Every tenth place: up to 5 steps from a place that was left out.
        return np.repeat(np.where(inside, -np.abs(gap), np.abs(gap)) - 5 * STEP_MM, 10)[: len(points)]
    return to_voxels(row, file, points)


def along_lines(points: FloatArray, corners: FloatArray, *, closed: bool) -> FloatArray:
    """Distance of points to a polyline."""
    best = np.full(len(points), np.inf)
    pairs = zip(corners if closed else corners[:-1], np.roll(corners, -1, axis=0) if closed else corners[1:], strict=True)
    for a, b in pairs:
        share = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-300), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return best


def wound(points: FloatArray, corners: FloatArray) -> Any:
    """Whether a polygon goes round points: its corners' directions turn by a whole number of turns that is not 0."""
    way = np.arctan2(corners[:, 1] - points[:, 1:2], corners[:, 0] - points[:, 0:1])
    turns = np.mod(np.diff(way, axis=1, append=way[:, :1]) + np.pi, 2.0 * np.pi) - np.pi
    return np.abs(turns.sum(axis=1)) > np.pi


def to_voxels(row: Mapping[str, Any], file: Path, points: FloatArray) -> FloatArray:
    """Distance to the boxes of the obstacle's voxels: the nearest of all whose centre could be it."""
    if "hu_min" in row:
        volume = read_ct(file).volume
        voxels, matrix = np.asarray(volume.voxels) >= row["hu_min"], volume.index_to_lps
    else:
        labels = read_volume_file(file)
        voxels, matrix = np.asarray(labels.voxels) > 0, labels.index_to_lps
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    inverse = np.linalg.inv(matrix)
    index = points @ inverse[:3, :3].T + inverse[:3, 3]
    centers = np.argwhere(voxels) * spacing
    tree = cKDTree(centers)
    here = index * spacing
    nearest = tree.query(here)[0]
    diagonal = float(np.linalg.norm(spacing))
    found = np.maximum(nearest - 0.5 * diagonal, 0.0)
    # Where that bound is not enough to tell, the boxes themselves.
    for k in np.flatnonzero(found < 3.0 * diagonal):
        near = centers[tree.query_ball_point(here[k], nearest[k] + diagonal)]
        found[k] = np.linalg.norm(np.maximum(np.abs(near - here[k]) - 0.5 * spacing, 0.0), axis=1).min()
    return found
