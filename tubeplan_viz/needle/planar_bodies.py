"""Circles and polygons in the complex plane of the planar search: nearest places of lines and arcs, with outward normals.

# Strategy: the search asks tens of thousands of paths at once, so everything is one array operation per piece of a form. A
# circle is a point with a radius. A polygon is nearest at a corner, at an end of the piece, or where an arc's radius meets an
# edge at a right angle; where they cross, the deepest of some samples and of the middles between crossings stands for the depth:
# without the middles a thin wall slips through between samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.bodies import ROUNDING, Polygon, Sphere, middles
from tubeplan_viz.needle.planar_shapes import PlanarProblem

ComplexArray = NDArray[np.complex128]
DEPTHS = 17  # samples along a piece that crosses a polygon
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Piece:
    """One piece of k paths: places (complex mm) and headings of its ends, length (mm) and signed curvature (1/mm), (k,) each."""

    start: ComplexArray
    heading: ComplexArray
    end: ComplexArray
    length: FloatArray
    curvature: FloatArray

    @property
    def straight(self) -> bool:
        """Whether it is a line; one form has lines or arcs here."""
        return not self.curvature.any()

    @property
    def center(self) -> ComplexArray:
        """Of the circle of an arc, (k,)."""
        return self.start + 1j * self.heading / self.curvature

    def passes(self, spokes: ComplexArray) -> BoolArray:
        """Whether directions from an arc's centre, (k, m), lead to a point of the arc."""
        bend, length = self.curvature[:, None], self.length[:, None]
        q = spokes * (1j * self.heading.conj())[:, None] * bend  # the spoke to the start becomes the real axis
        across = np.where(bend > 0, q.imag, -q.imag)
        turn = length * np.abs(bend)
        before_end = q.real * np.sin(turn) - across * np.cos(turn) >= 0.0
        return np.where(turn <= np.pi, (across >= 0.0) & before_end, (across >= 0.0) | before_end)

    def way_to(self, spokes: ComplexArray) -> FloatArray:
        """How far along the circle of an arc, mm, directions from its centre, (k, m), are met: (k, m)."""
        bend = self.curvature[:, None]
        angle = np.angle(spokes * (1j * self.heading.conj())[:, None] * bend)
        return np.asarray(np.mod(np.where(bend > 0, angle, -angle), 2.0 * np.pi) / np.abs(bend))

    def points(self, way: FloatArray) -> ComplexArray:
        """Places `way` mm along it, (k, j)."""
        if self.straight:
            return self.start[:, None] + way * self.heading[:, None]
        bend = self.curvature[:, None]
        return self.start[:, None] - 1j * self.heading[:, None] / bend * (np.exp(1j * bend * way) - 1.0)


@dataclass(frozen=True, eq=False)
class Nearest:
    """Of each of k pieces to each of m bodies, (k, m) each.

    Attributes
    ----------
    gap : float array, mm
        Signed distance.
    place : complex array, mm
        Where the piece comes nearest.
    normal : complex array
        Unit vector at `place` away from the body.
    at_end : bool array
        Whether `place` is the piece's end.
    """

    gap: FloatArray
    place: ComplexArray
    normal: ComplexArray
    at_end: BoolArray

    def columns(self, at: IntArray) -> Nearest:
        """Some columns of each row, (k, j)."""
        return Nearest(
            np.take_along_axis(self.gap, at, axis=1),
            np.take_along_axis(self.place, at, axis=1),
            np.take_along_axis(self.normal, at, axis=1),
            np.take_along_axis(self.at_end, at, axis=1),
        )


class FlatScene:
    """The bodies of a planar problem, circles first.

    Parameters
    ----------
    problem : PlanarProblem

    Raises
    ------
    CaseError
        If a body is neither a circle nor a polygon of the plane.
    """

    def __init__(self, problem: PlanarProblem) -> None:
        bodies = problem.scene.obstacles
        for k, body in enumerate(bodies):
            if not isinstance(body, Sphere | Polygon) or (isinstance(body, Sphere) and body.center[0] != 0.0):
                raise CaseError(f"obstacle {k + 1} is a {body.kind}; needle2d expects circles and polygons of the plane x = 0")
        origin = complex(problem.entry[1], -problem.entry[0])
        balls = [body for body in bodies if isinstance(body, Sphere)]
        self.centers = np.array([complex(ball.center[2], -ball.center[1]) for ball in balls], dtype=complex) - origin
        areas = [body for body in bodies if isinstance(body, Polygon)]
        self.polygons = [area.corners[:, 1] - 1j * area.corners[:, 0] - origin for area in areas]
        self.radii = np.array([float(ball.radius) for ball in balls] + [0.0] * len(areas))

    def __len__(self) -> int:
        return len(self.radii)

    def nearest(self, piece: Piece) -> Nearest:
        """Where a piece of each of k paths comes nearest to each body."""
        found = to_points(piece, self.centers)
        parts = [Nearest(found.gap - self.radii[: len(self.centers)], found.place, found.normal, found.at_end)]
        if not self.polygons:
            return parts[0]
        parts.extend(to_polygon(piece, corners) for corners in self.polygons)
        return side_by_side(parts)


def side_by_side(parts: list[Nearest]) -> Nearest:
    """Columns of several as one."""
    return Nearest(
        np.concatenate([part.gap for part in parts], axis=1),
        np.concatenate([part.place for part in parts], axis=1),
        np.concatenate([part.normal for part in parts], axis=1),
        np.concatenate([part.at_end for part in parts], axis=1),
    )


