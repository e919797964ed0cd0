"""A rigid run checked by other means: labels made again from the CT, the instrument swept past their voxels.

# Strategy: the planner measures from the instrument to the faces of voxels by a kd-tree and projections. Here every voxel of
# a structure near the way is filled with points, and each point is asked where it lies in the instrument's own coordinates
# (`rigid_sweep`). What else the run tells is held against the case, the CT and itself (`rigid_told`).
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.anatomy.nasal import NasalScene
from segmentation.arrays import BoolArray, FloatArray
from segmentation.errors import TubeplanError
from segmentation.faults import shortened
from tubeplan_viz.verify.needle import check_files
from tubeplan_viz.verify.page import check_page
from tubeplan_viz.verify.rigid_candidates import check_best, check_candidates, check_ranking
from tubeplan_viz.verify.rigid_entry import check_entry, check_reason
from tubeplan_viz.verify.rigid_head import own_head
from tubeplan_viz.verify.rigid_sweep import ROUNDING_MM, WRITTEN_MM, Boxes, gaps_along, swept_gap, turned_gap
from tubeplan_viz.verify.rigid_told import (
    check_directions,
    check_head,
    check_instrument,
    check_source,
    check_summary,
    check_worst,
)
from tubeplan_viz.verify.verification import Check

SAME_MM = 1e-6
BETWEEN_MM = 0.1  # half of what the distance can change between places of the tip 0.2 mm apart
AROUND_MM = 25.0  # of structures beside starts and lesion that are measured to


def check_rigid(folder: Path, result: Mapping[str, Any]) -> Iterator[Check]:
    """All checks of a rigid run, with a path or without."""
    try:
        case = tomllib.loads((folder / "case.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError) as fault:
        name = "case.toml"
        yield Check(name=name, ok=False, found=type(fault).__name__, expected="a TOML file", text="The case cannot be read.")
        return
    found = result["path"] is not None
    yield from check_asked(case, result)
    if found:
        yield from check_course(result)
        yield from check_poses(result)
        yield from check_directions(result)
        yield from check_summary(result)
        yield from check_ranking(result)
    else:
        yield from check_reason(result)
    yield from check_instrument(folder, case, result)
    try:
        head = own_head(folder, case, [float(row["amount"]) for row in result["details"]["shrinkage"]])
    except (TubeplanError, OSError) as fault:
        told = shortened(str(fault))
        yield Check(
            name="labels", ok=False, found=told, expected="a CT that can be read", text="The labels cannot be made again."
        )
    else:
        yield from check_source(result, head)
        yield from check_head(result, head)
        yield from check_entry(result, head)
        if found:
            yield from check_start(result, head.planned)
            yield from check_candidates(result, case, head)
            yield from check_sweep(result, head.planned)
            yield from check_distances(result, head.planned)
    if found:
        yield from check_files(folder, result)
        yield from check_table(folder, result)
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
    """The swept instrument keeps its distance from every structure's voxels, as far as stated."""
    asked, nodes, roll = result["limits"]["clearance_min_mm"], corners(result), roll_of(result)
    tool, turned = result["details"]["instrument"], result["details"].get("turn_clearance_mm")
    least, turns, slack = np.inf, np.inf, 0.0
    for name, mask in scene.structures.items():
        boxes = Boxes.of(mask, scene.volume)
        turn = turned_gap(boxes, nodes, roll, tool)
        gap = min(swept_gap(boxes, nodes, roll, tool), turn)
        turns, slack = min(turns, turn), max(slack, boxes.slack(gap))
        least = min(least, gap)
        yield Check(
            name=f"sweep: {name}",
            ok=gap > asked - SAME_MM and gap > 0.0,
            found=f"{gap:.3f} mm",
            expected=f"more than {asked:g} mm",
            text=f"Endoscope and shaver, pushed and turned along the path, keep clear of the {name.replace('_', ' ')}.",
        )
    stated = result["metrics"]["clearance_min_mm"]
    proved = result["certificate"]["clearance_lower_bound_mm"]
    if np.isfinite(least):
        yield Check(
            name="metrics: clearance_min_mm",
            # Places of the tip stand 0.2 mm apart, turns in steps of a degree: between them the distance may be a little less.
            ok=least - slack - ROUNDING_MM <= stated <= least + BETWEEN_MM,
            found=f"{stated:.3f} mm",
            expected=f"{least:.3f} mm, up to {slack:.3f} mm less or {BETWEEN_MM:g} mm more",
            text="The stated least distance is that of the voxels' points.",
        )
    if turned is not None or len(nodes) > 2:
        yield Check(
            name="turns: least distance",
            ok=turned is not None and turns - slack - ROUNDING_MM <= turned <= turns + BETWEEN_MM,
            found="none" if turned is None else f"{turned:.3f} mm",
            expected=f"{turns:.3f} mm, up to {slack:.3f} mm less or {BETWEEN_MM:g} mm more",
            text="The stated least distance in turns is that of the voxels' points.",
        )
    yield Check(
        name="certificate",
        ok=asked - SAME_MM <= proved <= min(least, stated) + SAME_MM,
        found=f"{proved:.3f} mm",
        expected=f"{asked:g} to {min(least, stated):.3f} mm",
        text="The proved distance is no more than the one measured, and no less than asked.",
    )


