"""Renal rows of tubeplan bench paper: a ureteroscope's way to the calyces (Dai 2024, table 3)."""

# Strategy: the paper's four patients are not published. The same columns are made for the
# generated urography, whose CT goes through the whole front end, and for the HuBMAP ureters
# where their files stand beside the source tree; the paper's range is quoted beside them.

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.caps import mark_flat_ends
from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.mesh import Surface
from segmentation.mesh_files import read_surface
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.synthetic.urography import urography
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.centerline import Endpoint, VoronoiGraph, find_endpoints, voronoi_graph
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.pipeline import Notify
from tubeplan_viz.plan import FlagKind, Limits, Plan
from tubeplan_viz.profile import measure_path
from tubeplan_viz.tube import RefineSettings, TubeProblem, TubeSettings, conclude, pose_problem, tube_steps

# Table 1, row renal: section radius 1.2 mm, least bend radius 8 mm, extrema move faster.
RENAL_LIMITS = Limits(curvature_max=0.125, clearance_min=1.2)
RENAL_SETTINGS = TubeSettings(method="feature_iteration", refine=RefineSettings(sigma_extremum=0.003))
# A ureter narrower than the endoscope never meets the limits and uses up all rounds: twice the largest number printed.
NARROW_SETTINGS = replace(RENAL_SETTINGS, refine=replace(RENAL_SETTINGS.refine, max_rounds=88))
CALYCES = {"upper": "upper 1", "middle": "middle 1", "lower": "lower 1"}
HUBMAP = Path(__file__).parents[2].parent / "shared" / "data" / "hubmap_ureter_female"
# Share of the height above which the tips of a HuBMAP ureter are calyces and not bulges of the ureter.
KIDNEY_SHARE = 0.6
# A breach is looked for ten times as densely as flags are made, and may stick out of its flag by less than this, mm.
CHECK_SPACING = 0.005
FLAG_TOLERANCE = 0.05
# Dai 2024, table 3, renal a to d: least and largest.
PRINTED = {
    "centerline points": "47 to 86",
    "feature points": "6 to 13",
    "rounds": "8 to 44",
    "least clearance mm": "0.605 to 1.528",
    "mean clearance mm": "2.420 to 3.602",
    "largest curvature 1/mm": "0.116 to 0.125",
    "mean curvature 1/mm": "0.055 to 0.081",
    "mean distance to the centerline mm": "0.184 to 0.439",
    "refinement, every round measured s": "1.281 to 1.984, with centerline",
}


def renal_rows(*, quick: bool, notify: Notify) -> list[Row]:
    """Rows of the renal cases at hand, limits 0.125 1/mm and 1.2 mm.

    Parameters
    ----------
    quick : bool
        The middle calyx of the generated urography only.
    notify : Notify
    """
    notify("renal, generated CT", 0, 0)
    rows: list[Row] = []
    for name, problem in generated_problems(("middle",) if quick else tuple(CALYCES)):
        rows += case_rows(f"renal, generated, {name} calyx", problem)
    if quick or not HUBMAP.is_dir():
        return rows
    for side in ("L", "R"):
        notify(f"renal, HuBMAP {side}", 0, 0)
        for name, problem in hubmap_problems(HUBMAP / f"fused_F_{side}_mm.stl"):
            rows += case_rows(f"renal, HuBMAP {side}, {name} calyx", problem)
    return rows


def generated_problems(calyces: tuple[str, ...]) -> Iterator[tuple[str, TubeProblem]]:
    """The generated CT, segmented as any other, from the lower ureter to the named calyces."""
    made = urography()
    region = segment_lumen(made.volume, SegmentationSettings(anatomy="urinary"))
    surface = lumen_surface(made.volume, region, SurfaceSettings()).surface
    wall = WallDistance(surface)
    graph = voronoi_graph(surface, wall)
    for name in calyces:
        yield name, posed(surface, made.truth.start, made.truth.goal(CALYCES[name]), wall, graph)


def hubmap_problems(path: Path) -> Iterator[tuple[str, TubeProblem]]:
    """From the ureteric orifice to the lowest, the middle and the highest calyx of one HuBMAP ureter."""
    surface, wall, graph, tips = hubmap_tips(path)
    orifice, calyces = orifice_and_calyces(tips)
    for name, tip in zip(("lower", "middle", "upper"), calyces, strict=True):
        yield name, posed(surface, orifice.point, tip.point, wall, graph, NARROW_SETTINGS)


