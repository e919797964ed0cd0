"""A cohort from one command: what it writes, that it resumes, and that what ends one case touches no other."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.cli.app import status_of
from tubeplan_viz.cohort import (
    CaseStatus,
    CohortError,
    CohortEvent,
    CohortSettings,
    read_manifest,
    run_cohort,
    validate_cohort,
)
from tubeplan_viz.cohort.hands import Hand
from tubeplan_viz.cohort.journal import JOURNAL, Journal
from tubeplan_viz.cohort.summary import exit_status
from tubeplan_viz.cohort.tasks import Answer, Task

OWN = {JOURNAL, "cohort.json", "cohort.csv", "index.html"}
# A tube that the feature iteration never gets through: it goes on until it is ended.
# The feature iteration goes on moving points of a bend that cannot be as straight as is asked.
ENDLESS = """[[cases]]
id = "{id}"
input.mesh = "meshes/bent.ply"
planner = {{ start = "E1", goal = "E2", method = "feature_iteration" }}
limits = {{ curvature_max = 0.03, clearance_min = 2.9 }}
tube = {{ max_rounds = 1000000, unchanged_rounds = 1000000 }}
"""
QUICK = '[[cases]]\nid = "{id}"\ncase = "files/flat.toml"\nneedle2d = {{ degree_max = 1 }}\n'
COSTS = ("planning_s", "wall_s", "cpu_s", "peak_memory_mb")
Plan = Callable[[Path], dict[str, Any]]


@pytest.fixture(scope="module")
def first(make_cohort: Callable[[Path], Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """The cohort of four planners' cases, two at a time, and its exit status."""
    place = make_cohort(tmp_path_factory.mktemp("cohort") / "c")
    arguments = [
        "batch",
        str(place / "cohort.toml"),
        "-o",
        str(place / "out"),
        "-j",
        "2",
        "--no-recording",
        "--rng-seed",
        "7",
        "-q",
    ]
    return place, status_of(arguments)


def document_of(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "cohort.json").read_text(encoding="utf-8"))
    return document


def without_costs(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key not in COSTS} for row in document["cases"]]


def no_hand(self: Hand, task: Task) -> Answer:
    raise AssertionError(f"{task.id} is done again")


def test_each_case_ends_as_it_must_and_none_stops_the_others(first: tuple[Path, int], expected_status: dict[str, str]) -> None:
    place, status = first
    assert status == 2  # bad input outweighs the missing path and the flag
    document = document_of(place / "out")
    validate_cohort(document)
    assert {row["id"]: row["status"] for row in document["cases"]} == expected_status
    names = {entry.name for entry in (place / "out").iterdir()}
    assert names == OWN | {name for name, ended in expected_status.items() if ended != "bad_input"}
    (damaged,) = (row for row in document["cases"] if row["id"] == "damaged")
    assert damaged["folder"] is None
    assert damaged["reason"].startswith("damaged.ply: ")
    assert all(row["cpu_s"] > 0.0 and row["peak_memory_mb"] > 50.0 for row in document["cases"])  # an interpreter alone takes 10


