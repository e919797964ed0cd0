"""Rerun recordings of planning runs: the only home of rerun.

Importing this package does not load rerun; the first recording opened or read does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tubeplan_viz.recording.native_viewer import has_display, show_native
from tubeplan_viz.recording.readback import RecordedIteration, RecordedPath, RecordedRun, read_recording
from tubeplan_viz.recording.single_file import write_single_file
from tubeplan_viz.recording.stream import Recording
from tubeplan_viz.recording.viewer_program import ViewerError
from tubeplan_viz.recording.web_viewer import WebViewer

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from segmentation.mesh import Surface
    from tubeplan_viz.result import Comparison


def record_comparison(comparison: Comparison, path: Path) -> None:
    """Write the recording of runs side by side.

    Raises
    ------
    RecordingError
        If it cannot be written or does not read back.
    """
    from tubeplan_viz.recording.comparison import log_comparison

    log_comparison(comparison, path)


def record_matrix(document: Mapping[str, Any], surface: Surface, path: Path) -> None:
    """Write the recording of instruments against targets, from the content of matrix.json.

    Raises
    ------
    RecordingError
        If it cannot be written or does not read back.
    """
    from tubeplan_viz.recording.matrix import log_matrix

    log_matrix(document, surface, path)


def record_reach(document: Mapping[str, Any], surface: Surface, path: Path) -> None:
    """Write the recording of a reach map, from the content of reach.json.

    Raises
    ------
    RecordingError
        If it cannot be written or does not read back.
    """
    from tubeplan_viz.recording.reach import log_reach

    log_reach(document, surface, path)


__all__ = [
    "RecordedIteration",
    "RecordedPath",
    "RecordedRun",
    "Recording",
    "ViewerError",
    "WebViewer",
    "has_display",
    "read_recording",
    "record_comparison",
    "record_matrix",
    "record_reach",
    "show_native",
    "write_single_file",
]
