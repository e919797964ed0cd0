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
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.search_state import SearchSettings, State

LEAST_LEG_MM = 5.0  # between a node and the goal
SPREAD_MM = 3.0  # between starts that are tried first
BESIDE_MM = 3.6  # starts so near a solved one are offered everything
LINES = 24  # free directions offered, over all rolls
TURNS = tuple(np.radians([4.0, 8.0, 14.0, 22.0, 32.0, 44.0, 56.0, 68.0]).tolist())
OFFER_BATCH = 32  # offers made at a time
FINER = (1.0, 0.9, 1.1, 0.8, 1.25, 0.65, 1.5)  # of a neighbour's turn
FAN_BESIDE = 9  # directions nearest to a neighbour's that are tried
TRIES = 256  # places that a start is offered in one wave


@dataclass(frozen=True, eq=False)
class Way:
    """A free direction at the goal and the turn onto it, or a whole way from a node.

    Attributes
    ----------
    direction : (3,) float array
        From the goal outwards.
    turn : float, radian
        Where the line of the direction is entered.
    tail : tuple of (3,) float array, LPS mm
        Nodes and goal of a way with more bends; empty otherwise.
    roll : float, radian
    """

    direction: FloatArray
    turn: float
    roll: float
    tail: tuple[FloatArray, ...] = ()

    @property
    def key(self) -> tuple[int, ...]:
        """The same for ways that hardly differ."""
        fine = np.concatenate([self.direction * 1000.0, [np.degrees(self.turn), np.degrees(self.roll)], *self.tail[:1]])
        return tuple(np.round(fine).astype(int).tolist())

    def seen_from(self, start: FloatArray, goal: FloatArray) -> tuple[FloatArray, ...]:
        """Nodes and goal for one start; empty where the turn lies too near the goal."""
        if self.tail:
            return self.tail
        along = float((start - goal) @ self.direction)
        aside = float(np.linalg.norm(start - goal - along * self.direction))
        depth = along - aside / float(np.tan(self.turn))
        return (goal + depth * self.direction, goal) if LEAST_LEG_MM <= depth < along - 1e-6 else ()


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
    pool = [Way(direction, turn, roll) for direction, roll in lines for turn in TURNS]
    bent = {tuple(path.nodes[1]): path for path in state.paths if len(path.nodes) > 3}
    pool += [
        Way(unit(path.nodes[-2] - state.goal), 0.0, path.roll, tuple(path.nodes[1:])) for path in list(bent.values())[:LINES]
    ]
    pool = [pool[k] for k in alternating(len(pool))]
    served = np.zeros(len(pool), dtype=np.int64)
    offered = state.solved.copy()
    rows = spread(state.starts, np.flatnonzero(~state.solved))
    while len(rows) and len(pool):
        offered[rows] = True
        _offer(state, rows, pool, served)
        tell()
        rest = np.flatnonzero(~offered & ~state.solved)
        if not state.solved.any() or not len(rest):
            return
        away, _ = cKDTree(state.starts[state.solved]).query(state.starts[rest])
        rows = rest[away <= BESIDE_MM]


def _offer(state: State, rows: IntArray, pool: Sequence[Way], served: IntArray) -> None:
    """Join starts to ways of the pool, those first that have served most; `served` is counted on."""
    order, batch, k = np.argsort(-served, kind="stable"), 1, 0
    while k < len(order):
        live = rows[~state.solved[rows]]
        if not len(live):
            return
        pairs = [(int(row), int(j)) for row in live for j in order[k : k + batch]]
        found = _join(state, [(row, pool[j]) for row, j in pairs])
        np.add.at(served, [pairs[f][1] for f in found], 1)
        k += batch
        batch = min(2 * batch, OFFER_BATCH)


