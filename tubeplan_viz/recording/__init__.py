"""Rerun recordings of planning runs: the only home of rerun.

Importing this package does not load rerun; the first recording opened or read does.
"""

from tubeplan_viz.recording.readback import RecordedIteration, RecordedPath, RecordedRun, read_recording
from tubeplan_viz.recording.stream import Recording

__all__ = ["RecordedIteration", "RecordedPath", "RecordedRun", "Recording", "read_recording"]
