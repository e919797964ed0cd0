"""What a worker does with one case, and how many work at a time."""

from __future__ import annotations

import sys
import threading
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz import __version__
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.cohort import CohortError, CohortSettings, here, read_manifest, run_cohort, worker
from tubeplan_viz.cohort.hands import Hand, answer_of
from tubeplan_viz.cohort.tasks import Answer, CaseStatus, Cost, Task
from tubeplan_viz.planners import PLANNERS, make_case
from tubeplan_viz.verify import verify_run

FREE = '[planner]\nname = "needle2d"\n[needle2d]\ntarget = [10, 90]\ndegree_max = 1\n'
TABLES: dict[str, dict[str, Any]] = {
    "tube": {
        "input": {"mesh": "m.ply", "case_id": "a"},
        "limits": {"curvature_max": 1.0 / 7.3},
        "measures": {"structures": "a=u.nii"},
    },
    "needle2d": {"limits": {"curvature_max": 0.03}, "needle2d": {"target": [0, 90], "angle_max_deg": 33.3}},
    "needle3d": {"needle3d": {"target": [0, 0, 90], "radius_mm": 33.3, "cone_deg": 12.7}, "input": {"ct": "c", "hu_min": 180}},
    "rigid": {"input": {"ct": "c"}, "rigid": {"side": "left", "roll_max_deg": 12.7, "shrinkage_percent": 33.3}},
    "bronchoscope": {"input": {"ct": "c"}, "planner": {"goal": "right upper lobe"}, "bronchoscope": {"bend_max_deg": 77.7}},
}


def task_of(target: Path, **more: Any) -> Task:
    return Task(id="a", target=str(target), case_text=FREE, version=__version__, recording=False, report=False, **more)


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_resolved_case_reads_back_as_itself(planner: str, tmp_path: Path) -> None:
    """What a worker writes is what the command compares with when it is called again."""
    tables = {**TABLES[planner], "planner": {"name": planner, **TABLES[planner].get("planner", {})}}
    target = tmp_path / "out" / "a"
    text = PLANNERS[planner].text(make_case(tables, folder=tmp_path), target)
    assert PLANNERS[planner].text(make_case(tomllib.loads(text), folder=target), target) == text


def test_a_case_is_planned_verified_and_told_by_stages(tmp_path: Path) -> None:
    said: list[dict[str, Any]] = []
    answer = worker.do(task_of(tmp_path / "a", verify=True), said.append)
    checks = len(verify_run(tmp_path / "a").checks)
    assert answer == {"status": "ok", "reason": None, "verification": {"holds": True, "checks": checks, "failed": []}}
    assert [message["stage"] for message in said] == ["obstacles", "plan", "verify"]


def test_a_run_that_was_changed_afterwards_is_not_verified(tmp_path: Path) -> None:
    worker.do(task_of(tmp_path / "a"), lambda message: None)
    with (tmp_path / "a" / "path.csv").open("a", encoding="utf-8") as file:
        file.write("\n")
    found = worker.do(task_of(tmp_path / "a", plan=False, verify=True), lambda message: None)["verification"]
    assert not found["holds"]
    assert [check["name"] for check in found["failed"]] == ["files: digests", "path.csv: same numbers"]
    assert found["failed"][0]["sentence"].endswith("for every file.")


def test_a_fault_of_the_program_is_a_row_that_says_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def faulty(*arguments: Any) -> None:
        raise ValueError(f"no such thing: '{tmp_path}/x y/lung.nii'")

    monkeypatch.setattr(worker, "run_case", faulty)
    answer = worker.do(task_of(tmp_path / "a"), lambda message: None)
    assert answer["status"] == "fault"
    told = "a fault of the program, please report it: ValueError: no such thing: 'lung.nii' (in faulty, line "
    assert answer["reason"].startswith(told)


