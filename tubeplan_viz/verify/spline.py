"""The spline of result.json, evaluated afresh as Bezier pieces.

# Strategy: every knot span is turned into a Bezier piece by blossoming (Ramshaw 1987): the k-th
# control point of the piece over [a, b] is the polar form at p-k times a and k times b. Points and
# derivatives follow by de Casteljau's rule. Nothing is shared with the planners' evaluation, which
# sums B-spline basis functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from segmentation.arrays import FloatArray, IntArray

# |F'| of a cubic piece is the root of a quartic: eight nodes on a stretch of at most 0.05 mm are exact to rounding.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
PROJECTION_ROUNDS = 12
POLISH_ROUNDS = 60  # thirds: (2/3)^60 of a 0.05 mm stretch is below rounding


@dataclass(frozen=True, eq=False)
class BezierPath:
    """A B-spline as Bezier pieces.

    Attributes
    ----------
    breaks : (m + 1,) float array
        Distinct knots.
    pieces : (m, p + 1, 3) float array, mm
        Control points of each piece.
    """

    breaks: FloatArray
    pieces: FloatArray

    @classmethod
    def from_spline(cls, degree: int, knots: FloatArray, control_points: FloatArray) -> BezierPath:
        """Extract the pieces of a clamped B-spline; `knots` (n + p + 1,), `control_points` (n, 3) in mm."""
        breaks = np.unique(knots)
        pieces = np.empty((len(breaks) - 1, degree + 1, 3))
        for m, (start, end) in enumerate(pairwise(breaks)):
            span = int(np.searchsorted(knots, start, side="right")) - 1
            for k in range(degree + 1):
                pieces[m, k] = _blossom(degree, knots, control_points, span, [start] * (degree - k) + [end] * k)
        return cls(breaks, pieces)

    @property
    def degree(self) -> int:
        """Polynomial degree of the pieces."""
        return int(self.pieces.shape[1]) - 1

    def evaluate(self, piece: IntArray, t: FloatArray, derivative: int = 0) -> FloatArray:
        """Points, mm, or derivatives with respect to u, at local parameters t in [0, 1] of the given pieces: (k, 3)."""
        if derivative > self.degree:
            return np.zeros((len(t), 3))
        points = self._derivatives[derivative][piece]  # (k, p + 1 - derivative, 3)
        weight = np.asarray(t, dtype=float)[:, None, None]
        while points.shape[1] > 1:
            points = points[:, :-1] + weight * (points[:, 1:] - points[:, :-1])
        return np.asarray(points[:, 0])

    @cached_property
    def _derivatives(self) -> tuple[FloatArray, ...]:
        width = np.diff(self.breaks)[:, None, None]
        found = [self.pieces]
        for order in range(self.degree):
            found.append((self.degree - order) * np.diff(found[-1], axis=1) / width)
        return tuple(found)

    def speed(self, piece: IntArray, t: FloatArray) -> FloatArray:
        """|F'(u)| in mm."""
        return np.asarray(np.linalg.norm(self.evaluate(piece, t, 1), axis=1))

    def curvature(self, piece: IntArray, t: FloatArray) -> FloatArray:
        """Curvature in 1/mm: the part of F'' across the tangent, over the speed squared; infinite where the speed is 0."""
        first, second = self.evaluate(piece, t, 1), self.evaluate(piece, t, 2)
        square = np.einsum("ij,ij->i", first, first)
        still = square <= 0.0
        safe = np.where(still, 1.0, square)
        across = second - (np.einsum("ij,ij->i", first, second) / safe)[:, None] * first
        return np.where(still, np.inf, np.linalg.norm(across, axis=1) / safe)

    def torsion(self, piece: IntArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Torsion in 1/mm, and by how much rounding may change it: both (k,)."""
        first, second, third = (self.evaluate(piece, t, order) for order in (1, 2, 3))
        cross = np.cross(first, second)
        square = np.maximum(np.einsum("ij,ij->i", cross, cross), 1e-300)
        size = [np.linalg.norm(vector, axis=1) for vector in (first, second, third)]
        rounding = np.finfo(float).eps * size[0] * size[1] * size[2] / square
        return np.einsum("ij,ij->i", cross, third) / square, rounding

    def lengths(self, piece: IntArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
        """Arc length, mm, of each piece between two local parameters."""
        half = 0.5 * (upper - lower)
        t = (0.5 * (upper + lower))[:, None] + half[:, None] * NODES
        speed = self.speed(np.repeat(piece, len(NODES)), t.ravel()).reshape(t.shape)
        return np.asarray(half * np.diff(self.breaks)[piece] * (speed @ WEIGHTS))

    def sample(self, spacing: float) -> Samples:
        """Parameters at most `spacing` mm apart on every piece, both ends of each piece included."""
        reach = np.linalg.norm(np.diff(self.pieces, axis=1), axis=2).sum(
            axis=1
        )  # control polygons are no shorter than their pieces
        fastest = np.linalg.norm(self._derivatives[1], axis=2).max(axis=1) * np.diff(self.breaks)  # |dF/dt| stays below its hull
        counts = np.maximum(np.ceil(np.maximum(reach, fastest) / spacing).astype(int), 2)
        piece = np.repeat(np.arange(len(counts)), counts + 1)
        t = np.concatenate([np.linspace(0.0, 1.0, count + 1) for count in counts])
        return Samples.at(self, piece, t)


@dataclass(frozen=True, eq=False)
class Samples:
    """Places on a path in order; neighbours on different pieces coincide.

    Attributes
    ----------
    piece : (n,) int array
    t : (n,) float array
        Local parameter.
    s : (n,) float array, mm
        Arc length from the start.
    points : (n, 3) float array, mm
    """

    path: BezierPath
    piece: IntArray
    t: FloatArray
    s: FloatArray
    points: FloatArray

    @classmethod
    def at(cls, path: BezierPath, piece: IntArray, t: FloatArray) -> Samples:
        """Measure arc length along the given places, which begin at the start and are in order."""
        same = piece[1:] == piece[:-1]
        steps = np.where(same, path.lengths(piece[1:], np.where(same, t[:-1], t[1:]), t[1:]), 0.0)
        return cls(path, piece, t, np.concatenate([[0.0], np.cumsum(steps)]), path.evaluate(piece, t))

    def at_length(self, s: FloatArray) -> tuple[IntArray, FloatArray]:
        """Piece and local parameter at given arc lengths, mm: Newton's rule on the exact speed, from the table."""
        s = np.clip(s, 0.0, self.s[-1])
        after = np.clip(np.searchsorted(self.s, s, side="right"), 1, len(self.s) - 1)
        before = after - 1
        split = self.piece[before] != self.piece[after]  # at the seam of two pieces the samples coincide
        before = np.where(split, np.maximum(before - 1, 0), before)
        after = np.where(split, before + 1, after)
        piece, low, high = self.piece[before], self.t[before], self.t[after]
        width = np.diff(self.path.breaks)[piece]
        span = np.maximum(self.s[after] - self.s[before], 1e-300)
        t = low + (high - low) * np.clip((s - self.s[before]) / span, 0.0, 1.0)
        for _ in range(PROJECTION_ROUNDS):
            gap = self.s[before] + self.path.lengths(piece, low, t) - s
            t = np.clip(t - gap / np.maximum(self.path.speed(piece, t) * width, 1e-12), low, high)
        return piece, t

    def peak_curvature(self) -> tuple[float, float]:
        """Largest curvature, 1/mm, and its arc length, mm: around the best samples, polished by thirds."""
        values = self.path.curvature(self.piece, self.t)
        best = int(np.argmax(values))
        if not np.isfinite(values[best]):
            return float(values[best]), float(self.s[best])
        chosen = np.flatnonzero(values >= 0.9 * values[best])
        left, right = np.maximum(chosen - 1, 0), np.minimum(chosen + 1, len(values) - 1)
        piece = self.piece[chosen]
        low = np.where(self.piece[left] == piece, self.t[left], self.t[chosen])
        high = np.where(self.piece[right] == piece, self.t[right], self.t[chosen])
        for _ in range(POLISH_ROUNDS):
            a, b = low + (high - low) / 3.0, high - (high - low) / 3.0
            rising = self.path.curvature(piece, a) < self.path.curvature(piece, b)
            low, high = np.where(rising, a, low), np.where(rising, high, b)
        t = 0.5 * (low + high)
        polished = self.path.curvature(piece, t)
        top = int(np.argmax(polished))
        if polished[top] <= values[best]:
            return float(values[best]), float(self.s[best])
        base = self.s[left[top]] if self.piece[left[top]] == piece[top] else self.s[chosen[top]]
        start = self.t[left[top]] if self.piece[left[top]] == piece[top] else self.t[chosen[top]]
        place = base + self.path.lengths(piece[top : top + 1], np.array([start]), t[top : top + 1])[0]
        return float(polished[top]), float(place)


def _blossom(degree: int, knots: FloatArray, control: FloatArray, span: int, arguments: list[float]) -> FloatArray:
    """Polar form of the spline's polynomial on one span, by de Boor's rule with another argument in each round."""
    points = [control[span - degree + j] for j in range(degree + 1)]
    for level, u in enumerate(arguments, start=1):
        for j in range(degree, level - 1, -1):
            low, high = knots[span - degree + j], knots[span + 1 + j - level]
            share = (u - low) / (high - low)
            points[j] = (1.0 - share) * points[j - 1] + share * points[j]
    return np.asarray(points[degree])
