"""Needles through the command line: events, insertions at random, the CT with its skin; and what the verifier finds planted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk

from segmentation.errors import CaseError
from tubeplan_viz.cases.needle import make_needle_case, needle_case_table
from tubeplan_viz.cases.needle_rows import read_events
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.verify import verify_run

EVENTS = """
[[events]]
at_mm = 20.0
obstacle = 1
center = [0.0, 0.0, 50.0]

[[events]]
at_mm = 40.0
kappa = 0.021
"""
BASE = ["plan", "needle3d", "--target", "0,0,100", "--sphere", "0,5,40,3", "--safety", "1", "--quiet"]


def result_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pushed")
    (folder / "events.toml").write_text(EVENTS, encoding="utf-8")
    options = ["--events", str(folder / "events.toml"), "--monte-carlo", "5", "-o", str(folder / "run")]
    assert status_of([*BASE, *options]) == 0
    return folder / "run"


@pytest.fixture(scope="module")
def imaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A made CT: a body from x = -60 on, a bone plate with a hole across the straight way."""
    folder = tmp_path_factory.mktemp("imaged")
    z, y, x = np.meshgrid(np.arange(0, 60, 2.0), np.arange(-40, 42, 2.0), np.arange(-90, 42, 2.0), indexing="ij")
    hu = np.where(x >= -60.0, 30, -1000)
    hu[(x >= -30.0) & (x <= -24.0) & (np.hypot(y - 8.0, z - 30.0) > 9.0)] = 600
    image = sitk.GetImageFromArray(hu.astype(np.int16))
    image.SetSpacing((2.0, 2.0, 2.0))
    image.SetOrigin((-90.0, -40.0, 0.0))
    sitk.WriteImage(image, str(folder / "ct.nii.gz"))
    asked = ["--hu-min", "300", "--target", "20,0,30", "--entry=-75,0,30", "--direction", "1,0,0", "--skin"]
    more = ["--entry-radius", "12", "--cone", "15", "--kappa", "0.01", "--safety", "1", "--restarts", "1", "--pieces", "3"]
    status = status_of(
        ["plan", "needle3d", "--ct", str(folder / "ct.nii.gz"), *asked, *more, "-o", str(folder / "run"), "--quiet"]
    )
    assert status == 0
    return folder / "run"


def test_events_of_a_file_are_simulated_logged_and_verified(pushed: Path) -> None:
    details = result_of(pushed)["details"]
    causes = [step["cause"] for step in details["insertion"]["replans"]]
    assert causes[0] == "obstacle 1 has moved"
    assert "the curvature is not that of the model" in causes
    assert details["insertion"]["error_mm"] < 0.1
    assert [check.name for check in verify_run(pushed).faults] == []


def test_insertions_at_random_are_counted_and_told(pushed: Path) -> None:
    found = result_of(pushed)["details"]["monte_carlo"]
    assert found["runs"] == 5
    assert found["ended"] + found["withdrawn"] == 5
    assert found["touched"] == 0
    page = (pushed / "report.html").read_text(encoding="utf-8")
    assert "Insertions at random" in page
    assert "obstacle 1 has moved" in page


