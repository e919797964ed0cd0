"""A rigid run checked by other means: labels made again from the CT, the instrument swept past their voxels.

# Strategy: the planner measures from the instrument to the faces of voxels by a kd-tree and projections. Here every voxel of
# a structure near the way is filled with points, and each point is asked where it lies in the instrument's own coordinates:
# how far along the axis and how far from it. On a straight push those change by the push alone, so one look per segment is
# enough; turns are looked at in steps. Points `GRID` to a side leave less than `SLACK_MM` unseen.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.anatomy.nasal import NasalScene, propose_scene, shrink
from segmentation.arrays import BoolArray, FloatArray
from segmentation.errors import TubeplanError
from segmentation.faults import shortened
from segmentation.images import read_ct
from segmentation.label_file import read_mask
from tubeplan_viz.verify.needle import check_files
from tubeplan_viz.verify.page import check_page
from tubeplan_viz.verify.verification import Check

GRID = 5  # points of a voxel to a side, its faces included
SLACK_MM = 0.25  # the diagonal of a gap between points of voxels up to 1.5 mm, halved, less what rounding adds
SAME_MM = 1e-6
NEAR_MM = 14.0  # voxels farther than this from the instrument are not looked at
TURN_STEP = np.radians(0.5)
LARGER_IS_BETTER = 4  # goals before this index are distances


def check_rigid(folder: Path, result: Mapping[str, Any]) -> Iterator[Check]:
    """All checks of a rigid run that has a path."""
    try:
        case = tomllib.loads((folder / "case.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError) as fault:
        name = "case.toml"
        yield Check(name=name, ok=False, found=type(fault).__name__, expected="a TOML file", text="The case cannot be read.")
        return
    yield from check_asked(case, result)
    yield from check_course(result)
    yield from check_poses(result)
    yield from check_ranking(result)
    try:
        scene = own_scene(folder, case)
    except (TubeplanError, OSError) as fault:
        told = shortened(str(fault))
        yield Check(
            name="labels", ok=False, found=told, expected="a CT that can be read", text="The labels cannot be made again."
        )
    else:
        yield from check_start(result, scene)
        yield from check_sweep(result, scene)
    yield from check_files(folder, result)
    page = folder / "report.html"
    if page.exists():
        yield from check_page(page.read_text(encoding="utf-8"), result)


def check_asked(case: Mapping[str, Any], result: Mapping[str, Any]) -> Iterator[Check]:
    """Side, lesion and margin are those of the case."""
    own, details = case["rigid"], result["details"]
    yield Check(
        name="side",
        ok=details["side"] == own["side"],
        found=str(details["side"]),
        expected=str(own["side"]),
        text="The side is that of the case.",
    )
    margin, asked = result["limits"]["clearance_min_mm"], case["limits"]["clearance_min"]
    yield Check(
        name="limits",
        ok=margin == asked,
        found=f"{margin:g} mm",
        expected=f"{asked:g} mm",
        text="The least distance is that which the case asks for.",
    )
    if "lesion" in own:
        off = float(np.linalg.norm(np.array(details["goal_mm"], float) - np.array(own["lesion"], float)))
        yield Check(
            name="lesion",
            ok=off <= SAME_MM,
            found=f"{off:.3g} mm away",
            expected="where the case puts it",
            text="The goal is the lesion of the case.",
        )


def check_course(result: Mapping[str, Any]) -> Iterator[Check]:
    """The path runs straight from node to node and ends at the lesion."""
    details, path = result["details"], result["path"]
    nodes = corners(result)
    lengths = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    expected = np.column_stack([np.interp(path["s_mm"], at, nodes[:, axis]) for axis in range(3)])
    off = np.linalg.norm(np.array(path["points_mm"], float) - expected, axis=1)
    yield Check(
        name="path: straight segments",
        ok=bool(off.max() <= 1e-6) and abs(at[-1] - result["metrics"]["length_mm"]) <= SAME_MM,
        found=f"{off.max():.2g} mm off at most, {result['metrics']['length_mm']:.4f} mm long",
        expected=f"0 mm off, {at[-1]:.4f} mm long",
        text="The points of the path lie on the segments between its nodes.",
    )
    tip = float(np.linalg.norm(nodes[-1] - np.array(details["goal_mm"], float)))
    yield Check(
        name="tip: at the lesion",
        ok=tip <= SAME_MM,
        found=f"{tip:.3g} mm away",
        expected="0 mm",
        text="The tip ends at the lesion.",
    )


def corners(result: Mapping[str, Any]) -> FloatArray:
    """Start, bends and goal, (k, 3) mm."""
    return np.array([feature["point_mm"] for feature in result["feature_points"]], dtype=float)


def check_poses(result: Mapping[str, Any]) -> Iterator[Check]:
    """At each node the shaver lies along the segment and the endoscope where the instrument's lengths put it."""
    details, nodes = result["details"], corners(result)
    tool = details["instrument"]
    worst = 0.0
    for node, a, b in zip(details["nodes"], nodes[:-1], nodes[1:], strict=True):
        way = (b - a) / np.linalg.norm(b - a)
        x = np.array(node["endoscope_front_mm"], float) - np.array(node["tip_mm"], float)
        along, across = float(x @ way), x - (x @ way) * way
        # Without roll the endoscope lies on the upper side: the roll is the angle to the vertical plane through the axis.
        level = np.array([0.0, 0.0, 1.0]) - way[2] * way
        level /= np.linalg.norm(level)
        roll = np.degrees(np.arctan2(np.cross(level, across) @ way, level @ across))
        faults = (
            np.linalg.norm(np.array(node["tip_mm"], float) - b),
            abs(along + np.sqrt(max(x @ x - tool["offset_mm"] ** 2, 0.0))),
            abs(np.linalg.norm(across) - tool["offset_mm"]),
            abs(-along - tool["setback_mm"]),
            abs(roll - node["beta_deg"]),
        )
        worst = max(worst, *(float(fault) for fault in faults))
    yield Check(
        name="poses",
        ok=worst <= 1e-6,
        found=f"{worst:.2g} mm or degrees off at most",
        expected="at most 1e-06",
        text="Shaver and endoscope stand at every node as their lengths and the roll say.",
    )


