"""`tubeplan view`: what it refuses, and how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest


def test_a_folder_that_is_no_run_is_refused(tubeplan: Callable, tmp_path: Path) -> None:
    (tmp_path / "recording.rrd").write_bytes(b"RRF2")
    outcome = tubeplan("view", tmp_path)
    assert outcome.status == 2
    assert "is no tubeplan run" in outcome.err
    assert outcome.err.count("\n") == 1


def test_a_folder_that_is_not_there_is_refused(tubeplan: Callable, tmp_path: Path) -> None:
    outcome = tubeplan("view", tmp_path / "nowhere")
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert "nowhere: no such run folder" in outcome.err


def test_a_run_without_recording_is_refused(tubeplan: Callable, clean_run: Path) -> None:
    outcome = tubeplan("view", clean_run)
    assert outcome.status == 2
    assert "holds no recording.rrd" in outcome.err


@pytest.mark.parametrize("content", [b"", b"a text", b"RRF2 and so on, cut off", b"RRF1 and so on to RRF2FOOT"])
def test_a_broken_recording_is_refused(content: bytes, tubeplan: Callable, clean_run: Path) -> None:
    (clean_run / "recording.rrd").write_bytes(content)
    outcome = tubeplan("view", clean_run, "--no-browser")
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert "recording.rrd is cut off or no recording of this version of rerun" in outcome.err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_address_is_printed_and_ctrl_c_ends_the_view_without_a_trace(
    number: signal.Signals, clean_run: Path, tmp_path: Path
) -> None:
    (clean_run / "recording.rrd").write_bytes(b"RRF2 and so on to RRF2FOOT")
    private = tmp_path / "tmp"
    private.mkdir()
    child = subprocess.Popen(
        [sys.executable, "-c", "from tubeplan_viz.cli import main; main()", "view", str(clean_run), "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(private)},
        # Where the tests themselves run in the background, Ctrl-C is ignored and children inherit that.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )
    assert child.stdout is not None
    try:
        url = child.stdout.readline().strip()
        assert url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(url + "recording.rrd", timeout=10) as answer:
            assert answer.read() == b"RRF2 and so on to RRF2FOOT"
        child.send_signal(number)
        out, err = child.communicate(timeout=20)
    finally:
        if child.poll() is None:
            child.kill()
            child.communicate()
    assert child.returncode == 0
    assert out == ""
    assert "Traceback" not in err
    assert "view ended" in err
    assert list(private.iterdir()) == []  # the viewer's home is gone


def test_a_comparison_has_a_recording_to_view_too(made_runs: Path, tmp_path: Path) -> None:
    from tubeplan_viz.cli.view import recording_of
    from tubeplan_viz.compare import compare_folders

    compare_folders([made_runs / "clean", made_runs / "flagged"], tmp_path / "both", report=False)
    assert recording_of(tmp_path / "both") == tmp_path / "both" / "recording.rrd"
