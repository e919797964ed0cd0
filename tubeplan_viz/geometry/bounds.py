"""Bounds on curvature and clearance that hold for every u, not only at samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import BoolArray, FloatArray
from segmentation.errors import GeometryError
from tubeplan_viz.geometry.curve import SplineCurve
from tubeplan_viz.geometry.distance import ON_SURFACE, WallDistance

MAX_DEPTH = 40
# Closer to its limit than this share a curvature is not decided.
DECIDED = 1e-5
# A piece this long bulges from its chord by 0.03 mm at a bend radius of 8 mm, and the
# faces within reach of it are few.
PIECE_LENGTH = 1.0
# Keeps the worst case at a few seconds; what is left then counts with its bound as it is.
MAX_PIECES = 40_000


@dataclass(frozen=True)
class Bound:
    """A proved bound and the extreme value met at a sample; the truth lies between them.

    `at` is the parameter u of that sample.
    """

    bound: float
    sampled: float
    at: float


def bezier_pieces(curve: SplineCurve) -> tuple[FloatArray, FloatArray]:
    """Bezier control points (m, 4, 3) of a cubic's knot spans, and their parameter ranges (m, 2)."""
    if curve.degree != 3:
        raise GeometryError(f"the spline has degree {curve.degree}, expected 3")
    breaks = np.unique(curve.knots)
    a, b = breaks[:-1], breaks[1:]
    third = ((b - a) / 3.0)[:, None]
    # A cubic is fixed by its end points and end derivatives: the inner Bezier points follow.
    control = np.stack([curve(a), curve(a) + third * curve(a, 1), curve(b) - third * curve(b, 1), curve(b)], axis=1)
    return control, np.column_stack([a, b])


def halves(control: FloatArray, ranges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """De Casteljau subdivision of every piece at its middle."""
    a, b, c, d = (control[:, k] for k in range(4))
    ab, bc, cd = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + d)
    abc, bcd = 0.5 * (ab + bc), 0.5 * (bc + cd)
    middle = 0.5 * (abc + bcd)
    split = np.concatenate([np.stack([a, ab, abc, middle], axis=1), np.stack([middle, bcd, cd, d], axis=1)])
    low, high = ranges.T
    half = 0.5 * (low + high)
    return split, np.concatenate([np.column_stack([low, half]), np.column_stack([half, high])])


def curvature_upper_bound(curve: SplineCurve, *, limit: float | None = None, tolerance: float = 0.005) -> Bound:
    """Largest curvature of a cubic spline, bounded from above within a relative `tolerance`.

    Parameters
    ----------
    curve : SplineCurve
    limit : float, 1/mm, optional
        While no sample exceeds it, pieces whose bound does are halved further, down to a
        relative `DECIDED`, so that the bound decides the limit.
    tolerance : float
        Pieces are halved until the bound is within this share of the sampled maximum.

    Returns
    -------
    Bound, 1/mm
        Infinite where the speed cannot be bounded away from zero (a cusp).

    Notes
    -----
    In Bernstein form every polynomial lies in the convex hull of its coefficients, so on
    a piece |F' x F''| <= max of its coefficients' norms and |F'|^2 >= its least coefficient.
    """
    control, ranges = bezier_pieces(curve)
    sampled, at, bound = 0.0, 0.0, 0.0
    for _ in range(MAX_DEPTH):
        ends = curve.curvature(ranges.ravel())
        if ends.max() > sampled:
            sampled, at = float(ends.max()), float(ranges.ravel()[int(np.argmax(ends))])
        upper = piece_curvature_bounds(control)
        loose = upper > sampled * (1.0 + tolerance) + 1e-9
        if limit is not None and sampled <= limit:
            loose |= upper > max(limit, sampled * (1.0 + DECIDED))
        if not loose.all():
            bound = max(bound, float(upper[~loose].max()))
        if not loose.any():
            return Bound(max(bound, sampled), sampled, at)
        control, ranges = halves(control[loose], ranges[loose])
    return Bound(float("inf"), sampled, at)


