"""All checks of a folder with instruments against targets."""

# Strategy: every path is measured afresh as that of a run is, and each cell is judged again on these measures: shaft, bends,
# length, and the rigid tip as chords of its length, sampled. What is said to be impossible is held against what proves it: the
# instrument's figures, the straight line, the verifier's own clearance at the narrow place and along every path, and samples
# of the cross-sections of a bend. That no way around a narrow place exists is not proved a second time.

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.result import ResultError, check_schema, shipped_schema
from tubeplan_viz.verify.mesh_file import MeshFile, MeshFileError, read_mesh
from tubeplan_viz.verify.no_path import SLACK, max_circle, room
from tubeplan_viz.verify.profile import ON_SURFACE_MM, SPACING_MM, OwnProfile, measure
from tubeplan_viz.verify.spline import BezierPath
from tubeplan_viz.verify.verification import Check
from tubeplan_viz.verify.wall import Lumen, Triangles

END_MM = 1e-6  # a path's ends are start and target
BOUND_MM, BOUND = 1e-6, 1e-6  # a proved bound is on its side of what is measured; the second relative, of curvatures
LEAST_MM = 2e-3  # the planner closes its bound on the clearance to this
MOST = 1e-2  # relative: it stops at the first bound on the curvature that decides
TIP_MM = 0.06  # it closes the bound on a rigid tip's clearance to 0.05 mm; chords here are sampled
SURE_MM = 0.02  # a path that keeps every limit by this is none to be flagged
TIP_STEP_MM = 0.5  # of the tip's front along the path, and of points along its chord
CHORDS = 8  # so many of those that come to the wall are asked whether they leave the lumen
PLACE_MM = 0.05  # the narrow place is the middle of a triangle of wall samples, whose circle is that much wider at most


