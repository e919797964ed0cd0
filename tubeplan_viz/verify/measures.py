"""Clinical measures computed again from mesh.ply, the path and the middle lines of result.json.

# Strategy: the product measures by balls found with a distance query, and by edges in the CT. Here the hollow is filled
# with voxels, whose distance transform gives pelvis and lips, and cross-sections come from rays in a plane of the mesh.
# Mesh and CT differ by up to half a millimetre a side where organs lie side by side, and voxels are 0.5 mm: the limits
# below are what that makes of each measure, and are stated in each check.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.hollow import Filled, Planes, at, filled, lengths
from tubeplan_viz.verify.measure_words import check_scores, check_stones
from tubeplan_viz.verify.mesh_file import MeshFile
from tubeplan_viz.verify.profile import OwnProfile
from tubeplan_viz.verify.verification import Check

LIMITS = {"°": 3.0, "length": 1.0, "width": 0.8, "ball": 1.0}  # degrees, mm
SHARE = 0.002  # of a path's own measures, which need no image
PELVIS_SHARE = 0.85
# A calyx's bottom lies on the CT's edge, which partial volume sets off the mesh by about a voxel's diagonal at most.
WALL_MM = 1.6
PARTED_MM = 0.5  # where two calyces' ways part, within the mesh's own error
EDGE_MM = (-0.6, 4.0)  # a diameter's share of two edges of up to 2 mm
CORONAL = np.array([1.0, 0.0, 1.0])
Items = Mapping[tuple[str, str], float]


def check_measures(result: Mapping[str, Any], case: Mapping[str, Any] | None, mesh: MeshFile, own: OwnProfile) -> Iterator[Check]:
    """All checks of ``details.measures``; none for a run without it."""
    told = result["details"].get("measures")
    if not told:
        return
    items = {(item["key"], item["of"]): item["value"] for item in told["items"] if item["value"] is not None}
    yield from check_path_measures(items, result, own)
    if told["drawing"] is not None:
        lines = {name: np.array(line, float) for name, line in told["drawing"]["lines"].items()}
        points = {name: np.array(point, float) for name, point in told["drawing"]["points"].items()}
        corners = mesh.vertices[mesh.faces]
        if any(key == "generation" for key, _ in items):
            yield from check_airway(items, lines, Planes(corners))
        else:
            level = float(((case or {}).get("measures") or {}).get("ureter_level_mm", 40.0))
            yield from check_urinary(items, lines, points, filled(corners), Planes(corners), level, result["frame"])
    yield from check_stones(items)
    yield from check_scores(told, items)


def compared(name: str, pairs: Iterable[tuple[str, float, float]], limit: float, unit: str, text: str) -> Check:
    """One check of stated values against own ones, as (part, stated, own); the worst is told."""
    rows = list(pairs)
    part, stated, mine = max(rows, key=lambda row: abs(row[1] - row[2]) if np.isfinite(row[2]) else np.inf)
    return Check(
        name=f"measures: {name}",
        ok=bool(abs(stated - mine) <= limit),
        found=f"{stated:.3g} {unit} stated{f' of {part}' if part else ''}, {len(rows)} compared",
        expected=f"{mine:.3g} {unit} within {limit:.2g}",
        text=text,
    )


def check_path_measures(items: Items, result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    """Tortuosity, bending and the sharpest place, from the spline's own samples."""
    samples = own.samples
    points, s = samples.points, samples.s
    straight = float(np.linalg.norm(points[-1] - points[0]))
    mine = {
        "tortuosity": float(s[-1]) / straight if straight > 0.0 else np.nan,
        "total_bending_deg": float(np.degrees(np.trapezoid(own.curvature, s))),
        "bend_radius_min_mm": 1.0 / own.curvature_peak if own.curvature_peak > 0.0 else np.nan,
    }
    for key, value in mine.items():
        if (key, "") in items:
            yield compared(
                key, [("", items[key, ""], value)], SHARE * abs(value) + 1e-3, "", "A measure of the path is that of its spline."
            )
    if ("bend_radius_min_at_mm", "") in items:
        there = float(np.interp(items["bend_radius_min_at_mm", ""], s, own.curvature))
        yield compared(
            "bend_radius_min_at_mm",
            [("", there, own.curvature_peak)],
            0.02 * own.curvature_peak,
            "1/mm",
            "The spline is as curved at the place of the least bend radius as anywhere.",
        )