def piece_curvature_bounds(control: FloatArray) -> FloatArray:
    """Upper bounds (m,) of the curvature of Bezier pieces (m, 4, 3)."""
    first = 3.0 * np.diff(control, axis=1)  # (m, 3, 3), degree 2
    second = 2.0 * np.diff(first, axis=1)  # (m, 2, 3), degree 1
    d0, d1, d2 = (first[:, k] for k in range(3))
    e0, e1 = second[:, 0], second[:, 1]
    cross = np.stack(
        [
            np.cross(d0, e0),
            (np.cross(d0, e1) + 2.0 * np.cross(d1, e0)) / 3.0,
            (2.0 * np.cross(d1, e1) + np.cross(d2, e0)) / 3.0,
            np.cross(d2, e1),
        ],
        axis=1,
    )
    square = np.stack([dots(d0, d0), dots(d0, d1), (dots(d0, d2) + 2.0 * dots(d1, d1)) / 3.0, dots(d1, d2), dots(d2, d2)], axis=1)
    slowest = square.min(axis=1)
    largest = np.linalg.norm(cross, axis=2).max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(slowest > 0, largest / np.maximum(slowest, 1e-300) ** 1.5, np.inf)


def dots(x: FloatArray, y: FloatArray) -> FloatArray:
    """Scalar products row by row, (m,)."""
    return np.asarray(np.einsum("ij,ij->i", x, y))


def clearance_lower_bound(
    curve: SplineCurve, wall: WallDistance, *, limit: float | None = None, tolerance: float = 0.01
) -> Bound:
    """Least clearance along a cubic spline, bounded from below within `tolerance` mm.

    Parameters
    ----------
    curve : SplineCurve
    wall : WallDistance
    limit : float, mm, optional
        Pieces whose bound falls short of it while their sample does not are halved
        further, so that the bound decides the limit wherever the clearance differs
        from it by more than a micrometre.
    tolerance : float, mm

    Returns
    -------
    Bound, mm
        Signed: negative when the curve leaves the lumen.

    Notes
    -----
    A Bezier piece lies in the convex hull of its control points. A triangle is convex, so
    the plane through its point f nearest to some point m, perpendicular to m - f, bounds the
    distance of x from below by n . (x - f): linear in x, and so least at a control point.
    With m the point of the piece's chord nearest to the triangle, the bound falls short only
    by the piece's bulge. A piece keeps away from all triangles farther from its middle than
    the distance asked plus the distance to its farthest control point, since the distance to a fixed
    set is 1-Lipschitz. Where the middle lies outside the lumen, the Lipschitz bound alone serves.
    The sign of the clearance jumps only where the curve passes a cap: a piece that could
    pass one is bounded as if it did, until it is shorter than the micrometre by which a
    point may lie outside.
    """
    control, ranges = bezier_pieces(curve)
    control, ranges = short_pieces(control, ranges)
    triangles = wall.triangles
    # The distance to any face bounds the least clearance from above: a first value to prune with.
    middle = middles(control)
    some = triangles.closest(middle, triangles.likely_nearest(middle)[:, 0])
    sampled, at, bound = float("inf"), 0.0, float("inf")
    least = float(np.linalg.norm(middle - some, axis=1).min())
    pieces = 0
    for _ in range(MAX_DEPTH):
        middle = middles(control)
        spread = np.linalg.norm(control - middle[:, None], axis=2).max(axis=1)
        value, lower = piece_clearances(control, middle, spread, min(least, sampled), wall)
        pieces += len(middle)
        if value.min() < sampled:
            k = int(np.argmin(value))
            sampled, at = float(value[k]), float(ranges[k].mean())
        loose = lower < sampled - tolerance
        if limit is not None:
            loose |= (lower < limit) & (value >= limit) & (value - lower > 1e-3)
        if pieces > MAX_PIECES:
            loose[:] = False
        if not loose.all():
            bound = min(bound, float(lower[~loose].min()))
        if not loose.any():
            break
        control, ranges = halves(control[loose], ranges[loose])
    return Bound(min(bound, sampled), sampled, at)


