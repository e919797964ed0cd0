"""Nodes that serve many starts: a free direction at the goal is found once and offered to all starts.

# Strategy: the last segment of every path lies along one of the free directions at the goal. Seen from a start, the places on
# such a line are told by the angle of the turn there: a sharp turn close to the start, a gentle one deep inside. (1) A coarse
# choice of lines and angles is offered to a spread of starts, then to starts beside solved ones, in waves; what has solved
# most starts is offered first, so that few offers are made in vain. (2) Starts beside solved ones that are still not solved
# are offered what serves their neighbours, and lines and angles a little beside, until a wave solves nothing: where the free
# directions end, a tenth of a degree decides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.search_state import RigidPath, SearchSettings, State
from tubeplan_viz.rigid.ways import Ways

SPREAD_MM = 3.0  # between starts that are tried first
BESIDE_MM = 3.6  # starts so near a solved one are offered everything
LINES = 24  # free directions offered, over all rolls
TURNS = tuple(np.radians([4.0, 8.0, 14.0, 22.0, 32.0, 44.0, 56.0, 68.0]).tolist())
OFFER_BATCH = 32  # offers made at a time
FINER = (1.0, 0.9, 1.1, 0.8, 1.25, 0.65, 1.5)  # of a neighbour's turn
FAN_BESIDE = 9  # directions nearest to a neighbour's that are tried
TRIES = 256  # places that a start is offered in one wave


def share(state: State, fans: Mapping[float, FloatArray], tell: Callable[[], None]) -> None:
    """Offer free ways to the goal to a spread of starts; then to starts beside solved ones, in waves.

    Parameters
    ----------
    state : State
        What is found is added.
    fans : mapping of roll to (k, 3) float array
        Free directions at the goal.
    tell : callable
        Called after every wave.
    """
    lines = [(direction, roll) for roll, fan in fans.items() for direction in fan]
    lines = [lines[k] for k in alternating(len(lines))[:LINES]]
    ways = Ways(state.goal)
    pool = [ways.add(np.broadcast_to(direction, (len(TURNS), 3)), np.array(TURNS), roll) for direction, roll in lines]
    bent = {tuple(path.nodes[1]): path for path in state.paths if len(path.nodes) > 3}
    pool += [_tail(ways, path) for path in list(bent.values())[:LINES]]
    order = alternating(len(ways))
    served = np.zeros(len(ways), dtype=np.int64)
    offered = state.solved.copy()
    rows = spread(state.starts, np.flatnonzero(~state.solved))
    while len(rows) and len(ways):
        offered[rows] = True
        _offer(state, rows, ways, order, served)
        tell()
        rest = np.flatnonzero(~offered & ~state.solved)
        if not state.solved.any() or not len(rest):
            return
        away, _ = cKDTree(state.starts[state.solved]).query(state.starts[rest])
        rows = rest[away <= BESIDE_MM]


def _offer(state: State, rows: IntArray, ways: Ways, pool: IntArray, served: IntArray) -> None:
    """Join starts to ways of the pool, those first that have served most; `served` is counted on, in the pool's order."""
    order, batch, k = np.argsort(-served, kind="stable"), 1, 0
    while k < len(order):
        live = rows[~state.solved[rows]]
        if not len(live):
            return
        some = order[k : k + batch]
        which = np.tile(some, len(live))
        found = _join(state, np.repeat(live, len(some)), ways, pool[which])
        np.add.at(served, which[found], 1)
        k += batch
        batch = min(2 * batch, OFFER_BATCH)


def _join(state: State, rows: IntArray, ways: Ways, which: IntArray) -> IntArray:
    """Join starts to ways as seen from them; which of the tries solved their start."""
    first, second = ways.seen_from(which, state.starts[rows])
    there = np.flatnonzero(~np.isnan(first[:, 0]))
    some = which[there]
    found = state.join(rows[there], first[there], second[there], ways.rolls(some), lambda j: ways.after(int(some[j])))
    return there[found]