def check_urinary(
    items: Items,
    lines: Mapping[str, FloatArray],
    points: Mapping[str, FloatArray],
    hollow: Filled,
    planes: Planes,
    level: float,
    frame: str,
) -> Iterator[Check]:
    """Angles, lengths and widths of a collecting system."""
    ways = {name.removeprefix("way to "): line for name, line in lines.items() if name.startswith("way to ")}
    depth = min((float(hollow.at(hollow.depth, line[1:-1]).min()) for line in ways.values() if len(line) > 2), default=0.0)
    yield Check(
        name="measures: middle lines",
        ok=bool(ways) and depth > 0.0,
        found=f"{len(ways)} lines, the nearest place {depth:.2f} mm from the wall",
        expected="at least one, all of it inside the lumen",
        text="The middle lines that were measured along run inside mesh.ply.",
    )
    center, outside, radius = hollow.wide(points.get("pelvis", np.zeros(3)), PELVIS_SHARE)
    if ("pelvis_diameter_mm", "") in items:
        yield compared(
            "pelvis_diameter_mm",
            [("", items["pelvis_diameter_mm", ""], 2.0 * radius)],
            LIMITS["ball"],
            "mm",
            "The largest ball of the voxels inside mesh.ply is as large as stated.",
        )
    groups = groups_of(items, ways)
    made: dict[str, list[tuple[str, float, float]]] = {"angle": [], "coronal angle": [], "width": [], "length": [], "calyx": []}
    for name, labels in groups.items():
        of = f"{name} infundibulum"
        way = max((ways[label] for label in labels), key=lambda line: float(lengths(line)[-1]))
        lip = lip_of(way, hollow, outside)
        if lip is None:
            continue
        end = parting(way, [ways[label] for label in labels], lip, hollow)
        down = down_of(way, center, level)
        axis = direction([at(way, s) for s in np.linspace(lip, max(end, lip + 8.0), 33)])
        if ("infundibulopelvic_angle_deg", of) in items and down is not None:
            made["angle"].append((of, items["infundibulopelvic_angle_deg", of], degrees(down, axis)))
        if ("infundibulopelvic_angle_coronal_deg", of) in items and down is not None and frame == "LPS":
            made["coronal angle"].append(
                (of, items["infundibulopelvic_angle_coronal_deg", of], degrees(down * CORONAL, axis * CORONAL))
            )
        if ("infundibular_width_mm", of) in items:
            found = planes.diameters(way, np.arange(lip, max(end, lip + 1.0), 1.0))
            made["width"].append((of, items["infundibular_width_mm", of], float(found.min()) if len(found) else np.nan))
        for label in labels:
            part = f"calyx {label}, {name}"
            bottom = points.get(f"bottom of {label}")
            if ("infundibular_length_mm", part) in items:
                whole = np.nan if bottom is None else float(np.linalg.norm(bottom - at(ways[label], lip)))
                made["length"].append((part, items["infundibular_length_mm", part], whole))
            if ("calyx_diameter_mm", part) in items:
                last = float(lengths(ways[label])[-1])
                begin = last - 0.5 * (last - (end if len(labels) > 1 else lip))
                found = planes.chords(ways[label], np.arange(begin, last, 0.5))
                made["calyx"].append((part, items["calyx_diameter_mm", part], float(found.max()) if len(found) else np.nan))
    texts = {
        "angle": ("°", "°", "The angle between the ureter and the middle line of the infundibulum is as stated."),
        "coronal angle": ("°", "°", "The same angle from the front is as stated."),
        "width": ("width", "mm", "The narrowest section of mesh.ply between lip and parting is as wide as stated."),
        "length": ("length", "mm", "From the lip that the voxels show to the bottom of the calyx it is as far as stated."),
        "calyx": ("ball", "mm", "The calyx is as wide in mesh.ply as stated."),
    }
    for kind, rows in made.items():
        if rows:
            limit, unit, text = texts[kind]
            yield compared(f"{kind} of infundibula" if kind != "calyx" else "calyx diameters", rows, LIMITS[limit], unit, text)
    yield from check_bottoms(points, hollow)
    yield from check_ureter(items, ways, planes, outside, hollow)


def check_bottoms(points: Mapping[str, FloatArray], hollow: Filled) -> Iterator[Check]:
    """Bottoms of calyces lie on the wall."""
    bottoms = {name: point for name, point in points.items() if name.startswith("bottom of ")}
    if not bottoms:
        return
    # A grid point within reach that is outside, and one that is inside: the wall passes between.
    off = {
        name: max(reach_to(hollow, point, inside=True), reach_to(hollow, point, inside=False)) for name, point in bottoms.items()
    }
    worst = max(off, key=lambda name: off[name])
    yield Check(
        name="measures: bottoms on the wall",
        ok=off[worst] <= WALL_MM,
        found=f"{off[worst]:.2f} mm ({worst})",
        expected=f"at most {WALL_MM:g} mm",
        text="Every stated bottom of a calyx lies at the wall of mesh.ply.",
    )


