"""The process that plans cases: it loads the planners once and gives each case a process of its own.

Strategy: tasks come in on standard input, one line of JSON each, and what happens goes out the same way. For each task
the process, which has one thread, forks; the child plans the case and ends. So a case that takes all memory or breaks a
library ends its own process alone, what a case leaves in memory is gone with it, and its time and memory are counted by
the system itself. Standard input that ends says that nobody waits any more: then the child is ended too, so that a
killed `tubeplan batch` leaves no process behind.
"""

from __future__ import annotations

import json
import os
import resource
import selectors
import signal
import time
import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from segmentation.errors import TubeplanError
from segmentation.faults import fault_words
from tubeplan_viz import __version__
from tubeplan_viz.cohort.state import sweep
from tubeplan_viz.cohort.tasks import CaseStatus, Task
from tubeplan_viz.cohort.words import without_paths
from tubeplan_viz.memory import megabytes
from tubeplan_viz.pipeline import RunOptions
from tubeplan_viz.plan import NoPathError
from tubeplan_viz.planners import make_case, run_case
from tubeplan_viz.verify import verify_run

GRACE_S = 5.0  # to remove what is half written, after the request to end and before the kill
POLL_S = 1.0  # how often a file that says whether the answer is wanted is looked for
Send = Callable[[dict[str, Any]], None]


def main() -> None:
    """Answer tasks until standard input ends."""
    out = os.dup(1)
    os.dup2(2, 1)  # what a library prints is no answer

    def send(message: dict[str, Any]) -> None:
        os.write(out, json.dumps(message, allow_nan=False).encode("utf-8") + b"\n")

    signal.signal(signal.SIGTERM, _leave)
    send({"event": "ready", "version": __version__})
    rest = b""
    while True:
        line, found, rest = rest.partition(b"\n")
        if not found:
            more = os.read(0, 1 << 16)
            if not more:
                return
            rest = line + more
            continue
        send({"event": "ended", **attend(Task(**json.loads(line)), send)})


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)


def attend(task: Task, send: Send) -> dict[str, Any]:
    """Give a task a process and wait for it: exit status, seconds, memory, and why it was ended from here, if it was."""
    begun = time.monotonic()
    # The child holds one end of a pipe as long as it lives, on whatever system.
    alive, held = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(alive)
        _be_the_child(task, send)
    os.close(held)
    with suppress(OSError):  # the child does the same; whoever is first, the group is there before it can be asked to end
        os.setpgid(child, child)
    ended = "unwanted"
    try:
        ended = _wait(alive, task, begun)
    finally:
        if ended:
            _end(child, alive)
        _, status, used = os.wait4(child, 0)
        os.close(alive)
        sweep(Path(task.target))
    return {
        "exit": os.waitstatus_to_exitcode(status),
        "ended": ended,
        "wall_s": round(time.monotonic() - begun, 3),
        "cpu_s": round(used.ru_utime + used.ru_stime, 3),
        "peak_memory_mb": round(megabytes(used.ru_maxrss), 1),
    }


def _wait(alive: int, task: Task, begun: float) -> str:
    """Empty when the child has ended by itself, otherwise why it has to be ended: ``time_limit`` or ``unwanted``."""
    with selectors.DefaultSelector() as watched:
        watched.register(alive, selectors.EVENT_READ)
        watched.register(0, selectors.EVENT_READ)
        while True:
            left = None if task.time_limit is None else task.time_limit - (time.monotonic() - begun)
            if left is not None and left <= 0.0:
                return "time_limit"
            ready = [key.fd for key, _ in watched.select(left if task.alive is None else min(POLL_S, left or POLL_S))]
            if alive in ready:
                return ""
            # Tasks come one at a time: what can be read while one is done is the end.
            if 0 in ready or (task.alive is not None and not os.path.exists(task.alive)):
                return "unwanted"


def _end(child: int, alive: int) -> None:
    """Ask the child and what it started to end, and insist."""
    with selectors.DefaultSelector() as watched:
        watched.register(alive, selectors.EVENT_READ)
        for number in (signal.SIGTERM, signal.SIGKILL):
            with suppress(ProcessLookupError):  # it has ended by itself by now
                os.killpg(child, number)
            if watched.select(GRACE_S):
                return


def _be_the_child(task: Task, send: Send) -> NoReturn:
    """Do the task in this process and leave it without the end of the program that was forked."""
    code = 1
    try:
        os.setpgid(0, 0)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a core holds the whole image
        send({"event": "answer", **do(task, send)})
        code = 0
    except KeyboardInterrupt:
        code = 130
    finally:
        os._exit(code)


def do(task: Task, send: Send) -> dict[str, Any]:
    """Plan the case of a task, verify its folder, or both: status, reason and verification."""
    target, parent = Path(task.target), os.getppid()

    def notify(stage: str, done: int, total: int) -> None:
        if os.getppid() != parent:  # whoever would end this process was killed
            raise KeyboardInterrupt
        if (done, total) == (0, 0):
            send({"event": "stage", "stage": stage})

    answer: dict[str, Any] = {"status": None, "reason": None, "verification": None}
    if task.plan:
        options = RunOptions(force=task.replace, recording=task.recording, report=task.report, notify=notify)
        answer |= _planned(task, target, options)
        if answer["status"] not in ("ok", "flagged", "infeasible") or not target.exists():
            return answer
    if task.verify:
        notify("verify", 0, 0)
        answer |= _verified(target)
    return answer


def _planned(task: Task, target: Path, options: RunOptions) -> dict[str, Any]:
    try:
        result = run_case(make_case(tomllib.loads(task.case_text), folder=target, name="case"), target, options)
    except NoPathError as fault:
        return {"status": CaseStatus.INFEASIBLE, "reason": without_paths(str(fault))}
    except TubeplanError as fault:
        return {"status": CaseStatus.BAD_INPUT, "reason": without_paths(str(fault))}
    except Exception as fault:  # a fault of the program costs this case and not the night's work; the row says where it was
        return {"status": CaseStatus.FAULT, "reason": without_paths(fault_words(fault))}
    return {"status": result["status"], "reason": result["reason"]}


def _verified(target: Path) -> dict[str, Any]:
    try:
        found = verify_run(target)
    except TubeplanError as fault:
        failed = [{"name": "run folder", "sentence": without_paths(str(fault))}]
        return {"verification": {"holds": False, "checks": 1, "failed": failed}}
    except Exception as fault:  # as above
        return {"status": CaseStatus.FAULT, "reason": without_paths(f"verify: {fault_words(fault)}")}
    failed = [{"name": check.name, "sentence": without_paths(check.sentence)} for check in found.faults]
    return {"verification": {"holds": found.holds, "checks": len(found.checks), "failed": failed}}
