"""Whether some curve within a curvature limit passes a chain of cross-sections: a proof that none does."""

# Strategy: by facts 2 and 3 of `bend` the directions of two chords in a row differ by at most the sum of asin(k c / 2) over both
# chords c, and by less where the path between two sections stays in a small ball. Points p1 ... pn, one of each section, are on
# no path unless this holds at every one but the first and the last. Pairs of squares, one of each of two neighbouring sections,
# are kept while some pair before and some pair after allow such a turn between points of theirs, at best;
# squares are split until no pair is left, which is the proof, or the centres themselves can be passed, and there is none.
# What a pair allows depends on its chord alone, but for the angle between both, so that cos(angle) >= cos(f + g) for all pairs of
# pairs about one square is the sign of a product of two matrices.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from segmentation.arrays import BoolArray, FloatArray
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.tube.chain import ROUNDING, Chain, Station, quartered

# Pairs of pairs looked at in one round at most: a second or two.
WORK_MAX = 2e9
# Squares of this share of a bend radius are split no more.
FINEST = 2e-3


def impassable(wall: WallDistance, chain: Chain, *, curvature: float, clearance: float) -> bool:
    """Whether no curve within the limit passes all sections of a chain at points of the clearance asked for. Proved if so."""
    stations = list(chain.stations)
    if not all(len(station.place) for station in stations):
        return True
    pairs = [np.ones((len(a.place), len(b.place)), dtype=bool) for a, b in pairwise(stations)]
    turns = [float(np.arcsin(curvature * radius)) for radius in chain.radii]
    while True:
        chords = [Chords(a, b, turn) for a, b, turn in zip(stations, stations[1:], turns, strict=False)]
        if work(pairs) > WORK_MAX or passable(stations, pairs, chords, curvature):
            return False
        pairs = linked(chords, pairs, curvature, sharp=False)
        stations, pairs = without_lone(stations, pairs)
        if not all(pair.any() for pair in pairs):
            return True
        chosen = bluntest(stations)
        if stations[chosen].width < FINEST / curvature:
            return False
        stations[chosen], parent = quartered(wall, stations[chosen], clearance)
        if chosen > 0:
            pairs[chosen - 1] = pairs[chosen - 1][:, parent]
        if chosen < len(pairs):
            pairs[chosen] = pairs[chosen][parent]


def passable(stations: Sequence[Station], pairs: Sequence[BoolArray], chords: Sequence[Chords], curvature: float) -> bool:
    """Whether the centres of some squares can be passed in order: no proof is to be had."""
    clear = [pair & a.clear[:, None] & b.clear for pair, a, b in zip(pairs, stations, stations[1:], strict=False)]
    return all(pair.any() for pair in clear) and all(pair.any() for pair in linked(chords, clear, curvature, sharp=True))


def work(pairs: Sequence[BoolArray]) -> float:
    """Pairs of pairs about a common square, over all squares."""
    return float(sum((one.sum(axis=0) * two.sum(axis=1)).sum() for one, two in pairwise(pairs)))


def bluntest(stations: Sequence[Station]) -> int:
    """The section whose squares blur the directions to its neighbours most."""
    blur = np.zeros(len(stations))
    for k, (a, b) in enumerate(pairwise(stations)):
        apart = max(float(np.linalg.norm(b.origin - a.origin)), 1e-9)
        blur[k] += a.width / apart
        blur[k + 1] += b.width / apart
    return int(np.argmax(blur))


def without_lone(stations: Sequence[Station], pairs: Sequence[BoolArray]) -> tuple[list[Station], list[BoolArray]]:
    """Both without the squares that no pair holds."""
    kept = [pairs[0].any(axis=1), *(pair.any(axis=0) for pair in pairs)]
    left = [replace(s, place=s.place[k], clear=s.clear[k]) for s, k in zip(stations, kept, strict=True)]
    return left, [pair[a][:, b] for pair, a, b in zip(pairs, kept, kept[1:], strict=False)]


def linked(chords: Sequence[Chords], pairs: Sequence[BoolArray], curvature: float, *, sharp: bool) -> list[BoolArray]:
    """The pairs that some pair before and some pair after them can be passed with; of the centres alone when sharp."""
    links = [each.link(curvature, sharp=sharp) for each in chords]
    found = [pair.copy() for pair in pairs]
    for k in range(len(found) - 1, 0, -1):
        found[k - 1] = after(links[k - 1], links[k], found[k - 1], found[k])[0]
    for k in range(1, len(found)):
        found[k] = after(links[k - 1], links[k], found[k - 1], found[k])[1]
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class Link:
    """What chords between two sections allow at either end.

    Attributes
    ----------
    one, two : (n, m, 5) float array
        Of the chord from square i to square j as the first and as the second of two: rows whose product with those
        of a chord that meets it is not negative where the turn between both is allowed.
    """

    one: FloatArray
    two: FloatArray


class Chords:
    """Chords between the centres of the squares of two sections, between which a path turns by at most 2 `turn` rad."""

    def __init__(self, a: Station, b: Station, turn: float) -> None:
        chord = b.center[None] - a.center[:, None]
        self._reach, self._turn = a.reach + b.reach, turn
        self._length = np.linalg.norm(chord, axis=2)
        self._unit = chord / np.maximum(self._length, 1e-30)[:, :, None]

    def link(self, curvature: float, *, sharp: bool) -> Link:
        """The turns that they allow at best; that the chords of the centres themselves allow when sharp."""
        length, reach = self._length, 0.0 if sharp else self._reach
        # A direction between two discs differs from that between their centres by at most the angle of the tangent cone.
        spread = np.arcsin(np.minimum(reach / np.maximum(length, 1e-30), 1.0))
        allowed = np.minimum(np.arcsin(np.minimum(0.5 * curvature * (length + reach), 1.0)), self._turn) + spread
        wide = (allowed >= 0.5 * np.pi) | (length <= reach)
        unit = np.where(wide[:, :, None], 0.0, self._unit)
        cos, sin = np.where(wide, -1.0, np.cos(allowed)), np.where(wide, 1.0, np.sin(allowed))
        return Link(
            one=np.concatenate([unit, -cos[:, :, None], sin[:, :, None]], axis=2),
            two=np.concatenate([unit, cos[:, :, None], sin[:, :, None]], axis=2),
        )


def after(first: Link, second: Link, one: BoolArray, two: BoolArray) -> tuple[BoolArray, BoolArray]:
    """The pairs of two neighbouring links that some pair of the other can be passed with at their common square."""
    left, right = np.zeros_like(one), np.zeros_like(two)
    for k in range(two.shape[0]):
        rows, columns = np.flatnonzero(one[:, k]), np.flatnonzero(two[k])
        if not (len(rows) and len(columns)):
            continue
        fits = first.one[rows, k] @ second.two[k, columns].T >= -ROUNDING
        left[rows, k] = fits.any(axis=1)
        right[k, columns] = fits.any(axis=0)
    return left, right
