"""The native viewer as a child process: a home of its own, listening on loopback alone."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tubeplan_viz.recording.viewer_program import ViewerError, quiet_home, viewer_program
from tubeplan_viz.recording.web_viewer import LOOPBACK, end, free_ports

INTERRUPTED = (-2, 130)  # how the child ends when the terminal's Ctrl-C reaches it first


def has_display() -> bool:
    """Whether a program can open a window here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def show_native(recording: Path, *, port: int = 0) -> None:
    """Open a recording in the native viewer and wait until its window is closed.

    Parameters
    ----------
    recording : Path
    port : int
        Port of 127.0.0.1 at which the viewer takes live streams; 0 for any that is free.

    Raises
    ------
    ViewerError
        If the viewer ends with a fault, for instance without a graphics driver.
    """
    with quiet_home() as environment, tempfile.TemporaryFile() as said:
        chosen = port or free_ports(1)[0]
        options = ["--bind", LOOPBACK, "--port", str(chosen), "--hide-welcome-screen"]
        child = subprocess.Popen(
            [str(viewer_program()), *options, str(recording.resolve())],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=said,
        )
        try:
            status = child.wait()
        finally:
            end(child)
        if status not in (0, *INTERRUPTED):
            said.seek(0)
            lines = said.read().decode(errors="replace").strip().splitlines()
            raise ViewerError(
                f"the native viewer ended with status {status} ({lines[-1].strip()[:160] if lines else 'no message'}); "
                "see the recording in the browser with --web"
            )
