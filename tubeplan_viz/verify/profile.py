"""A path measured afresh between the samples of its file: extremes, and where limits are broken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.verify.spline import BezierPath, Samples
from tubeplan_viz.verify.wall import Lumen

SPACING_MM = 0.04  # 25 samples per mm
CLEARANCE_PROOF_MM = 2e-4  # the least clearance is searched until it is known this well,
CLEARANCE_AIM_MM = 1e-6  # and this well where that needs no more than
AIM_PLACES = 2000  # more places in a round
REFINEMENT_ROUNDS = 16
CROSSING_ROUNDS = 16  # 0.04 mm halved 16 times: ends of broken stretches to 1e-6 mm
ON_SURFACE_MM = 1e-6  # on an end cap: not told apart from it by rounding


@dataclass(frozen=True, eq=False)
class OwnProfile:
    """The verifier's own measurement of a path.

    Attributes
    ----------
    samples : Samples
        At most 0.04 mm apart, finer near the least clearance.
    curvature : (n,) float array, 1/mm
    clearance : (n,) float array, mm
        Signed, end caps left out.
    inside : (n,) bool array
    curvature_peak, curvature_peak_at : float, 1/mm and mm
    clearance_bound : float, mm
        No point of the path, between the samples neither, has less clearance.
    """

    lumen: Lumen
    samples: Samples
    curvature: FloatArray
    clearance: FloatArray
    inside: BoolArray
    curvature_peak: float
    curvature_peak_at: float
    clearance_bound: float

    @property
    def clearance_least(self) -> float:
        """Least clearance found, mm."""
        return float(self.clearance.min())

    @property
    def clearance_least_at(self) -> float:
        """Its arc length, mm."""
        return float(self.samples.s[int(self.clearance.argmin())])

    @property
    def length(self) -> float:
        """Arc length of the path, mm."""
        return float(self.samples.s[-1])

    @cached_property
    def _weights(self) -> FloatArray:
        step = np.diff(self.samples.s)
        return np.asarray(0.5 * (np.concatenate([[0.0], step]) + np.concatenate([step, [0.0]])) / self.length)

    @property
    def curvature_mean(self) -> float:
        """Mean over arc length, 1/mm."""
        return float(self._weights @ self.curvature)

    @property
    def clearance_mean(self) -> float:
        """Mean over arc length, mm."""
        return float(self._weights @ self.clearance)

    def broken_curvature(self, limit: float) -> list[tuple[float, float]]:
        """Stretches, mm of arc length, whose curvature exceeds `limit` (1/mm)."""
        found = self._stretches(self.curvature - limit, lambda piece, t: self.samples.path.curvature(piece, t) - limit)
        if not found and self.curvature_peak > limit:  # a peak between two samples
            found = [(self.curvature_peak_at, self.curvature_peak_at)]
        return found

    def broken_clearance(self, limit: float) -> list[tuple[float, float]]:
        """Stretches, mm of arc length, whose clearance is below `limit` (mm)."""

        def excess(piece: IntArray, t: FloatArray) -> FloatArray:
            points = self.samples.path.evaluate(piece, t)
            if limit > 2.0 * SPACING_MM:  # a sample beside one that keeps the limit is still inside
                return np.asarray(limit - self.lumen.wall.distance(points))
            return limit - self.lumen.clearance(points, on_surface=ON_SURFACE_MM)[0]

        return self._stretches(limit - self.clearance, excess)

    def _stretches(self, excess: FloatArray, measure: Callable[[IntArray, FloatArray], FloatArray]) -> list[tuple[float, float]]:
        bad = excess > 0.0
        edges = np.flatnonzero(bad[1:] != bad[:-1])
        samples = self.samples
        places = np.empty(len(edges))
        if len(edges):
            seam = samples.piece[edges] != samples.piece[edges + 1]  # a jump at a knot: the crossing is the knot itself
            piece = samples.piece[edges]
            start = samples.t[edges]
            low, high = start.copy(), np.where(seam, start, samples.t[edges + 1])
            for _ in range(CROSSING_ROUNDS):
                middle = 0.5 * (low + high)
                keep = (measure(piece, middle) > 0.0) == bad[edges]
                low, high = np.where(keep, middle, low), np.where(keep, high, middle)
            places = samples.s[edges] + samples.path.lengths(piece, start, 0.5 * (low + high))
        borders = places.tolist()
        if bad[0]:
            borders.insert(0, 0.0)
        if bad[-1]:
            borders.append(self.length)
        return list(zip(borders[::2], borders[1::2], strict=True))


def measure(path: BezierPath, lumen: Lumen) -> OwnProfile:
    """Measure curvature and clearance along the whole path.

    # Strategy: samples every 0.04 mm. Between two of them, Delta apart, the clearance d is bounded from
    # below twice: d changes by no more than the distance walked, and its second derivative along the path
    # is at most 1/d + curvature (the distance to a convex set has no sharper bend than that to a point, and a
    # minimum of such functions keeps the bound), so that it dips below its chord by at most
    # (1/d + curvature) Delta^2 / 8. Stretches whose bound is under the least value found are halved until
    # the two agree to 2e-4 mm. A path that leaves the lumen is not searched further: it is broken as it is.
    """
    samples = path.sample(SPACING_MM)
    clearance, inside = lumen.clearance(samples.points, on_surface=ON_SURFACE_MM)
    peak, peak_at = samples.peak_curvature()
    bound = 0.0
    for _ in range(REFINEMENT_ROUNDS):
        lower = _lower_bounds(samples.s, clearance, peak)
        bound = float(min(lower.min(), clearance.min()))
        if clearance.min() <= 0.0:
            break
        short = np.where(samples.piece[1:] == samples.piece[:-1], clearance.min() - lower, 0.0)
        weak = np.flatnonzero(short > CLEARANCE_AIM_MM)
        if len(weak) > AIM_PLACES:
            weak = np.flatnonzero(short > CLEARANCE_PROOF_MM)
        if len(weak) == 0:
            break
        piece, t = samples.piece[weak], 0.5 * (samples.t[weak] + samples.t[weak + 1])
        more, more_inside = lumen.clearance(path.evaluate(piece, t), on_surface=ON_SURFACE_MM)
        samples = Samples.at(path, np.insert(samples.piece, weak + 1, piece), np.insert(samples.t, weak + 1, t))
        clearance, inside = np.insert(clearance, weak + 1, more), np.insert(inside, weak + 1, more_inside)
    return OwnProfile(lumen, samples, path.curvature(samples.piece, samples.t), clearance, inside, peak, peak_at, bound)


def _lower_bounds(s: FloatArray, clearance: FloatArray, curvature: float) -> FloatArray:
    step = np.diff(s)
    before, after = clearance[:-1], clearance[1:]
    walked = 0.5 * (before + after - step)
    curved = np.minimum(before, after) - (1.0 / np.maximum(walked, 1e-12) + curvature) * step**2 / 8.0
    return np.where(walked > 0.0, np.maximum(walked, curved), walked)