def test_rows_hold_the_numbers_of_the_runs(first: tuple[Path, int]) -> None:
    place, _ = first
    document = document_of(place / "out")
    with (place / "out" / "cohort.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["id"] for line in lines] == [row["id"] for row in document["cases"]]
    for row, line in zip(document["cases"], lines, strict=True):
        if row["folder"] is None:
            assert line["length_mm"] == line["folder"] == ""
            continue
        result = json.loads((place / "out" / row["folder"] / "result.json").read_text(encoding="utf-8"))
        assert (row["status"], row["reason"]) == (result["status"], result["reason"])
        assert row["metrics"] == {key: result["metrics"][key] for key in row["metrics"]}
        least, limit = result["metrics"]["clearance_min_mm"], result["limits"]["clearance_min_mm"]
        assert row["margin_mm"] == (None if least is None else least - limit)
        assert line["margin_mm"] == ("" if least is None else repr(least - limit))
        assert row["rng_seed"] == result["provenance"]["rng_seed"]
    (neck,) = (row for row in document["cases"] if row["id"] == "neck")
    assert neck["margin_mm"] == pytest.approx(1.0 - 1.5, abs=0.02)  # a neck of 1 mm, as fine as its mesh


def test_nothing_names_a_folder_of_this_machine(first: tuple[Path, int]) -> None:
    place, _ = first
    for name in OWN:
        text = (place / "out" / name).read_text(encoding="utf-8")
        assert str(place) not in text
        assert str(Path.home()) + "/" not in text


def test_again_nothing_is_done_and_all_is_told_alike(
    first: tuple[Path, int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    place, status = first
    before = document_of(place / "out")
    monkeypatch.setattr(Hand, "run", no_hand)
    arguments = ["batch", str(place / "cohort.toml"), "-o", str(place / "out"), "--no-recording", "--rng-seed", "7", "--json"]
    assert status_of(arguments) == status
    told = json.loads(capsys.readouterr().out)
    assert told["pass"]["kept"] == 5
    assert told["cases"] == before["cases"]


def test_neither_other_cases_nor_the_number_of_workers_change_a_number(
    first: tuple[Path, int], make_cohort: Callable[[Path], Path], plan_of: Plan, tmp_path: Path
) -> None:
    place, _ = first
    other = make_cohort(tmp_path / "c")
    text = (other / "cohort.toml").read_text(encoding="utf-8")
    head, *rows = text.split("[[cases]]")
    (other / "cohort.toml").write_text("[[cases]]".join([head, rows[3], rows[1]]), encoding="utf-8")
    settings = CohortSettings(jobs=1, recording=False)
    document = run_cohort(read_manifest(other / "cohort.toml", rng_seed=7), other / "out", settings)
    assert document["exit_status"] == 0
    for name in ("space", "flat"):
        assert plan_of(other / "out" / name) == plan_of(place / "out" / name)
    assert (place / "out" / "space" / "case.toml").read_bytes() == (other / "out" / "space" / "case.toml").read_bytes()
    # A case by itself, from the case file of the run, is the same plan too.
    assert (
        status_of(["run", str(place / "out" / "space" / "case.toml"), "-o", str(tmp_path / "alone"), "--no-recording", "-q"]) == 0
    )
    assert plan_of(tmp_path / "alone") == plan_of(place / "out" / "space")


def test_only_what_is_missing_or_changed_is_done_again(first: tuple[Path, int], plan_of: Plan) -> None:
    place, _ = first
    out, manifest = place / "again", place / "changed.toml"
    shutil.copytree(place / "out", out)  # a neighbour: the paths in its case files lead to the same
    shutil.copytree(out / "flat", out / "stranger")
    shutil.copytree(out / "flat", out / ".flat.partial-killed")
    lines = (out / JOURNAL).read_text(encoding="utf-8").splitlines()
    # The machine stopped after the run of "none" appeared, and while it wrote of the last one.
    kept = [line for line in lines if not ('"ended"' in line and '"none"' in line)]
    (out / JOURNAL).write_text("\n".join(kept) + '\n{"event": "end', encoding="utf-8")
    (out / "space" / "report.html").unlink()
    neck = place / "meshes" / "neck.ply"
    whole = neck.read_bytes()
    neck.write_bytes(whole[:40_000])
    text = (place / "cohort.toml").read_text(encoding="utf-8")
    manifest.write_text(text.replace('id = "flat"\n', 'id = "flat"\nneedle2d.target = [5, 80]\n'), encoding="utf-8")
    events: list[CohortEvent] = []
    settings = CohortSettings(jobs=1, recording=False, verify=True)
    try:
        document = run_cohort(read_manifest(manifest, rng_seed=7), out, settings, watch=events.append)
    finally:
        neck.write_bytes(whole)
    status = {row["id"]: row["status"] for row in document["cases"]}
    planned = {event.id for event in events if event.stage not in ("", "verify")}
    # flat has another target, the report of space was missing, and the mesh of neck is cut: what changed, and no more.
    assert planned == {"flat", "space", "neck"}
    assert status == {"neck": "bad_input", "flat": "ok", "none": "infeasible", "space": "ok", "damaged": "bad_input"}
    assert not (out / "neck").exists()  # the run of the whole mesh is not that of this case
    assert json.loads((out / "flat" / "result.json").read_text())["provenance"]["settings"]["needle2d"]["target"] == [5.0, 80.0]
    for name in ("none", "space"):
        assert plan_of(out / name) == plan_of(place / "out" / name)
    checked = {row["id"]: row["verification"] for row in document["cases"]}
    assert [name for name, found in checked.items() if found is not None and found["holds"]] == ["flat", "none", "space"]
    assert document["others"] == ["stranger"]
    assert document["pass"]["kept"] == 1  # damaged failed before, and nothing of it changed
    assert not list(out.glob(".*"))


def test_its_folders_are_runs_for_the_other_commands(first: tuple[Path, int], tmp_path: Path) -> None:
    place, _ = first
    assert status_of(["verify", str(place / "out" / "neck")]) == 0
    runs = [str(place / "out" / name) for name in ("flat", "neck")]
    assert status_of(["compare", *runs, "-o", str(tmp_path / "comparison"), "--no-recording", "-q"]) == 0


def children(process: int) -> list[int]:
    """Processes whose parent is this one."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            stat = (entry / "stat").read_text(encoding="ascii")
        except OSError:
            continue
        if int(stat.rpartition(")")[2].split()[1]) == process:
            found.append(int(entry.name))
    return found


def until(found: Callable[[], Any], wait: float = 60.0) -> Any:
    """What `found` gives as soon as it gives something."""
    deadline = time.monotonic() + wait
    while not (here := found()):
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.02)
    return here


def test_a_killed_case_and_one_that_takes_too_long_cost_a_row_each(make_cohort: Callable[[Path], Path], tmp_path: Path) -> None:
    place = make_cohort(tmp_path / "c")
    rows = ENDLESS.format(id="killed") + ENDLESS.format(id="endless") + QUICK.format(id="quick")
    (place / "m.toml").write_text(rows, encoding="utf-8")
    settings = CohortSettings(jobs=1, recording=False, time_limit=3.0)

    def kill() -> None:
        until(lambda: list((place / "out").glob(".killed.partial-*")))
        (worker,) = (child for child in children(os.getpid()) if b"cohort.worker" in Path(f"/proc/{child}/cmdline").read_bytes())
        os.kill(children(worker)[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    document = run_cohort(read_manifest(place / "m.toml"), place / "out", settings)
    killer.join()
    reasons = {row["id"]: (row["status"], row["reason"]) for row in document["cases"]}
    assert reasons["quick"] == ("ok", None)
    assert reasons["killed"][0] == "died"
    assert reasons["killed"][1].startswith("its process ended: signal SIGKILL, as the system does where memory runs out")
    assert reasons["endless"] == (
        "time_limit",
        "not done within the time limit of 3 s; give --time-limit more, then --retry-failed",
    )
    assert document["exit_status"] == 1
    assert {entry.name for entry in (place / "out").iterdir()} == OWN | {"quick"}


def test_failures_stay_until_they_are_asked_for_again(cohort_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    statuses = iter(["bad_input", "time_limit", "died", "fault", *(["infeasible"] * 5)])
    done: list[str] = []

    def give(self: Hand, task: Task) -> Answer:
        done.append(task.id)
        return Answer(id=task.id, status=CaseStatus(next(statuses)), reason="made up, no folder")

    monkeypatch.setattr(Hand, "run", give)
    manifest, out = read_manifest(cohort_files / "cohort.toml"), cohort_files / "out"
    first = run_cohort(manifest, out, CohortSettings(jobs=1))
    assert (len(done), first["exit_status"]) == (5, 1)
    assert run_cohort(manifest, out, CohortSettings(jobs=1))["pass"]["kept"] == 5
    again = run_cohort(manifest, out, CohortSettings(jobs=1, retry_failed=True))
    # The first four had no verdict; that there is no path is one, and stays.
    assert done[5:] == done[:4]
    assert again["cases"][4] == first["cases"][4]


@pytest.mark.parametrize(
    ("statuses", "status"),
    [
        (["ok", "ok"], 0),
        (["ok", "flagged"], 3),
        (["flagged", "infeasible"], 4),
        (["time_limit", "flagged"], 4),
        (["infeasible", "bad_input"], 2),
        (["bad_input", "died"], 1),
        (["fault", "bad_input"], 1),
    ],
)
def test_the_gravest_case_gives_the_exit_status(statuses: list[str], status: int) -> None:
    rows = [{"status": ended, "verification": None} for ended in statuses]
    assert exit_status(rows) == exit_status(rows[::-1]) == status
    unverified = [{"status": "ok", "verification": {"holds": False}}, *rows]
    assert exit_status(unverified) == (status or 3)


def test_ctrl_c_keeps_what_is_done_and_leaves_no_half(make_cohort: Callable[[Path], Path], tmp_path: Path) -> None:
    """The worker, in a session of its own, sees of this only that its standard input ends, as when the command is killed."""
    place = make_cohort(tmp_path / "c")
    (place / "m.toml").write_text(QUICK.format(id="quick") + ENDLESS.format(id="endless"), encoding="utf-8")
    command = shutil.which("tubeplan", path=Path(sys.executable).parent)
    assert command is not None, "the project is not installed"
    call = [command, "batch", str(place / "m.toml"), "-o", str(place / "out"), "-j", "1", "--no-recording", "-q"]
    # Where the tests themselves run in the background, Ctrl-C is ignored and children inherit that.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heed) as process:
        try:
            until(lambda: list((place / "out").glob(".endless.partial-*")))
            (worker,) = children(process.pid)
            (case,) = children(worker)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert (out, err.strip()) == (
        "",
        "tubeplan: interrupted; 1 of 2 cases are done and kept, the same command goes on from there",
    )
    assert {entry.name for entry in (place / "out").iterdir()} == {JOURNAL, "quick"}
    assert not any(Path(f"/proc/{number}").exists() for number in (worker, case))
    with Journal(place / "out") as journal:
        assert journal.of("quick").ended["status"] == "ok"
        assert not journal.of("endless").ended


def test_a_folder_is_worked_in_by_one_command_and_holds_nothing_else(cohort_files: Path) -> None:
    out = cohort_files / "out"
    manifest, settings = read_manifest(cohort_files / "cohort.toml"), CohortSettings()
    with Journal(out), pytest.raises(CohortError, match="out: another `tubeplan batch` is at work in it"):
        run_cohort(manifest, out, settings)
    with pytest.raises(CohortError, match=r"files is not empty and holds no cohort \(no journal\.jsonl\)"):
        run_cohort(manifest, cohort_files / "files", settings)
    with pytest.raises(CohortError, match="out: no cohort can be kept there"):
        run_cohort(manifest, cohort_files / "nowhere" / "out", settings)