def hubmap_tips(path: Path) -> tuple[Surface, WallDistance, VoronoiGraph, tuple[Endpoint, ...]]:
    """The ureter's wall with its flat ends named, and its end points."""
    surface = read_surface(path).surface
    for _ in range(2):
        wall = WallDistance(surface)
        graph = voronoi_graph(surface, wall)
        tips = find_endpoints(graph, wall)
        marked = mark_flat_ends(surface, np.array([tip.point for tip in tips]))
        if len(marked.caps) == len(surface.caps):
            break
        surface = marked
    return surface, wall, graph, tips


def orifice_and_calyces(tips: tuple[Endpoint, ...]) -> tuple[Endpoint, tuple[Endpoint, Endpoint, Endpoint]]:
    """The tip with the lowest y, and the lowest, middle and highest of those in the kidney (y is up in these meshes)."""
    ordered = sorted(tips, key=lambda tip: float(tip.point[1]))
    low, high = float(ordered[0].point[1]), float(ordered[-1].point[1])
    calyces = [tip for tip in ordered if tip.point[1] > low + KIDNEY_SHARE * (high - low)]
    return ordered[0], (calyces[0], calyces[len(calyces) // 2], calyces[-1])


def posed(
    surface: Surface,
    start: FloatArray,
    goal: FloatArray,
    wall: WallDistance,
    graph: VoronoiGraph,
    settings: TubeSettings = RENAL_SETTINGS,
) -> TubeProblem:
    """The problem with the renal limits."""
    return pose_problem(surface, start, goal, RENAL_LIMITS, settings, wall=wall, graph=graph)


def case_rows(case: str, problem: TubeProblem) -> list[Row]:
    """Columns of table 3 for one way, and whether every breach is flagged."""
    begun = time.perf_counter()
    steps = list(tube_steps(problem))
    seconds = time.perf_counter() - begun
    plan = conclude(problem, steps)
    figures = {
        "centerline points": float(len(problem.centerline.points)),
        "feature points": float(len(plan.features)),
        "rounds": float(plan.steps[-1].index),
        "least clearance mm": plan.metrics["clearance_min_mm"],
        "mean clearance mm": plan.metrics["clearance_mean_mm"],
        "largest curvature 1/mm": plan.metrics["curvature_max_per_mm"],
        "mean curvature 1/mm": plan.metrics["curvature_mean_per_mm"],
        "mean distance to the centerline mm": plan.metrics["centerline_distance_mean_mm"],
        "refinement, every round measured s": seconds,
    }
    targets = {"mean distance to the centerline mm": ("under 0.5", figures["mean distance to the centerline mm"] < 0.5)}
    missed = unflagged_length(plan, problem.wall)
    rows = []
    for figure, value in figures.items():
        target, holds = targets.get(figure, ("", None))
        rows.append(
            Row(case=case, figure=figure, ours=value, source=f"Dai 2024, renal: {PRINTED[figure]}", target=target, holds=holds)
        )
    return [
        *rows,
        Row(case=case, figure="flagged stretches", ours=len(plan.flagged)),
        Row(case=case, figure="breach that is not flagged mm", ours=missed, target="0", holds=missed == 0.0),
    ]


def unflagged_length(plan: Plan, wall: WallDistance) -> float:
    """Length in mm of path that breaks a limit and lies in no flag of that kind, found by dense sampling."""
    profile = measure_path(plan.curve, wall, spacing=CHECK_SPACING)
    s, limits = profile.arc_length, plan.limits
    spacing = profile.length / (len(s) - 1)
    missed = 0.0
    for kind, bad in (
        (FlagKind.CURVATURE, profile.curvature > limits.curvature_max),
        (FlagKind.CLEARANCE, profile.clearance < limits.clearance_min),
    ):
        covered = np.zeros(len(s), dtype=bool)
        for flag in plan.flagged:
            if flag.kind is kind:
                covered |= (s >= flag.start - FLAG_TOLERANCE) & (s <= flag.end + FLAG_TOLERANCE)
        missed += spacing * float(np.count_nonzero(bad & ~covered))
    return missed
