"""Ways onto free directions at the goal, as a table: there are many times as many as starts, and each is seen from many.

A way is a direction in which the instrument is free at the goal and the angle of the turn onto it; seen from a start it is
one node. What bends more than once stands in the table as the nodes that it shares.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from segmentation.arrays import FloatArray, IntArray

LEAST_LEG_MM = 5.0  # between a node and the goal
KEY = np.array([1000.0, 1000.0, 1000.0, 1.0, 1.0, 1.0, 1.0, 1.0])  # of direction, turn and roll in degrees, first node in mm


class Ways:
    """Ways to one goal; rows are added and never change.

    Attributes
    ----------
    goal : (3,) float array, LPS mm
    """

    def __init__(self, goal: FloatArray) -> None:
        self.goal = goal
        # Columns: direction from the goal outwards, turn, roll, first node of a tail, what follows it; no number without a tail.
        self._rows = np.empty((0, 11))
        self._added: list[FloatArray] = []
        self._count = 0
        self._tails: dict[int, tuple[FloatArray, ...]] = {}
        self._keys = np.empty(0, dtype=np.int64)
        self._known: dict[bytes, int] = {}

    def __len__(self) -> int:
        return self._count

    def add(self, direction: FloatArray, turn: FloatArray, roll: float) -> IntArray:
        """Rows of new ways: (k, 3) unit vectors from the goal outwards, (k,) turns in radian, one roll in radian."""
        rows = np.full((len(turn), 11), np.nan)
        rows[:, :3], rows[:, 3], rows[:, 4] = direction, turn, roll
        return self._append(rows)

    def add_tail(self, direction: FloatArray, roll: float, tail: Sequence[FloatArray]) -> IntArray:
        """Row of a way with more bends, (1,): its nodes and the goal, (3,) LPS mm each."""
        row = np.concatenate([direction, [0.0, roll], tail[0], tail[1]])
        self._tails[self._count] = tuple(tail)
        return self._append(row[None])

    def _append(self, rows: FloatArray) -> IntArray:
        self._added.append(rows)
        self._count += len(rows)
        return np.arange(self._count - len(rows), self._count)

    def _table(self) -> FloatArray:
        """All rows; what was added since is put to them, and numbered by its key."""
        if self._added:
            fresh = np.vstack(self._added)
            told = np.nan_to_num(np.column_stack([fresh[:, :3], np.degrees(fresh[:, 3:5]), fresh[:, 5:8]]), nan=1e6)
            text = np.round(told * KEY).astype(np.int64)
            keys = [self._known.setdefault(row.tobytes(), len(self._known)) for row in text]
            self._rows, self._keys = np.vstack([self._rows, fresh]), np.concatenate([self._keys, keys])
            self._added = []
        return self._rows

    def keys(self, which: IntArray) -> IntArray:
        """Numbers that are the same for ways that hardly differ, (n,)."""
        self._table()
        return self._keys[which]

    def rolls(self, which: IntArray) -> FloatArray:
        """The instrument's roll on each way, (n,) radian."""
        return self._table()[which, 4]

    def seen_from(self, which: IntArray, starts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """First node of each way and what comes after it, for the start of the same row, (n, 3) LPS mm each.

        Not a number where the turn would lie nearer than `LEAST_LEG_MM` to the goal, or behind the start.
        """
        rows = self._table()[which]
        direction, turn = rows[:, :3], rows[:, 3]
        offset = starts - self.goal
        along = np.einsum("ij,ij->i", offset, direction)
        aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
        bent = ~np.isnan(rows[:, 5])
        depth = along - aside / np.tan(np.where(bent, 1.0, turn))
        depth[(depth < LEAST_LEG_MM) | (depth >= along - 1e-6)] = np.nan
        first = np.where(bent[:, None], rows[:, 5:8], self.goal + depth[:, None] * direction)
        return first, np.where(bent[:, None], rows[:, 8:], self.goal)

    def after(self, way: int) -> tuple[FloatArray, ...]:
        """What follows a way's first node: further nodes and the goal."""
        return self._tails[way][1:] if way in self._tails else (self.goal,)