def test_the_case_of_such_a_run_gives_the_same_numbers(pushed: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    assert status_of(["run", str(pushed / "case.toml"), "-o", str(again), "--quiet", "--no-recording", "--no-report"]) == 0
    first, second = result_of(pushed)["details"], result_of(again)["details"]
    assert first["controls"] == second["controls"]
    assert first["insertion"]["controls"] == second["insertion"]["controls"]
    assert first["monte_carlo"]["errors_mm"] == second["monte_carlo"]["errors_mm"]


@pytest.mark.parametrize(
    ("change", "names"),
    [
        (lambda d: d["insertion"].update(clearance_min_mm=d["insertion"]["clearance_min_mm"] + 0.2),
         {"insertion: obstacles where they stood"}),
        (lambda d: d["insertion"].update(error_mm=0.5), {"insertion: tip and length"}),
        (lambda d: d["insertion"]["replans"].pop(0), {"insertion: causes"}),
        (lambda d: d["insertion"]["controls"][-1].update(curvature_per_mm=0.02), {"insertion: curvature"}),
        (lambda d: d["pareto"][0].update(length_mm=d["pareto"][0]["length_mm"] - 1.0), {"front: errors and lengths"}),
        (lambda d: d["pareto"].append({**d["pareto"][0], "danger": 9.0}), {"front: none is beaten", "front: obstacles"}),
        (lambda d: d["monte_carlo"].update(withdrawn=d["monte_carlo"]["withdrawn"] + 1), {"Monte Carlo: counts"}),
        (lambda d: d["monte_carlo"]["percentiles_mm"].update({"50": 0.0}), {"Monte Carlo: errors"}),
        (lambda d: d["controls"][0].update(duty=0.5), {"duty cycle"}),
    ],
)  # fmt: skip
def test_the_verifier_finds_planted_faults(
    pushed: Path, found_in: Callable[..., set[str]], change: Callable[[dict[str, Any]], None], names: set[str]
) -> None:
    assert names <= found_in(pushed, lambda document: change(document["details"]))


def test_a_ct_gives_obstacle_skin_and_pictures(imaged: Path) -> None:
    result = result_of(imaged)
    entry = result["details"]["entry_mm"]
    assert result["frame"] == "LPS"
    assert entry[0] == pytest.approx(-61.0, abs=1.0)  # between the last voxel of air and the first of tissue
    through = [p for p in result["path"]["points_mm"] if -30.0 <= p[0] <= -24.0]
    assert max(np.hypot(p[1] - 8.0, p[2] - 30.0) for p in through) < 9.0  # through the hole, not beside it
    page = (imaged / "report.html").read_text(encoding="utf-8")
    assert page.count('<svg class="cut"') == 4
    assert [check.name for check in verify_run(imaged).faults] == []


def test_the_verifier_finds_an_entry_off_the_skin(imaged: Path, found_in: Callable[..., set[str]]) -> None:
    def sunk(document: dict[str, Any]) -> None:
        document["path"]["points_mm"][0][0] += 8.0

    assert "entry: on the skin" in found_in(imaged, sunk)


def test_polygons_capsules_and_the_tree_from_the_command_line(tmp_path: Path) -> None:
    flat = ["plan", "needle2d", "--target", "0,90", "--polygon=-10,40,10,40,10,50,-10,50", "--degree-max", "2", "--safety", "1"]
    common = ["--quiet", "--no-recording", "--no-report"]
    assert status_of([*flat, "-o", str(tmp_path / "flat"), *common]) == 0
    assert result_of(tmp_path / "flat")["details"]["obstacles"][0]["kind"] == "polygon"
    rod = [*BASE[:4], "--capsule=-20,4,50,20,4,50,4", "--method", "rrt", "--safety", "1"]
    assert status_of([*rod, "-o", str(tmp_path / "rod"), *common]) == 0
    result = result_of(tmp_path / "rod")
    assert result["planner"]["method"] == "rrt"
    assert result["details"]["nodes"] >= 1
    for name in ("flat", "rod"):
        assert [check.name for check in verify_run(tmp_path / name).faults] == []


def test_the_case_file_holds_the_options_by_the_same_names() -> None:
    table = {
        "input": {"ct": "ct", "hu_min": 180, "seed_point": [1, 2, 3]},
        "planner": {"name": "needle3d", "method": "rrt"},
        "needle3d": {"target": [0, 0, 90], "skin": True},
        "monte_carlo": {"runs": 20, "tip_noise_mm": 0.3},
    }
    case = make_needle_case(table)
    assert case.frame == "LPS"
    assert case.obstacles[0].hu_min == 180.0
    assert case.monte_carlo.noise == 0.3
    assert make_needle_case(needle_case_table(case)) == case


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"input": {"hu_min": 180}}, "without ct"),
        ({"input": {"ct": "ct", "hu_max": 180}}, "give hu_min too"),
        ({"needle3d": {"target": [0, 0, 9], "skin": True}}, "no CT that shows the skin"),
        ({"monte_carlo": {"runs": 2.5}}, "expected a whole number of insertions"),
        ({"monte_carlo": {"runs": 5, "tip_noise_mm": -1}}, "tip_noise_mm is -1, expected 0 to 20"),
        ({"obstacles": [{"kind": "mask", "file": "a", "hu_min": 9, "hu_max": 5}]}, "hu_max is 5, under hu_min 9"),
    ],
)
def test_what_does_not_fit_together_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        make_needle_case({"planner": {"name": "needle3d"}, "needle3d": {"target": [0, 0, 9]}, **change})


def test_a_file_without_events_is_refused(tmp_path: Path) -> None:
    (tmp_path / "events.toml").write_text("events = []\n", encoding="utf-8")
    with pytest.raises(CaseError, match=r"events\.toml: found no \[\[events\]\]"):
        read_events(tmp_path / "events.toml")
