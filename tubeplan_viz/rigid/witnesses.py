"""Places where instruments were stopped before: an instrument that holds one of them needs no further collision evaluation."""

from __future__ import annotations

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.rigid.instrument import Bodies

FIRST = 24  # witnesses that stopped most, asked before the others
KEPT = 160
CELL_MM = 0.5  # witnesses nearer to each other than this are one
BLOCK = 2_000_000  # pairs of body and witness compared at a time


class Witnesses:
    """Places inside obstacles, those that stopped most instruments first.

    A neighbouring try is mostly stopped by the same place. Whether it lies inside a body is a matter of a few
    multiplications, where a collision evaluation asks a tree all along the body; and it is never wrong, since the place is
    of an obstacle. (The same thought as the witnesses, or cached features, of collision detection.)
    """

    def __init__(self) -> None:
        self._label = np.empty(0, dtype=np.int64)
        self._place = np.empty((0, 3))
        self._count = np.empty(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._label)

    def add(self, label: IntArray, place: FloatArray) -> None:
        """Remember what stopped some instruments: structures (n,), -1 for none, and places (n, 3), LPS mm."""
        hit = label >= 0
        if not hit.any():
            return
        labels = np.concatenate([self._label, label[hit]])
        places = np.vstack([self._place, place[hit]])
        counts = np.concatenate([self._count, np.ones(int(hit.sum()), dtype=np.int64)])
        cube = np.column_stack([np.floor(places / CELL_MM).astype(np.int64), labels])
        _, first, which = np.unique(cube, axis=0, return_index=True, return_inverse=True)
        total = np.bincount(which.reshape(-1), weights=counts).astype(np.int64)
        order = np.argsort(-total, kind="stable")[:KEPT]
        self._label, self._place, self._count = labels[first[order]], places[first[order]], total[order]

    def stopping(self, bodies: Bodies) -> tuple[IntArray, FloatArray]:
        """Structure, -1 for none, and place of a witness inside each of n instruments (2 n bodies, LPS mm): (n,), (n, 3)."""
        n = len(bodies) // 2
        found, place = np.full(n, -1, dtype=np.int64), np.full((n, 3), np.nan)
        for low, high in ((0, FIRST), (FIRST, len(self))):
            for part in np.array_split(np.arange(n), max(1, n * 2 * max(0, high - low) // BLOCK)):
                live = part[found[part] < 0]
                if low >= len(self) or not len(live):
                    continue
                rows = np.column_stack([2 * live, 2 * live + 1]).reshape(-1)
                both = held(bodies.take(rows), self._place[low:high])
                inside = both[0::2] | both[1::2]
                hit = inside.any(axis=1)
                which = low + np.argmax(inside[hit], axis=1)
                found[live[hit]], place[live[hit]] = self._label[which], self._place[which]
        return found, place


def held(bodies: Bodies, points: FloatArray) -> BoolArray:
    """Which points (m, 3) lie inside which cylinders, their round fronts left out: (n, m)."""
    axis = bodies.axis
    along = axis @ points.T - np.einsum("ij,ij->i", axis, bodies.tail)[:, None]
    apart = (points**2).sum(axis=1)[None] - 2.0 * bodies.tail @ points.T + (bodies.tail**2).sum(axis=1)[:, None]
    within = (along >= 0.0) & (along <= bodies.length[:, None])
    return np.asarray(within & (apart - along**2 <= bodies.radius[:, None] ** 2 - 1e-6))