def check_ranking(result: Mapping[str, Any]) -> Iterator[Check]:
    """Normalised goals, weighted sums, Pareto set and best paths follow from the candidates' goals."""
    details = result["details"]
    rows = details["candidates"]
    names = ("brain_mm", "orbit_mm", "septum_mm", "turbinate_mm", "length_mm", "tissue_voxels")
    goals = np.array([[np.nan if row[name] is None else row[name] for name in names] for row in rows], dtype=float)
    share = np.zeros_like(goals)
    for k in range(len(names)):
        column = goals[:, k]
        if not np.isfinite(column).any() or np.nanmax(column) == np.nanmin(column):
            continue
        column = np.where(np.isnan(column), np.nanmax(column), column)
        share[:, k] = (column - column.min()) / (column.max() - column.min())
        if k < LARGER_IS_BETTER:
            share[:, k] = 1.0 - share[:, k]
    # Goals are written with 4 decimals.
    off = float(np.abs(share - np.array([row["normalised"] for row in rows], float)).max())
    weights = np.array(list(details["weights"].values()), float)
    scores = np.array([row["normalised"] for row in rows], float) @ weights
    off_score = float(np.abs(scores - np.array([row["score"] for row in rows])).max())
    chosen = [details["best"]["overall"]["path"], details["best"]["brain"]["path"], details["best"]["length"]["path"]]
    right = scores[chosen[0]] <= scores.min() + 1e-5 and share[chosen[1], 0] <= 1e-9 and share[chosen[2], 4] <= 1e-9
    right = right and share[details["best"]["tissue"]["path"], 5] <= 1e-9
    yield Check(
        name="ranking",
        ok=bool(off <= 2e-3 and off_score <= 1e-4 and right),
        found=f"goals {off:.2g}, scores {off_score:.2g} off at most, best paths {'right' if right else 'wrong'}",
        expected="goals within 0.002, scores within 0.0001, best paths right",
        text="Normalised goals, weighted sums and the four best paths follow from the goals of the candidates.",
    )


def own_scene(folder: Path, case: Mapping[str, Any]) -> NasalScene:
    """The labels of the case, made again from its CT and shrunk as planned."""
    own = case["rigid"]

    def place(name: str) -> Path:
        path = Path(name)
        return path if path.is_absolute() else folder.resolve() / path

    volume = read_ct(place(case["input"]["ct"]), series=case["input"].get("series")).volume
    masks = {name: read_mask(place(file), volume) for name, file in own.get("masks", {}).items()}
    boxes = {name: np.reshape(box, (2, 3)) for name, box in own.get("boxes", {}).items()}
    scene = propose_scene(volume, masks=masks, seeds=own.get("seeds", {}), boxes=boxes)
    return shrink(scene, own["shrinkage_percent"] / 100.0, own["side"]).scene


def check_start(result: Mapping[str, Any], scene: NasalScene) -> Iterator[Check]:
    """The path starts in the entry region of its side."""
    region = scene.entries.get(result["details"]["side"])
    index = np.rint(scene.volume.to_index(corners(result)[0])).astype(int)
    inside = region is not None and bool(region.widened[tuple(index)])
    yield Check(
        name="start: in the entry region",
        ok=inside,
        found="inside" if inside else "outside",
        expected="inside",
        text="The path starts at a voxel of the entry region.",
    )