def middles(control: FloatArray) -> FloatArray:
    """Points at the middle parameter of Bezier pieces (m, 4, 3): (m, 3)."""
    return np.asarray(0.125 * (control[:, 0] + 3.0 * control[:, 1] + 3.0 * control[:, 2] + control[:, 3]))


def short_pieces(control: FloatArray, ranges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pieces halved until none is longer than `PIECE_LENGTH`."""
    done: list[tuple[FloatArray, FloatArray]] = []
    for _ in range(MAX_DEPTH):
        long = np.linalg.norm(np.diff(control, axis=1), axis=2).sum(axis=1) > PIECE_LENGTH
        done.append((control[~long], ranges[~long]))
        if not long.any():
            break
        control, ranges = halves(control[long], ranges[long])
    return np.concatenate([c for c, _ in done]), np.concatenate([r for _, r in done])


def piece_clearances(
    control: FloatArray, middle: FloatArray, spread: FloatArray, least: float, wall: WallDistance
) -> tuple[FloatArray, FloatArray]:
    """Signed clearance at the middles, and lower bounds over the pieces, both (m,) mm.

    Clearances are exact where they are under `least` plus the spread, and at least that
    elsewhere; bounds are cut off at `least`, since no larger one is of use.

    Parameters
    ----------
    control : (m, 4, 3) float array, mm
        Bezier control points of the pieces.
    middle : (m, 3) float array, mm
        The place of each piece at its middle parameter.
    spread : (m,) float array, mm
        Radius of a ball around the middle that holds the piece.
    least : float, mm
        Clearance that is met already.
    wall : WallDistance
    """
    triangles = wall.triangles
    reach = least + spread
    row, face = triangles.within(middle, reach)
    foot = triangles.closest(middle[row], face)
    gap = np.linalg.norm(middle[row] - foot, axis=1)
    value, lower = reach.copy(), np.full(len(middle), least)
    np.minimum.at(value, row, gap)
    near = gap < reach[row]
    row, face, foot, gap = row[near], face[near], foot[near], gap[near]
    first, last = control[row, 0], control[row, 3]
    chord = last - first
    share = np.einsum("ij,ij->i", foot - first, chord) / np.maximum(np.einsum("ij,ij->i", chord, chord), 1e-30)
    site = first + np.clip(share, 0.0, 1.0)[:, None] * chord
    foot = triangles.closest(site, face)
    normal = site - foot
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    plane = np.einsum("pki,pi->pk", control[row] - foot[:, None], normal).min(axis=1)
    np.minimum.at(lower, row, np.maximum(plane, gap - spread[row]))
    outside = ~wall.inside(middle)
    if outside.any():
        value[outside] = -wall.distance(middle[outside])
    doubtful = outside | may_pass_opening(control, middle, spread, wall)
    if doubtful.any():
        lower[doubtful] = -wall.distance(middle[doubtful]) - spread[doubtful]
    return value, lower


def may_pass_opening(control: FloatArray, middle: FloatArray, spread: FloatArray, wall: WallDistance) -> BoolArray:
    """Pieces that reach a cap and are not seen to stay on its inner side, (m,)."""
    doubtful = (spread > ON_SURFACE) & (wall.cap_distance(middle) <= spread + ON_SURFACE)
    if wall.openings is not None and doubtful.any():
        near = np.flatnonzero(doubtful)
        row, face = wall.openings.within(middle[near], spread[near] + ON_SURFACE)
        beyond = wall.openings.ahead(control[near[row]], face).max(axis=1) > ON_SURFACE
        doubtful[near] = False
        doubtful[near[row[beyond]]] = True
    return doubtful
