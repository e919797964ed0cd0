"""Reverse tangent-point search: from the lesion to every voxel of the entry region.

# Strategy: (1) every straight push is tried, without roll first. (2) Where it is blocked, the structure in the way is looked
# at from the goal, in planes through goal and start: the first direction beside it that leaves room for the instrument is
# the tangent, and the node lies d_t beyond the tangent point, across the tangent, away from the obstacle. The push from the
# node to the goal and the one from the start to the node must be free, and so must the turn between them. (3) What is
# still blocked is continued from its node in the same way, up to the number of nodes allowed. (4) A part of the way that is
# free serves all starts: free ways from many nodes to the goal are found once and offered to a spread of starts, then to those
# beside solved ones; starts that remain are offered the nodes of their nearest solved neighbours, in waves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.judge import Judge
from tubeplan_viz.rigid.shared_nodes import alternating, lines_of_nodes
from tubeplan_viz.rigid.witnesses import Witnesses

CELLS_SEEN = 3000  # of a structure, as seen from a node; more only cost time
CHUNK = 48
BESIDE_MM = 5.0  # starts so near a solved one are offered every node of the pool
LEAST_LEG_MM = 5.0  # between a node and the goal
LEGS_TRIED, LEGS_BATCH = 4000, 500  # ways from the goal that are looked at, and how many before what stopped them is remembered
STRAIGHT_SHARED = 40  # straight paths whose places are offered as nodes
POOL, OFFER_BATCH = 450, 32  # nodes offered; so many at a time
SPREAD_MM = 3.0  # tangents are looked for from one start in every cube of this side
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """What the search may do.

    Attributes
    ----------
    roll_max : float, radian
        `beta` may be between -roll_max and roll_max; the text takes about 0.
    rolls : int
        How many values of it are tried, odd; 0 is tried first.
    planes : int
        Planes around the line from a node to a start in which tangents are looked for.
    nodes : int
        Most bends of a path.
    tangent_gap : float, mm
        `d_t`, on top of the room that the instrument itself needs beside the shaver's axis.
    neighbours : int
        Solved starts, and lines at each depth, whose nodes are offered to a start that is not solved.
    waves : int
        How often they are offered.
    """

    roll_max: float = np.radians(15.0)
    rolls: int = 5
    planes: int = 8
    nodes: int = 2
    tangent_gap: float = 0.5
    neighbours: int = 9
    waves: int = 4

    def __post_init__(self) -> None:
        if not 0.0 <= self.roll_max <= np.pi / 2:
            raise CaseError(f"roll_max_deg is {np.degrees(self.roll_max):g}, expected 0 to 90")
        if self.rolls < 1 or self.rolls % 2 == 0:
            raise CaseError(f"rolls is {self.rolls}, expected an odd number")
        if not 0 <= self.nodes <= 4:
            raise CaseError(f"nodes is {self.nodes}, expected 0 to 4")
        if not 4 <= self.planes <= 64:
            raise CaseError(f"planes is {self.planes}, expected 4 to 64")

    @property
    def roll_values(self) -> FloatArray:
        """Rolls in the order in which they are tried: the smallest first."""
        values = np.linspace(-self.roll_max, self.roll_max, self.rolls) if self.rolls > 1 else np.zeros(1)
        return np.asarray(values[np.argsort(np.abs(values), kind="stable")])


@dataclass(frozen=True, eq=False)
class RigidPath:
    """Straight segments from a start to the goal, the instrument's roll the same on all.

    Attributes
    ----------
    nodes : (k, 3) float array, LPS mm
        Start, bends, goal.
    roll : float, radian
    start : int
        Index of the entry voxel.
    """

    nodes: FloatArray
    roll: float
    start: int

    @property
    def length(self) -> float:
        """Sum of the segments, mm."""
        return float(np.linalg.norm(np.diff(self.nodes, axis=0), axis=1).sum())


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What the search found for every start.

    Attributes
    ----------
    paths : tuple of RigidPath
        At least one for every feasible start.
    feasible : (n,) bool array
    blocked_by : (n,) int array
        Of the straight push without roll: index of the structure, -1 where that push is free.
    blocked_at : (n, 3) float array, LPS mm
        Where; not a number where it is free.
    refused : (n, structures) int array
        How many tries each structure refused, for every start.
    evaluations : int
        Collision evaluations that it took.
    """

    paths: tuple[RigidPath, ...]
    feasible: BoolArray
    blocked_by: IntArray
    blocked_at: FloatArray
    refused: IntArray
    evaluations: int


