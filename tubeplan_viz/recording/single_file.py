"""One HTML file with a recording and the viewer that shows it, which opens from disk and asks nothing of any host."""

# Strategy: a browser lets no page from disk fetch its neighbours, so the viewer's WebAssembly and
# the recording stand in the page as gzip in base64 and are unpacked by the browser itself. The
# page's policy lets it connect to nothing, which also stops the viewer's own requests.

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import os
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path

from tubeplan_viz.recording.viewer_program import ViewerError
from tubeplan_viz.recording.web_viewer import viewer_files

JS, WASM = "re_viewer.js", "re_viewer_bg.wasm"


def write_single_file(recording: Path, path: Path, *, title: str) -> None:
    """Write a page that holds the recording and its viewer; about 19 MB more than the recording.

    Parameters
    ----------
    recording : Path
        The rerun file.
    path : Path
        The page to write, readable by its owner only.
    title : str
        The case's own name; never a patient's.

    Raises
    ------
    ViewerError
        If the viewer's files cannot be had.
    """
    parts = viewer_files()
    viewer = _bytes(parts[JS].content).decode("utf-8")
    if "</script" in viewer or "send_rrd_to_channel" not in viewer:
        raise ViewerError("rerun's web viewer is not the one that is known here; install the pinned rerun-sdk again")
    start = _part("single_file.js")
    page = _part("single_file.html")
    # The long parts last, and each once: none of them can be taken for a mark.
    for mark, text in (
        ("policy", content_policy((viewer, start))),
        ("title", html.escape(title)),
        ("style", _part("single_file.css")),
        ("licence", viewer_licence()),
        ("start", start),
        ("viewer", viewer),
        ("rrd", packed(recording.read_bytes())),
        ("wasm", packed(_bytes(parts[WASM].content))),
    ):
        page = page.replace(f"@{mark}@", text)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="utf-8", newline="\n") as file:
        file.write(page)


def viewer_licence() -> str:
    """The licence that a copy of rerun's viewer has to carry, as the installed package states it."""
    text = distribution("rerun-sdk").read_text("licenses/LICENSE-MIT")
    if text is None or "-->" in text:
        raise ViewerError("rerun's licence is not where it is known to be; install the pinned rerun-sdk again")
    return text.strip()


def packed(data: bytes) -> str:
    """Bytes as gzip in base64; the same bytes give the same text."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode("ascii")


def content_policy(scripts: tuple[str, ...]) -> str:
    """Nothing from outside, these scripts by their hashes, and WebAssembly; the viewer draws text from fonts of its own."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts)
    return (
        f"default-src 'none'; script-src 'wasm-unsafe-eval' {hashes}; style-src 'unsafe-inline'; "
        "img-src data: blob:; font-src data:; connect-src data: blob:; worker-src blob:; base-uri 'none'; form-action 'none'"
    )


def _part(name: str) -> str:
    return files("tubeplan_viz.recording").joinpath(name).read_text(encoding="utf-8")


def _bytes(content: bytes | Path) -> bytes:
    return content.read_bytes() if isinstance(content, Path) else content
