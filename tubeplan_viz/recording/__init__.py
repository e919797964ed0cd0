"""Rerun recordings of planning runs: the only home of rerun.

Importing this package does not load rerun; the first recording opened or read does.
"""

from tubeplan_viz.recording.native_viewer import has_display, show_native
from tubeplan_viz.recording.readback import RecordedIteration, RecordedPath, RecordedRun, read_recording
from tubeplan_viz.recording.stream import Recording
from tubeplan_viz.recording.viewer_program import ViewerError
from tubeplan_viz.recording.web_viewer import WebViewer

__all__ = [
    "RecordedIteration",
    "RecordedPath",
    "RecordedRun",
    "Recording",
    "ViewerError",
    "WebViewer",
    "has_display",
    "read_recording",
    "show_native",
]
