"""What the recordings of all planners share: published once when whole, or discarded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tubeplan_viz.recording.sink import Sink


class RunRecording:
    """A recording that is being written: `close` publishes it, `abort` leaves no file.

    Attributes
    ----------
    warnings : tuple of str
        What the user should know of the live viewer, as sentences.
    """

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._open = True

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about the live viewer."""
        return self._sink.warnings

    def close(self) -> None:
        """Publish the file: packed, checked, synced and renamed; a second call does nothing."""
        if self._open:
            self._open = False
            try:
                self._sink.publish(self._blueprint())
            except BaseException:
                self._sink.discard()
                raise

    def abort(self) -> None:
        """Leave no file; a second call, or one after `close`, does nothing."""
        if self._open:
            self._open = False
            self._sink.discard()

    def _blueprint(self) -> Any:
        """The layout with which the file opens."""
        raise NotImplementedError
