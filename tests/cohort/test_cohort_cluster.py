"""Cases on a cluster, a Dask scheduler on loopback, with real data; and options that are refused."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.cli.app import status_of
from tubeplan_viz.cohort import CohortSettings, cluster, read_manifest, run_cohort

SHARED = Path(__file__).parents[2].parent / "shared"
REAL = """id,planner,ct,start,goal,method,diameter
robot,bronchoscope,lung.mha,E1,E2,kinematic,3
cut,bronchoscope,cut.mha,E1,E2,kinematic,3
"""


@pytest.mark.filterwarnings("ignore")  # what Dask, tornado and asyncio warn of is theirs
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared data do not stand beside the source tree")
def test_a_cluster_does_real_cases_and_tells_a_damaged_one(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    image = SHARED / "data" / "elastix_right_lung" / "3DCT_lung.mha"
    shutil.copyfile(image, tmp_path / "lung.mha")
    (tmp_path / "cut.mha").write_bytes(image.read_bytes()[:100_000])
    (tmp_path / "real.csv").write_text(REAL, encoding="utf-8")
    here: dict[str, Any] = {"processes": False, "dashboard_address": None, "n_workers": 1, "threads_per_worker": 1}
    with distributed.LocalCluster(**here) as loopback:
        settings = CohortSettings(scheduler=loopback.scheduler_address, recording=False, report=False)
        document = run_cohort(read_manifest(tmp_path / "real.csv"), tmp_path / "out", settings)
    robot, cut = document["cases"]
    assert document["pass"]["cluster"] is True
    assert robot["status"] in ("ok", "flagged")
    assert robot["metrics"]["tip_error_mm"] < 2.0
    result = json.loads((tmp_path / "out" / "robot" / "result.json").read_text(encoding="utf-8"))
    assert robot["metrics"]["length_mm"] == result["metrics"]["length_mm"]
    assert robot["inputs"] == result["provenance"]["inputs"]
    assert (cut["status"], cut["reason"]) == (
        "bad_input",
        "cut.mha: its voxels cannot be read, it is cut or damaged; copy or save it again",
    )
    assert {entry.name for entry in (tmp_path / "out").iterdir()} == {
        "robot", "journal.jsonl", "cohort.json", "cohort.csv", "index.html",
    }  # fmt: skip


def test_without_dask_one_sentence_says_how_to_get_it(
    cohort_files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    call = ["batch", str(cohort_files / "cohort.toml"), "-o", str(cohort_files / "out"), "--scheduler", "tcp://127.0.0.1:1"]
    assert status_of(call) == 2
    told = "tubeplan: --scheduler needs Dask, which is not installed; pip install 'tubeplan[cluster]'\n"
    assert capsys.readouterr().err == told


@pytest.mark.filterwarnings("ignore")  # as above
def test_a_scheduler_that_does_not_answer_is_said(
    cohort_files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="the extra cluster is not installed")
    monkeypatch.setattr(cluster, "CONNECT_S", 0.2)
    call = ["batch", str(cohort_files / "cohort.toml"), "-o", str(cohort_files / "out"), "--scheduler", "tcp://127.0.0.1:1"]
    assert status_of(call) == 2
    assert "--scheduler tcp://127.0.0.1:1: no Dask scheduler answers there" in capsys.readouterr().err
    assert [entry.name for entry in (cohort_files / "out").iterdir()] == ["journal.jsonl"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--jobs", "0"], "--jobs is 0, expected 1 or more"),
        (["--time-limit", "0"], "--time-limit is 0 s, expected more than 0"),
        (["--rng-seed", "-1"], "--rng-seed is -1, expected 0 or more"),
        (["--jobs", "2", "--scheduler", "tcp://h:1"], "--jobs is for this machine and --scheduler for a cluster"),
    ],
)
def test_a_wrong_option_is_one_sentence_and_nothing_is_made(
    cohort_files: Path, options: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of(["batch", str(cohort_files / "cohort.toml"), "-o", str(cohort_files / "out"), *options]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert not (cohort_files / "out").exists()
