"""A run folder of a plan in the simulator: the same seed gives the same plan, and planted faults in its states are found."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from segmentation.mesh import Surface
from segmentation.mesh_files import write_ply
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.verify import verify_run


@pytest.fixture(scope="module")
def dynamic_run(phantoms: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The simulated robot in a straight tube of 4.5 mm, on whose wall it lies."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: the extra [dynamics]")
    folder = tmp_path_factory.mktemp("dynamic")
    # Along z, across the gravity that pulls along +y.
    made = phantoms.straight_tube(length=90.0, radius=2.25).surface
    write_ply(Surface(made.vertices[:, [2, 0, 1]], made.faces, np.full(len(made.faces), -1), (), "mesh"), folder / "tube.ply")
    common = ["plan", "bronchoscope", "--mesh", str(folder / "tube.ply"), "--goal", "0,0,45", "--method", "dynamic", "-q"]
    assert status_of([*common, "-o", str(folder / "run")]) == 0
    return folder / "run"


def test_the_same_seed_gives_the_same_plan_in_the_simulator(dynamic_run: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    case = str(dynamic_run / "case.toml")
    assert status_of(["run", case, "-o", str(again), "-q", "--no-report", "--no-recording"]) == 0
    for name in ("actuation.csv", "states.csv"):
        assert (again / name).read_bytes() == (dynamic_run / name).read_bytes()


def test_the_run_holds_and_its_page_tells_error_force_and_steps(dynamic_run: Path) -> None:
    assert [check.sentence for check in verify_run(dynamic_run).faults] == []
    result = json.loads((dynamic_run / "result.json").read_text())
    contacts = result["details"]["contacts"]
    assert contacts["largest_force_n"] > 0.0
    # The robot weighs 0.1 N at most (10 cm of it, 1.1 g/cm^3): at rest in a straight tube nothing presses harder.
    assert contacts["largest_force_n"] < 0.1
    page = (dynamic_run / "report.html").read_text()
    for word in ("The robot reaches its target", "Tip error", "Largest contact force", "after step"):
        assert word in page


def altered_state(folder: Path, row: int, change: float) -> None:
    rows = list(csv.reader((folder / "states.csv").read_text().splitlines()))
    rows[row][1] = repr(float(rows[row][1]) + change)
    (folder / "states.csv").write_text("\n".join(",".join(cells) for cells in rows) + "\n")


def altered_result(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    result = json.loads((folder / "result.json").read_text())
    change(result)
    (folder / "result.json").write_text(json.dumps(result))


def shift_tip(result: dict[str, Any]) -> None:
    result["details"]["steps"][-2]["tip_mm"][0] += 1.0


def praise_body(result: dict[str, Any]) -> None:
    result["metrics"]["body_clearance_min_mm"] += 0.5


def soften(result: dict[str, Any]) -> None:
    result["details"]["contacts"]["largest_force_n"] *= 0.5


def lift_contact(result: dict[str, Any]) -> None:
    path = result["path"]
    roomy = max(range(len(path["s_mm"])), key=path["clearance_mm"].__getitem__)
    step = next(step for step in result["details"]["steps"] if step["contacts_mm"])
    step["contacts_mm"][0] = path["points_mm"][roomy]  # more than a millimetre from any wall


@pytest.mark.parametrize(
    ("plant", "found"),
    [
        # 2.25 mm of room less 1.75 mm of robot: 5 mm aside the body is through the wall, and its neighbours are not.
        (lambda folder: altered_state(folder, -12, 5.0), {"states: body to wall", "states: whole"}),
        (lambda folder: altered_result(folder, shift_tip), {"path: the tips' track", "states: whole"}),
        (lambda folder: altered_result(folder, praise_body), {"metrics: body_clearance_min_mm"}),
        (lambda folder: altered_result(folder, soften), {"contacts"}),
        (lambda folder: altered_result(folder, lift_contact), {"contacts"}),
    ],
    ids=["body through the wall", "tip off its track", "body praised", "force halved", "contact in the air"],
)
def test_a_planted_fault_is_refused(dynamic_run: Path, tmp_path: Path, plant: Callable[[Path], None], found: set[str]) -> None:
    folder = tmp_path / "run"
    shutil.copytree(dynamic_run, folder)
    plant(folder)
    assert found <= {check.name for check in verify_run(folder).faults}
