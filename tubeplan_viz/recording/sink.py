"""Where the stream goes: a file that appears only when it is whole, and a live viewer if one listens."""

from __future__ import annotations

import errno
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import rerun as rr
import rerun.blueprint as rrb

from segmentation.errors import TubeplanError

APPLICATION = "tubeplan"
PROBE_TIMEOUT_S = 0.3
LIVE_FLUSH_TIMEOUT_S = 3.0
VIEWER_PORT = 9876


class RecordingError(TubeplanError):
    """A recording that cannot be written or read."""


class Sink:
    """One rerun stream whose bytes this process writes itself, mirrored to a live viewer.

    rerun's own file sink hangs on a full disk and leaves a cut file without an
    error, so the bytes are taken from memory after every call of `flush` and written
    here, where a failing write raises. The file's own blueprint is added at the end,
    when it is known what there is to show.

    Parameters
    ----------
    path : Path
        The final file; until `publish` only a hidden neighbour exists.
    case_id : str
    connect : str or None
        ``host:port`` or a ``rerun+http://`` address of a running viewer.
    """

    def __init__(self, path: Path, *, case_id: str, connect: str | None) -> None:
        self.path = path
        self.warnings: tuple[str, ...] = ()
        self._partial = path.with_name(f".{path.stem}.partial-{uuid.uuid4().hex[:8]}.rrd")
        try:
            self._file = os.open(self._partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError as error:
            raise _cannot_write(path, error) from error
        rr.set_strict_mode(True)
        recording_id = f"{re.sub('[^A-Za-z0-9_-]+', '-', case_id)}-{uuid.uuid4().hex[:12]}"
        memory = _stream(recording_id)
        self._bytes = memory.binary_stream()
        self._streams = [memory]
        self._live = self._open_live(connect, recording_id) if connect is not None else None
        if self._live is not None:
            self._streams.append(self._live)
        for stream in self._streams:
            stream.send_recording_name(case_id)

    def _open_live(self, connect: str, recording_id: str) -> Any:
        host, port = viewer_address(connect)
        try:
            socket.create_connection((host, port), timeout=PROBE_TIMEOUT_S).close()
        except OSError:
            self.warnings += (f"no viewer listens at {host}:{port}; the recording goes to the file alone",)
            return None
        stream = _stream(recording_id)
        stream.connect_grpc(f"rerun+http://{host}:{port}/proxy")
        return stream

    def log(self, entity: str, *archetypes: Any, static: bool = False) -> None:
        """Log archetypes at the current time, or for all times."""
        for stream in self._streams:
            stream.log(entity, *archetypes, static=static)

    def columns(self, entity: str, timeline: str, ticks: Any, columns: Any) -> None:
        """Log one row per tick of a sequence timeline at once."""
        for stream in self._streams:
            stream.send_columns(entity, [rr.TimeColumn(timeline, sequence=ticks)], columns)

    def at(self, timeline: str, tick: int) -> None:
        """What follows belongs to this tick of this timeline alone."""
        for stream in self._streams:
            stream.reset_time()
            stream.set_time(timeline, sequence=tick)

    def property(self, name: str, values: Any) -> None:
        """Log one property of the recording as a whole."""
        for stream in self._streams:
            stream.send_property(name, values)

    def show(self, blueprint: rrb.Blueprint) -> None:
        """Give the live viewer its layout; the file gets its own at the end."""
        if self._live is not None:
            self._live.send_blueprint(blueprint, make_active=True, make_default=True)

    def flush(self) -> None:
        """Write what was logged so far.

        Raises
        ------
        RecordingError
            If the file cannot be written, for instance on a full disk.
        """
        data = self._bytes.read(flush=True)
        if data:
            self._write(self._file, data)

    def publish(self, blueprint: rrb.Blueprint) -> None:
        """Finish the file: blueprint in, chunks packed, checked, synced, renamed.

        Raises
        ------
        RecordingError
            If it cannot be written or does not read back.
        """
        self._disconnect()
        self.flush()
        os.close(self._file)
        with tempfile.TemporaryDirectory(prefix="tubeplan-") as scratch:
            layout = Path(scratch) / "layout.rbl"
            blueprint.save(APPLICATION, str(layout))
            packed = _viewer_tool(scratch, "rrd", "optimize", "--profile", "live", str(layout), str(self._partial))
            self._file = os.open(self._partial, os.O_WRONLY | os.O_TRUNC)
            self._write(self._file, packed)
            os.fsync(self._file)
            os.close(self._file)
            _viewer_tool(scratch, "rrd", "verify", str(self._partial))
        os.replace(self._partial, self.path)
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def discard(self) -> None:
        """Leave nothing behind."""
        self._disconnect()
        try:
            os.close(self._file)
        except OSError as error:
            if error.errno != errno.EBADF:
                raise
        self._partial.unlink(missing_ok=True)

    def _disconnect(self) -> None:
        if self._live is not None:
            try:
                self._live.flush(timeout_sec=LIVE_FLUSH_TIMEOUT_S)
            except (RuntimeError, ValueError):
                self.warnings += ("the live viewer went away; the recording in the file is whole",)
            self._live.disconnect()
            self._live = None
        for stream in self._streams[:1]:
            stream.flush()

    def _write(self, file: int, data: bytes) -> None:
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(file, view) :]
        except OSError as error:
            raise _cannot_write(self.path, error) from error


def viewer_address(connect: str) -> tuple[str, int]:
    """Host and port of ``host:port``, ``rerun+http://host:port/proxy`` or an empty text (the default viewer).

    Raises
    ------
    RecordingError
        If the text is no such address.

    Examples
    --------
    >>> viewer_address("localhost:9877"), viewer_address("rerun+http://10.0.0.2:9876/proxy"), viewer_address("")
    (('localhost', 9877), ('10.0.0.2', 9876), ('127.0.0.1', 9876))
    """
    parts = urlsplit(connect if "://" in connect else f"rerun+http://{connect}")
    try:
        return parts.hostname or "127.0.0.1", parts.port or VIEWER_PORT
    except ValueError as error:
        raise RecordingError(
            f"the viewer address {connect!r} has no valid port; expected host:port, for instance 127.0.0.1:9876"
        ) from error


def _stream(recording_id: str) -> Any:
    # No properties and no wall clock: they would carry the start time and a second timeline.
    stream = rr.RecordingStream(APPLICATION, recording_id=recording_id, send_properties=False)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream


def _viewer_tool(scratch: str, *arguments: str) -> bytes:
    """Run the viewer's own binary with a home of its own: no usage statistics, nothing left in the user's home."""
    home = Path(scratch) / ".config" / "rerun"
    home.mkdir(parents=True, exist_ok=True)
    (home / "analytics.json").write_text(json.dumps({"analytics_enabled": False, "analytics_id": "", "metadata": {}}))
    environment = dict(os.environ, HOME=scratch, XDG_CONFIG_HOME=str(Path(scratch) / ".config"), NO_COLOR="1")
    run = subprocess.run([sys.executable, "-m", "rerun_cli", *arguments], capture_output=True, env=environment, check=False)
    if run.returncode:
        last = run.stderr.decode(errors="replace").strip().splitlines()[-1:]
        text = re.sub(r"(/[^\s\":]+)+/", "", last[0]) if last else "no message"
        raise RecordingError(
            f"the recording does not pass `rerun {' '.join(arguments[:2])}`: {text}; plan again or use --no-recording"
        )
    return run.stdout


def _cannot_write(path: Path, error: OSError) -> RecordingError:
    return RecordingError(
        f"{path.name}: the recording cannot be written ({error.strerror}); free space or choose another folder with -o"
    )
