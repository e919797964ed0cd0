"""Instruments against targets: one wall, one start, one search per target, on several processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from queue import SimpleQueue

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from tubeplan_viz.centerline import Endpoint, VoronoiGraph, trace_centerline
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.instruments.catalogue import Instrument
from tubeplan_viz.instruments.ceiling import ClearanceCeiling
from tubeplan_viz.instruments.proof import SharpBend
from tubeplan_viz.instruments.reach import Reach, ReachSettings
from tubeplan_viz.instruments.verdict import Cell, Target, Verdict, Witness

# Fewer targets are done in this process sooner than another one starts.
FEW_TARGETS = 4


@dataclass(frozen=True, eq=False, kw_only=True)
class Column:
    """All instruments for one target, with the paths found and the bends proved to be too sharp."""

    cells: tuple[Cell, ...]
    paths: tuple[Witness, ...]
    bends: tuple[SharpBend, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Matrix:
    """Every instrument against every target.

    Attributes
    ----------
    instruments : tuple of Instrument
    targets : tuple of Target
    cells : tuple of tuple of Cell
        ``cells[i][j]`` is instrument i and target j.
    paths : tuple of tuple of Witness
        Of each target, the paths that cells refer to.
    bends : tuple of tuple of SharpBend
        Of each target, the bends that cells refer to.
    """

    instruments: tuple[Instrument, ...]
    targets: tuple[Target, ...]
    cells: tuple[tuple[Cell, ...], ...]
    paths: tuple[tuple[Witness, ...], ...]
    bends: tuple[tuple[SharpBend, ...], ...]

    def count(self, verdict: Verdict) -> int:
        """Number of cells with a verdict."""
        return sum(cell.verdict is verdict for row in self.cells for cell in row)


def find_targets(
    wall: WallDistance, graph: VoronoiGraph, start: FloatArray, goals: Sequence[Endpoint], settings: ReachSettings
) -> tuple[Target, ...]:
    """Centerline and clearance ceiling of every goal; one graph and one widest-way tree serve all."""
    ceiling = ClearanceCeiling(wall, start)
    found = []
    for goal in goals:
        line = trace_centerline(graph, wall, start, goal.point, settings.tube.centerline)
        kept = 0.0 if line is None else float(line.radii.min())
        found.append(Target(label=goal.label, point=goal.point, centerline=line, ceiling=ceiling.to(goal.point, kept=kept)))
    return tuple(found)


def instrument_matrix(
    wall: WallDistance,
    start: FloatArray,
    targets: Sequence[Target],
    instruments: Sequence[Instrument],
    settings: ReachSettings,
    *,
    jobs: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> Matrix:
    """Judge every instrument for every target.

    Parameters
    ----------
    wall : WallDistance
    start : (3,) float array, mm
    targets : sequence of Target
        From `find_targets`.
    instruments : sequence of Instrument
    settings : ReachSettings
    jobs : int
        Processes, this one among them; their number changes nothing but the time.
    progress : callable, optional
        Called with the number of targets done and of all.

    Raises
    ------
    CaseError
        If there is no instrument or no target.
    """
    if not instruments or not targets:
        raise CaseError(
            f"the matrix has {len(instruments)} instruments and {len(targets)} targets; expected at least one of each"
        )
    # Long ways first, so that no process is left with one at the end.
    order = sorted(range(len(targets)), key=lambda k: -way_length(targets[k]))
    done: dict[int, Column] = {}

    def finished(k: int, found: Column) -> None:
        done[k] = found
        if progress is not None:
            progress(len(done), len(targets))

    if jobs < 2 or len(targets) <= FEW_TARGETS:
        for k in order:
            finished(k, judge_target(wall, start, targets[k], instruments, settings))
    else:
        share_targets(wall, start, targets, instruments, settings, order=order, helpers=jobs - 1, finished=finished)
    columns = [done[k] for k in range(len(targets))]
    return Matrix(
        instruments=tuple(instruments),
        targets=tuple(targets),
        cells=tuple(tuple(column.cells[i] for column in columns) for i in range(len(instruments))),
        paths=tuple(column.paths for column in columns),
        bends=tuple(column.bends for column in columns),
    )


def share_targets(
    wall: WallDistance,
    start: FloatArray,
    targets: Sequence[Target],
    instruments: Sequence[Instrument],
    settings: ReachSettings,
    *,
    order: Sequence[int],
    helpers: int,
    finished: Callable[[int, Column], None],
) -> None:
    """Judge the targets in this process and some more, each taking the next one when it is free."""
    waiting, found = deque(order), SimpleQueue[tuple[int, Column]]()
    # Not forked: the caller's threads (progress bars, linear algebra) would not survive it.
    with (
        ProcessPoolExecutor(
            max_workers=helpers,
            mp_context=get_context("spawn"),
            initializer=prepare_worker,
            initargs=(wall.surface, wall.closed_ends, np.asarray(start), tuple(instruments), settings),
        ) as pool,
        ThreadPoolExecutor(max_workers=helpers) as feeders,
    ):

        def feed() -> None:
            while (k := taken(waiting)) is not None:
                found.put((k, pool.submit(judge_in_worker, targets[k]).result()))

        fed = [feeders.submit(feed) for _ in range(helpers)]
        try:
            while (k := taken(waiting)) is not None:
                finished(k, judge_target(wall, start, targets[k], instruments, settings))
                while not found.empty():
                    finished(*found.get())
        finally:
            waiting.clear()  # after a fault or an interrupt nothing more is begun
        for one in fed:
            one.result()
    while not found.empty():
        finished(*found.get())


def taken(waiting: deque[int]) -> int | None:
    """The next number; None when all are taken. Safe between threads."""
    try:
        return waiting.popleft()
    except IndexError:
        return None


def way_length(target: Target) -> float:
    """Length of a target's centerline, mm; 0 without one."""
    return 0.0 if target.centerline is None else float(target.centerline.arc_length[-1])


def judge_target(
    wall: WallDistance, start: FloatArray, target: Target, instruments: Sequence[Instrument], settings: ReachSettings
) -> Column:
    """All instruments for one target."""
    reach = Reach(wall, start, target, instruments, settings)
    return Column(cells=reach.cells(), paths=tuple(reach.witnesses), bends=reach.bends)


# What one worker process works on; set once when it starts.
_bench: list[tuple[WallDistance, FloatArray, tuple[Instrument, ...], ReachSettings]] = []


def prepare_worker(
    surface: Surface, closed_ends: bool, start: FloatArray, instruments: tuple[Instrument, ...], settings: ReachSettings
) -> None:
    """Build the wall's search trees in a worker; they cannot be sent."""
    _bench[:] = [(WallDistance(surface, closed_ends=closed_ends), start, instruments, settings)]


def judge_in_worker(target: Target) -> Column:
    """`judge_target` on what the worker holds."""
    wall, start, instruments, settings = _bench[0]
    return judge_target(wall, start, target, instruments, settings)
