"""The other end of a worker: start it, give it one task after the other, read what it answers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any

from tubeplan_viz.cohort.errors import CohortError
from tubeplan_viz.cohort.tasks import Answer, CaseStatus, Cost, Task
from tubeplan_viz.cohort.words import without_paths

# Cases side by side take the processors; threads inside one would only get in the way of the others.
ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "RAYON_NUM_THREADS",
    "IGL_NUM_THREADS",
    "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS",
)
# -P: a file in the current folder must not stand in for a library.
COMMAND = (sys.executable, "-P", "-c", "from tubeplan_viz.cohort.worker import main; main()")
LEAVE_S = 15.0
Stage = Callable[[str, str], None]  # id of the case and name of the stage that it begins


def no_stage(case_id: str, stage: str) -> None:
    """Stages for nobody."""


class Hand:
    """One worker process; begun with the first task, begun again should it have died."""

    def __init__(self, *, stage: Stage = no_stage) -> None:
        self._stage = stage
        self._process: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] | None = None
        self._ready = False
        self._stopped = False

    def run(self, task: Task) -> Answer:
        """Have a task done; however it ends there is an answer.

        Raises
        ------
        CohortError
            If there is no worker at all: it ends before it can be asked, or is of another version.
        """
        if self._stopped:
            return Answer(id=task.id, status=None, stopped=True)
        process = self._started()
        said: dict[str, Any] = {}
        try:
            assert process.stdin is not None
            process.stdin.write(json.dumps(task.plain()).encode("utf-8") + b"\n")
            process.stdin.flush()
        except BrokenPipeError:
            return self._lost(task)
        assert process.stdout is not None
        for line in process.stdout:
            message = json.loads(line)
            event = message.pop("event")
            if event == "ready":
                self._ready = True
                if message["version"] != task.version:
                    self.stop()
                    raise CohortError(f"a worker has tubeplan {message['version']}, expected {task.version} as here; install it")
            if event == "stage":
                self._stage(task.id, message["stage"])
            elif event == "answer":
                said = message
            elif event == "ended":
                return answer_of(task, said, message)
        return self._lost(task)

    def stop(self) -> None:
        """End the worker with what it is doing; nothing half-written is left. No task is taken afterwards."""
        self._stopped = True
        process = self._process
        if process is None:
            return
        self._close_input()
        try:
            process.wait(LEAVE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def close(self) -> None:
        """Stop, and give back what the system lent; no task may be running."""
        self.stop()
        self._put_away()
        if self._errors is not None:
            self._errors.close()

    def _close_input(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            with suppress(BrokenPipeError):  # the worker has ended already
                self._process.stdin.close()

    def _put_away(self) -> None:
        self._close_input()
        if self._process is not None and self._process.stdout is not None:
            self._process.stdout.close()

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self._errors = self._errors or tempfile.TemporaryFile()  # noqa: SIM115 - closed with the worker
            environment = {**os.environ, **dict.fromkeys(ONE_THREAD, "1")}
            self._ready = False
            # A session of its own: Ctrl-C is for the command, which ends its workers in order.
            self._process = subprocess.Popen(
                COMMAND,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env=environment,
                start_new_session=True,
            )
        return self._process

    def _lost(self, task: Task) -> Answer:
        """The worker itself ended."""
        assert self._process is not None
        code = self._process.wait()
        if self._stopped:
            return Answer(id=task.id, status=None, stopped=True)
        self._put_away()
        if not self._ready:
            raise CohortError(
                f"no worker can be started ({ending(code)}){self._last_words()}; does `tubeplan --version` work there?"
            )
        return Answer(id=task.id, status=CaseStatus.DIED, reason=f"its worker ended: {ending(code)}")

    def _last_words(self) -> str:
        """The last line that the worker wrote on standard error, for a fault that no row can tell otherwise."""
        if self._errors is None:
            return ""
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(size - 2000, 0))
        lines = self._errors.read().decode("utf-8", "replace").strip().splitlines()
        return f": {without_paths(lines[-1])}" if lines else ""


def answer_of(task: Task, said: dict[str, Any], ended: dict[str, Any]) -> Answer:
    """The answer from what the case said of itself and how its process ended."""
    cost = Cost(wall_s=ended["wall_s"], cpu_s=ended["cpu_s"], peak_memory_mb=ended["peak_memory_mb"])
    if ended["ended"] == "unwanted":
        return Answer(id=task.id, status=None, stopped=True, cost=cost)
    if ended["ended"] == "time_limit":
        reason = f"not done within the time limit of {task.time_limit:g} s; give --time-limit more, then --retry-failed"
        return Answer(id=task.id, status=CaseStatus.TIME_LIMIT, reason=reason, cost=cost)
    if not said or ended["exit"] != 0:
        reason = f"its process ended: {ending(int(ended['exit']))}"
        return Answer(id=task.id, status=CaseStatus.DIED, reason=reason, cost=cost)
    status = None if said["status"] is None else CaseStatus(said["status"])
    return Answer(id=task.id, status=status, reason=said["reason"], verification=said["verification"], cost=cost)


def ending(code: int) -> str:
    """How a process ended, from its exit code.

    Examples
    --------
    >>> ending(-11), ending(3)
    ('signal SIGSEGV', 'exit status 3')
    """
    if code >= 0:
        return f"exit status {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = str(-code)
    if -code == signal.SIGKILL:
        return "signal SIGKILL, as the system does where memory runs out; make room or give fewer --jobs, then --retry-failed"
    return f"signal {name}"
