"""From a needle's case to its run folder and back: case files, exit statuses, report, recording, verifier."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk
import tomli_w

from segmentation.errors import CaseError
from tubeplan_viz.bench.needle_scenes import SCENES
from tubeplan_viz.cases.needle import make_needle_case, needle_case_table
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.verify import verify_run

ROOT = Path(__file__).resolve().parents[3]


def run(folder: Path, table: dict[str, Any], name: str = "run", *options: str) -> int:
    case = folder / f"{name}.toml"
    case.write_text(tomli_w.dumps(table), encoding="utf-8")
    return status_of(["run", str(case), "-o", str(folder / name), "--quiet", *options])


def result_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flat")
    assert run(folder, SCENES["planar"]) == 0
    return folder / "run"


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pushed")
    assert run(folder, SCENES["replan-target"]) == 0
    return folder / "run"


@pytest.mark.parametrize("name", sorted(SCENES))
def test_the_files_of_the_papers_cases_are_those_of_the_benchmark(name: str) -> None:
    told = tomllib.loads((ROOT / "datasets" / "needle" / f"{name}.toml").read_text(encoding="utf-8"))
    assert make_needle_case(told) == make_needle_case(SCENES[name])


@pytest.mark.parametrize("which", ["flat", "pushed"])
def test_a_run_folder_holds_what_it_should_and_the_verifier_agrees(which: str, request: pytest.FixtureRequest) -> None:
    folder: Path = request.getfixturevalue(which)
    names = {entry.name for entry in folder.iterdir()}
    assert names == {"case.toml", "path.csv", "path.mrk.json", "recording.rrd", "report.html", "result.json"}
    verification = verify_run(folder)
    assert [check.name for check in verification.faults] == []
    assert len(verification.checks) >= 15


def test_the_case_of_a_run_gives_the_same_plan(flat: Path, tmp_path: Path) -> None:
    assert status_of(["run", str(flat / "case.toml"), "-o", str(tmp_path / "again"), "--quiet", "--no-recording"]) == 0
    first, second = result_of(flat), result_of(tmp_path / "again")
    assert first["path"] == second["path"]
    assert first["details"]["controls"] == second["details"]["controls"]


def test_forms_controls_and_insertion_are_told(flat: Path, pushed: Path) -> None:
    details = result_of(flat)["details"]
    assert len(details["forms"]) == 18
    assert details["chosen_form"] == "RL"
    assert sum(control["length_mm"] for control in details["controls"]) == pytest.approx(
        result_of(flat)["metrics"]["length_mm"], abs=1e-9
    )
    insertion = result_of(pushed)["details"]["insertion"]
    assert insertion["error_mm"] < 0.1
    assert insertion["replans"][0]["cause"] == "the target has moved"
    assert result_of(pushed)["details"]["pareto"]


def test_the_report_needs_no_network_and_no_script(flat: Path, pushed: Path) -> None:
    for folder in (flat, pushed):
        page = (folder / "report.html").read_text(encoding="utf-8")
        assert "default-src 'none'" in page
        # The scene's library names namespaces and manuals in its own text; whether it fetches anything is the browser's to see.
        assert "http" not in re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL).replace("http-equiv", "")
        assert page.count("Research use, not for clinical decisions") >= 2
        assert str(folder.parent) not in page
    assert "Forms" in (flat / "report.html").read_text(encoding="utf-8")
    assert "the target has moved" in (pushed / "report.html").read_text(encoding="utf-8")


def test_the_verifier_finds_a_push_that_is_too_long(flat: Path, found_in: Callable[..., set[str]]) -> None:
    def change(document: dict[str, Any]) -> None:
        document["details"]["controls"][0]["length_mm"] += 0.01

    assert {"tip: on the target", "path: from the controls"} <= found_in(flat, change)


def test_the_verifier_finds_two_percent_too_much_bend(pushed: Path, found_in: Callable[..., set[str]]) -> None:
    def change(document: dict[str, Any]) -> None:
        document["details"]["controls"][1]["curvature_per_mm"] *= 1.02

    assert {"curvature", "tip: on the target"} <= found_in(pushed, change)


def test_the_verifier_finds_an_obstacle_that_is_too_near(flat: Path, tmp_path: Path) -> None:
    copy = tmp_path / "near"
    shutil.copytree(flat, copy)
    case = tomllib.loads((copy / "case.toml").read_text(encoding="utf-8"))
    case["obstacles"][0]["radius_mm"] += 0.1
    (copy / "case.toml").write_text(tomli_w.dumps(case), encoding="utf-8")
    assert "obstacle 1 (circle)" in [check.name for check in verify_run(copy).faults]


def test_a_blocked_target_ends_with_status_4_and_a_reason(tmp_path: Path) -> None:
    around = [{"kind": "circle", "center": [18 * np.sin(a), 80 + 18 * np.cos(a)], "radius_mm": 8.0} for a in np.arange(8) * 0.785]
    table = {"planner": {"name": "needle2d"}, "target": [0, 80], "safety_mm": 1.0, "degree_max": 3, "obstacles": around}
    assert run(tmp_path, json.loads(json.dumps(table)), "run", "--no-recording") == 4
    result = result_of(tmp_path / "run")
    assert result["status"] == "infeasible"
    assert result["path"] is None
    assert all(form["reason"] for form in result["details"]["forms"])
    assert verify_run(tmp_path / "run").holds


def test_without_obstacles_there_is_no_clearance(tmp_path: Path) -> None:
    options = ["--target", "30,90", "-o", str(tmp_path / "free"), "--quiet", "--no-recording"]
    assert status_of(["plan", "needle2d", *options]) == 0
    result = result_of(tmp_path / "free")
    assert result["path"]["clearance_mm"] is None
    assert result["metrics"]["length_mm"] == pytest.approx(np.hypot(30, 90), abs=1e-9)
    assert result["details"]["insertion_angle_deg"] == pytest.approx(-18.434948822922, abs=1e-9)
    assert verify_run(tmp_path / "free").holds


def test_a_label_volume_is_kept_away_from(tmp_path: Path) -> None:
    voxels = np.zeros((60, 40, 40), np.int16)
    voxels[24:30, 18:40, 12:28] = 1  # a plate on the straight way, z 48 to 60 mm
    image = sitk.GetImageFromArray(voxels)
    image.SetSpacing((2.0, 2.0, 2.0))
    image.SetOrigin((-40.0, -40.0, -5.0))
    sitk.WriteImage(image, str(tmp_path / "plate.nii.gz"))
    table = {
        "planner": {"name": "needle3d"},
        "needle3d": {"target": [0.0, 0.0, 100.0], "safety_mm": 1.0, "restarts": 1, "pieces": 3},
        "obstacles": [{"kind": "mask", "file": "plate.nii.gz"}],
    }
    assert run(tmp_path, table, "run", "--no-recording", "--no-report") == 0
    assert [check.name for check in verify_run(tmp_path / "run").faults] == []
    bound = result_of(tmp_path / "run")["details"]["obstacles"][0]["distance_bound_mm"]
    assert bound == pytest.approx(0.25 * 2.0 * np.sqrt(3.0), abs=1e-9)  # a quarter of a voxel's diagonal


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"needle3d": {"kappa": 0.02}}, "no target was given"),
        ({"needle3d": {"target": [0, 0]}}, "expected 3 numbers in mm"),
        ({"needle3d": {"target": [0, 0, 9], "kapa": 1}}, "unknown key 'kapa'"),
        ({"needle3d": {"target": [0, 0, 9], "kappa": 0.02, "radius_mm": 50}}, "kappa and radius_mm are both given"),
        ({"needle3d": {"target": [0, 0, 9]}, "target": [0, 0, 9]}, "target stands twice"),
        ({"needle3d": {"target": [0, 0, 9]}, "obstacles": [{"kind": "circle"}]}, "expected sphere, capsule, mesh, mask in space"),
        ({"needle3d": {"target": [0, 0, 9]}, "obstacles": [{"kind": "sphere"}]}, "a sphere needs center"),
        ({"needle3d": {"target": [0, 0, 9]}, "events": [{"kappa": 0.02}]}, "an event needs at_mm"),
        ({"needle3d": {"target": [0, 0, 9]}, "tube": {}}, "unknown table 'tube'"),
    ],
)
def test_a_case_that_cannot_be_is_refused_with_its_place(change: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError, match=message.replace("(", r"\(")):
        make_needle_case({"planner": {"name": "needle3d"}, **change})


def test_keys_are_taken_from_the_top_and_from_limits() -> None:
    table = {
        "planner": {"name": "needle3d", "entry": [1, 2, 3]},
        "target": [0, 0, 90],
        "limits": {"curvature_max": 0.01, "clearance_min": 3},
    }
    case = make_needle_case(table)
    assert (case.kappa, case.safety, case.entry) == (0.01, 3.0, (1.0, 2.0, 3.0))
    assert make_needle_case(needle_case_table(case)) == case


def test_bad_options_end_with_status_2_and_one_sentence(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert status_of(["plan", "needle3d", "--target", "0,0,100", "--sphere", "0,5", "-o", str(tmp_path / "x"), "--quiet"]) == 2
    assert "expected 4 numbers in mm" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
