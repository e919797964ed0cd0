"""The ranked paths of a rigid run: where they run, their goals, and what is best among them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from segmentation.anatomy.nasal import NasalScene, Tissue
from segmentation.arrays import FloatArray
from tubeplan_viz.verify.alike import SAME, same
from tubeplan_viz.verify.rigid_head import OwnHead
from tubeplan_viz.verify.rigid_sweep import RANKED_MM, WRITTEN_MM, Boxes, Pose, apart, swept_gap
from tubeplan_viz.verify.verification import Check

REACH_MM = 14.0
RIM_MM = 1e-4
LARGER_IS_BETTER = 4  # goals before this index are distances
BEST_NAMES = {
    "overall": "overall best",
    "brain": "farthest from the brain",
    "length": "shortest",
    "tissue": "least tissue",
}


def check_candidates(result: Mapping[str, Any], case: Mapping[str, Any], head: OwnHead) -> Iterator[Check]:
    """Every candidate runs from its voxel to the lesion, at a roll that was allowed, as long as it says."""
    details, path = result["details"], result["path"]
    rows, feasible = details["candidates"], np.array(details["entry"]["feasible"], bool)
    goal, side = np.array(details["goal_mm"], float), str(details["side"])
    own = head.planned.volume.to_lps(np.argwhere(head.planned.entries[side].widened))
    most, count = float(case["rigid"]["roll_max_deg"]), int(case["rigid"]["rolls"])
    rolls = np.linspace(-most, most, count) if count > 1 else np.zeros(1)
    wrong: list[str] = []
    for number, row in enumerate(rows):
        nodes = np.array(row["nodes_mm"], float)
        length = float(np.linalg.norm(np.diff(nodes, axis=0), axis=1).sum())
        start = row["start"]
        good = 0 <= start < len(own) and bool(feasible[start]) and np.linalg.norm(nodes[0] - own[start]) <= 2.0 * WRITTEN_MM
        good = good and np.linalg.norm(nodes[-1] - goal) <= 2.0 * WRITTEN_MM and np.abs(rolls - row["roll_deg"]).min() <= SAME
        if not good or abs(length - row["length_mm"]) > 4.0 * WRITTEN_MM:
            wrong.append(str(number))
    yield Check(
        name="candidates",
        ok=not wrong,
        found=f"{len(rows)}, wrong: {', '.join(wrong[:8]) or 'none'}",
        expected="each from a feasible voxel to the lesion, its length that of its nodes, its roll one that is tried",
        text="Every ranked path begins at its voxel and ends at the lesion.",
    )
    chosen = rows[details["best"]["overall"]["path"]]
    corners = [feature["point_mm"] for feature in result["feature_points"]]
    off = (
        [float(np.abs(np.array(chosen["nodes_mm"], float) - np.array(corners, float)).max())]
        if len(corners) == len(chosen["nodes_mm"])
        else [np.inf]
    )
    turned = abs(chosen["roll_deg"] - details["nodes"][0]["beta_deg"])
    yield Check(
        name="path: the overall best",
        ok=off[0] <= WRITTEN_MM and turned <= 1e-5 and abs(path["s_mm"][-1] - chosen["length_mm"]) <= WRITTEN_MM,
        found=f"{off[0]:.3g} mm and {turned:.3g} degrees off",
        expected="the nodes and the roll of the overall best candidate",
        text="The path that the run gives is the overall best of its candidates.",
    )
    names = {key: choice["name"] for key, choice in details["best"].items()}
    yield same("best paths: names", names, BEST_NAMES, "The best paths are named for their goals.")
    worst = 0.0
    for line, choice in zip(details["best_paths"], details["best"].values(), strict=True):
        worst = max(worst, _off_line(np.array(line, float), np.array(rows[choice["path"]]["nodes_mm"], float)))
    yield Check(
        name="best paths: drawn",
        ok=worst <= 2.0 * WRITTEN_MM,
        found=f"{worst:.3g} mm off",
        expected=f"at most {2.0 * WRITTEN_MM:g} mm",
        text="What is drawn of the best paths lies on the segments between their nodes.",
    )


def _off_line(points: FloatArray, nodes: FloatArray) -> float:
    """Largest distance of points to a polyline, and of the first point to its beginning, mm."""
    away = np.full(len(points), np.inf)
    for a, b in pairwise(nodes):
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.minimum(away, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return float(max(away.max(), np.linalg.norm(points[0] - nodes[0])))


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
    # Goals are told as they are ranked; normalised ones and scores have 6 decimals.
    off = np.abs(share - np.array([row["normalised"] for row in rows], float))
    weights = np.array(list(details["weights"].values()), float)
    scores = np.array([row["normalised"] for row in rows], float) @ weights
    off_score = float(np.abs(scores - np.array([row["score"] for row in rows])).max())
    chosen = [details["best"]["overall"]["path"], details["best"]["brain"]["path"], details["best"]["length"]["path"]]
    right = scores[chosen[0]] <= scores.min() + 1e-5 and share[chosen[1], 0] <= 1e-9 and share[chosen[2], 4] <= 1e-9
    right = right and share[details["best"]["tissue"]["path"], 5] <= 1e-9
    yield Check(
        name="ranking",
        ok=bool(off.max() <= 1e-6 and off_score <= 2e-6 and right),
        found=f"goals {off.max():.2g}, scores {off_score:.2g} off at most, best paths {'right' if right else 'wrong'}",
        expected="goals within 1e-06, scores within 2e-06, best paths right",
        text="Normalised goals, weighted sums and the four best paths follow from the goals of the candidates.",
    )
    told = np.array([row["pareto"] for row in rows], bool)
    wrong = [k for k in range(len(rows)) if beaten(share, k) is bool(told[k])]
    yield Check(
        name="ranking: Pareto set",
        ok=not wrong,
        found=f"{int(told.sum())} of {len(rows)}, wrong: {', '.join(map(str, wrong[:8])) or 'none'}",
        expected="those that no other path beats",
        text="In the Pareto set are the paths that no other beats in one goal without losing in another.",
    )


def beaten(share: FloatArray, row: int) -> bool:
    """Whether another path is no worse in any goal and better in one."""
    gain = share[row] - share
    return bool(((gain >= 0.0).all(axis=1) & (gain > 0.0).any(axis=1)).any())


def check_best(result: Mapping[str, Any], scene: NasalScene, boxes: Mapping[str, Boxes]) -> Iterator[Check]:
    """The goals of the best paths, measured again."""
    details, tool = result["details"], result["details"]["instrument"]
    wrong = []
    for number in sorted({choice["path"] for choice in details["best"].values()}):
        row = details["candidates"][number]
        nodes, roll = np.array(row["nodes_mm"], float), float(np.radians(row["roll_deg"]))
        for goal in ("brain", "orbit", "septum", "turbinate"):
            some = [boxes[name] for name in boxes if name.startswith(goal)]
            own = min((swept_gap(one, nodes, roll, tool) for one in some), default=np.inf)
            stated = np.inf if row[f"{goal}_mm"] is None else row[f"{goal}_mm"]
            slack = max((one.slack(own) for one in some), default=0.0) + 2.0 * WRITTEN_MM
            if own != stated and not -2.0 * WRITTEN_MM - RANKED_MM <= own - stated <= slack:
                wrong.append(f"{number} {goal} {stated:.3f} instead of {own:.3f} mm")
        count, doubtful = channel(nodes, roll, tool, scene)
        if not count - doubtful <= row["tissue_voxels"] <= count + doubtful:
            wrong.append(f"{number} tissue {row['tissue_voxels']:g} instead of {count} voxels")
    yield Check(
        name="best paths: goals",
        ok=not wrong,
        found="; ".join(wrong[:4]) or "as measured",
        expected="distances and tissue as the voxels say",
        text="Distances and tissue of the best paths are those measured again.",
    )


def channel(nodes: FloatArray, roll: float, tool: Mapping[str, Any], scene: NasalScene) -> tuple[int, int]:
    """Voxels of soft tissue and bone whose middles the instrument sweeps between start and goal, and how many lie on its rim."""
    solid = np.argwhere(scene.tissue != Tissue.AIR)
    middles = scene.volume.to_lps(solid)
    low, high = nodes.min(axis=0) - 3.0 * REACH_MM, nodes.max(axis=0) + 3.0 * REACH_MM
    middles = middles[((middles >= low) & (middles <= high)).all(axis=1)]
    inside, rim = np.zeros(len(middles), bool), np.zeros(len(middles), bool)
    for a, b in pairwise(nodes):
        way = (b - a) / np.linalg.norm(b - a)
        behind = float(np.linalg.norm(b - nodes[0]))
        local = Pose(b, way, roll, tool).local(middles)
        # What the shafts pass in front of the start counts no more: they are cut there.
        cut = {**tool, "shaver_length_mm": behind, "scope_length_mm": behind - tool["setback_mm"]}
        held = apart(local, cut, 0.0)
        inside |= held <= SAME
        rim |= np.abs(apart(local * (1.0 + 1e-6), cut, 0.0) - apart(local * (1.0 - 1e-6), cut, 0.0)) > 0.0
        rim |= (held > 0.0) & (held <= RIM_MM)
    return int(inside.sum()), int((rim & ~inside).sum()) + int((rim & inside).sum())