@dataclass
class _State:
    """Where the search stands: suffixes are free ways from a node to the goal, one per start, as lists of nodes."""

    starts: FloatArray
    goal: FloatArray
    judge: Judge
    paths: list[RigidPath]
    solved: BoolArray
    refused: IntArray

    def note(self, rows: IntArray, labels: IntArray) -> None:
        """Count refusals."""
        hit = labels >= 0
        np.add.at(self.refused, (rows[hit], labels[hit]), 1)

    def solve(self, row: int, nodes: Sequence[FloatArray], roll: float) -> None:
        """A path is found."""
        self.paths.append(RigidPath(np.array(nodes), float(roll), int(row)))
        self.solved[row] = True


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
    begun = judge.evaluations
    judge = replace(judge, witnesses=judge.witnesses or Witnesses())
    n = len(starts)
    state = _State(starts, goal, judge, list(known), np.zeros(n, bool), np.zeros((n, len(judge.obstacles.names)), np.int64))
    state.solved[[path.start for path in known]] = True
    tell = progress or (lambda done, total: None)
    blocked_by, blocked_at = _straight(state, settings)
    tell(int(state.solved.sum()), n)
    if settings.nodes and len(judge.obstacles.names):
        for roll in settings.roll_values[[0, -1, -2] if settings.rolls > 1 else [0]]:
            suffixes: dict[int, list[FloatArray]] = {int(row): [goal] for row in _spread(starts, np.flatnonzero(~state.solved))}
            for _ in range(settings.nodes):
                suffixes = _bend(state, suffixes, roll, settings)
                tell(int(state.solved.sum()), n)
        _share(state, 0.0, lambda: tell(int(state.solved.sum()), n))
        if state.solved.any():
            _from_neighbours(state, settings, lambda: tell(int(state.solved.sum()), n))
    tell(n, n)
    return SearchResult(tuple(state.paths), state.solved, blocked_by, blocked_at, state.refused, judge.evaluations - begun)


def _straight(state: _State, settings: SearchSettings) -> tuple[IntArray, FloatArray]:
    """Every straight push; what blocks the one without roll, and where."""
    n = len(state.starts)
    blocked_by, blocked_at = np.full(n, -1, dtype=np.int64), np.full((n, 3), np.nan)
    for k, roll in enumerate(settings.roll_values):
        rows = np.flatnonzero(~state.solved) if k else np.arange(n)
        if not len(rows):
            break
        ends = np.broadcast_to(state.goal, (len(rows), 3))
        label, place = state.judge.push(state.starts[rows], ends, np.full(len(rows), roll))
        if k == 0:
            blocked_by, blocked_at = label, place
        state.note(rows, label)
        for row in rows[(label < 0) & ~state.solved[rows]]:
            state.solve(row, (state.starts[row], state.goal), roll)
    return blocked_by, blocked_at