def roll_of(result: Mapping[str, Any]) -> float:
    """The roll on all segments, radian."""
    return float(np.radians(result["details"]["nodes"][0]["beta_deg"]))


def near_the_way(mask: BoolArray, scene: NasalScene, result: Mapping[str, Any]) -> BoolArray:
    """What of a structure the planner measures to: its voxels in the box of starts and lesion, widened."""
    points = np.vstack([np.array(result["details"]["entry"]["points_mm"], float), [result["details"]["goal_mm"]]])
    low, high = points.min(axis=0) - AROUND_MM, points.max(axis=0) + AROUND_MM
    box = np.stack(np.meshgrid(*np.column_stack([low, high]), indexing="ij"), axis=-1).reshape(-1, 3)
    index = scene.volume.to_index(box)
    first = np.clip(np.floor(index.min(axis=0)).astype(int), 0, mask.shape)
    last = np.clip(np.ceil(index.max(axis=0)).astype(int) + 1, first, mask.shape)
    window = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
    cut = np.zeros_like(mask)
    cut[window] = mask[window]
    return cut


def check_distances(result: Mapping[str, Any], scene: NasalScene) -> Iterator[Check]:
    """Distances along the path, structure by structure, those of the best candidates, and the place of the least."""
    details, path, tool = result["details"], result["path"], result["details"]["instrument"]
    told = details["structure_distances_mm"]
    boxes = {name: Boxes.of(near_the_way(mask, scene, result), scene.volume) for name, mask in scene.structures.items()}
    boxes = {name: some for name, some in boxes.items() if len(some.middles)}
    tips = np.array(path["points_mm"], float)
    ends = np.cumsum(np.linalg.norm(np.diff(corners(result), axis=0), axis=1))
    # The sample at a node belongs to the segment that begins there; the last one to the last segment.
    segment = np.minimum(np.searchsorted(ends, np.array(path["s_mm"], float) + SAME_MM), len(ends) - 1)
    ways = np.diff(corners(result), axis=0)
    ways = (ways / np.linalg.norm(ways, axis=1)[:, None])[segment]
    wrong, worst, whole = "", 0.0, set(told) == set(boxes)
    for name in sorted(set(told) & set(boxes)):
        some = boxes[name]
        own = gaps_along(some, tips, ways, roll_of(result), tool)
        stated = np.array([np.nan if value is None else value for value in told[name]], float)
        off = own - stated
        slack = np.array([some.slack(float(gap)) for gap in own])
        over = np.nan_to_num(np.maximum(off - slack, -off - ROUNDING_MM), nan=np.inf)
        if float(over.max()) > worst:
            worst, wrong = float(over.max()), f"{name} at {path['s_mm'][int(over.argmax())]:.2f} mm"
    yield Check(
        name="distances: of every structure",
        ok=whole and worst <= 0.0,
        found=f"{worst:.3f} mm more than can be, {wrong}" if worst else f"{len(told)} structures as measured",
        expected=f"{', '.join(sorted(boxes))}, each as the voxels' points say",
        text="The distance of the instrument to every structure at every place of the tip is that of the voxels' points.",
    )
    least = np.min([[np.inf if value is None else value for value in values] for values in told.values()], axis=0)
    off = float(np.abs(least - np.array(path["clearance_mm"], float)).max())
    yield Check(
        name="path: clearance",
        ok=off <= WRITTEN_MM,
        found=f"{off:.2g} mm off at most",
        expected="the least of all structures' distances",
        text="The clearance of the path is the distance to the nearest structure.",
    )
    yield from check_worst(result, boxes, told)
    yield from check_best(result, scene, boxes)


def check_table(folder: Path, result: Mapping[str, Any]) -> Iterator[Check]:
    """The columns of path.csv that result.json does not hold: tangents, and a torsion of 0."""
    try:
        rows = list(csv.reader((folder / "path.csv").read_text(encoding="utf-8").splitlines()))[1:]
        told = np.array([[float(row[k]) for k in (4, 5, 6, 8)] for row in rows])
    except (OSError, ValueError, IndexError):
        return  # the check of the same numbers says so
    points = np.array(result["path"]["points_mm"], float)
    ahead = np.diff(points, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    meant = np.column_stack([np.vstack([ahead, ahead[-1:]]), np.zeros(len(points))])
    off = float(np.abs(told - meant).max()) if told.shape == meant.shape else np.inf
    yield Check(
        name="path.csv: tangents",
        ok=off <= 1e-9,
        found=f"{off:.2g} off at most",
        expected="unit vectors to the next point, no torsion",
        text="The tangents of path.csv point to the next place of the path.",
    )
