"""Where the stream goes: a file that appears only when it is whole, and a live viewer if one listens."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import uuid
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import rerun as rr
import rerun.blueprint as rrb

from segmentation.errors import TubeplanError
from tubeplan_viz.recording.viewer_program import quiet_home

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
    when it is known what there is to show. As a context manager it is discarded when
    the block raises.

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
        self._timeline = ""
        self._filled: set[tuple[str, str]] = set()
        viewer = None if connect is None else viewer_address(connect)
        self._recording_id = f"{re.sub('[^A-Za-z0-9_-]+', '-', case_id)}-{uuid.uuid4().hex[:12]}"
        self._partial = path.with_name(f".{path.stem}.partial-{uuid.uuid4().hex[:8]}.rrd")
        try:
            self._file: int | None = os.open(self._partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError as error:
            raise _cannot_write(path, error) from error
        rr.set_strict_mode(True)
        memory = _stream(self._recording_id)
        self._bytes = memory.binary_stream()
        self._streams = [memory]
        self._live = None if viewer is None else self._open_live(*viewer)
        if self._live is not None:
            self._streams.append(self._live)
        for stream in self._streams:
            stream.send_recording_name(case_id)

    def _open_live(self, host: str, port: int) -> Any:
        try:
            socket.create_connection((host, port), timeout=PROBE_TIMEOUT_S).close()
        except OSError:
            self.warnings += (f"no viewer listens at {host}:{port}; the recording goes to the file alone",)
            return None
        stream = _stream(self._recording_id)
        stream.connect_grpc(f"rerun+http://{host}:{port}/proxy")
        return stream

    def log(self, entity: str, *archetypes: Any, static: bool = False) -> None:
        """Log archetypes at the current time, or for all times."""
        for stream in self._streams:
            stream.log(entity, *archetypes, static=static)

    def log_some(self, entity: str, count: int, *archetypes: Any) -> None:
        """Log archetypes of `count` things; an entity that was always empty is left out of the file altogether."""
        if count or (self._timeline, entity) in self._filled:
            self._filled.add((self._timeline, entity))
            self.log(entity, *archetypes)

    def columns(self, entity: str, timeline: str, ticks: Any, columns: Any) -> None:
        """Log one row per tick of a sequence timeline at once."""
        for stream in self._streams:
            stream.send_columns(entity, [rr.TimeColumn(timeline, sequence=ticks)], columns)

    def at(self, timeline: str, tick: int) -> None:
        """What follows belongs to this tick of this timeline alone."""
        self._timeline = timeline
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
        if data and self._file is not None:
            self._write(self._file, data)

    def publish(self, blueprint: rrb.Blueprint) -> None:
        """Finish the file: blueprint in, chunks packed, checked, synced, renamed.

        Raises
        ------
        RecordingError
            If it cannot be written or does not read back.
        """
        self.flush()
        self._disconnect()
        try:
            self._close()
            packed = _viewer_tool("optimize", "--profile", "live", data=self._layout(blueprint) + self._partial.read_bytes())
            _viewer_tool("verify", data=packed)
            self._file = os.open(self._partial, os.O_WRONLY | os.O_TRUNC)
            self._write(self._file, packed)
            os.fsync(self._file)
            self._close()
            if self._partial.read_bytes() != packed:
                raise RecordingError(f"{self.path.name}: what was written does not read back; check the disk and plan again")
            os.replace(self._partial, self.path)
            _sync_folder(self.path.parent)
        except OSError as error:
            raise _cannot_write(self.path, error) from error

    def discard(self) -> None:
        """Leave nothing behind."""
        if self._streams:
            # Taken out and dropped here, since rerun itself warns on standard error when it drops data.
            self._bytes.read(flush=True)
        self._disconnect()
        self._close()
        self._partial.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None:
            self.discard()

    def _layout(self, blueprint: rrb.Blueprint) -> bytes:
        """The blueprint as the beginning of a recording."""
        stream = _stream(self._recording_id)
        memory = stream.binary_stream()
        stream.send_blueprint(blueprint, make_active=True, make_default=True)
        data = memory.read(flush=True)
        stream.disconnect()
        return data or b""

    def _close(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _disconnect(self) -> None:
        if self._live is not None:
            try:
                self._live.flush(timeout_sec=LIVE_FLUSH_TIMEOUT_S)
            except (RuntimeError, ValueError):
                self.warnings += ("the live viewer went away; the recording in the file is whole",)
        for stream in self._streams:
            stream.disconnect()
        self._streams, self._live = [], None

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


def _viewer_tool(*arguments: str, data: bytes) -> bytes:
    """Run ``rerun rrd`` on bytes, with a home of its own: no usage statistics, nothing left in the user's home."""
    with quiet_home() as environment:
        command = [sys.executable, "-m", "rerun_cli", "rrd", *arguments]
        run = subprocess.run(command, input=data, capture_output=True, env=environment, check=False)
    if run.returncode:
        last = run.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise RecordingError(
            f"the recording does not pass `rerun rrd {arguments[0]}` ({last[0] if last else 'no message'}); "
            "plan again, or leave it out with --no-recording"
        )
    return run.stdout


def _sync_folder(folder: Path) -> None:
    """Make the new name itself durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _cannot_write(path: Path, error: OSError) -> RecordingError:
    return RecordingError(
        f"{path.name}: the recording cannot be written ({error.strerror}); free space or choose another folder with -o"
    )
