"""The commands: exit status, output, and what is left on the disk."""

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

from segmentation.mesh_files import write_ply
from segmentation.synthetic import weibel_airway
from tubeplan_viz import __version__
from tubeplan_viz.recording import read_recording
from tubeplan_viz.verify import verify_run

Call = Callable[..., Any]
BARE = ("--no-recording", "--no-report", "--quiet")
# The paper's local repair flags what it cannot mend; the default would mend it, or prove that nothing can.
LOCAL = ("--method", "feature_iteration")
COMMANDS = (
    ("demo",),
    ("run",),
    ("plan", "tube"),
    ("inspect",),
    ("segment",),
    ("endpoints",),
    ("verify",),
    ("batch",),
    ("bench",),
)


def plan_tube(tubeplan: Call, mesh: Path, target: Path, *more: object, start: str = "0,0,0", goal: str = "0,40,0") -> Any:
    return tubeplan("plan", "tube", "--mesh", mesh, "--start", start, "--goal", goal, "-o", target, *more)


@pytest.fixture(scope="session")
def whole_run(meshes: Path, process: Call, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flagged run with all its files, made by a real process in its own folder."""
    folder = tmp_path_factory.mktemp("runs")
    done = process(
        "plan", "tube", "--mesh", meshes / "variant.ply", "--start", "E1", "--goal", "E2",
        "--curvature-max", "0.1", "--clearance-min", "2.4", "--max-rounds", "4", "--centerline-step", "0.8",
        *LOCAL, "-o", "run", cwd=folder,
    )  # fmt: skip
    assert done.status == 3, done.err
    assert "Traceback" not in done.err
    # A line for each stage, since standard error is no terminal.
    assert "centerline: " in done.err
    assert "flagged: " in done.out
    return folder / "run"


def test_a_plan_that_holds_ends_with_0(tubeplan: Call, meshes: Path, tmp_path: Path) -> None:
    done = plan_tube(tubeplan, meshes / "tube.ply", tmp_path / "run", "--clearance-min", "2", *BARE)
    assert done.status == 0
    assert done.err == ""
    assert done.out.startswith("holds: both limits are kept and proved")
    assert json.loads((tmp_path / "run" / "result.json").read_text())["status"] == "ok"


def test_an_airways_ends_have_names_that_start_and_goal_take(tubeplan: Call, tmp_path: Path) -> None:
    write_ply(weibel_airway(generations=1, voxel=1.0).surface, tmp_path / "airway.ply")
    listed = json.loads(tubeplan("endpoints", tmp_path / "airway.ply", "--anatomy", "airway", "--json").out)["endpoints"]
    names = {tip["name"]: tip["label"] for tip in listed}
    assert names.keys() == {"trachea", "left main bronchus", "right main bronchus"}
    shown = tubeplan("endpoints", tmp_path / "airway.ply", "--anatomy", "airway", "-q").out
    assert re.search(r"E1 .* trachea", shown)
    done = tubeplan(
        "plan", "tube", "--mesh", tmp_path / "airway.ply", "--anatomy", "airway", "--start", "trachea", "--goal", "Left main",
        "--clearance-min", "2", "-o", tmp_path / "run", *LOCAL, *BARE,
    )  # fmt: skip
    assert done.status in (0, 3), done.err
    assert "through trachea, left main bronchus" in done.out
    details = json.loads((tmp_path / "run" / "result.json").read_text())["details"]
    assert (details["start_label"], details["goal_label"]) == ("E1", names["left main bronchus"])
    assert [part["name"] for part in details["parts"]] == ["trachea", "left main bronchus"]
    assert {tip["label"]: tip["name"] for tip in details["endpoints"]} == {label: name for name, label in names.items()}
    # A run folder knows what its lumen is.
    of_run = json.loads(tubeplan("endpoints", tmp_path / "run", "--json").out)["endpoints"]
    assert {tip["name"] for tip in of_run} == names.keys()
    assert verify_run(tmp_path / "run").faults == ()


def test_a_plan_with_flags_ends_with_3_and_names_them(tubeplan: Call, meshes: Path, tmp_path: Path) -> None:
    done = plan_tube(tubeplan, meshes / "neck.ply", tmp_path / "run", "--clearance-min", "1.5", *LOCAL, *BARE)
    assert done.status == 3
    assert "clearance falls to 1.00 mm" in done.out
    assert "clearance from 17.7 to 22.3 mm, worst 1.00" in done.out


def test_a_neck_below_the_instrument_ends_with_4_and_its_proof(tubeplan: Call, meshes: Path, tmp_path: Path) -> None:
    done = plan_tube(tubeplan, meshes / "neck.ply", tmp_path / "run", "--clearance-min", "1.5", *BARE)
    assert done.status == 4
    # The neck of 1 mm lies in the middle of 40 mm; its facets leave a little less, and the bound is within 2 %.
    found = re.search(r"no path exists: every way from start to goal comes within (\S+) mm of the wall", done.out)
    assert found
    assert 0.98 <= float(found[1]) <= 1.02
    assert "1.5 mm are required" in done.out
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["planner"]["method"] == "optimal"
    assert result["details"]["bottleneck"]["proves_impossible"] is True


def test_a_lumen_narrower_everywhere_ends_with_4_and_the_reason(tubeplan: Call, meshes: Path, tmp_path: Path) -> None:
    done = plan_tube(tubeplan, meshes / "tube.ply", tmp_path / "run", "--clearance-min", "3.5", *LOCAL, *BARE)
    assert done.status == 4
    assert "infeasible: the lumen is narrower than the instrument everywhere" in done.out
    assert json.loads((tmp_path / "run" / "result.json").read_text())["status"] == "infeasible"


BAD: list[tuple[tuple[str, ...], str]] = [
    (("plan", "tube", "--start", "0,0,0", "--goal", "0,40,0"), "give either a CT"),
    (("plan", "tube", "--mesh", "{tube}", "--ct", "x", "--start", "0,0,0", "--goal", "0,40,0"), "exactly one of them"),
    (("plan", "tube", "--mesh", "missing.ply", "--start", "0,0,0", "--goal", "0,40,0"), "missing.ply"),
    (("plan", "tube", "--ct", "missing", "--anatomy", "airway", "--start", "0,0,0", "--goal", "0,40,0"), "missing"),
    (("plan", "tube", "--ct", "nowhere", "--start", "0,0,0", "--goal", "0,40,0"), "nowhere: there is no such file or folder"),
    (("plan", "tube", "--mesh", "{tube}", "--goal", "0,40,0"), "no start was given; .* end points: E1 .*; E2"),
    (("plan", "tube", "--mesh", "{tube}", "--start", "E1", "--goal", "E9"), "the lumen has no end point E9; it has E1"),
    (
        ("plan", "tube", "--mesh", "{tube}", "--start", "5,20,0", "--goal", "E2"),
        r"lies outside the lumen, 2\.0\d mm from its wall",
    ),
    (("plan", "tube", "--mesh", "{tube}", "--start", "E1", "--goal", "E1"), "start and goal are both"),
    (("plan", "tube", "--mesh", "{tube}", "--start", "1,2", "--goal", "E1"), "expected three numbers"),
    (("plan", "tube", "--mesh", "{tube}", "--start", "E1", "--goal", "E2", "--curvature-max", "0"), "--curvature-max is 0"),
    (
        ("plan", "tube", "--mesh", "{tube}", "--start", "E1", "--goal", "E2", "--clearance-min", "abc"),
        "--clearance-min: found 'abc', expected a number .least distance to the wall",
    ),
    (("plan", "tube", "--mesh", "{tube}", "--start", "E1", "--goal", "E2", "--method", "magic"), "no method 'magic'"),
    (("plan", "tube", "--mesh", "{tube}", "--start", "E1", "--goal", "E2", "--scans", "peaks"), "unknown feature scan 'peaks'"),
    (("plan", "tube", "--mesh", "{tube}", "--mesh-unit", "mile", "--start", "E1", "--goal", "E2"), "mile"),
    (("plan", "tube", "--bogus"), "bogus"),
    (("run", "missing.toml"), "missing.toml: no such case file"),
    (("verify", "missing"), "missing is no tubeplan run .no result.json of one.; name the folder"),
    (("endpoints",), "name a mesh file or run folder"),
    (("inspect", "missing"), "missing: no such file or folder"),
    (("segment", "--anatomy", "airway"), "segmenting needs a CT; give --ct"),
    (("segment", "--ct", "chest", "--goal", "1,2,3"), "No such option: --goal"),
    (("endpoints", "tube.ply", "--clearance-min", "2"), "No such option: --clearance-min"),
    (("bench", "nothing"), "no benchmark 'nothing', expected one of paper, centerline"),
    (("bogus",), "bogus"),
    # A byte that is no UTF-8, as Python hands it on.
    (("plan", "tube", "--mesh", "{tube}", "--case-id", "J\udcf6rg"), r"--case-id: found 'J\\udcf6rg', expected text in UTF-8"),
    (("export", "run", "-o", "p\udcfc"), r"'p\\udcfc' is no name in UTF-8"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD)
def test_bad_input_ends_with_2_one_sentence_and_no_folder(
    arguments: tuple[str, ...], message: str, tubeplan: Call, meshes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [argument.replace("{tube}", str(meshes / "tube.ply")) for argument in arguments]
    writes = arguments[0] in ("plan", "run", "segment")
    done = tubeplan(*given, *(("-o", tmp_path / "run", "--quiet") if writes else ()))
    assert done.status == 2
    assert done.out == ""
    lines = done.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("tubeplan: ")
    assert "Traceback" not in done.err
    # The folder of the input is the user's business, not the message's.
    assert str(tmp_path) not in done.err
    assert re.search(message, done.err)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_exists_is_refused_without_force(tubeplan: Call, meshes: Path, tmp_path: Path) -> None:
    first = plan_tube(tubeplan, meshes / "tube.ply", tmp_path / "run", *BARE)
    assert first.status == 0
    before = (tmp_path / "run" / "result.json").read_bytes()
    again = plan_tube(tubeplan, meshes / "tube.ply", tmp_path / "run", *BARE)
    assert again.status == 2
    assert "run exists already; choose another name, or replace that run with --force" in again.err
    assert (tmp_path / "run" / "result.json").read_bytes() == before
    forced = plan_tube(tubeplan, meshes / "tube.ply", tmp_path / "run", "--force", "--clearance-min", "2.5", *BARE)
    assert forced.status == 0
    assert json.loads((tmp_path / "run" / "result.json").read_text())["limits"]["clearance_min_mm"] == 2.5
    assert [entry.name for entry in tmp_path.iterdir()] == ["run"]


def test_force_replaces_no_folder_that_is_not_a_run(tubeplan: Call, meshes: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.txt").write_text("years of work")
    done = plan_tube(tubeplan, meshes / "tube.ply", tmp_path / "thesis", "--force", *BARE)
    assert done.status == 2
    assert "chapter.txt" in done.err
    assert (tmp_path / "thesis" / "chapter.txt").read_text() == "years of work"


def test_json_holds_the_outcome_and_nothing_else(tubeplan: Call, meshes: Path, tmp_path: Path) -> None:
    done = plan_tube(tubeplan, meshes / "neck.ply", tmp_path / "run", "--clearance-min", "1.5", "--json", *LOCAL, *BARE)
    assert done.status == 3
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert done.document["status"] == "flagged"
    assert done.document["metrics"] == result["metrics"]
    assert done.document["flagged_intervals"] == result["flagged_intervals"]
    assert done.document["files"] == sorted(entry.name for entry in (tmp_path / "run").iterdir())


def test_a_run_has_all_its_files_and_is_verified(whole_run: Path, tubeplan: Call) -> None:
    names = sorted(entry.name for entry in whole_run.iterdir())
    assert names == ["case.toml", "mesh.ply", "path.csv", "path.mrk.json", "recording.rrd", "report.html", "result.json"]
    verification = verify_run(whole_run)
    assert verification.holds, [check.text for check in verification.faults]
    done = tubeplan("verify", whole_run, "--json")
    assert done.status == 0
    assert done.document["holds"] is True
    count = len(verification.checks)
    said = f"{count} of {count} checks hold\n"
    shown = tubeplan("verify", whole_run).out
    assert shown.endswith(said)
    assert shown.count("ok  ") == count
    assert tubeplan("verify", whole_run, "--quiet").out == said


def test_verify_ends_with_3_when_a_number_was_edited(whole_run: Path, tubeplan: Call, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(whole_run, copy)
    result = json.loads((copy / "result.json").read_text())
    result["metrics"]["clearance_min_mm"] += 0.1
    (copy / "result.json").write_text(json.dumps(result))
    done = tubeplan("verify", copy)
    assert done.status == 3
    assert "FAIL" in done.out
    quiet = tubeplan("verify", copy, "--quiet").out.splitlines()
    assert quiet == [line for line in done.out.splitlines() if not line.startswith("ok  ")]


def test_the_case_file_of_a_run_gives_the_same_plan_number_for_number(whole_run: Path, tubeplan: Call) -> None:
    again = whole_run.parent / "again"
    done = tubeplan("run", whole_run / "case.toml", "-o", again, *BARE)
    assert done.status == 3
    first, second = (json.loads((folder / "result.json").read_text()) for folder in (whole_run, again))
    for key in (
        "status",
        "reason",
        "limits",
        "path",
        "spline",
        "centerline",
        "feature_points",
        "metrics",
        "certificate",
        "flagged_intervals",
        "iterations",
    ):
        assert first[key] == second[key], key
    assert (whole_run / "path.csv").read_bytes() == (again / "path.csv").read_bytes()
    assert (whole_run / "mesh.ply").read_bytes() == (again / "mesh.ply").read_bytes()
    assert tomllib.loads((whole_run / "case.toml").read_text()) == tomllib.loads((again / "case.toml").read_text())


def test_options_take_the_place_of_the_case_files_values(whole_run: Path, tubeplan: Call, tmp_path: Path) -> None:
    done = tubeplan("run", whole_run / "case.toml", "--clearance-min", "1", "--max-rounds", "0", "-o", tmp_path / "run", *BARE)
    assert done.status == 3
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["limits"] == {"curvature_max_per_mm": 0.1, "clearance_min_mm": 1.0}
    assert len(result["iterations"]) == 1


def test_every_iteration_of_the_recording_is_that_of_the_result(whole_run: Path) -> None:
    result = json.loads((whole_run / "result.json").read_text())
    recorded = read_recording(whole_run / "recording.rrd")
    assert [step.index for step in recorded.iterations] == [step["index"] for step in result["iterations"]]
    # Four rounds after the first spline, and perhaps a step back to the best of them.
    assert len(recorded.iterations) in (5, 6)
    for step, written in zip(recorded.iterations, result["iterations"], strict=True):
        assert len(step.features) == step.facts["features"] == written["feature_count"]
        assert step.facts["curvature_max_per_mm"] == written["curvature_max_per_mm"]
        assert step.facts["clearance_min_mm"] == written["clearance_min_mm"]
        assert (step.facts["moved"], step.facts["added"]) == (written["moved"], written["added"])
    last, path = recorded.iterations[-1], result["path"]
    np.testing.assert_array_equal(last.curve.control_points, result["spline"]["control_points_mm"])
    np.testing.assert_array_equal(last.curve.knots, result["spline"]["knots"])
    np.testing.assert_array_equal(last.arc_length, path["s_mm"])
    np.testing.assert_array_equal(last.curvature, path["curvature_per_mm"])
    np.testing.assert_array_equal(last.clearance, path["clearance_mm"])
    assert [feature.point.tolist() for feature in last.features] == [f["point_mm"] for f in result["feature_points"]]
    assert [feature.kind.value for feature in last.features] == [f["kind"] for f in result["feature_points"]]
    # The drawn line is in single precision: 1e-5 mm at 100 mm.
    np.testing.assert_allclose(last.curve_points[[0, -1]], np.array(path["points_mm"])[[0, -1]], atol=1e-4)


def test_endpoints_are_listed_for_a_mesh_and_for_a_run(whole_run: Path, meshes: Path, tubeplan: Call) -> None:
    for source in (meshes / "variant.ply", whole_run):
        done = tubeplan("endpoints", source, "--json")
        assert done.status == 0
        tips = done.document["endpoints"]
        assert [tip["label"] for tip in tips] == ["E1", "E2"]
        assert [tip["cap"] for tip in tips] == ["C1", "C2"]
    assert "E2" in tubeplan("endpoints", whole_run, "--quiet").out


def test_inspect_tells_what_a_mesh_is(meshes: Path, tubeplan: Call) -> None:
    done = tubeplan("inspect", meshes / "tube.ply", "--json")
    assert done.status == 0
    assert "tube.ply" in json.dumps(done.document)
    assert tubeplan("inspect", meshes / "tube.ply").status == 0


def test_inspect_lists_a_series_without_its_patient(series: Path, tubeplan: Call, identity: dict[str, str]) -> None:
    for flags in ((), ("--json",)):
        done = tubeplan("inspect", series, *flags)
        assert done.status == 0
        assert "48" in done.out
        assert not [value for value in identity.values() if value in done.out]


def test_segment_writes_mask_and_mesh(series: Path, tubeplan: Call, tmp_path: Path) -> None:
    arguments = (
        "segment",
        "--ct",
        series,
        "--anatomy",
        "generic",
        "--seed-point",
        "1,4,120",
        "--hu-min",
        "170",
        "--hu-max",
        "400",
    )
    done = tubeplan(*arguments, "-o", tmp_path / "lumen", "--json")
    assert done.status == 0, done.err
    assert sorted(entry.name for entry in (tmp_path / "lumen").iterdir()) == ["mask.nii.gz", "mesh.ply", "segmentation.json"]
    # A tube of radius 4 mm through 48 slices of 1 mm, whose first and last lie at the image's border.
    assert done.document["surface"]["volume_ml"] == pytest.approx(np.pi * 16.0 * 48.0 / 1000.0, rel=0.06)
    assert len(done.document["surface"]["caps"]) == 2
    assert tubeplan(*arguments, "-o", tmp_path / "lumen", "--quiet").status == 2
    tips = tubeplan("endpoints", tmp_path / "lumen", "--json")
    assert len(tips.document["endpoints"]) == 2


@pytest.mark.parametrize("command", COMMANDS)
def test_help_gives_an_example(command: tuple[str, ...], tubeplan: Call) -> None:
    done = tubeplan(*command, "--help")
    assert done.status == 0
    assert f"Example: tubeplan {' '.join(command)}" in " ".join(done.out.split())


def test_every_way_to_end_is_the_exit_status_of_a_process(process: Call, whole_run: Path, tmp_path: Path) -> None:
    # All commands have one entry point: what else they do is tested in this process. plan, demo, view, export and batch are
    # started as processes by other tests.
    assert process("--version").out.strip() == f"tubeplan {__version__}"
    assert process("verify", whole_run, "--json").document["holds"] is True
    done = process("run", whole_run / "case.toml", "--max-rounds", "0", "-o", tmp_path / "run", "--json", *BARE)
    assert (done.status, done.document["status"]) == (3, "flagged")
    wrong = process("plan", "tube", "--mesh", "missing.ply", "-o", tmp_path / "none")
    assert wrong.status == 2
    assert "Traceback" not in wrong.err


def test_the_demo_goes_from_ct_to_report(process: Call, tmp_path: Path) -> None:
    done = process("demo", "-o", tmp_path / "demo", "--json", "--quiet")
    assert done.status == 0, done.err
    assert done.document["status"] == "ok"
    assert done.document["frame"] == "LPS"
    assert (tmp_path / "demo" / "report.html").stat().st_size < 8e6
    verification = verify_run(tmp_path / "demo")
    assert verification.holds, [check.text for check in verification.faults]


def test_a_fault_of_the_program_ends_with_1_and_says_so(
    tubeplan: Call, meshes: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("a loose wire")

    monkeypatch.setattr("tubeplan_viz.pipeline.tube.load_lumen", broken)
    done = plan_tube(tubeplan, meshes / "tube.ply", tmp_path / "run", *BARE)
    assert done.status == 1
    assert "a fault of the program, please report it: RuntimeError: a loose wire" in done.err
    assert list(tmp_path.iterdir()) == []
