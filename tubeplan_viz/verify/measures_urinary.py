"""A collecting system computed again: pelvis, infundibula, calyces and ureter, from voxels and sections of mesh.ply."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.hollow import Filled, Planes, at, lengths
from tubeplan_viz.verify.measures_compared import Items, compared, degrees
from tubeplan_viz.verify.pelvis import SHARE, Pelvis, pelvis_of, together
from tubeplan_viz.verify.verification import Check

LIMITS = {"°": 3.0, "length": 1.0, "width": 0.8, "ball": 1.0}  # degrees, mm
# A calyx's bottom lies on the CT's edge, which partial volume sets off the mesh by about a voxel's diagonal at most.
WALL_MM = 1.6
CORONAL = np.array([1.0, 0.0, 1.0])


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
    if not ways:
        return
    pelvis = pelvis_of(list(ways.values()), hollow)
    if ("pelvis_diameter_mm", "") in items:
        yield compared(
            "pelvis_diameter_mm",
            [("", items["pelvis_diameter_mm", ""], 2.0 * pelvis.largest)],
            LIMITS["ball"],
            "mm",
            "The largest ball of the voxels inside mesh.ply, before the necks of the calyces, is as large as stated.",
        )
    made = infundibula(items, ways, points, hollow, planes, pelvis, level, frame)
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
    yield from check_ureter(items, ways, planes, pelvis, hollow)


def infundibula(
    items: Items,
    ways: Mapping[str, FloatArray],
    points: Mapping[str, FloatArray],
    hollow: Filled,
    planes: Planes,
    pelvis: Pelvis,
    level: float,
    frame: str,
) -> dict[str, list[tuple[str, float, float]]]:
    """Stated and own values of each infundibulum and its calyces, by kind of measure: (part, stated, own)."""
    groups = groups_of(items, ways)
    made: dict[str, list[tuple[str, float, float]]] = {"angle": [], "coronal angle": [], "width": [], "length": [], "calyx": []}
    for name, labels in groups.items():
        of = f"{name} infundibulum"
        way = max((ways[label] for label in labels), key=lambda line: float(lengths(line)[-1]))
        lip = lip_of(way, pelvis)
        if lip is None:
            continue
        end = parting(way, [ways[label] for label in labels], lip, hollow)
        down = down_of(way, pelvis.center, level)
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
                own = max((together(ways[label], ways[other]) for other in labels if other != label), default=lip)
                begin = last - 0.5 * (last - own)
                found = planes.chords(ways[label], np.arange(begin, last, 0.5))
                made["calyx"].append((part, items["calyx_diameter_mm", part], float(found.max()) if len(found) else np.nan))
    return made


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


def check_ureter(items: Items, ways: Mapping[str, FloatArray], planes: Planes, pelvis: Pelvis, hollow: Filled) -> Iterator[Check]:
    """Mean and least diameter of the ureter below the pelvis."""
    if ("ureter_diameter_mean_mm", "") not in items or not ways:
        return
    way = max(ways.values(), key=lambda line: float((hollow.at(hollow.depth, line) * (pelvis.outside(line) <= 0.0)).max()))
    along, deep = lengths(way), hollow.at(hollow.depth, way)
    if pelvis.divided is not None and float(deep[along <= pelvis.divided].max()) < SHARE * pelvis.largest:
        last = pelvis.divided
    else:
        entered = np.flatnonzero(pelvis.outside(way) <= 0.0)
        if not len(entered):
            return
        narrow = np.flatnonzero((np.arange(len(way)) < entered[0]) & (deep <= 0.5 * pelvis.largest))
        if not len(narrow):
            return
        last = float(along[narrow[-1]])
    found = planes.diameters(way, np.arange(2.0, max(last - 2.0, 4.0), 1.0))
    text = "The ureter's sections in mesh.ply are as wide as stated."
    for key, mine in (("ureter_diameter_mean_mm", found.mean()), ("ureter_diameter_min_mm", found.min())):
        if (key, "") in items:
            yield compared(key, [("", items[key, ""], float(mine))], LIMITS["width"], "mm", text)


def groups_of(items: Items, ways: Mapping[str, FloatArray]) -> dict[str, list[str]]:
    """Labels of the calyces of each infundibulum, from the names of the lengths."""
    groups: dict[str, list[str]] = {}
    for key, of in items:
        if key in ("infundibular_length_mm", "calyx_diameter_mm") and of.startswith("calyx "):
            label, _, name = of.removeprefix("calyx ").partition(", ")
            if label in ways and label not in groups.setdefault(name, []):
                groups[name].append(label)
    return groups


def lip_of(way: FloatArray, pelvis: Pelvis) -> float | None:
    """Arc length at which a way leaves the pelvis for good, mm; None where it does not pass it."""
    level = pelvis.outside(way)
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
        return min(together(way, other) for other in group if other is not way)
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
