"""A short run through a bent tube, recorded once for all tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from segmentation.mesh import Surface
from segmentation.region_growing import GrowthCurve, Region
from segmentation.volume import Volume
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.endoluminal import FilmSettings, make_film
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.plan import Feature, FeatureKind, Limits, PlanStep
from tubeplan_viz.profile import flag_stretches, measure_path
from tubeplan_viz.recording import RecordedRun, Recording, read_recording

LIMITS = Limits(curvature_max=0.08, clearance_min=2.5)


@dataclass(frozen=True, eq=False)
class Run:
    """What a planner would have given: states that approach the axis, and result.json's content."""

    surface: Surface
    centerline: Centerline
    steps: tuple[PlanStep, ...]
    result: Mapping[str, Any]


def state(curve: SplineCurve, wall: WallDistance, index: int) -> PlanStep:
    """One iteration with features of three kinds, one of them moved as often as the index says."""
    kinds = [FeatureKind.START, FeatureKind.NODE, FeatureKind.EXTREMUM, FeatureKind.NODE, FeatureKind.GOAL]
    u = np.linspace(0.0, 1.0, len(kinds))
    features = tuple(
        Feature(kind=kind, point=point, u=float(at), moved=index if kind is FeatureKind.EXTREMUM else 0)
        for kind, point, at in zip(kinds, curve(u), u, strict=True)
    )
    profile = measure_path(curve, wall)
    return PlanStep(
        index=index,
        curve=curve,
        features=features,
        profile=profile,
        flagged=flag_stretches(profile, LIMITS),
        moved=index,
        added=3 - index,
        decisions=(f"decision {index}",),
    )


def result_of(step: PlanStep) -> dict[str, Any]:
    """The keys of result.json that a recording reads."""
    profile = step.profile
    return {
        "status": "flagged" if step.flagged else "ok",
        "reason": "a limit is broken" if step.flagged else None,
        "planner": {"name": "tube", "method": "feature_iteration", "version": "0.1.0"},
        "path": {
            "s_mm": profile.arc_length.tolist(),
            "points_mm": profile.points.tolist(),
            "curvature_per_mm": profile.curvature.tolist(),
            "clearance_mm": profile.clearance.tolist(),
        },
        "feature_points": [
            {"point_mm": feature.point.tolist(), "kind": feature.kind.value, "s_mm": float(step.curve.arc_length(feature.u)[0])}
            for feature in step.features
        ],
        "metrics": {"length_mm": profile.length, "clearance_min_mm": float(profile.clearance.min())},
        "flagged_intervals": [
            {
                "kind": flag.kind.value,
                "from_mm": flag.start,
                "to_mm": flag.end,
                "worst": flag.worst,
                "worst_at_mm": flag.worst_at,
            }
            for flag in step.flagged
        ],
        "iterations": [{}] * (step.index + 1),
    }


@pytest.fixture(scope="session")
def run(bent_tube: Any) -> Run:
    """Four states: iteration 0 breaks both limits, iteration 3 holds them."""
    wall = WallDistance(bent_tube.surface)
    control = bent_tube.curve.control_points
    shape = np.sin(np.linspace(0.0, 4.0 * np.pi, len(control)))[:, None] * [0.0, 0.0, 1.0]
    curves = [SplineCurve(3, bent_tube.curve.knots, control + size * shape) for size in (1.6, 0.8, 0.3, 0.0)]
    steps = tuple(state(curve, wall, index) for index, curve in enumerate(curves))
    return Run(bent_tube.surface, bent_tube.centerline, steps, result_of(steps[-1]))


def oblique_volume(center: np.ndarray, fall: np.ndarray) -> Volume:
    """A small CT with turned axes whose HU rise linearly along `fall` from 0 at `center`."""
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    shape, spacing = np.array([60, 66, 70]), np.array([1.0, 0.9, 0.8])
    matrix = np.eye(4)
    matrix[:3, :3] = turn * spacing
    matrix[:3, 3] = center - matrix[:3, :3] @ (shape - 1) / 2.0
    index = np.moveaxis(np.indices(shape), 0, -1)
    hu = (index @ matrix[:3, :3].T + matrix[:3, 3] - center) @ fall
    return Volume(np.rint(hu).astype(np.int16), matrix)


@pytest.fixture(scope="session")
def imaged(run: Run) -> tuple[Volume, Region]:
    """A CT around the tube and its lumen, and the lumen as a mask."""
    center = run.centerline.points.mean(axis=0)
    volume = oblique_volume(center, np.array([2.0, 1.0, -1.0]))
    index = np.moveaxis(np.indices(volume.voxels.shape), 0, -1)
    points = volume.to_lps(index.reshape(-1, 3))
    near = np.full(len(points), np.inf)
    for vertex in run.centerline.points:
        np.minimum(near, np.linalg.norm(points - vertex, axis=1), out=near)
    lumen = (near <= 3.0).reshape(volume.voxels.shape)
    inside = np.argwhere(lumen)
    low, high = inside.min(axis=0), inside.max(axis=0) + 1
    mask = lumen[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    a, b, c = (int(each) for each in low)
    region = Region(mask=mask, lower=(a, b, c), seed=(a, b, c), hu_min=-50.0, hu_max=50.0, volume_ml=1.0, border={})
    return volume, region


GROWTH = GrowthCurve(
    varied="hu_min",
    limits=np.array([300.0, 250.0, 200.0, 150.0]),
    volumes_ml=np.array([1.0, 1.2, 1.3, 40.0]),
    chosen=200.0,
    leak_limit=150.0,
    leak_voxel=(1, 2, 3),
    leak_point=np.array([1.0, 2.0, 3.0]),
)


def record(path: Path, run: Run, *, imaged: tuple[Volume, Region] | None = None, light: bool = False) -> None:
    """The whole of a recording, as the pipeline makes it."""
    with Recording.open(
        path, case_id="bent tube", limits=LIMITS, planner="tube", method="feature_iteration", frame="mesh", light=light
    ) as recording:
        if imaged is not None:
            recording.log_volume(*imaged)
            recording.log_growth(GROWTH)
        recording.log_surface(run.surface)
        recording.log_centerline(run.centerline)
        for step in run.steps:
            recording.log_step(step)
        if not light:
            profile = run.steps[-1].profile
            seen = FilmSettings(size=48, step=8.0)
            film = make_film(run.surface, profile.arc_length, profile.points, profile.clearance, settings=seen)
            recording.log_film(film)
        recording.finish(run.result)


@pytest.fixture(scope="session")
def recorded_file(run: Run, imaged: tuple[Volume, Region], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished recording with CT."""
    path = tmp_path_factory.mktemp("recorded") / "recording.rrd"
    record(path, run, imaged=imaged)
    return path


@pytest.fixture(scope="session")
def recorded(recorded_file: Path) -> RecordedRun:
    """The recording with CT, read back."""
    return read_recording(recorded_file)


@pytest.fixture(scope="session")
def light_file(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished light recording."""
    path = tmp_path_factory.mktemp("light") / "recording.rrd"
    record(path, run, light=True)
    return path


@pytest.fixture(scope="session")
def limits() -> Limits:
    """What the recorded runs are held against."""
    return LIMITS
