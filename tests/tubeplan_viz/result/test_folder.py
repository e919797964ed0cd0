"""The run folder is whole or not there."""

from __future__ import annotations

import errno
import json
import os
import signal
import stat
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.plan import Limits
from tubeplan_viz.result import Provenance, ResultError, RunFolder, RunFolderError, build_result, file_sha256, is_run, read_result


@pytest.fixture(scope="module")
def result(bent_tube: Any) -> dict[str, Any]:
    plan = bent_tube.plan(Limits(curvature_max=0.09, clearance_min=2.2))
    return build_result(plan, frame="LPS", timings_s={}, provenance=Provenance(inputs=(), rng_seed=1))


def make_run(target: Path, result: dict[str, Any], text: str = "a,b\n", *, force: bool = False) -> dict[str, Any]:
    with RunFolder(target, force=force) as run:
        run.write_text("path.csv", text)
        return run.finish(result)


def fail_with(fault: BaseException, target: Path, *, force: bool = False) -> None:
    with RunFolder(target, force=force) as run:
        run.write_text("path.csv", "second")
        raise fault


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_finished_folder_is_whole_private_and_signed(tmp_path: Path, result: dict[str, Any]) -> None:
    with RunFolder(tmp_path / "run") as run:
        assert names(tmp_path)[0].startswith(".run.partial-")
        run.path("mesh.ply").write_bytes(b"ply")
        run.path("mesh.ply").chmod(0o644)
        run.write_text("case.toml", "a = 1\n")
        run.write_json("path.mrk.json", {"markups": []})
        assert not (tmp_path / "run").exists()
        document = run.finish(result)
    assert names(tmp_path) == ["run"]
    assert names(tmp_path / "run") == ["case.toml", "mesh.ply", "path.mrk.json", "result.json"]
    assert stat.S_IMODE((tmp_path / "run").stat().st_mode) == 0o700
    assert {stat.S_IMODE(entry.stat().st_mode) for entry in (tmp_path / "run").iterdir()} == {0o600}
    assert read_result(tmp_path / "run") == document
    assert "outputs" not in result["provenance"]
    outputs = {entry["name"]: entry["sha256"] for entry in document["provenance"]["outputs"]}
    assert outputs == {name: file_sha256(tmp_path / "run" / name) for name in ("case.toml", "mesh.ply", "path.mrk.json")}


def test_no_trace_is_left_by_an_error_an_interrupt_or_an_unfinished_run(tmp_path: Path, result: dict[str, Any]) -> None:
    for fault in (ValueError("a fault"), KeyboardInterrupt(), SystemExit(3)):
        with pytest.raises(type(fault)):
            fail_with(fault, tmp_path / "run")
        assert names(tmp_path) == []
    with RunFolder(tmp_path / "run") as run:
        run.write_text("path.csv", "")
    assert names(tmp_path) == []
    with pytest.raises(ResultError, match="at reason"):
        make_run(tmp_path / "run", result | {"status": "fine"})
    assert names(tmp_path) == []


def test_existing_run_is_refused_and_replaced_only_with_force(tmp_path: Path, result: dict[str, Any]) -> None:
    make_run(tmp_path / "run", result, "first")
    with pytest.raises(RunFolderError, match=r"exists already.*--force"):
        make_run(tmp_path / "run", result, "second")
    assert (tmp_path / "run" / "path.csv").read_text() == "first"
    make_run(tmp_path / "run", result, "second", force=True)
    assert (tmp_path / "run" / "path.csv").read_text() == "second"
    assert names(tmp_path) == ["run"]


def test_old_run_survives_when_the_new_one_fails(tmp_path: Path, result: dict[str, Any]) -> None:
    make_run(tmp_path / "run", result, "first")
    with pytest.raises(ZeroDivisionError):
        fail_with(ZeroDivisionError(), tmp_path / "run", force=True)
    assert (tmp_path / "run" / "path.csv").read_text() == "first"
    assert names(tmp_path) == ["run"]


