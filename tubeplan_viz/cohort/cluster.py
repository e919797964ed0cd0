"""Cases on an existing cluster: any that runs a Dask scheduler, whose workers see the same files under the same paths."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from tubeplan_viz.cohort.errors import CohortError
from tubeplan_viz.cohort.hands import Hand
from tubeplan_viz.cohort.tasks import Answer, CaseStatus, Task
from tubeplan_viz.cohort.words import without_paths

CONNECT_S = 15
ALIVE = ".alive-"


def run_there(tasks: Iterator[Task], address: str, folder: Path) -> Generator[Answer]:
    """Do tasks on the workers of a Dask scheduler, as many at a time as they have threads.

    A worker that is lost with its machine has its case done by another. What a case needs beside
    the files is the same tubeplan on the worker.

    Parameters
    ----------
    tasks : iterator of Task
    address : str
        As ``tcp://host:8786``.
    folder : Path
        The cohort's folder. A file in it stands as long as the answers are wanted; without it the workers end what they do.

    Yields
    ------
    Answer
        In the order in which they end. Closed before its end, everything that runs is ended.

    Raises
    ------
    CohortError
        If Dask is not installed here, or no scheduler answers.
    """
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as fault:
        told = f"no Dask scheduler answers there ({type(fault).__name__})"
        raise CohortError(f"--scheduler {address}: {told}; start it or check the address") from None
    handle, alive = tempfile.mkstemp(prefix=ALIVE, dir=folder)
    os.close(handle)
    ids: dict[Any, str] = {}
    try:
        for task in tasks:
            future = client.submit(do_alone, replace(task, alive=alive), key=f"{task.id}-{Path(alive).name}", pure=False)
            ids[future] = task.id
        for future in distributed.as_completed(ids):
            lost = future.exception()
            if lost is None:
                yield future.result()
            else:
                reason = f"lost by the cluster: {type(lost).__name__}: {without_paths(str(lost))}"
                yield Answer(id=ids[future], status=CaseStatus.DIED, reason=reason)
    finally:
        Path(alive).unlink(missing_ok=True)
        client.cancel(list(ids))
        client.close()


def call_back(folder: Path) -> None:
    """Let the workers know that what a killed command asked of them is not wanted any more."""
    for left in folder.glob(f"{ALIVE}*"):
        left.unlink(missing_ok=True)


def do_alone(task: Task) -> Answer:
    """One task in a worker process of its own, on a machine of the cluster."""
    hand = Hand()
    try:
        return hand.run(task)
    finally:
        hand.close()


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise CohortError("--scheduler needs Dask, which is not installed; pip install 'tubeplan[cluster]'") from None
    return distributed
