"""A run that is ended from outside leaves nothing that looks finished."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest


@pytest.fixture
def run(command: str, meshes: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A run that would take very long, past the beginning of its recording."""
    arguments = ["--curvature-max", "0.03", "--clearance-min", "2.9", "--quiet"]
    arguments += ["--method", "feature_iteration", "--max-rounds", "1000000"]
    ends = ["--start", "E1", "--goal", "E2", "-o", str(tmp_path / "run")]
    call = [command, "plan", "tube", "--mesh", str(meshes / "variant.ply"), *ends, *arguments]
    # Where the tests themselves run in the background, Ctrl-C is ignored and children inherit that.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heed) as process:
        try:
            deadline = time.monotonic() + 60.0
            while not list(tmp_path.glob(".run.partial-*/.recording.partial-*.rrd")):
                assert process.poll() is None, f"it ended by itself: {process.communicate()}"
                assert time.monotonic() < deadline, "no recording was begun"
                time.sleep(0.05)
            time.sleep(0.3)
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_says_so_and_leaves_nothing(
    number: signal.Signals, run: subprocess.Popen[str], tmp_path: Path
) -> None:
    run.send_signal(number)
    out, err = run.communicate(timeout=60)
    assert run.returncode == 130
    assert out == ""
    assert err.strip() == "tubeplan: interrupted; nothing was written"
    assert list(tmp_path.iterdir()) == []


def test_a_killed_run_leaves_no_folder_that_looks_finished(run: subprocess.Popen[str], tmp_path: Path) -> None:
    run.kill()
    run.communicate(timeout=60)
    assert not (tmp_path / "run").exists()
    # What cannot be cleaned up is hidden, named as partial, and has no result.
    for rest in tmp_path.iterdir():
        assert rest.name.startswith(".run.partial-")
        assert not (rest / "result.json").exists()