def _bend(
    state: _State, suffixes: dict[int, list[FloatArray]], roll: float, settings: SearchSettings
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
        _finish(state, rows[live], [[node[j], *suffixes[int(rows[j])]] for j in live], rolls[live])
    return {row: nodes for row, nodes in longer.items() if not state.solved[row]}


def _spread(starts: FloatArray, rows: IntArray) -> IntArray:
    """One of the starts in every cube of `SPREAD_MM`: what is found for it is offered to the others."""
    _, first = np.unique(np.floor(starts[rows] / SPREAD_MM), axis=0, return_index=True)
    return rows[first]


def _finish(
    state: _State,
    rows: IntArray,
    tails: Sequence[Sequence[FloatArray]],
    rolls: FloatArray,
    which: IntArray | None = None,
    served: IntArray | None = None,
) -> None:
    """Join starts to free ways to the goal: the push to the first node, and the turn there.

    `served` is counted on at `which` for every start that is solved.
    """
    if not len(rows):
        return
    first, second = np.array([tail[0] for tail in tails]), np.array([tail[1] for tail in tails])
    label, _ = state.judge.push(state.starts[rows], first, rolls)
    state.note(rows, label)
    live = np.flatnonzero(label < 0)
    if not len(live):
        return
    before, after = unit(first[live] - state.starts[rows[live]]), unit(second[live] - first[live])
    free = state.judge.turn(first[live], before, after, rolls[live])
    for j in live[free]:
        if not state.solved[rows[j]]:
            state.solve(int(rows[j]), (state.starts[rows[j]], *tails[j]), rolls[j])
            if which is not None and served is not None:
                served[which[j]] += 1


def _share(state: _State, roll: float, tell: Callable[[], None]) -> None:
    """Offer free ways from many nodes to the goal to a spread of starts; then to starts beside solved ones, in waves."""
    step = SPREAD_MM
    every = state.starts[_spread(state.starts, np.arange(len(state.starts)))]
    grid = lines_of_nodes(every, state.goal, step, LEAST_LEG_MM)
    grid = grid[alternating(len(grid))[:LEGS_TRIED]]
    pool: list[tuple[Sequence[FloatArray], float]] = [
        (list(path.nodes[1:]), path.roll) for path in state.paths if len(path.nodes) > 2
    ]
    for part in np.array_split(grid, max(1, len(grid) // LEGS_BATCH)):
        label, _ = state.judge.push(part, np.broadcast_to(state.goal, part.shape), np.full(len(part), roll))
        pool += [([node, state.goal], roll) for node in part[label < 0]]
    straight = [path for path in state.paths if len(path.nodes) == 2]
    for path in (straight[k] for k in alternating(len(straight))[:STRAIGHT_SHARED]):
        pool += [([node, state.goal], path.roll) for node in lines_of_nodes(path.nodes[:1], state.goal, step, LEAST_LEG_MM)]
    pool = [pool[k] for k in alternating(len(pool))[:POOL]]
    served = np.zeros(len(pool), dtype=np.int64)
    offered = state.solved.copy()
    rows = _spread(state.starts, np.flatnonzero(~state.solved))
    while len(rows) and len(pool):
        offered[rows] = True
        _offer(state, rows, pool, served)
        tell()
        rest = np.flatnonzero(~offered & ~state.solved)
        if not state.solved.any() or not len(rest):
            return
        away, _ = cKDTree(state.starts[state.solved]).query(state.starts[rest])
        rows = rest[away <= BESIDE_MM]


def _offer(state: _State, rows: IntArray, pool: Sequence[tuple[Sequence[FloatArray], float]], served: IntArray) -> None:
    """Join starts to ways of the pool, those first that have served most; `served` is counted on."""
    order, batch, k = np.argsort(-served, kind="stable"), 1, 0
    while k < len(order):
        live = rows[~state.solved[rows]]
        if not len(live):
            return
        some = order[k : k + batch]
        which = np.tile(some, len(live))
        _finish(
            state, np.repeat(live, len(some)), [pool[j][0] for j in which], np.array([pool[j][1] for j in which]), which, served
        )
        k += len(some)
        batch = min(2 * batch, OFFER_BATCH)


def _from_neighbours(state: _State, settings: SearchSettings, tell: Callable[[], None]) -> None:
    """Offer the nodes of solved neighbours, wave by wave, until a wave solves nothing."""
    offered: set[tuple[int, int]] = set()
    for _ in range(settings.waves):
        rows = np.flatnonzero(~state.solved)
        if not len(rows):
            return
        by_start = {path.start: k for k, path in enumerate(state.paths)}
        solved = np.array(sorted(by_start), dtype=np.int64)
        tree = cKDTree(state.starts[solved])
        away, near = tree.query(state.starts[rows], k=min(settings.neighbours, len(solved)))
        near, away = np.asarray(near).reshape(len(rows), -1), np.asarray(away).reshape(len(rows), -1)
        before = int(state.solved.sum())
        for k in range(near.shape[1]):
            chosen, tails, rolls = [], [], []
            for row, other, gap in zip(rows, solved[near[:, k]], away[:, k], strict=True):
                which = by_start[int(other)]
                if gap > SPREAD_MM or state.solved[row] or (int(row), which) in offered:
                    continue
                offered.add((int(row), which))
                path = state.paths[which]
                # On a straight path any place can be the node; its middle leaves room for the turn on both sides.
                tail = [0.5 * (path.nodes[0] + path.nodes[1]), path.nodes[1]] if len(path.nodes) == 2 else list(path.nodes[1:])
                chosen.append(row)
                tails.append(tail)
                rolls.append(path.roll)
            _finish(state, np.array(chosen, dtype=np.int64), tails, np.array(rolls))
            tell()
        if int(state.solved.sum()) == before:
            return


def tangent_nodes(judge: Judge, here: FloatArray, starts: FloatArray, label: IntArray, settings: SearchSettings) -> FloatArray:
    """Nodes beside the structures in the way, (n, planes, 3) LPS mm, those that turn least first; not a number for none.

    Parameters
    ----------
    here, starts : (n, 3) float array, LPS mm
        Where the search stands, and the start it wants to reach from there.
    label : (n,) int array
        The structure in between; -1 for none.
    """
    out = np.full((len(here), settings.planes, 3), np.nan)
    for k in np.unique(label[label >= 0]):
        cells = judge.obstacles.frame.to_lps(judge.obstacles.cells[judge.obstacles.rows[k]])
        cells = cells[:: max(1, len(cells) // CELLS_SEEN)]
        rows = np.flatnonzero(label == k)
        for part in np.array_split(rows, max(1, len(rows) // CHUNK)):
            out[part] = _tangents(judge, cells, here[part], starts[part], settings)
    return out


def _tangents(judge: Judge, cells: FloatArray, here: FloatArray, starts: FloatArray, settings: SearchSettings) -> FloatArray:
    """Tangent nodes of one structure for a few starts."""
    instrument = judge.instrument
    ahead = unit(starts - here)
    up = unit(np.array([0.0, 0.0, 1.0]) - ahead[:, 2:] * ahead)
    side = np.cross(ahead, up)
    phi = 2.0 * np.pi * np.arange(settings.planes) / settings.planes
    away = np.cos(phi)[None, :, None] * up[:, None] + np.sin(phi)[None, :, None] * side[:, None]  # (n, planes, 3)
    normal = np.cross(ahead[:, None], away)
    offset = cells[None] - here[:, None]  # (n, m, 3)
    forth = np.einsum("nmi,ni->nm", offset, ahead)
    length = np.linalg.norm(starts - here, axis=1)
    reach = np.linalg.norm(offset, axis=2)
    relevant = (forth > 1.0) & (forth < length[:, None])
    out = np.full((len(here), settings.planes, 3), np.nan)
    turned = np.full((len(here), settings.planes), np.inf)
    for p in range(settings.planes):
        sideways = np.einsum("nmi,ni->nm", offset, away[:, p])
        beside = np.abs(np.einsum("nmi,ni->nm", offset, normal[:, p])) < instrument.scope_radius
        # An obstacle below is passed by the shaver, one above by the endoscope.
        rise = -np.einsum("ni,ni->n", away[:, p], up)
        room = np.maximum(instrument.shaver_radius, rise * instrument.offset + instrument.scope_radius * (rise > 0.3))
        room = room + settings.tangent_gap + judge.margin
        angle = np.arctan2(sideways, forth)
        spread = np.arcsin(np.clip(room[:, None] / np.maximum(reach, room[:, None] + 1e-9), 0.0, 1.0))
        for i in range(len(here)):
            use = relevant[i] & beside[i]
            if not use.any():
                continue
            found = _first_free(angle[i, use], spread[i, use])
            if found is None:
                continue
            theta, which = found
            cell = np.flatnonzero(use)[which]
            tangent = np.cos(theta) * ahead[i] + np.sin(theta) * away[i, p]
            # Along the tangent as far as the tangent point: the node is d_t and the instrument's room away from it.
            node = here[i] + (offset[i, cell] @ tangent) * tangent
            out[i, p], turned[i, p] = node, theta
    order = np.argsort(turned, axis=1, kind="stable")
    return np.take_along_axis(out, order[:, :, None], axis=1)


def _first_free(angle: FloatArray, spread: FloatArray) -> tuple[float, int] | None:
    """The least angle from 0 up that lies outside all intervals `angle +- spread`, and which interval ends there.

    Examples
    --------
    >>> theta, which = _first_free(np.array([0.0, 0.15, 0.8]), np.array([0.1, 0.1, 0.1]))
    >>> round(theta, 5), which
    (0.25, 1)
    """
    low, high = angle - spread, angle + spread
    order = np.argsort(low)
    theta, which = 0.0, -1
    for k in order:
        if low[k] > theta:
            break
        if high[k] > theta:
            theta, which = float(high[k]), int(k)
    return (theta + 1e-6, which) if which >= 0 and theta < 0.5 * np.pi else None