def to_points(piece: Piece, points: ComplexArray) -> Nearest:
    """Where a piece comes nearest to each of m points."""
    start, end = piece.start[:, None], piece.end[:, None]
    if piece.straight:
        heading = piece.heading[:, None]
        away = (points - start) * heading.conj()
        along = np.clip(away.real, 0.0, np.maximum(piece.length, 0.0)[:, None])
        place = start + along * heading
        off = place - points
        gap = np.abs(off)
        return Nearest(gap, place, off / np.maximum(gap, TINY), away.real >= piece.length[:, None])
    center, radius = piece.center[:, None], 1.0 / np.abs(piece.curvature[:, None])
    spokes = points - center
    beside = piece.passes(spokes)
    at_end = ~beside & (np.abs(end - points) < np.abs(start - points))
    place = np.where(beside, center + spokes * (radius / np.maximum(np.abs(spokes), TINY)), np.where(at_end, end, start))
    off = place - points
    gap = np.abs(off)
    return Nearest(gap, place, off / np.maximum(gap, TINY), at_end)


def to_polygon(piece: Piece, corners: ComplexArray) -> Nearest:
    """Where a piece comes nearest to a polygon, (k, 1)."""
    edge = np.roll(corners, -1) - corners
    size = np.abs(edge)
    along = edge / size
    parts = [to_points(piece, corners)]
    for tip, is_end in ((piece.start, False), (piece.end, True)):
        q = (tip[:, None] - corners) * along.conj()
        gap = np.where((q.real >= 0.0) & (q.real <= size), np.abs(q.imag), np.inf)
        parts.append(
            Nearest(gap, np.broadcast_to(tip[:, None], gap.shape), 1j * along * np.sign(q.imag), np.full(gap.shape, is_end))
        )
    length = piece.length[:, None]
    if piece.straight:
        height = (piece.start[:, None] - corners) * along.conj()
        rate = piece.heading[:, None] * along.conj()
        ahead = -height.imag / np.where(np.abs(rate.imag) < TINY, TINY, rate.imag)
        crossings = [(ahead >= 0.0, ahead, height.real + ahead * rate.real)]
    else:
        center, radius = piece.center[:, None], 1.0 / np.abs(piece.curvature[:, None])
        q = (center - corners) * along.conj()
        inward = -1j * along * np.sign(q.imag)
        beside = (np.abs(q.imag) >= radius) & (q.real >= 0.0) & (q.real <= size) & piece.passes(inward)
        gap = np.where(beside, np.abs(q.imag) - radius, np.inf)
        parts.append(Nearest(gap, center + radius * inward, -inward, np.zeros(gap.shape, bool)))
        half = np.sqrt(np.maximum(radius**2 - q.imag**2, 0.0))
        meets = np.abs(q.imag) < radius
        crossings = [(meets, piece.way_to(corners + at * along - center), at) for at in (q.real - half, q.real + half)]
    # A path through a corner can miss both edges by rounding: what lies between is asked, so that too many do no harm.
    near = [may & (way <= length) & (at >= -ROUNDING) & (at <= size + ROUNDING) for may, way, at in crossings]
    crossed = np.any([hit & (at >= 0.0) & (at <= size) for hit, (_, _, at) in zip(near, crossings, strict=True)], axis=(0, 2))
    every = side_by_side(parts)
    best = every.columns(every.gap.argmin(axis=1)[:, None])
    deep: IntArray = np.flatnonzero(np.any(near, axis=(0, 2)) | contains(corners, piece.start[:, None])[:, 0])
    if not len(deep):
        return best
    ways = np.concatenate([np.where(hit, way, length) for hit, (_, way, _) in zip(near, crossings, strict=True)], axis=1)
    along_it = np.column_stack([middles(ways, piece.length), length * np.linspace(0.0, 1.0, DEPTHS)])
    sampled = piece.points(along_it)[deep]
    depths, outward = signed(corners, sampled)
    worst = depths.argmin(axis=1)[:, None]
    depth, place, normal, at_end = best.gap.copy(), best.place.copy(), best.normal.copy(), best.at_end.copy()
    found = np.take_along_axis(depths, worst, axis=1)
    inside = crossed[deep, None] | (found < 0.0)
    depth[deep] = np.where(inside, np.minimum(found, 0.0), depth[deep])
    place[deep] = np.where(inside, np.take_along_axis(sampled, worst, axis=1), place[deep])
    normal[deep] = np.where(inside, np.take_along_axis(outward, worst, axis=1), normal[deep])
    at_end[deep] = np.where(inside, worst == along_it.shape[1] - 1, at_end[deep])
    return Nearest(depth, place, normal, at_end)


def contains(corners: ComplexArray, points: ComplexArray) -> BoolArray:
    """Whether (k, j) points lie in a polygon, by the even-odd rule."""
    first, second = corners, np.roll(corners, -1)
    rise = np.where(second.imag == first.imag, 1.0, second.imag - first.imag)
    at = points[..., None]
    crosses = (first.imag > at.imag) != (second.imag > at.imag)
    beyond = at.real < first.real + (at.imag - first.imag) / rise * (second.real - first.real)
    return np.asarray(np.count_nonzero(crosses & beyond, axis=-1) % 2 == 1)


def signed(corners: ComplexArray, points: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Signed distance, mm, of (k, j) points to a polygon and the direction in which it grows."""
    edge = np.roll(corners, -1) - corners
    share = np.clip(((points[..., None] - corners) * edge.conj()).real / np.abs(edge) ** 2, 0.0, 1.0)
    off = points[..., None] - (corners + share * edge)
    nearest = np.abs(off).argmin(axis=-1)[..., None]
    off = np.take_along_axis(off, nearest, axis=-1)[..., 0]
    distance = np.abs(off)
    sign = np.where(contains(corners, points), -1.0, 1.0)
    return sign * distance, sign * off / np.maximum(distance, TINY)