@pytest.mark.parametrize(
    ("ended", "status", "reason"),
    [
        ({"ended": "", "exit": -11}, "died", "its process ended: signal SIGSEGV"),
        ({"ended": "", "exit": 1}, "died", "its process ended: exit status 1"),
        ({"ended": "time_limit", "exit": -15}, "time_limit", "not done within the time limit of 2 s"),
    ],
)
def test_how_a_process_ends_is_its_reason(ended: dict[str, Any], status: str, reason: str, tmp_path: Path) -> None:
    costs = {"wall_s": 1.0, "cpu_s": 0.5, "peak_memory_mb": 300.0}
    answer = answer_of(task_of(tmp_path / "a", time_limit=2.0), {}, ended | costs)
    assert answer.status == status
    assert answer.reason is not None
    assert answer.reason.startswith(reason)
    assert answer.cost == Cost(**costs)


def test_a_worker_that_cannot_start_says_why_and_ends_the_cohort(cohort_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = (sys.executable, "-c", "import sys; sys.exit('ImportError: no numpy')")
    monkeypatch.setattr("tubeplan_viz.cohort.hands.COMMAND", broken)
    told = r"no worker can be started \(exit status 1\): ImportError: no numpy; does `tubeplan --version` work there\?"
    with pytest.raises(CohortError, match=told):
        run_cohort(read_manifest(cohort_files / "cohort.toml"), cohort_files / "out", CohortSettings(jobs=2))
    foreign = (sys.executable, "-c", 'print(\'{"event": "ready", "version": "0.0.1"}\', flush=True); input()')
    monkeypatch.setattr("tubeplan_viz.cohort.hands.COMMAND", foreign)
    with pytest.raises(CohortError, match=rf"a worker has tubeplan 0\.0\.1, expected {__version__} as here"):
        run_cohort(read_manifest(cohort_files / "cohort.toml"), cohort_files / "out", CohortSettings(jobs=1))


@pytest.fixture
def together(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """Cases end after a twentieth of a second; gives the largest number that ran at a time."""
    lock, now, most = threading.Lock(), [0], [0]

    def wait(self: Hand, task: Task) -> Answer:
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        time.sleep(0.05)
        with lock:
            now[0] -= 1
        return Answer(id=task.id, status=CaseStatus.INFEASIBLE, reason="made up", cost=Cost(wall_s=0.05, peak_memory_mb=900.0))

    monkeypatch.setattr(Hand, "run", wait)
    return lambda: most[0]


@pytest.mark.parametrize(("jobs", "free", "most"), [(1, None, 1), (3, None, 3), (3, 1e6, 3), (3, 100.0, 1)])
def test_as_many_cases_run_at_a_time_as_are_asked_for_and_memory_allows(
    cohort_files: Path, together: Callable[[], int], monkeypatch: pytest.MonkeyPatch, jobs: int, free: float | None, most: int
) -> None:
    monkeypatch.setattr(here, "free_memory_mb", lambda: free)
    document = run_cohort(read_manifest(cohort_files / "cohort.toml"), cohort_files / "out", CohortSettings(jobs=jobs))
    assert document["counts"]["infeasible"] == 5
    assert together() == most


def test_free_memory_is_that_of_the_control_group_where_it_has_less(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(here, "CGROUP", tmp_path)
    machine = here.free_memory_mb()
    if machine is None:
        pytest.skip("this system does not tell its free memory in /proc/meminfo")
    (tmp_path / "memory.current").write_text("9000000\n")
    (tmp_path / "memory.stat").write_text("file 4000000\ninactive_file 3000000\n")
    (tmp_path / "memory.max").write_text("max\n")
    assert here.free_memory_mb() == pytest.approx(machine, rel=0.5)  # no limit; the machine's own changes all the time
    (tmp_path / "memory.max").write_text("10000000\n")
    assert here.free_memory_mb() == 4.0  # 10 - 9 + 3: files that nobody uses are given back


def test_progress_is_a_line_for_each_case_and_the_end_a_table(
    cohort_files: Path, together: Callable[[], int], capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["batch", str(cohort_files / "cohort.toml"), "-o", str(cohort_files / "out"), "-j", "1"]
    assert status_of(call) == 4
    shown = capsys.readouterr()
    assert shown.err.splitlines()[:2] == [
        "[1/5] neck: infeasible, 0.1 s: made up",
        "[2/5] flat: infeasible, 0.1 s: made up",
    ]
    assert "5 without a path; 5 done, 0 kept from before\n  5 without a path: made up\n" in shown.out
    assert status_of([*call, "-q"]) == 4
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "0 done, 5 kept from before" in shown.out
