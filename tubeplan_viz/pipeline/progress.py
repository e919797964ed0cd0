"""Progress of a run and the seconds of its stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tubeplan_viz.interrupts import check_interrupted

# Called with the stage, and how many of how many parts of it are done (0 of 0: unknown).
Notify = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Progress for nobody."""


class Stopwatch:
    """Seconds per stage, in the order in which the stages ran; an interruption that was swallowed is raised again here."""

    def __init__(self, notify: Notify) -> None:
        self.seconds: dict[str, float] = {}
        self._notify = notify

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[int, int], None]]:
        """Time a block under `name`; yields the progress callback of that stage."""

        def notify(done: int, total: int) -> None:
            check_interrupted()
            self._notify(name, done, total)

        notify(0, 0)
        begun = time.perf_counter()
        yield notify
        self.seconds[name] = round(self.seconds.get(name, 0.0) + time.perf_counter() - begun, 4)
