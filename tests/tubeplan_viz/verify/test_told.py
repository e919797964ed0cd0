"""A number that is altered in result.json alone is refused, though no other file of the run tells it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.pipeline import RunOptions
from tubeplan_viz.planners import make_case, run_case
from tubeplan_viz.verify import verify_run

Altered = Callable[..., set[str]]

PLANAR = {
    "input": {"case_id": "planar"},
    "planner": {"name": "needle2d"},
    "needle2d": {"entry": [0.0, 0.0], "target": [0.0, 90.0], "radius_mm": 50.0, "safety_mm": 1.0, "degree_max": 3},
    "obstacles": [
        {"kind": "circle", "center": [0.0, 40.0], "radius_mm": 10.0},
        {"kind": "polygon", "points": [[20.0, 30.0], [30.0, 30.0], [25.0, 45.0]]},
    ],
}


@pytest.fixture(scope="module")
def needle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A planar needle past a circle and a polygon, without a page: nothing else tells its numbers."""
    folder = tmp_path_factory.mktemp("needle") / "run"
    result = run_case(make_case(PLANAR), folder, RunOptions(recording=False, report=False))
    assert result["status"] == "ok"
    assert verify_run(folder).holds
    return folder


@pytest.fixture
def altered(plant: Callable[..., None]) -> Altered:
    """Names of the checks that do not hold when one value of result.json is changed."""

    def found(folder: Path, way: str, change: Callable[[Any], Any] | None = None) -> set[str]:
        document = json.loads((folder / "result.json").read_text())
        plant(document, way, change)
        (folder / "result.json").write_text(json.dumps(document))
        return {check.name for check in verify_run(folder).faults}

    return found


NEEDLE: Mapping[str, str] = {
    "provenance.settings.needle2d.safety_mm": "settings",
    "provenance.settings.obstacles.0.radius_mm": "settings",
    "provenance.rng_seed": "planner, seed and case",
    "provenance.version": "planner, seed and case",
    "planner.method": "planner, seed and case",
    "details.case_id": "planner, seed and case",
    "details.target_mm.1": "places: as in the case",
    "details.obstacles.0.radius_mm": "places: as in the case",
    "details.obstacles.0.center_mm.2": "places: as in the case",
    "details.obstacles.1.points_mm.2.1": "places: as in the case",
    "details.insertion_angle_deg": "places: as in the case",
    "details.controls.0.turn_deg": "places: as in the case",
    "certificate.holds": "certificate: holds",
    "certificate.clearance_lower_bound_mm": "certificate: bounds",
    "path.curvature_per_mm.7": "path: curvature and clearance",
    "path.clearance_mm.7": "path: curvature and clearance",
    "metrics.curvature_mean_per_mm": "metrics: means and largest curvature",
    "metrics.clearance_mean_mm": "metrics: means and largest curvature",
    "metrics.danger": "metrics: danger",
    "metrics.score": "metrics: score",
    "details.chosen_form": "forms",
    "details.best_per_degree.2": "forms",
    "details.forms.0.degree": "forms",
}


@pytest.mark.parametrize(("way", "check"), NEEDLE.items(), ids=NEEDLE)
def test_one_altered_number_of_a_needle_is_refused(needle: Path, altered: Altered, tmp_path: Path, way: str, check: str) -> None:
    assert check in altered(Path(shutil.copytree(needle, tmp_path / "run")), way)


TUBE: Mapping[str, str] = {
    "provenance.settings.planner.start.0": "settings",
    "planner.version": "planner, seed and case",
    "centerline.radius_mm.11": "radii: of end points and centerline",
    "details.surface.caps.0.normal.1": "surface: directions of the caps",
    "iterations.0.index": "iterations",
    "flagged_intervals.1.worst_at_mm": "flagged intervals: worst values",
}


@pytest.mark.parametrize(("way", "check"), TUBE.items(), ids=TUBE)
def test_one_altered_number_of_a_tube_is_refused(flagged_run: Path, altered: Altered, way: str, check: str) -> None:
    # Along values that hardly change a place is told no better than that; here 2 mm on they have changed.
    shift = (lambda value: value + 2.0) if way.startswith("flagged") else None
    if way == "iterations.0.index":
        document = json.loads((flagged_run / "result.json").read_text())
        document["iterations"].append({**document["iterations"][0], "index": 1})
        (flagged_run / "result.json").write_text(json.dumps(document))
    assert check in altered(flagged_run, way, shift)


def test_facts_of_the_mesh_that_are_told_are_measured(flagged_run: Path, altered: Altered, bent_tube: Any) -> None:
    document = json.loads((flagged_run / "result.json").read_text())
    details = document["details"]
    ends = document["path"]["points_mm"][0], document["path"]["points_mm"][-1]
    details |= {"start_mm": ends[0], "goal_mm": ends[1]}
    details["surface"]["volume_ml"] = bent_tube.surface.volume_ml
    radii = document["centerline"]["radius_mm"]
    narrow = radii.index(min(radii))
    details["centerline_radius_min"] = {"radius_mm": radii[narrow], "point_mm": document["centerline"]["points_mm"][narrow]}
    details["endpoints"] = [
        {"label": "E1", "point_mm": document["centerline"]["points_mm"][3], "radius_mm": radii[3]},
    ]
    (flagged_run / "result.json").write_text(json.dumps(document))
    apart = {"report.html: embedded result", "page: result"}
    before = {check.name for check in verify_run(flagged_run).faults} - apart
    assert not {name for name in before if "report" not in name}
    for way, check in {
        "details.start_mm.1": "ends: as told",
        "details.goal_mm.2": "ends: as told",
        "details.surface.volume_ml": "surface: volume",
        "details.centerline_radius_min.radius_mm": "centerline: narrowest place",
        "details.endpoints.0.radius_mm": "radii: of end points and centerline",
    }.items():
        text = (flagged_run / "result.json").read_text()
        assert check in altered(flagged_run, way)
        (flagged_run / "result.json").write_text(text)


def test_an_obstacle_that_moves_onto_a_needle_that_then_stops_is_no_touch_of_what_was_pushed(tmp_path: Path) -> None:
    table = {
        "planner": {"name": "needle3d"},
        "needle3d": {"target": [0.0, 0.0, 100.0], "kappa": 0.02, "safety_mm": 2.0, "restarts": 1, "rounds": 60},
        "obstacles": [{"kind": "sphere", "center": [0, 5, 40], "radius_mm": 5}],
        "events": [{"at_mm": 10.0, "obstacle": 1, "center": [0, 0, 10]}],
    }
    result = run_case(make_case(table), tmp_path / "run", RunOptions(recording=False, report=False))
    assert result["status"] == "infeasible"
    assert "withdraw the needle" in result["reason"]
    assert verify_run(tmp_path / "run").holds


@pytest.mark.parametrize(
    ("way", "value"),
    [
        ("details.controls.0.duty", []),
        ("details.entry_frame", "x"),
        ("details.obstacles.0.center_mm.2", {}),
        ("details.forms.0.degree", None),
        ("path.points_mm.3.1", 1e308),
    ],
)
def test_a_value_of_another_kind_is_refused(needle: Path, altered: Altered, tmp_path: Path, way: str, value: Any) -> None:
    assert altered(Path(shutil.copytree(needle, tmp_path / "run")), way, lambda _: value)


def test_a_page_that_is_no_text_is_refused(needle: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(needle, tmp_path / "run"))
    (run / "report.html").write_bytes(b"\xff\xfe\x83")
    assert {"files: digests", "values"} <= {check.name for check in verify_run(run).faults}
