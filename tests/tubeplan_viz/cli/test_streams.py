"""Standard streams that are closed, full, or read by nobody; and interruptions that a library swallows."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

from tubeplan_viz.interrupts import check_interrupted, ending_like_ctrl_c
from tubeplan_viz.verify import verify_run


def test_a_reader_that_goes_is_no_fault(command: str) -> None:
    read, written = os.pipe()
    os.close(read)
    # The schema's list is longer than what a pipe's buffer would take anyway.
    done = subprocess.run([command, "schema"], stdout=written, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(written)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full on this system")
def test_output_that_takes_nothing_is_told_in_one_sentence(command: str) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([command, "schema"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert done.returncode == 2
    told = "tubeplan: standard output cannot be written (no space left on device); make room or send it elsewhere\n"
    assert done.stderr == told


def test_a_run_without_standard_streams_is_whole(command: str, meshes: Path, tmp_path: Path) -> None:
    def close_all() -> None:
        for number in range(3):
            os.close(number)

    ends = ["--mesh", str(meshes / "tube.ply"), "--start", "E1", "--goal", "E2", "--no-report", "-o", str(tmp_path / "run")]
    done = subprocess.run([command, "plan", "tube", *ends], preexec_fn=close_all, timeout=120, check=False)
    assert done.returncode == 0
    assert verify_run(tmp_path / "run").faults == ()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_that_is_swallowed_comes_again(number: signal.Signals) -> None:
    before = signal.signal(number, signal.SIG_DFL)  # where the tests run in the background, SIGINT is ignored
    try:
        with ending_like_ctrl_c():
            check_interrupted()
            with suppress(KeyboardInterrupt), ending_like_ctrl_c():
                os.kill(os.getpid(), number)
            with pytest.raises(KeyboardInterrupt, match=number.name):
                check_interrupted()
        check_interrupted()
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)
