"""A planned run whose geometry is known: a bent tube and a spline along its axis."""

from __future__ import annotations

import html
import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from segmentation.arrays import FloatArray
from segmentation.mesh import Cap, Surface
from segmentation.mesh_files import write_ply
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.pipeline.tube import surface_details
from tubeplan_viz.plan import Feature, FeatureKind, Limits, Plan, PlanStatus, PlanStep
from tubeplan_viz.profile import certify, flag_stretches, measure_path, path_metrics
from tubeplan_viz.result import Provenance, RunFolder, build_result, path_csv, slicer_markups

RADIUS, BEND_RADIUS, STRAIGHT = 3.0, 15.0, 12.0  # mm
LENGTH = 2.0 * STRAIGHT + 0.5 * np.pi * BEND_RADIUS
ORIGIN = np.array([40.0, -25.0, 110.0])
PAGE_KEYS = {  # keys that the page prints, with their decimals
    "limits.curvature_max_per_mm": 4,
    "limits.clearance_min_mm": 2,
    "metrics.length_mm": 1,
    "metrics.curvature_max_per_mm": 4,
    "metrics.curvature_mean_per_mm": 4,
    "metrics.clearance_min_mm": 2,
    "metrics.clearance_mean_mm": 2,
    "spline.control_points_mm.0.1": 1,
    "iterations.0.feature_count": 0,
}


@dataclass(frozen=True, eq=False)
class BentTube:
    """A bent tube of radius 3 mm and a spline near its axis."""

    surface: Surface
    curve: SplineCurve
    centerline: Centerline

    def plan(self, limits: Limits, *, closed_ends: bool = False) -> Plan:
        """The curve measured and judged by the product's own functions."""
        wall = WallDistance(self.surface, closed_ends=closed_ends)
        profile, dense = measure_path(self.curve, wall), measure_path(self.curve, wall, spacing=0.02)
        flagged, certificate = flag_stretches(dense, limits), certify(self.curve, wall, limits)
        status = PlanStatus.FLAGGED if flagged else PlanStatus.OK
        features = tuple(
            Feature(kind=kind, point=self.curve([u])[0], u=u)
            for kind, u in [(FeatureKind.START, 0.0), (FeatureKind.NODE, 0.4), (FeatureKind.GOAL, 1.0)]
        )
        metrics = path_metrics(profile, self.centerline) | {
            "curvature_max_per_mm": float(dense.curvature.max()),
            "clearance_min_mm": float(dense.clearance.min()),
            "tip_error_mm": 0.0,
        }
        return Plan(
            planner="tube",
            method="feature_iteration",
            status=status,
            reason="a stretch breaks its limit" if flagged else None,
            limits=limits,
            curve=self.curve,
            profile=profile,
            features=features,
            centerline=Centerline(points=self.centerline.points, radii=wall.clearance(self.centerline.points)),
            steps=(PlanStep(index=0, curve=self.curve, features=features, profile=profile, flagged=flagged),),
            flagged=flagged,
            certificate=certificate,
            metrics=metrics,
            details={"closed_ends": closed_ends},
        )


