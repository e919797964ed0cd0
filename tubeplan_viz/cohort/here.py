"""Cases side by side on this machine."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

from tubeplan_viz.cohort.hands import Hand, Stage, no_stage
from tubeplan_viz.cohort.tasks import Answer, Task

MEGABYTE = 1e6
# Taken by a case of which nothing is known yet: a mesh of a ureter; a CT takes more and is known after the first.
FIRST_GUESS_MB = 600.0
CGROUP = Path("/sys/fs/cgroup")


def usable_processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def free_memory_mb() -> float | None:
    """Memory that can be taken without swapping, in the machine and in this process's control group; None if not told."""
    found: list[float] = []
    with suppress(OSError, LookupError):  # a system that does not tell
        found.append(_figures(Path("/proc/meminfo"))["MemAvailable:"] * 1024 / MEGABYTE)
    with suppress(OSError, LookupError, ValueError):  # no control group of the second version, or one without a limit
        limit, taken = (int((CGROUP / name).read_text(encoding="ascii")) for name in ("memory.max", "memory.current"))
        # Files that were read and not used since are given back when memory is asked for.
        found.append((limit - taken + _figures(CGROUP / "memory.stat")["inactive_file"]) / MEGABYTE)
    return min(found, default=None)


def _figures(file: Path) -> dict[str, int]:
    """The first two words of each line, a name and a number."""
    return {line.split()[0]: int(line.split()[1]) for line in file.read_text(encoding="ascii").splitlines()}


def run_here(tasks: Iterator[Task], jobs: int, *, stage: Stage = no_stage) -> Generator[Answer]:
    """Do tasks on this machine, several at a time.

    Parameters
    ----------
    tasks : iterator of Task
        Taken one by one as places become free.
    jobs : int
        Cases at a time, 1 or more; fewer as long as memory for one more like the largest so far is not free.
    stage : callable, optional
        Told when a case begins a stage, from other threads.

    Yields
    ------
    Answer
        In the order in which they end. Closed before its end, everything that runs is ended.
    """
    hands = [Hand(stage=stage) for _ in range(jobs)]
    idle: SimpleQueue[Hand] = SimpleQueue()
    for hand in hands:
        idle.put(hand)

    def work(task: Task) -> Answer:
        hand = idle.get()
        try:
            return hand.run(task)
        finally:
            idle.put(hand)

    pool = ThreadPoolExecutor(jobs)
    running: set[Future[Answer]] = set()
    largest = FIRST_GUESS_MB
    try:
        for task in tasks:
            running.add(pool.submit(work, task))
            while running and (len(running) >= jobs or short_of(largest)):
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    answer = future.result()
                    largest = max(largest, answer.cost.peak_memory_mb or 0.0)
                    yield answer
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for hand in hands:
            hand.stop()
        pool.shutdown(wait=True)
        for hand in hands:
            hand.close()


def short_of(megabytes: float) -> bool:
    """Whether so much memory is not free."""
    free = free_memory_mb()
    return free is not None and free < megabytes
