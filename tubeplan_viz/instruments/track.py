"""A path laid out by arc length, with the clearances known along it: what a rigid tip is moved on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from segmentation.arrays import FloatArray, frozen_array
from tubeplan_viz.geometry import SplineCurve, WallDistance

# Hermite pieces of this length with exact ends and tangents miss the curve by h^4 / 384 times its fourth derivative:
# under a hundredth of a micrometre where it bends by 5 mm. Mm.
STEP = 0.1
# Clearances are known this far apart; in between they are 1-Lipschitz. Mm.
CLEARANCE_STEP = 0.5
# Chords this many tip lengths behind are looked at first; a path that curls up more is searched as a whole.
WINDOW = 1.5
NEWTON_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Track:
    """One path between its ends.

    Attributes
    ----------
    length : float, mm
    places : (m,) float array, mm
        Evenly spaced arc lengths, `STEP` apart or less.
    points : (m, 3) float array, mm
    known : (k,) float array, mm
        Arc lengths at which the clearance is known.
    clearance : (k,) float array, mm
        Signed.
    """

    length: float
    places: FloatArray
    points: FloatArray
    known: FloatArray
    clearance: FloatArray
    path: CubicHermiteSpline = field(repr=False)

    @classmethod
    def of(cls, curve: SplineCurve, wall: WallDistance) -> Track:
        """Lay out a curve and ask for its clearance along the way."""
        u = curve.uniform_parameters(STEP)
        places = np.linspace(0.0, curve.length, len(u))
        points = curve(u)
        every = max(int(CLEARANCE_STEP / max(places[1], 1e-9)), 1)
        rows = np.union1d(np.arange(0, len(u), every), [len(u) - 1])
        return cls(
            length=curve.length,
            places=frozen_array(places, (None,), "places"),
            points=frozen_array(points, (len(u), 3), "points"),
            known=frozen_array(places[rows], (None,), "known"),
            clearance=frozen_array(wall.clearance(points[rows]), (len(rows),), "clearance"),
            path=CubicHermiteSpline(places, points, curve.tangent(u)),
        )

    def at(self, arc_length: FloatArray, derivative: int = 0) -> FloatArray:
        """Points, mm, or derivatives with respect to arc length, (k, 3)."""
        return np.asarray(self.path(arc_length, derivative))

    def at_least(self, arc_length: FloatArray) -> FloatArray:
        """What the clearance at places of the path cannot fall below, (k,) mm."""
        after = np.clip(np.searchsorted(self.known, arc_length), 1, len(self.known) - 1)
        nearest = after - (arc_length - self.known[after - 1] < self.known[after] - arc_length)
        return np.asarray(self.clearance[nearest] - np.abs(arc_length - self.known[nearest]))

    def behind(self, front: FloatArray, length: float) -> FloatArray:
        """Arc length of a tip's back for each rising arc length of its front: the nearest place behind at the tip's length.

        Never falls while the front advances; 0 where the tip is not yet wholly on the path.
        """
        here = self.at(front)
        # A chord is never longer than its arc: the back lies at least the tip's length behind.
        near = np.maximum(front - length, 0.0)
        back = np.zeros_like(front)
        on_path = np.flatnonzero(front > length)
        if len(on_path):
            window = int(np.ceil(WINDOW * length / self.places[1])) + 2
            found, sure = self._crossing(here[on_path], near[on_path], length, window)
            if not sure.all():
                found[~sure] = self._crossing(here[on_path[~sure]], near[on_path[~sure]], length, len(self.places))[0]
            back[on_path] = found
        for _ in range(NEWTON_ROUNDS):
            inner = back > 0.0
            if not inner.any():
                break
            offset = here[inner] - self.at(back[inner])
            gap = np.linalg.norm(offset, axis=1)
            slope = np.einsum("ij,ij->i", offset, self.at(back[inner], 1)) / gap
            move = np.where(slope > 0.2, (gap - length) / np.maximum(slope, 0.2), 0.0)
            back[inner] = np.clip(back[inner] + np.clip(move, -STEP, STEP), 0.0, near[inner])
        return np.maximum.accumulate(back)

    def _crossing(self, here: FloatArray, near: FloatArray, length: float, window: int) -> tuple[FloatArray, np.ndarray]:
        """Where the gap to `here`, looked at backwards from `near`, first reaches the length; and whether the window told."""
        stop = np.searchsorted(self.places, near, side="right") - 1  # (k,)
        rows = stop[:, None] - np.arange(min(window, int(stop.max()) + 1))
        looked = rows >= 0
        rows = np.maximum(rows, 0)
        gap = np.linalg.norm(self.points[rows] - here[:, None], axis=2)  # (k, window)
        beyond = looked & (gap >= length)
        first = np.argmax(beyond, axis=1)
        met = beyond[np.arange(len(here)), first]
        row = rows[np.arange(len(here)), first]
        ahead = np.linalg.norm(self.points[np.minimum(row + 1, len(self.points) - 1)] - here, axis=1)
        there = gap[np.arange(len(here)), first]
        share = np.where(first > 0, (there - length) / np.maximum(there - ahead, 1e-12), 0.0)
        place = np.minimum(self.places[row] + share * self.places[1], near)
        # Without a crossing the tip is not wholly on the path; that is certain when the whole way back was looked at.
        return np.where(met, place, 0.0), met | (rows[:, -1] == 0)