@dataclass(frozen=True, eq=False)
class Measured:
    """One path of the matrix with the verifier's own figures."""

    stated: Mapping[str, Any]
    own: OwnProfile
    sweeps: dict[float, Sweep] = field(default_factory=dict)

    @property
    def curvature(self) -> float:
        """Largest curvature, 1/mm."""
        return self.own.curvature_peak

    def tip(self, length: float, near: Corners, *, until: float = np.inf, enough: float = np.inf) -> float:
        """Least clearance of a rigid tip of a length on its way, mm, up to some mm of it; infinite without one.

        What is found to be `enough` is not told any closer.
        """
        if length <= 0.0:
            return np.inf
        if length not in self.sweeps:
            self.sweeps[length] = Sweep.of(self.own, length, near)
        return self.sweeps[length].clearance(self.own.lumen, until=until, enough=enough)


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of the wall's faces, and how far the wall is from them at most: what tells most points clear at once."""

    tree: cKDTree
    reach: float

    @classmethod
    def of(cls, lumen: Lumen) -> Corners:
        """All corners of a wall."""
        corners = lumen.wall.corners
        # No point of a face is farther from its nearest corner than the longest edge is long.
        longest = max(float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(initial=0.0)), 0.0)
        return cls(cKDTree(corners.reshape(-1, 3)), longest)

    def bounds(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the distance to the wall lies between, mm."""
        above = np.asarray(self.tree.query(points)[0])
        return np.maximum(above - self.reach, 0.0), above


def check_matrix(folder: Path, document: Mapping[str, Any]) -> Iterator[Check]:
    """Every claim of matrix.json, held against the folder's mesh and table."""
    try:
        check_schema(
            document,
            shipped_schema("tubeplan_viz.instruments", "matrix"),
            name="matrix",
            remedy="make it again",
            error=ResultError,
        )
    except ResultError as fault:
        yield Check(name="schema", ok=False, found="not valid", expected="matrix.schema.json", text=f"{fault}.")
        return
    yield from check_tally(document)
    yield from check_csv(folder, document)
    try:
        mesh = read_mesh(folder / "mesh.ply")
    except MeshFileError as fault:
        yield Check(name="mesh.ply", ok=False, found="not readable", expected="a binary PLY of triangles", text=f"{fault}.")
        return
    lumen = lumen_of(mesh, closed=bool(document["provenance"]["settings"].get("planner", {}).get("closed_ends", False)))
    paths = [[Measured(one, measured(one, lumen)) for one in column] for column in document["paths"]]
    yield check_paths(document, paths)
    yield check_cells(document, paths, lumen)
    yield check_advances(document, paths, lumen)
    yield check_impossible(document, paths, lumen)
    yield check_bends(document, lumen)


def lumen_of(mesh: MeshFile, *, closed: bool) -> Lumen:
    """The surface as the matrix counts it: the faces of caps come last, as many as the header says, and are no wall."""
    corners = mesh.vertices[mesh.faces]
    caps = 0 if closed else sum(int(line.split()[1]) for line in mesh.comments if line.split(" ")[0] == "cap")
    wall = len(corners) - caps
    return Lumen(Triangles(corners[:wall]), Triangles(corners[wall:]))


def measured(path: Mapping[str, Any], lumen: Lumen) -> OwnProfile:
    """A path of matrix.json along its spline."""
    spline = path["spline"]
    control = np.array(spline["control_points_mm"], dtype=float)
    return measure(BezierPath.from_spline(int(spline["degree"]), np.array(spline["knots"], dtype=float), control), lumen)


@dataclass(frozen=True, eq=False)
class Sweep:
    """Chords of one length with both ends on a path: places of their fronts, points along them, and bounds of the clearance.

    A chord that is not yet wholly on the path begins at its start.
    """

    front: FloatArray
    along: FloatArray
    least: FloatArray
    most: FloatArray

    @classmethod
    def of(cls, own: OwnProfile, length: float, near: Corners) -> Sweep:
        """The chords of a path at every half millimetre and at its end."""
        s, first = np.unique(own.samples.s, return_index=True)
        points = own.samples.points[first]
        front = np.append(np.arange(0.0, s[-1], TIP_STEP_MM), s[-1])
        ahead = np.minimum(np.searchsorted(s, front), len(s) - 1)
        behind = np.zeros_like(ahead)
        for number, k in enumerate(ahead):
            far = np.flatnonzero(np.linalg.norm(points[: k + 1] - points[k], axis=1) >= length)
            behind[number] = far[-1] if len(far) else 0
        share = np.linspace(0.0, 1.0, max(int(np.ceil(length / TIP_STEP_MM)), 2) + 1)
        along = points[ahead][:, None] + share[:, None] * (points[behind] - points[ahead])[:, None]  # (chords, places, 3)
        least, most = (bound.reshape(along.shape[:2]) for bound in near.bounds(along.reshape(-1, 3)))
        # The path beside the chord, whose clearance is known, tells more: it is no farther from the wall than that and the gap.
        beside = np.rint(ahead[:, None] + share * (behind - ahead)[:, None]).astype(int)
        gap, free = np.linalg.norm(along - points[beside], axis=2), np.abs(own.clearance[first])[beside]
        return cls(front, along, np.maximum(least, free - gap), np.minimum(most, free + gap))

    def clearance(self, lumen: Lumen, *, until: float = np.inf, enough: float = np.inf) -> float:
        """Least clearance of the chords up to a place, mm, no closer than `enough`; 0 where one of them leaves the lumen."""
        # The sample at a front lies up to its spacing beyond it.
        before = self.front + SPACING_MM <= until
        before[0] = True
        along, free = self.along[before], self.least[before].copy()
        asked = free <= min(float(self.most[before].min()), enough)
        free[asked] = lumen.wall.distance(along[asked])
        # Between neighbours whose balls without wall meet there is no wall: the chord stays where it begins, inside.
        apart = np.linalg.norm(np.diff(along, axis=1), axis=2)
        doubtful = np.flatnonzero((free[:, 1:] + free[:, :-1] <= apart).any(axis=1))
        leaving = doubtful[np.linspace(0, len(doubtful) - 1, min(CHORDS, len(doubtful))).astype(int)]
        if len(leaving) and not lumen.clearance(along[leaving].reshape(-1, 3), on_surface=ON_SURFACE_MM)[1].all():
            return 0.0
        return float(free.min())


def tip_clearance(own: OwnProfile, length: float, near: Corners) -> float:
    """Least clearance of chords of a length with both ends on the path, mm; 0 where one of them leaves the lumen."""
    return Sweep.of(own, length, near).clearance(own.lumen)


def told(faults: list[str], count: int, what: str) -> str:
    """The first faults, or how many were held against what they claim."""
    return (
        "; ".join(faults[:4]) + (f"; and {len(faults) - 4} more" if len(faults) > 4 else "")
        if faults
        else f"{count} {what} agree"
    )


def check_tally(document: Mapping[str, Any]) -> Iterator[Check]:
    """Counts and the verdict of the whole."""
    cells = [cell for row in document["cells"] for cell in row]
    shape = {len(row) for row in document["cells"]} == {len(document["targets"])} and len(document["cells"]) == len(
        document["instruments"]
    )
    counts = {name: sum(cell["verdict"] == name for cell in cells) for name in ("feasible", "flagged", "impossible")}
    status = "ok" if counts["feasible"] == len(cells) else "infeasible" if all(c["path"] is None for c in cells) else "flagged"
    yield Check(
        name="verdicts: counted",
        ok=shape and counts == document["counts"] and status == document["status"],
        found=f"{document['counts']}, {document['status']}",
        expected=f"{counts}, {status}",
        text="One cell for each instrument and target, counted by verdict.",
    )


def cells_of(document: Mapping[str, Any]) -> Iterator[tuple[Mapping[str, Any], int, Mapping[str, Any]]]:
    """Every cell with its instrument and the number of its target."""
    for one, row in zip(document["instruments"], document["cells"], strict=True):
        for j, (_, cell) in enumerate(zip(document["targets"], row, strict=True)):
            yield one, j, cell


def check_csv(folder: Path, document: Mapping[str, Any]) -> Iterator[Check]:
    """matrix.csv says what matrix.json says."""
    faults = []
    try:
        with (folder / "matrix.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        pairs = [(one, document["targets"][j], cell) for one, j, cell in cells_of(document)]
        if len(rows) != len(pairs):
            faults.append(f"{len(rows)} rows instead of {len(pairs)}")
        for number, (row, (one, target, cell)) in enumerate(zip(rows, pairs, strict=False), start=2):
            stated = {"instrument": one["name"], "target": target["label"], **{key: cell[key] for key in row if key in cell}}
            faults += [f"line {number}: {key} is {row[key]!r}" for key, value in stated.items() if not same(row[key], value)]
    except (OSError, ValueError, KeyError) as fault:
        faults.append(f"cannot be read ({type(fault).__name__})")
    yield Check(
        name="matrix.csv",
        ok=not faults,
        found=told(faults, len(document["cells"]), "rows of cells"),
        expected="the verdicts and figures of matrix.json",
        text="The table holds a line for each cell.",
    )


def same(text: str, value: Any) -> bool:
    """Whether a cell of the table says what stands in the document."""
    if value is None or isinstance(value, str):
        return text == (value or "")
    return abs(float(text) - float(value)) <= 1e-9 * max(abs(float(value)), 1.0)


def check_paths(document: Mapping[str, Any], paths: list[list[Measured]]) -> Check:
    """Ends, length, clearance, curvature and proved bounds of every path."""
    faults = []
    start = np.array(document["start_mm"], dtype=float)
    for target, column in zip(document["targets"], paths, strict=True):
        for number, path in enumerate(column):
            own, stated, points = path.own, path.stated, path.own.samples.points
            gaps = np.linalg.norm(points[[0, -1]] - np.array([start, target["point_mm"]]), axis=1)
            length, least, bound = (stated[key] for key in ("length_mm", "clearance_min_mm", "clearance_lower_bound_mm"))
            most, above = stated["curvature_max_per_mm"], stated["curvature_upper_bound_per_mm"]
            claims = {
                f"its ends lie {gaps.max():.3g} mm off": gaps.max() <= END_MM,
                "it leaves the lumen": bool(own.inside.all()),
                f"its length is {own.length:.4f} mm": abs(own.length - length) <= 1e-6 * own.length,
                f"its clearance falls to {own.clearance_least:.4f} mm": -BOUND_MM <= least - own.clearance_least <= LEAST_MM,
                f"it is not proved to keep {bound:.4f} mm": bound <= own.clearance_least + BOUND_MM,
                f"its curvature rises to {own.curvature_peak:.5f} 1/mm": abs(most - path.curvature)
                <= MOST * path.curvature + 1e-6,
                f"it bends more than {above:.5f} 1/mm": above >= path.curvature * (1.0 - BOUND) - 1e-9,
            }
            faults += [f"{target['label']}, path {number}: {words}" for words, holds in claims.items() if not holds]
    return Check(
        name="paths: measured",
        ok=not faults,
        found=told(faults, sum(map(len, paths)), "paths"),
        expected="ends at start and target, inside the lumen, with the figures and bounds stated",
        text="Every path, measured between its samples too.",
    )


def check_cells(document: Mapping[str, Any], paths: list[list[Measured]], lumen: Lumen) -> Check:
    """Every cell with a path, judged again."""
    faults, count = [], 0
    near = Corners.of(lumen)
    tips: dict[tuple[int, int, float], float] = {}
    rows = {one["name"]: (one, row) for one, row in zip(document["instruments"], document["cells"], strict=True)}
    for one, row in rows.values():
        required, length = 0.5 * one["outer_diameter_mm"], one["rigid_tip_mm"]
        for j, (target, cell) in enumerate(zip(document["targets"], row, strict=True)):
            if cell["path"] is None:
                if cell["verdict"] == "feasible":
                    faults.append(f"{one['name']}, {target['label']}: said to hold without a path")
                continue
            count += 1
            path = paths[j][cell["path"]]
            if (j, cell["path"], length) not in tips:
                tips[j, cell["path"], length] = path.tip(length, near)
            tip = tips[j, cell["path"], length]
            least = min(path.own.clearance_least, tip)
            other = rows.get(cell["inferred_from"])
            claims = {
                f"{required:g} mm are required": abs(cell["required_mm"] - required) <= 1e-12,
                f"its clearance is {least:.3f} mm": cell["inferred_from"] is not None
                # How far a tip stands out of the lumen is told roughly, and is not asked here.
                or abs(max(cell["available_mm"], 0.0) - max(least, 0.0))
                <= (LEAST_MM if tip > path.own.clearance_least else TIP_MM),
                "margin and clearance differ": abs(cell["margin_mm"] - (cell["available_mm"] - required)) <= 1e-9,
            }
            spare = min(
                least - required,
                (1.0 - path.curvature * one["bend_radius_min_mm"]) * one["bend_radius_min_mm"],
                one["working_length_mm"] - path.own.length - document["before_start_mm"],
            )
            if cell["verdict"] == "feasible" and cell["inferred_from"] is None:
                claims[f"it keeps its limits by {spare:.4f} mm"] = spare >= -BOUND_MM
            elif cell["verdict"] == "feasible":
                claims[f"{cell['inferred_from']} is no harder, or does not reach it"] = other is not None and harder(
                    other[0], one, other[1][j], cell
                )
            else:
                claims[f"it is flagged though it keeps every limit by {spare:.3f} mm"] = spare <= SURE_MM
            faults += [f"{one['name']}, {target['label']}: {words}" for words, holds in claims.items() if not holds]
    return Check(
        name="cells: judged on their paths",
        ok=not faults,
        found=told(faults, count, "cells"),
        expected="the verdict that shaft, bends, length and rigid tip give",
        text="Every instrument on its path; of a rigid tip, chords at every half millimetre.",
    )


def check_advances(document: Mapping[str, Any], paths: list[list[Measured]], lumen: Lumen) -> Check:
    """How far every instrument comes that does not hold: the beginning of its path, measured."""
    faults, count = [], 0
    near = Corners.of(lumen)
    for one, j, cell in cells_of(document):
        target, required = document["targets"][j], 0.5 * one["outer_diameter_mm"]
        keys = ("reached_mm", "reached_point_mm", "short_mm", "reached_path")
        if cell["reached_path"] is None or cell["verdict"] == "feasible":
            if any(cell[key] is not None for key in keys):
                faults.append(f"{one['name']}, {target['label']}: a place on the way, and no way or the target itself")
            continue
        count += 1
        path, reached = paths[j][cell["reached_path"]], cell["reached_mm"]
        own, s = path.own, path.own.samples.s
        before = s <= reached
        least = min(float(own.clearance[before].min()), path.tip(one["rigid_tip_mm"], near, until=reached, enough=required))
        bent = float(own.curvature[before].max())
        point = np.array([np.interp(reached, s, own.samples.points[:, k]) for k in range(3)])
        claims = {
            f"its clearance falls to {least:.3f} mm before": least >= required - BOUND_MM,
            f"its curvature rises to {bent:.4f} 1/mm before": bent * one["bend_radius_min_mm"] <= 1.0 + BOUND,
            "the working length ends before": reached + document["before_start_mm"] <= one["working_length_mm"] + BOUND_MM,
            f"{own.length - reached:.4f} mm are left": abs(own.length - reached - cell["short_mm"]) <= 1e-6 * own.length,
            # Between samples 0.04 mm apart a line for the curve; arc lengths agree to a millionth.
            "the place is not on the path": np.linalg.norm(point - np.array(cell["reached_point_mm"])) <= 1e-3,
        }
        faults += [f"{one['name']}, {target['label']}: {words}" for words, holds in claims.items() if not holds]
    return Check(
        name="cells: how far",
        ok=not faults,
        found=told(faults, count, "cells"),
        expected="every limit kept up to the place stated, and what is left of the path from there",
        text="How far an instrument comes that does not hold.",
    )


def harder(other: Mapping[str, Any], one: Mapping[str, Any], others: Mapping[str, Any], cell: Mapping[str, Any]) -> bool:
    """Whether an instrument that holds by itself on the same path can take no shape that the other cannot."""
    keys = ("outer_diameter_mm", "bend_radius_min_mm", "rigid_tip_mm")
    no_easier = all(other[key] >= one[key] for key in keys) and other["working_length_mm"] <= one["working_length_mm"]
    return no_easier and others["verdict"] == "feasible" and others["inferred_from"] is None and others["path"] == cell["path"]


def check_impossible(document: Mapping[str, Any], paths: list[list[Measured]], lumen: Lumen) -> Check:
    """What is said to keep an instrument out: its own figures, and where they come from."""
    faults, count = [], 0
    start = np.array(document["start_mm"], dtype=float)
    for j, target in enumerate(document["targets"]):
        ceiling, place = target["ceiling_mm"], np.array(target["ceiling_point_mm"], dtype=float)
        there = float(lumen.clearance(place[None], on_surface=ON_SURFACE_MM)[0][0])
        if there > ceiling + PLACE_MM:
            faults.append(f"{target['label']}: {there:.3f} mm at the narrow place")
        faults += [
            f"{target['label']}: a path keeps {path.own.clearance_least:.3f} mm, more than the ceiling"
            for path in paths[j]
            if path.own.inside.all() and path.own.clearance_least > ceiling + BOUND_MM
        ]
        away = float(np.linalg.norm(np.array(target["point_mm"]) - start)) + document["before_start_mm"]
        for one, row in zip(document["instruments"], document["cells"], strict=True):
            cell, required = row[j], 0.5 * one["outer_diameter_mm"]
            if cell["verdict"] != "impossible":
                continue
            count += 1
            if cell["bend"] is not None:
                bend = document["bends"][j][cell["bend"]]
                left = bend["clearance_upper_bound_mm"]
                out = required >= left and 1.0 / one["bend_radius_min_mm"] <= bend["curvature_max_per_mm"] * (1.0 + 1e-12)
            else:
                left = ceiling
                out = required > ceiling or one["working_length_mm"] < away
            if not out or abs(cell["margin_mm"] - (left - required)) > 1e-9 or cell["path"] is not None:
                faults.append(f"{one['name']}, {target['label']}: {required:g} mm where {left:.4f} mm are left")
    return Check(
        name="cells: impossible",
        ok=not faults,
        found=told(faults, count, "cells"),
        expected="more is required than is left, or the straight way is longer than the instrument; no path keeps more",
        text="What keeps instruments out is there, and no path refutes it. "
        "That there is no way around a narrow place is not proved again.",
    )


def check_bends(document: Mapping[str, Any], lumen: Lumen) -> Check:
    """Every bend that keeps instruments out, by samples of its cross-sections."""
    faults, count = [], 0
    for target, bends in zip(document["targets"], document["bends"], strict=True):
        for bend in bends:
            count += 1
            limit, bound = bend["curvature_max_per_mm"], bend["clearance_upper_bound_mm"]
            largest = max_circle([room(section, lumen, bound) for section in bend["sections"]])
            if largest > (1.0 + SLACK) / limit:
                faults.append(
                    f"{target['label']}: a circle of {largest:.3f} mm passes where {1.0 / limit:.3f} mm are said to be too much"
                )
    return Check(
        name="cells: bends",
        ok=not faults,
        found=told(faults, count, "bends"),
        expected="no circle through neighbouring cross-sections, with the clearance stated, as large as the bend radius",
        text="Bends that are said to be too sharp.",
    )
