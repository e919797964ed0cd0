"""Verdicts of collision tests that stand in a later search, where tissue has been taken away and none added.

# Strategy: a search with more shrinkage asks much that the one before has asked. What was free is free among less; what was
# stopped is stopped still where the very place that stopped it is of the obstacle's surface still. An instrument is known
# again by a digest of where its shafts begin and end; those of all verdicts stand in order, so that many are looked up at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.rigid.instrument import Bodies
from tubeplan_viz.rigid.obstacles import Obstacles

KEY_MM = 1e-6  # instruments nearer to each other than this are one; touching is told to 1e-4 mm
SAME_MM = 1e-6  # a cell of the one surface that is a cell of the other
Keys = NDArray[np.uint64]
SEEDS = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F)  # odd, with bits of 1 and 0 well mixed
FACTOR, SHIFT = np.uint64(0xFF51AFD7ED558CCD), np.uint64(32)


@dataclass
class Verdicts:
    """What instruments meet among some obstacles, as searches before found and this one finds.

    Attributes
    ----------
    obstacles : Obstacles
        Among which the verdicts hold.
    keys : (n, 2) uint64 array
        Of the instruments known from before, in rising order of the first column.
    label : (n,) int array
        Structure that each meets, -1 for none.
    place : (n, 3) float array, LPS mm
        Where.
    fresh : list of (keys, label, place)
        Found since; not looked up, since a search hardly asks anything twice.
    """

    obstacles: Obstacles
    keys: Keys = field(default_factory=lambda: np.empty((0, 2), np.uint64))
    label: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    place: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    fresh: list[tuple[Keys, IntArray, FloatArray]] = field(default_factory=list)

    def recall(self, keys: Keys) -> tuple[BoolArray, IntArray]:
        """Which instruments are known, (n,), and the rows of their verdicts, those known only."""
        if not len(self.keys):
            return np.zeros(len(keys), dtype=bool), np.empty(0, np.int64)
        row = np.minimum(np.searchsorted(self.keys[:, 0], keys[:, 0]), len(self.keys) - 1)
        known = (self.keys[row] == keys).all(axis=1)
        return known, row[known]

    def among(self, obstacles: Obstacles) -> Verdicts:
        """All verdicts that stand among other obstacles, each a part of the one of its name here or the same."""
        keys, label, place = (
            np.concatenate(columns) for columns in zip((self.keys, self.label, self.place), *self.fresh, strict=True)
        )
        stands, renamed = label < 0, np.full(len(label), -1, dtype=np.int64)
        for k, name in enumerate(self.obstacles.names):
            hit = np.flatnonzero(label == k)
            if len(hit) and name in obstacles.names:
                renamed[hit] = obstacles.names.index(name)
                stands[hit] = of_surface(obstacles, int(renamed[hit[0]]), place[hit])
        # Where one was asked anew, the later verdict is taken: the first of equal ones in order is found.
        rows = np.flatnonzero(stands)[::-1]
        rows = rows[np.argsort(keys[rows, 0], kind="stable")]
        return Verdicts(obstacles, keys[rows], renamed[rows], place[rows])


def of_surface(obstacles: Obstacles, structure: int, places: FloatArray) -> BoolArray:
    """Which places, (n, 3) LPS mm, are a cell of a structure's surface or lie inside the structure: (n,)."""
    unique, which = np.unique(places, axis=0, return_inverse=True)
    at = obstacles.frame.to_frame(unique)
    away, _ = obstacles.trees[structure].query(at)
    return np.asarray(((away <= SAME_MM) | (obstacles.holds(at) == structure))[which.reshape(-1)])


def keys_of(bodies: Bodies) -> Keys:
    """A digest for each of n instruments (2 n bodies), (n, 2): of the ends of its shafts and their radii."""
    numbers = np.column_stack([bodies.tail, bodies.front, bodies.radius]).reshape(-1, 14)
    whole = np.rint(numbers / KEY_MM).astype(np.int64).view(np.uint64)
    made = np.empty((len(whole), 2), np.uint64)
    for k, seed in enumerate(SEEDS):
        digest = np.full(len(whole), seed, np.uint64)
        for column in whole.T:
            digest = (digest ^ column) * FACTOR  # whole numbers modulo 2^64
            digest ^= digest >> SHIFT
        made[:, k] = digest
    return made