def test_old_run_comes_back_when_the_last_rename_fails(
    tmp_path: Path, result: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    make_run(tmp_path / "run", result, "first")
    real = os.rename

    def refuse_partial(source: Path, target: Path) -> None:
        if ".partial-" in str(source):
            raise OSError(errno.EIO, "Input/output error")
        real(source, target)

    monkeypatch.setattr(os, "rename", refuse_partial)
    with pytest.raises(RunFolderError, match="cannot take that name"):
        make_run(tmp_path / "run", result, "second", force=True)
    assert (tmp_path / "run" / "path.csv").read_text() == "first"
    assert names(tmp_path) == ["run"]


def test_target_that_appears_meanwhile_is_not_overwritten(tmp_path: Path, result: dict[str, Any]) -> None:
    with RunFolder(tmp_path / "run") as run:
        make_run(tmp_path / "run", result, "other")
        with pytest.raises(RunFolderError, match="exists already"):
            run.finish(result)
    assert (tmp_path / "run" / "path.csv").read_text() == "other"
    assert names(tmp_path) == ["run"]


def not_a_run(folder: Path) -> Path:
    (folder / "run").mkdir()
    (folder / "run" / "report.html").write_text("another program's")
    return folder / "run"


def with_notes(folder: Path) -> Path:
    (folder / "run").mkdir()
    (folder / "run" / "result.json").write_text('{"provenance": {"software": "tubeplan"}}')
    (folder / "run" / "notes.txt").write_text("mine")
    return folder / "run"


def a_file(folder: Path) -> Path:
    (folder / "run").write_text("text")
    return folder / "run"


def a_link(folder: Path) -> Path:
    (folder / "there").mkdir()
    (folder / "run").symlink_to("there")
    return folder / "run"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (not_a_run, "no tubeplan run"),
        (with_notes, "notes.txt"),
        (a_file, "is no folder"),
        (a_link, "is no folder"),
        (lambda folder: Path("/"), "root"),
        (lambda folder: Path.home(), "home"),
        (lambda folder: Path("."), "current folder"),
        (lambda folder: Path(".."), "current folder"),
        (lambda folder: folder / "absent" / "run", "parent folder does not exist"),
    ],
)
def test_places_that_are_never_replaced(tmp_path: Path, result: dict[str, Any], make: Callable[[Path], Path], words: str) -> None:
    target = make(tmp_path)
    before = {entry: entry.read_bytes() for entry in tmp_path.rglob("*") if entry.is_file()}
    with pytest.raises(RunFolderError, match=words) as fault:
        make_run(target, result, force=True)
    assert str(tmp_path) not in str(fault.value)
    assert {entry: entry.read_bytes() for entry in tmp_path.rglob("*") if entry.is_file()} == before


def test_empty_folder_needs_force_too(tmp_path: Path, result: dict[str, Any]) -> None:
    (tmp_path / "run").mkdir()
    with pytest.raises(RunFolderError, match="exists already"):
        make_run(tmp_path / "run", result)
    make_run(tmp_path / "run", result, force=True)
    assert is_run(tmp_path / "run")


def test_parent_that_refuses(tmp_path: Path, result: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    # Permission bits do not bind a superuser, who may run the tests; the system's answer is the same.
    def refuse(*args: object, **kwargs: object) -> str:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with pytest.raises(RunFolderError, match=r"no folder can be made there \(permission denied\)"):
        make_run(tmp_path / "run", result)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_full_disk_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="run: the disk is full, nothing was kept"), RunFolder(tmp_path / "run"):
        Path("/dev/full").write_text("x" * 100_000)
    assert names(tmp_path) == []


def test_files_that_do_not_belong_there(tmp_path: Path, result: dict[str, Any]) -> None:
    with RunFolder(tmp_path / "run") as run:
        with pytest.raises(RunFolderError, match=r"notes\.txt is no file of a run folder"):
            run.write_text("notes.txt", "")
        (run.path("mesh.ply").parent / "scratch.tmp").write_text("")
        with pytest.raises(RunFolderError, match=r"scratch\.tmp was left"):
            run.finish(result)
    with pytest.raises(RunFolderError, match="not open"):
        RunFolder(tmp_path / "run").path("mesh.ply")


CHILD = """
    import sys, time
    from pathlib import Path
    from tubeplan_viz.result import RunFolder
    try:
        with RunFolder(Path(sys.argv[1])) as run:
            run.write_text("path.csv", "x")
            print("writing", flush=True)
            time.sleep(60)
    except KeyboardInterrupt as interrupt:
        sys.exit(130)
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 130), (signal.SIGKILL, -9)])
def test_signals_leave_no_folder_that_looks_finished(tmp_path: Path, number: int, status: int) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(CHILD), str(tmp_path / "run")],
        stdout=subprocess.PIPE,
        text=True,
        # Where the tests themselves run in the background, Ctrl-C is ignored and children inherit that.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )
    assert child.stdout is not None
    with child.stdout as lines:
        assert lines.readline() == "writing\n"
        time.sleep(0.05)
        child.send_signal(number)
        assert child.wait(20) == status
    left = names(tmp_path)
    if number == signal.SIGKILL:
        assert [name.rpartition("-")[0] for name in left] == [".run.partial"]
    else:
        assert left == []


def test_a_folder_of_another_command_is_told_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "cohort").mkdir()
    (tmp_path / "cohort" / "cohort.json").write_text('{"provenance": {"software": "tubeplan"}}')
    with pytest.raises(RunFolderError, match=r"^cohort was made by `tubeplan batch` and is no run; name a folder"):
        read_result(tmp_path / "cohort")


def test_handlers_of_the_caller_are_given_back(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with RunFolder(tmp_path / "run"):
        assert signal.getsignal(signal.SIGTERM) is not before
    assert signal.getsignal(signal.SIGTERM) is before


def test_reading_what_is_no_run(tmp_path: Path, result: dict[str, Any]) -> None:
    with pytest.raises(RunFolderError, match="no tubeplan run"):
        read_result(tmp_path)
    (tmp_path / "result.json").write_text(json.dumps(result | {"frame": "RAS"}))
    with pytest.raises(ResultError, match="at frame"):
        read_result(tmp_path)
