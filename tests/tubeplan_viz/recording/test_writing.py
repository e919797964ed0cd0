"""A recording appears whole or not at all, and holds nothing that it should not."""

from __future__ import annotations

import getpass
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from segmentation.errors import TubeplanError
from tubeplan_viz.plan import Limits
from tubeplan_viz.recording import Recording, read_recording

NAMES = {"case_id": "c", "planner": "tube", "method": "feature_iteration", "frame": "mesh"}


def test_nothing_is_left_when_the_run_fails(tmp_path: Path, limits: Limits, run: Any) -> None:
    path = tmp_path / "recording.rrd"

    def fails() -> None:
        with Recording.open(path, limits=limits, **NAMES) as recording:
            recording.log_step(run.steps[0])
            assert not path.exists()
            raise RuntimeError("planner")

    with pytest.raises(RuntimeError, match="planner"):
        fails()
    assert list(tmp_path.iterdir()) == []


KILLED = """
import os, signal, sys
from pathlib import Path
from tubeplan_viz.plan import Limits
from tubeplan_viz.recording import Recording
recording = Recording.open(Path(sys.argv[1]), case_id="c", limits=Limits(curvature_max=0.1, clearance_min=1.0),
                           planner="tube", method="feature_iteration", frame="mesh")
recording.log_decision("before the end")
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_writer_leaves_no_file_that_looks_finished(tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    ended = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert ended.returncode == -signal.SIGKILL
    left = [each.name for each in tmp_path.iterdir()]
    assert len(left) == 1
    assert left[0].startswith(".recording.partial-")


def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path, limits: Limits, run: Any) -> None:
    path = tmp_path / "recording.rrd"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fills() -> None:
        with Recording.open(path, limits=limits, **NAMES) as recording:
            resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, hard))
            for step in run.steps:
                recording.log_step(step)

    try:
        with pytest.raises(TubeplanError, match=r"^recording\.rrd: the recording cannot be written"):
            fills()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_told_without_its_path(tmp_path: Path, limits: Limits) -> None:
    with pytest.raises(TubeplanError, match=r"^recording\.rrd: .*No such file") as told:
        Recording.open(tmp_path / "absent" / "recording.rrd", limits=limits, **NAMES)
    assert str(tmp_path) not in str(told.value)


def test_only_the_owner_may_read_it_and_a_second_close_does_nothing(recorded_file: Path, tmp_path: Path, limits: Limits) -> None:
    assert recorded_file.stat().st_mode & 0o777 == 0o600
    recording = Recording.open(tmp_path / "recording.rrd", limits=limits, **NAMES)
    recording.close()
    recording.close()
    recording.abort()
    assert (tmp_path / "recording.rrd").is_file()


def test_no_path_user_or_host_is_inside(recorded_file: Path) -> None:
    from rerun.chunk import RrdReader

    reader = RrdReader(recorded_file)
    text = "".join(chunk.format() for store in (None, *reader.blueprints()) for chunk in reader.stream(store=store))
    held = recorded_file.read_bytes() + text.encode()
    names = [str(recorded_file.parent), os.getcwd(), str(Path(__file__).parents[3]), str(Path.home()) + os.sep, sys.prefix]
    names += [name for name in (getpass.getuser(), socket.gethostname()) if len(name) > 4]
    assert b"bent tube" in held
    assert [name for name in names if name.encode() in held] == []


def test_without_a_viewer_the_file_is_whole_and_the_user_is_told(tmp_path: Path, limits: Limits, run: Any) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    path = tmp_path / "recording.rrd"
    with Recording.open(path, limits=limits, connect=f"127.0.0.1:{port}", **NAMES) as recording:
        recording.log_step(run.steps[0])
        assert recording.warnings == (f"no viewer listens at 127.0.0.1:{port}; the recording goes to the file alone",)
    assert len(read_recording(path).iterations) == 1


def test_a_viewer_that_goes_away_costs_the_file_nothing(tmp_path: Path, limits: Limits, run: Any) -> None:
    path = tmp_path / "recording.rrd"
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"

        def hang_up() -> None:
            server.settimeout(20.0)
            try:
                while True:
                    server.accept()[0].close()
            except OSError:
                return

        listener = threading.Thread(target=hang_up, daemon=True)
        listener.start()
        with Recording.open(path, limits=limits, connect=address, **NAMES) as recording:
            recording.log_step(run.steps[0])
        assert recording.warnings == ("the live viewer went away; the recording in the file is whole",)
    assert len(read_recording(path).iterations) == 1


def test_an_address_that_is_none_is_refused_before_anything_is_written(tmp_path: Path, limits: Limits) -> None:
    with pytest.raises(TubeplanError, match="expected host:port"):
        Recording.open(tmp_path / "recording.rrd", limits=limits, connect="localhost:viewer", **NAMES)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_recording_is_refused(tmp_path: Path, recorded_file: Path) -> None:
    with pytest.raises(TubeplanError, match=r"^none\.rrd: no such recording"):
        read_recording(tmp_path / "none.rrd")
    (tmp_path / "text.rrd").write_text("not a recording")
    with pytest.raises(TubeplanError, match=r"^text\.rrd: no readable recording"):
        read_recording(tmp_path / "text.rrd")
    (tmp_path / "cut.rrd").write_bytes(recorded_file.read_bytes()[:200_000])
    with pytest.raises(TubeplanError, match=r"^cut\.rrd: "):
        read_recording(tmp_path / "cut.rrd")


def test_importing_the_package_does_not_load_rerun() -> None:
    code = "import sys, tubeplan_viz.recording; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