def axis(s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points and tangents, (n, 3), of a line, a quarter circle to the left and a line in the plane z = const."""
    turn = np.clip((s - STRAIGHT) / BEND_RADIUS, 0.0, 0.5 * np.pi)
    tangent = np.column_stack([-np.sin(turn), np.cos(turn), 0.0 * s])
    bend = BEND_RADIUS * np.column_stack([np.cos(turn) - 1.0, np.sin(turn), 0.0 * s])
    straight = np.minimum(s, STRAIGHT)[:, None] * [0.0, 1.0, 0.0] + np.maximum(s - LENGTH + STRAIGHT, 0.0)[:, None] * [
        -1.0,
        0.0,
        0.0,
    ]
    return ORIGIN + straight + bend, tangent


def swept(stations: int = 56, around: int = 24) -> Surface:
    """Rings on the axis, vertices exactly 3 mm from it, closed by a fan at each end."""
    points, tangents = axis(np.linspace(0.0, LENGTH, stations))
    angle = 2.0 * np.pi * np.arange(around) / around
    side = np.column_stack([tangents[:, 1], -tangents[:, 0], 0.0 * tangents[:, 0]])
    up = np.array([0.0, 0.0, 1.0])
    rings = points[:, None] + RADIUS * (np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up)
    vertices = np.concatenate([rings.reshape(-1, 3), points[[0, -1]]])
    ring, place = (grid.ravel() for grid in np.meshgrid(np.arange(stations - 1), np.arange(around), indexing="ij"))
    a, b = ring * around + place, ring * around + (place + 1) % around
    first, last = np.arange(around), (stations - 1) * around + np.arange(around)
    start = np.column_stack([np.full(around, stations * around), first, np.roll(first, -1)])
    end = np.column_stack([np.full(around, stations * around + 1), np.roll(last, -1), last])
    wall = np.concatenate([np.column_stack([a, a + around, b]), np.column_stack([b, a + around, b + around])])
    faces = np.concatenate([wall, start, end])
    inward = np.einsum("ij,ij->", vertices[faces[:, 0]], np.cross(vertices[faces[:, 1]], vertices[faces[:, 2]])) < 0.0
    face_cap = np.concatenate([np.full(len(wall), -1), np.zeros(around), np.ones(around)])
    area = 0.5 * around * RADIUS**2 * np.sin(2.0 * np.pi / around)
    caps = (Cap("C1", "flat end", points[0], -tangents[0], area), Cap("C2", "flat end", points[-1], tangents[-1], area))
    return Surface(vertices, faces[:, ::-1] if inward else faces, face_cap, caps, "mesh")


@pytest.fixture(scope="session")
def bent_tube() -> BentTube:
    """The tube in the axes of a mesh file, its spline 0.4 mm above the axis in the bend."""
    s = np.linspace(0.0, LENGTH, 17)
    points = axis(s)[0] + 0.4 * np.sin(np.pi * s / LENGTH)[:, None] ** 2 * [0.0, 0.0, 1.0]
    spline = make_interp_spline(s / s[-1], points, k=3, bc_type="natural")
    curve = SplineCurve(3, np.asarray(spline.t), np.asarray(spline.c))
    line = axis(np.linspace(0.0, LENGTH, 48))[0]
    return BentTube(swept(), curve, Centerline(points=line, radii=np.full(len(line), RADIUS)))


def page_of(result: Mapping[str, Any]) -> str:
    """A small report: numbers with their keys, and the result embedded."""
    rows = []
    for key, digits in PAGE_KEYS.items():
        value: Any = result
        for name in key.split("."):
            value = value[int(name)] if isinstance(value, list) else value[name]
        rows.append((key, value, digits))
    rows.append(("derived:margin_mm", result["metrics"]["clearance_min_mm"] - result["limits"]["clearance_min_mm"], 3))
    rows.append(("derived:bend_radius_mm", 1.0 / result["metrics"]["curvature_max_per_mm"], 2))
    for index, flag in enumerate(result["flagged_intervals"]):
        rows.append((f"derived:flag.{index}.length_mm", flag["to_mm"] - flag["from_mm"], 2))
    cells = "".join(
        f'<p><data class="v" value="{json.dumps(value)}" data-key="{html.escape(key)}">'
        f"{f'{value:.{digits}f}'.replace('-', chr(0x2212))}</data> mm</p>\n"
        for key, value, digits in rows
    )
    embedded = json.dumps(result).replace("<", "\\u003c")
    return f'<!doctype html><title>case</title>{cells}<script type="application/json" id="tubeplan-result">{embedded}</script>'


def case_toml(start: FloatArray, goal: FloatArray) -> str:
    """A case file with the ends asked for."""
    return f"[planner]\nname = 'tube'\nstart = {np.asarray(start).tolist()}\ngoal = {np.asarray(goal).tolist()}\n"


def write_run(folder: Path, plan: Plan, surface: Surface) -> dict[str, Any]:
    """A whole run folder through the product's own writers; returns result.json's content."""
    ends = plan.curve([0.0, 1.0])
    with RunFolder(folder) as run:
        ordered = write_ply(surface, run.path("mesh.ply"))
        result = build_result(
            plan,
            frame=surface.frame,
            timings_s={"plan": 0.25, "surface": 1.5},
            provenance=Provenance(
                inputs=(("tube.stl", "0" * 64),),
                rng_seed=3,
                settings={"planner": {"start": ends[0], "goal": ends[1]}},
            ),
            details={"surface": surface_details(ordered)},
        )
        run.write_text("case.toml", case_toml(ends[0], ends[1]))
        run.write_text("path.csv", path_csv(plan.profile))
        run.write_json("path.mrk.json", slicer_markups(result))
        run.write_text("report.html", page_of(result))
        return run.finish(result)


GENEROUS = Limits(curvature_max=0.09, clearance_min=2.2)
TIGHT = Limits(curvature_max=0.0665, clearance_min=2.75)


@pytest.fixture(scope="session")
def made_runs(bent_tube: BentTube, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs, made once and never changed: `clean` keeps its limits, `flagged` breaks both on some stretches."""
    folder = tmp_path_factory.mktemp("runs")
    write_run(folder / "clean", bent_tube.plan(GENEROUS), bent_tube.surface)
    write_run(folder / "flagged", bent_tube.plan(TIGHT), bent_tube.surface)
    return folder


@pytest.fixture
def clean_run(made_runs: Path, tmp_path: Path) -> Path:
    """A copy of the run whose path keeps its limits."""
    return Path(shutil.copytree(made_runs / "clean", tmp_path / "run"))


@pytest.fixture
def flagged_run(made_runs: Path, tmp_path: Path) -> Path:
    """A copy of the run whose path breaks both limits on some stretches."""
    return Path(shutil.copytree(made_runs / "flagged", tmp_path / "run"))


@pytest.fixture(scope="session")
def writer() -> Callable[[Path, Plan, Surface], dict[str, Any]]:
    """`write_run`, for tests that make their own plans."""
    return write_run