def reach_to(hollow: Filled, point: FloatArray, *, inside: bool) -> float:
    """Distance from a place to the nearest voxel of one kind, mm; infinite beyond 5 mm."""
    steps = np.arange(-10, 11)
    around = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3) * 0.5
    held = hollow.at((hollow.depth > 0.0).astype(float), point + around) > 0.5
    away = np.linalg.norm(around[held == inside], axis=1)
    return float(away.min()) if len(away) else np.inf


def check_ureter(
    items: Items, ways: Mapping[str, FloatArray], planes: Planes, outside: FloatArray, hollow: Filled
) -> Iterator[Check]:
    """Mean and least diameter of the ureter below the pelvis."""
    if ("ureter_diameter_mean_mm", "") not in items or not ways:
        return
    way = max(ways.values(), key=lambda line: float(hollow.at(hollow.depth, line).max()))
    entered = np.flatnonzero(hollow.at(outside, way) <= 0.0)
    if not len(entered):
        return
    along, deep = lengths(way), hollow.at(hollow.depth, way)
    before = np.arange(len(way)) < entered[0]
    narrow = np.flatnonzero(before & (deep <= 0.5 * hollow.depth.max()))
    if not len(narrow):
        return
    last = float(along[narrow[-1]])
    found = planes.diameters(way, np.arange(2.0, max(last - 2.0, 4.0), 1.0))
    text = "The ureter's sections in mesh.ply are as wide as stated."
    for key, mine in (("ureter_diameter_mean_mm", found.mean()), ("ureter_diameter_min_mm", found.min())):
        if (key, "") in items:
            yield compared(key, [("", items[key, ""], float(mine))], LIMITS["width"], "mm", text)


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


def groups_of(items: Items, ways: Mapping[str, FloatArray]) -> dict[str, list[str]]:
    """Labels of the calyces of each infundibulum, from the names of the lengths."""
    groups: dict[str, list[str]] = {}
    for key, of in items:
        if key in ("infundibular_length_mm", "calyx_diameter_mm") and of.startswith("calyx "):
            label, _, name = of.removeprefix("calyx ").partition(", ")
            if label in ways and label not in groups.setdefault(name, []):
                groups[name].append(label)
    return groups


def lip_of(way: FloatArray, hollow: Filled, outside: FloatArray) -> float | None:
    """Arc length at which a way leaves the pelvis for good, mm; None where it does not pass it."""
    level = hollow.at(outside, way)
    inside = np.flatnonzero(level <= 0.0)
    if not len(inside) or inside[-1] == len(way) - 1:
        return None
    k = int(inside[-1])
    along = lengths(way)
    return float(along[k] + level[k] / (level[k] - level[k + 1]) * (along[k + 1] - along[k]))


def parting(way: FloatArray, group: list[FloatArray], lip: float, hollow: Filled) -> float:
    """Arc length at which the ways of a group part; at the widest place of the far half where there is but one."""
    along = lengths(way)
    if len(group) > 1:
        apart = [
            float(along[k])
            for other in group
            if other is not way
            for k in np.flatnonzero(np.linalg.norm(way[:, None] - other, axis=2).min(axis=1) > PARTED_MM)[:1]
        ]
        return min(apart, default=float(along[-1]))
    far = along >= 0.5 * (lip + along[-1])
    return float(along[far][hollow.at(hollow.depth, way[far]).argmax()])


def down_of(way: FloatArray, center: FloatArray, level: float) -> FloatArray | None:
    """From the centre of the pelvis to the way's last place `level` mm from it on the ureter's side, (3,) mm."""
    away = np.linalg.norm(way - center, axis=1)
    before = np.flatnonzero(away[: away.argmin() + 1] >= level)
    return way[before[-1]] - center if len(before) else None


def direction(points: list[FloatArray]) -> FloatArray:
    """Main direction of points from the first to the last, (3,)."""
    cloud = np.array(points)
    spread = cloud - cloud.mean(axis=0)
    axis = np.linalg.eigh(spread.T @ spread)[1][:, -1]
    return np.asarray(axis if axis @ (cloud[-1] - cloud[0]) >= 0.0 else -axis)


def degrees(one: FloatArray, other: FloatArray) -> float:
    """Angle between two vectors, degrees."""
    cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
