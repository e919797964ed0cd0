"""An airway's measures computed again: generations, lengths, diameters and angles, from its branches' lines and mesh.ply."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.hollow import Planes, at, lengths
from tubeplan_viz.verify.measures_compared import Items, compared, degrees
from tubeplan_viz.verify.verification import Check

EDGE_MM = (-0.6, 4.0)  # a diameter's share of two edges of up to 2 mm


def check_airway(items: Items, lines: Mapping[str, FloatArray], planes: Planes) -> Iterator[Check]:
    """Generations, lengths, diameters and angles of an airway, from its branches' lines."""
    branches = {int(name.split()[1]): line for name, line in lines.items() if name.startswith("branch ")}
    parts = {of: int(of.split()[1]) for key, of in items if key == "generation"}
    parents = {number: parent_of(number, branches) for number in branches}
    generations = {number: generation_of(number, parents) for number in branches}
    rows: dict[str, list[tuple[str, float, float]]] = {"generation": [], "length": [], "diameter": [], "angle": []}
    for of, number in parts.items():
        line = branches.get(number)
        if line is None:
            rows["generation"].append((of, items["generation", of], np.nan))
            continue
        rows["generation"].append((of, items["generation", of], float(generations[number])))
        whole = float(lengths(line)[-1])
        rows["length"].append((of, items["branch_length_mm", of], whole))
        if ("branch_diameter_mm", of) in items:
            rows["diameter"].append((of, items["branch_diameter_mm", of], median_width(planes, line)))
        if ("branch_angle_deg", of) in items and parents[number] >= 0:
            turn = turn_between(branches[parents[number]], line, planes)
            # A branch shorter than it is wide has no direction and no section of its own to measure with.
            if np.isfinite(turn) and whole > median_width(planes, line):
                rows["angle"].append((of, items["branch_angle_deg", of], turn))
    # An airway's mesh stands at its growing limit, inside the edge in the CT by much the same in all branches.
    off = float(np.median([stated - mine for _, stated, mine in rows["diameter"]])) if rows["diameter"] else 0.0
    if ("trachea_diameter_mm", "") in items and 0 in branches:
        rows["diameter"].append(("the trachea", items["trachea_diameter_mm", ""], median_diameter(planes, branches[0])))
    if rows["diameter"]:
        yield Check(
            name="measures: airway edge",
            ok=EDGE_MM[0] <= off <= EDGE_MM[1],
            found=f"diameters {off:.2f} mm above those of mesh.ply",
            expected=f"{EDGE_MM[0]:g} to {EDGE_MM[1]:g} mm",
            text="The edge in the CT that diameters were measured to lies at the mesh or a voxel outside it.",
        )
    rows["diameter"] = [(of, stated, mine + off) for of, stated, mine in rows["diameter"]]
    limits = {"generation": (0.0, "branchings"), "length": (0.3, "mm"), "diameter": (1.0, "mm"), "angle": (8.0, "°")}
    for kind, found in rows.items():
        if found:
            limit, unit = limits[kind]
            text = f"The {kind} of every branch is that of its line in mesh.ply."
            yield compared(f"airway {kind}s", found, limit, unit, text)


def parent_of(number: int, branches: Mapping[int, FloatArray]) -> int:
    """The branch at whose end a branch begins; -1 for the first."""
    ends = {other: float(np.linalg.norm(line[-1] - branches[number][0])) for other, line in branches.items() if other != number}
    nearest = min(ends, key=lambda other: ends[other], default=-1)
    return nearest if nearest >= 0 and ends[nearest] <= 0.05 else -1


def generation_of(number: int, parents: Mapping[int, int]) -> int:
    """How many branchings lie before a branch."""
    count = 0
    while parents[number] >= 0 and count <= len(parents):
        number, count = parents[number], count + 1
    return count


def median_diameter(planes: Planes, line: FloatArray) -> float:
    """Median section of the middle half of a line, mm."""
    whole = float(lengths(line)[-1])
    found = planes.diameters(line, np.linspace(0.25, 0.75, 9) * whole)
    return float(np.median(found)) if len(found) else np.nan


def median_width(planes: Planes, line: FloatArray) -> float:
    """Median chord of the middle half of a line, mm."""
    found = planes.chords(line, np.linspace(0.25, 0.75, 9) * float(lengths(line)[-1]))
    return float(np.median(found)) if len(found) else np.nan


def ball_radius(planes: Planes, line: FloatArray, places: Iterable[float]) -> float:
    """Median over places of a line of the distance to the nearest wall in its plane, mm."""
    found = [planes.radii(at(line, s), at(line, s + 1.5) - at(line, s - 1.5)) for s in places]
    least = [float(radii.min()) for radii in found if radii is not None]
    return float(np.median(least)) if least else np.nan


def turn_between(parent: FloatArray, child: FloatArray, planes: Planes) -> float:
    """Angle between a parent's line one to three radii before its end and a child's beyond its first radius, degrees."""
    whole, reach = float(lengths(parent)[-1]), float(lengths(child)[-1])
    radius = ball_radius(planes, parent, [whole, whole - 0.5, whole - 1.0, 0.9 * whole])
    own = ball_radius(planes, child, np.linspace(0.1, 0.9, 7) * reach)
    if not np.isfinite(radius + own):
        return np.nan
    begin, end = max(whole - 3.0 * radius, 0.0), max(whole - radius, 0.2 * whole)
    low = min(radius, 0.5 * reach)
    return degrees(at(parent, end) - at(parent, begin), at(child, min(low + 2.0 * own, reach)) - at(child, low))