def _join(state: State, tries: Sequence[tuple[int, Way]]) -> list[int]:
    """Join starts to ways as seen from them; which of the tries solved their start."""
    tails = [way.seen_from(state.starts[row], state.goal) for row, way in tries]
    which = [k for k, tail in enumerate(tails) if tail]
    rows = np.array([tries[k][0] for k in which], dtype=np.int64)
    found = state.join(rows, [tails[k] for k in which], np.array([tries[k][1].roll for k in which]))
    return [which[f] for f in found]


def refine(state: State, fans: Mapping[float, FloatArray], settings: SearchSettings, tell: Callable[[], None]) -> None:
    """Offer starts beside solved ones what serves these, and ways beside it, until a wave solves nothing."""
    trees = {roll: cKDTree(fan) for roll, fan in fans.items() if len(fan)}
    offered: set[tuple[int, tuple[int, ...]]] = set()
    fresh = np.flatnonzero(state.solved)
    for _ in range(settings.waves):
        rows = np.flatnonzero(~state.solved)
        if not len(rows) or not len(fresh):
            return
        away, _ = cKDTree(state.starts[fresh]).query(state.starts[rows])
        rows = rows[away <= BESIDE_MM]
        by_start = {path.start: k for k, path in enumerate(state.paths)}
        solved = np.array(sorted(by_start), dtype=np.int64)
        ways = {start: _beside(state, by_start[start], fans, trees) for start in solved.tolist()}
        near = cKDTree(state.starts[solved]).query_ball_point(state.starts[rows], BESIDE_MM)
        tries: list[tuple[int, Way]] = []
        for row, found in zip(rows.tolist(), near, strict=True):
            others = solved[found]
            others = others[np.argsort(np.linalg.norm(state.starts[others] - state.starts[row], axis=1), kind="stable")]
            lists = [ways[other] for other in others[: settings.neighbours].tolist()]
            made = 0
            # The nearest wishes of all neighbours first.
            for place in range(max((len(some) for some in lists), default=0)):
                for way in (some[place] for some in lists if place < len(some)):
                    key = (row, way.key)
                    if key not in offered and made < TRIES:
                        offered.add(key)
                        tries.append((row, way))
                        made += 1
        before = state.solved.copy()
        # In turns, so that a start that is solved early is not asked again.
        rank = _rank([row for row, _ in tries])
        for turn in range(0, TRIES, 4):
            asked = np.flatnonzero((rank >= turn) & (rank < turn + 4))
            _join(state, [tries[k] for k in asked if not state.solved[tries[k][0]]])
        tell()
        fresh = np.flatnonzero(state.solved & ~before)


def _beside(state: State, index: int, fans: Mapping[float, FloatArray], trees: Mapping[float, cKDTree]) -> list[Way]:
    """What serves a solved start, and ways a little beside it."""
    path = state.paths[index]
    direction = unit(path.nodes[-2] - state.goal)
    if len(path.nodes) > 3:
        return [Way(direction, 0.0, path.roll, tuple(path.nodes[1:]))]
    if len(path.nodes) == 3:
        before = unit(path.nodes[1] - path.nodes[0])
        turns = [float(np.arccos(np.clip(-before @ direction, -1.0, 1.0)))]
        made = [Way(direction, turns[0], path.roll)]
    else:
        # Onto a straight path any turn may lead.
        turns, made = list(TURNS), []
    if path.roll in trees:
        _, beside = trees[path.roll].query(direction, k=min(FAN_BESIDE, len(fans[path.roll])))
        for share_of in FINER if len(path.nodes) == 3 else (1.0,):
            for turn in turns:
                made += [Way(fans[path.roll][k], share_of * turn, path.roll) for k in np.atleast_1d(beside)]
    return [way for way in made if way.tail or 0.02 < way.turn < 1.5]


def _rank(rows: Sequence[int]) -> IntArray:
    """How often each entry has stood before in a sequence."""
    seen: dict[int, int] = {}
    made = []
    for row in rows:
        made.append(seen.get(row, 0))
        seen[row] = made[-1] + 1
    return np.array(made, dtype=np.int64)


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