def refine(state: State, fans: Mapping[float, FloatArray], settings: SearchSettings, tell: Callable[[], None]) -> None:
    """Offer starts beside solved ones what serves these, and ways beside it, until a wave solves nothing."""
    trees = {roll: cKDTree(fan) for roll, fan in fans.items() if len(fan)}
    ways = Ways(state.goal)
    beside: dict[int, IntArray] = {}  # ways by the start that they serve
    offered: dict[int, IntArray] = {}  # keys of ways by the start that they were offered to
    fresh = np.flatnonzero(state.solved)
    for _ in range(settings.waves):
        rows = np.flatnonzero(~state.solved)
        if not len(rows) or not len(fresh):
            return
        away, _ = cKDTree(state.starts[fresh]).query(state.starts[rows])
        rows = rows[away <= BESIDE_MM]
        by_start = {path.start: path for path in state.paths}
        solved = np.array(sorted(by_start), dtype=np.int64)
        near = cKDTree(state.starts[solved]).query_ball_point(state.starts[rows], BESIDE_MM)
        wishes: list[IntArray] = []
        for row, found in zip(rows.tolist(), near, strict=True):
            others = solved[found]
            others = others[np.argsort(np.linalg.norm(state.starts[others] - state.starts[row], axis=1), kind="stable")]
            for other in others[: settings.neighbours].tolist():
                if other not in beside:
                    beside[other] = _beside(ways, by_start[other], fans, trees)
            wishes.append(_in_turns([beside[other] for other in others[: settings.neighbours].tolist()]))
        tries = [_not_offered(ways, row, wish, offered) for row, wish in zip(rows.tolist(), wishes, strict=True)]
        before = state.solved.copy()
        # In turns, so that a start that is solved early is not asked again.
        for turn in range(0, TRIES, 4):
            parts = [
                (row, some[turn : turn + 4]) for row, some in zip(rows.tolist(), tries, strict=True) if not state.solved[row]
            ]
            asked = np.repeat([row for row, _ in parts], [len(some) for _, some in parts])
            if len(asked):
                _join(state, asked, ways, np.concatenate([some for _, some in parts]))
        tell()
        fresh = np.flatnonzero(state.solved & ~before)


def _in_turns(lists: Sequence[IntArray]) -> IntArray:
    """The first of every list, then the second, and so on.

    Examples
    --------
    >>> _in_turns([np.array([1, 2, 3]), np.array([7]), np.array([8, 9])]).tolist()
    [1, 7, 8, 2, 9, 3]
    """
    if not lists:
        return np.empty(0, dtype=np.int64)
    place = np.concatenate([np.arange(len(some)) for some in lists])
    return np.asarray(np.concatenate(lists)[np.argsort(place, kind="stable")])


def _not_offered(ways: Ways, row: int, wishes: IntArray, offered: dict[int, IntArray]) -> IntArray:
    """The first `TRIES` ways that a start was not offered yet, nor one that hardly differs; they count as offered then."""
    keys = ways.keys(wishes)
    _, first = np.unique(keys, return_index=True)
    first.sort()
    before = offered.get(row, np.empty(0, dtype=np.int64))
    kept = first[~np.isin(keys[first], before)][:TRIES]
    offered[row] = np.concatenate([before, keys[kept]])
    return np.asarray(wishes[kept])


def _beside(ways: Ways, path: RigidPath, fans: Mapping[float, FloatArray], trees: Mapping[float, cKDTree]) -> IntArray:
    """The way that serves a solved start, and ways a little beside it."""
    if len(path.nodes) > 3:
        return _tail(ways, path)
    bent = len(path.nodes) == 3
    direction = unit(path.nodes[-2] - path.nodes[-1])
    if bent:
        before = unit(path.nodes[1] - path.nodes[0])
        turns = np.arccos(np.clip(-before @ direction, -1.0, 1.0))[None]
    else:
        # Onto a straight path any turn may lead.
        turns = np.array(TURNS)
    directions, angles = [direction[None][: int(bent)]], [turns[: int(bent)]]
    if path.roll in trees:
        fan = fans[path.roll]
        _, near = trees[path.roll].query(direction, k=min(FAN_BESIDE, len(fan)))
        near = np.atleast_1d(near)
        wanted = np.concatenate([finer * turns for finer in (FINER if bent else (1.0,))])
        directions.append(np.tile(fan[near], (len(wanted), 1)))
        angles.append(np.repeat(wanted, len(near)))
    turn = np.concatenate(angles)
    kept = (turn > 0.02) & (turn < 1.5)
    return ways.add(np.vstack(directions)[kept], turn[kept], path.roll)


def _tail(ways: Ways, path: RigidPath) -> IntArray:
    """The way of a path with more than one bend, from its first node on."""
    return ways.add_tail(unit(path.nodes[-2] - path.nodes[-1]), path.roll, list(path.nodes[1:]))


def spread(points: FloatArray, rows: IntArray, side: float = SPREAD_MM) -> IntArray:
    """One of some rows in every cube of a side: what is found for it is offered to the others."""
    _, first = np.unique(np.floor(points[rows] / side), axis=0, return_index=True)
    return np.asarray(rows[first])


def alternating(count: int) -> IntArray:
    """Numbers below `count`, each far from those before it: multiples of the golden section.

    Examples
    --------
    >>> alternating(5).tolist()
    [0, 2, 4, 1, 3]
    """
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    return np.asarray(np.argsort(np.argsort(np.argsort((np.arange(count) * golden) % 1.0))))
