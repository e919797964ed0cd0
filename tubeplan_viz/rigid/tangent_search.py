"""Reverse tangent-point search: from the lesion to every voxel of the entry region.

# Strategy: (1) every straight push is tried, without roll first. (2) Where it is blocked, the structure in the way is looked
# at from the goal, in planes through goal and start: the first direction beside it that leaves room for the instrument is
# the tangent, and the node lies d_t beyond the tangent point, across the tangent, away from the obstacle. The push from the
# node to the goal and the one from the start to the node must be free, and so must the turn between them. (3) What is
# still blocked is continued from its node in the same way, up to the number of nodes allowed. (4) A part of the way that is
# free serves all starts: the directions in which the instrument can stand at the goal are found once (`free_directions`), and
# nodes on them are offered to a spread of starts, then to those beside solved ones (`shared_nodes`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.rigid.free_directions import free_directions
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.judge import Judge
from tubeplan_viz.rigid.search_state import RigidPath, SearchResult, SearchSettings, State
from tubeplan_viz.rigid.shared_nodes import refine, share, spread
from tubeplan_viz.rigid.tangents import tangent_nodes
from tubeplan_viz.rigid.witnesses import Witnesses

Progress = Callable[[int, int], None]


def search(
    judge: Judge,
    starts: FloatArray,
    goal: FloatArray,
    settings: SearchSettings,
    *,
    known: Sequence[RigidPath] = (),
    progress: Progress | None = None,
) -> SearchResult:
    """Paths from as many starts as have one.

    Parameters
    ----------
    judge : Judge
    starts : (n, 3) float array, LPS mm
    goal : (3,) float array, LPS mm
    settings : SearchSettings
    known : sequence of RigidPath
        Paths that are free among obstacles of which those here are a part; they stand, and their starts are done.
    progress : callable, optional
        Called with starts decided so far and their number.
    """
    tests, evaluations = judge.tests, judge.evaluations
    judge = replace(judge, witnesses=judge.witnesses or Witnesses())
    n = len(starts)
    state = State(starts, goal, judge, list(known), np.zeros(n, bool), np.zeros((n, len(judge.obstacles.names)), np.int64))
    state.solved[[path.start for path in known]] = True
    told = progress or (lambda done, total: None)

    def tell() -> None:
        told(int(state.solved.sum()), n)

    blocked_by, blocked_at = _straight(state, settings)
    tell()
    legs = 0
    if settings.nodes and len(judge.obstacles.names):
        for roll in settings.roll_values[[0, -1, -2] if settings.rolls > 1 else [0]]:
            suffixes: dict[int, list[FloatArray]] = {int(row): [goal] for row in spread(starts, np.flatnonzero(~state.solved))}
            for _ in range(settings.nodes):
                suffixes = _bend(state, suffixes, roll, settings)
                tell()
        fans = {float(roll): _fan(state, float(roll)) for roll in settings.roll_values}
        legs = sum(len(fan) for fan in fans.values())
        if legs:
            share(state, fans, tell)
            refine(state, fans, settings, tell)
    told(n, n)
    return SearchResult(
        tuple(state.paths),
        state.solved,
        blocked_by,
        blocked_at,
        state.refused,
        judge.tests - tests,
        judge.evaluations - evaluations,
        legs,
    )


def cannot_stand(judge: Judge, starts: FloatArray, goal: FloatArray, settings: SearchSettings) -> bool:
    """Whether no straight push is free, nor any direction at the goal that the finest grids look at.

    Then a path is not to be expected; it is not ruled out, since directions between those of the grids are not looked at.
    """
    judge = replace(judge, witnesses=judge.witnesses or Witnesses())
    for roll in settings.roll_values:
        label, _ = judge.push(starts, np.broadcast_to(goal, starts.shape), np.full(len(starts), roll))
        if (label < 0).any() or len(free_directions(judge, starts, goal, float(roll), known=np.empty((0, 3)))):
            return False
    return True


def _fan(state: State, roll: float) -> FloatArray:
    """Free directions at the goal, looked for around the last segments that are known too."""
    ends = [path.nodes[-2] for path in state.paths if path.roll == roll]
    return free_directions(state.judge, state.starts, state.goal, roll, known=np.array(ends).reshape(-1, 3))


def _straight(state: State, settings: SearchSettings) -> tuple[IntArray, FloatArray]:
    """Every straight push; what blocks the one without roll, and where."""
    n = len(state.starts)
    blocked_by, blocked_at = np.full(n, -1, dtype=np.int64), np.full((n, 3), np.nan)
    for k, roll in enumerate(settings.roll_values):
        rows = np.flatnonzero(~state.solved) if k else np.arange(n)
        if not len(rows):
            break
        ends = np.broadcast_to(state.goal, (len(rows), 3))
        label, place = state.judge.push(state.starts[rows], ends, np.full(len(rows), roll), anew=k == 0)
        if k == 0:
            blocked_by, blocked_at = label, place
        state.note(rows, label)
        for row in rows[(label < 0) & ~state.solved[rows]]:
            state.solve(row, (state.starts[row], state.goal), roll)
    return blocked_by, blocked_at


def _bend(
    state: State, suffixes: dict[int, list[FloatArray]], roll: float, settings: SearchSettings
) -> dict[int, list[FloatArray]]:
    """Put one more node before the suffixes; those that are longer now and whose start is not reached yet."""
    rows = np.array([row for row in suffixes if not state.solved[row]], dtype=np.int64)
    if not len(rows):
        return {}
    here = np.array([suffixes[row][0] for row in rows])
    rolls = np.full(len(rows), roll)
    label, _ = state.judge.push(state.starts[rows], here, rolls)
    # A free push that did not solve its start failed at the turn: what blocked the goal is still in the way.
    candidates = tangent_nodes(state.judge, here, state.starts[rows], label, settings)
    longer: dict[int, list[FloatArray]] = {}
    for k in range(candidates.shape[1]):
        node = candidates[:, k]
        live = np.flatnonzero(~np.isnan(node[:, 0]) & ~state.solved[rows])
        if not len(live):
            continue
        label, _ = state.judge.push(node[live], here[live], rolls[live])
        state.note(rows[live], label)
        live = live[label < 0]
        bent = live[[len(suffixes[row]) > 1 for row in rows[live]]] if len(live) else live
        if len(bent):
            nxt = np.array([suffixes[row][1] for row in rows[bent]])
            free = state.judge.turn(here[bent], unit(here[bent] - node[bent]), unit(nxt - here[bent]), rolls[bent])
            live = np.setdiff1d(live, bent[~free])
        for j in live:
            longer.setdefault(int(rows[j]), [node[j], *suffixes[int(rows[j])]])
        some = rows[live]
        state.join(some, node[live], here[live], rolls[live], lambda j, some=some: suffixes[int(some[j])])  # type: ignore[misc]
    return {row: nodes for row, nodes in longer.items() if not state.solved[row]}