def check_sweep(result: Mapping[str, Any], scene: NasalScene) -> Iterator[Check]:
    """The swept instrument keeps its distance from every structure's voxels."""
    asked, least = result["limits"]["clearance_min_mm"], np.inf
    for name, mask in scene.structures.items():
        gap = sweep_gap(result, scene, mask)
        least = min(least, gap)
        yield Check(
            name=f"sweep: {name}",
            ok=gap > asked - SAME_MM and gap > 0.0,
            found=f"{gap:.3f} mm" if np.isfinite(gap) else f"more than {NEAR_MM:g} mm",
            expected=f"more than {asked:g} mm",
            text=f"Endoscope and shaver, pushed and turned along the path, keep clear of the {name.replace('_', ' ')}.",
        )
    stated = result["metrics"]["clearance_min_mm"]
    proved = result["certificate"]["clearance_lower_bound_mm"]
    if np.isfinite(least):
        yield Check(
            name="metrics: clearance_min_mm",
            ok=abs(stated - least) <= SLACK_MM,
            found=f"{stated:.3f} mm",
            expected=f"{least:.3f} mm within {SLACK_MM:g}",
            text="The stated least distance is that of the voxels' points.",
        )
    yield Check(
        name="certificate",
        ok=asked - SAME_MM <= proved <= min(least, stated) + SAME_MM,
        found=f"{proved:.3f} mm",
        expected=f"{asked:g} to {min(least, stated):.3f} mm",
        text="The proved distance is no more than the one measured, and no less than asked.",
    )


def sweep_gap(result: Mapping[str, Any], scene: NasalScene, mask: BoolArray) -> float:
    """Least distance of the swept instrument to the points of a mask's voxels, mm; infinite beyond `NEAR_MM`."""
    nodes, roll = corners(result), np.radians(result["details"]["nodes"][0]["beta_deg"])
    tool, volume = result["details"]["instrument"], scene.volume
    behind = float(np.linalg.norm(nodes - nodes[-1], axis=1).max()) + NEAR_MM
    index = np.argwhere(mask)
    centres = volume.to_lps(index)
    margin = NEAR_MM + tool["offset_mm"] + tool["scope_diameter_mm"]
    near = np.zeros(len(centres), dtype=bool)
    for a, b in pairwise(nodes):
        way = (b - a) / np.linalg.norm(b - a)
        along = (centres - b) @ way
        off = np.linalg.norm(centres - b - along[:, None] * way, axis=1)
        near |= (off < margin) & (along < margin) & (along > -behind - margin)
    index = index[near]
    # Inner voxels are no nearer than their neighbours: only those on the surface matter.
    padded = np.pad(mask, 1)
    inner = np.ones(len(index), dtype=bool)
    for step in np.vstack([np.eye(3, dtype=int), -np.eye(3, dtype=int)]):
        inner &= padded[tuple((index + 1 + step).T)]
    index = index[~inner]
    if not len(index):
        return float("inf")
    share = np.linspace(-0.5, 0.5, GRID)
    offsets = np.stack(np.meshgrid(share, share, share, indexing="ij"), axis=-1).reshape(-1, 3)
    outer = offsets[(np.abs(offsets) == 0.5).any(axis=1)]
    points = volume.to_lps((index[:, None] + outer[None]).reshape(-1, 3))
    least = np.inf
    for a, b in pairwise(nodes):
        run = float(np.linalg.norm(b - a))
        least = min(least, pose_gap(points, b, (b - a) / run, roll, run, tool))
    for a, b, c in zip(nodes[:-2], nodes[1:-1], nodes[2:], strict=True):
        first, second = (b - a) / np.linalg.norm(b - a), (c - b) / np.linalg.norm(c - b)
        angle = float(np.arccos(np.clip(first @ second, -1.0, 1.0)))
        for part in np.linspace(0.0, 1.0, max(int(np.ceil(angle / TURN_STEP)), 1) + 1):
            way = np.sin((1.0 - part) * angle) * first + np.sin(part * angle) * second
            least = min(least, pose_gap(points, b, way / np.linalg.norm(way), roll, 0.0, tool))
    return float(least) if least < NEAR_MM else float("inf")


def pose_gap(points: FloatArray, tip: FloatArray, way: FloatArray, roll: float, run: float, tool: Mapping[str, Any]) -> float:
    """Least distance of points to the instrument with its tip there, drawn out backwards by `run` mm."""
    level = np.array([0.0, 0.0, 1.0]) - way[2] * way
    level /= np.linalg.norm(level)
    up = np.cos(roll) * level + np.sin(roll) * np.cross(way, level)
    offset = points - tip
    along, rise, aside = offset @ way, offset @ up, offset @ np.cross(way, up)
    r_s, r_e = 0.5 * tool["shaver_diameter_mm"], 0.5 * tool["scope_diameter_mm"]
    # Shaver: a cylinder up to the centre of its ball, and the ball.
    radial = np.hypot(rise, aside)
    back = -(tool["shaver_length_mm"] + run)
    beyond = np.maximum(np.maximum(back - along, along + r_s), 0.0)
    cylinder = np.hypot(np.maximum(radial - r_s, 0.0), beyond)
    ball = np.maximum(np.hypot(radial, along + r_s) - r_s, 0.0)
    # Endoscope: a cylinder with flat ends.
    radial = np.hypot(rise - tool["offset_mm"], aside)
    front, back = -tool["setback_mm"], -(tool["setback_mm"] + tool["scope_length_mm"] + run)
    beyond = np.maximum(np.maximum(back - along, along - front), 0.0)
    scope = np.hypot(np.maximum(radial - r_e, 0.0), beyond)
    return float(min(cylinder.min(), ball.min(), scope.min()))
