"""What the recordings of all planners share: published once when whole, or discarded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from tubeplan_viz.recording import entities as at

if TYPE_CHECKING:
    from tubeplan_viz.recording.sink import Sink


class RunRecording(ABC):
    """A recording that is being written: `close` publishes it, `abort` leaves no file.

    As a context manager it is published at the end of the block, and discarded when
    the block raises. Until it is published the final file does not exist.

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
            with self._sink:
                self._sink.publish(self._blueprint())

    def abort(self) -> None:
        """Leave no file; a second call, or one after `close`, does nothing."""
        if self._open:
            self._open = False
            self._sink.discard()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    @abstractmethod
    def _blueprint(self) -> Any:
        """The layout with which the file opens."""


def begin(path: Path, *, case_id: str, frame: str, connect: str | None, **facts: Any) -> Sink:
    """A sink that names the case and its axes; `facts` are the case's own, as planner and method.

    Raises
    ------
    RecordingError
        If the file cannot be made.
    """
    import rerun as rr

    from tubeplan_viz.recording.blueprint import scene_axes
    from tubeplan_viz.recording.sink import Sink

    sink = Sink(path, case_id=case_id, connect=connect)
    with sink:
        sink.property("case", rr.AnyValues(case_id=case_id, frame=frame, units="mm", notice=at.NOTICE, **facts))
        sink.log(at.CASE, scene_axes(frame), static=True)
    return sink
