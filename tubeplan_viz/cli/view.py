"""tubeplan view: the recording of a run in the rerun viewer."""

from __future__ import annotations

import os
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from segmentation.errors import CaseError
from tubeplan_viz.interrupts import ending_like_ctrl_c
from tubeplan_viz.recording import WebViewer, has_display, show_native
from tubeplan_viz.result import RunFolderError, is_run, not_a_run

MARKERS = ("result.json", "compare.json", "matrix.json", "reach.json")
# Both ends of a recording that was written to its end, and how much of its file holds the last one.
BEGIN, END, TAIL = b"RRF2", b"RRF2FOOT", 64


def view(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="A run folder, or one of compare, matrix or reach.")],
    web: Annotated[bool, typer.Option("--web", help="The web viewer even where there is a display.")] = False,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Serve and print the address, open no browser.")] = False,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Port of 127.0.0.1; 0 for any free one.")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print the address alone.")] = False,
) -> None:
    """Open a run's recording in the rerun viewer.

    With a display the native viewer opens; without one, or with --web or --no-browser, the
    web viewer is served on 127.0.0.1 alone until Ctrl-C, at an address that cannot be
    guessed, and its requests to other hosts are blocked. Ending the view by closing the
    window or by Ctrl-C is no fault: exit status 0.

    Example: tubeplan view run
    """
    recording = recording_of(run_folder)
    with ending_like_ctrl_c():
        try:
            if has_display() and not (web or no_browser):
                show_native(recording, port=port)
            else:
                serve(recording, port=port, browser=not no_browser, quiet=quiet)
        except KeyboardInterrupt:
            tell("view ended", quiet=quiet)


def recording_of(folder: Path) -> Path:
    """The recording in a run folder.

    Raises
    ------
    CaseError, RunFolderError
        If the folder is not there, is no run, or its recording is missing or broken.
    """
    if not folder.is_dir():
        raise CaseError(f"{folder.name}: no such run folder; name the folder that `tubeplan run` or `tubeplan plan` made")
    if not any(is_run(folder, marker) for marker in MARKERS):
        raise not_a_run(folder)
    recording = folder / "recording.rrd"
    if not recording.is_file():
        raise RunFolderError(
            f"{folder.resolve().name} holds no recording.rrd; it was made with --no-recording, "
            "make it again without, for instance `tubeplan run` on its case.toml"
        )
    if not is_whole(recording):
        raise RunFolderError(
            f"{folder.resolve().name}: recording.rrd is cut off or no recording of this version of rerun; make the run again, "
            "for instance with `tubeplan run` on its case.toml"
        )
    return recording


def is_whole(recording: Path) -> bool:
    """Whether a file begins and ends as a recording does: the viewer itself shows nothing of a broken one and says nothing."""
    try:
        with recording.open("rb") as file:
            begin = file.read(len(BEGIN))
            file.seek(-min(TAIL, recording.stat().st_size), os.SEEK_END)
            return begin == BEGIN and END in file.read()
    except OSError as fault:
        reason = (fault.strerror or "the system refuses").lower()
        raise RunFolderError(f"{recording.name} cannot be read ({reason}); check its permissions") from None


def tell(words: str, *, quiet: bool) -> None:
    """Say on standard error how the view goes, unless it is to be quiet."""
    if not quiet:
        typer.echo(words, err=True)


def serve(recording: Path, *, port: int, browser: bool, quiet: bool) -> None:
    """Serve the web viewer until interrupted."""
    with WebViewer(recording, port=port) as viewer:
        typer.echo(viewer.url)
        tell("served to this machine alone; open the address in a browser, end with Ctrl-C", quiet=quiet)
        # Without a display `webbrowser` may start a browser in the terminal, which cannot show this page.
        if browser and has_display():
            webbrowser.open(viewer.url)
        viewer.wait()
