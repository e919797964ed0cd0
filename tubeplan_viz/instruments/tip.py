"""A rigid tip on a curved path: the straight chord that it makes, at every place that it passes."""

# Strategy: with the front of the tip at parameter u its back is the nearest point behind it at the
# tip's length. The chords sweep a strip, parameters (front, share of the chord). Cells of the strip
# are halved until none can hold a clearance below the least one found: the distance to the wall is
# 1-Lipschitz, and no point of a cell is farther from its middle than the corners' moves allow.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import GeometryError
from tubeplan_viz.geometry import SplineCurve, WallDistance

# Fronts are taken this far apart at first, mm; the bound does not depend on it.
STEP = 0.5
MAX_DEPTH = 24
# Keeps the worst case, a tube of even width, at a few seconds; what is left then counts with its bound as it is.
MAX_CELLS = 40_000


@dataclass(frozen=True)
class TipClearance:
    """Least clearance of a rigid tip on its way along a path.

    Attributes
    ----------
    bound : float, mm
        Lower bound over all places of the tip and all points of it.
    sampled : float, mm
        Least value met; the truth lies between the two.
    arc_length : float, mm
        Of the tip's front where it was met.
    point : 3 floats, mm
        The point of the tip that came so near to the wall.
    deviation : float, mm
        Largest distance found between the tip's axis and the path that it cuts short.
    """

    bound: float
    sampled: float
    arc_length: float
    point: tuple[float, float, float]
    deviation: float


def tip_clearance(
    curve: SplineCurve, wall: WallDistance, length: float, *, limit: float = np.inf, tolerance: float = 0.05
) -> TipClearance:
    """Least clearance of a straight tip that moves along a path with both its ends on it.

    Until the front has come the tip's own length from the start, its back is the start: what
    is still outside is not looked at.

    Parameters
    ----------
    curve : SplineCurve
    wall : WallDistance
    length : float, mm
        Of the rigid tip, more than 0.
    limit : float, mm, optional
        Where the bound exceeds it, it is not made closer.
    tolerance : float, mm
        Between the bound and the least value met, where the bound falls short of the limit.

    Raises
    ------
    GeometryError
        If the length is not positive.
    """
    if not length > 0.0:
        raise GeometryError(f"the rigid tip is {length:g} mm long, expected more than 0")
    # Arc length stands for the parameter: fronts move at unit speed.
    count = max(int(np.ceil(curve.length / STEP)), 2)
    front = np.linspace(0.0, curve.length, count + 1)
    parts = max(int(np.ceil(min(length, curve.length) / STEP)), 2)
    share = np.linspace(0.0, 1.0, parts + 1)
    low_s, low_t = (grid.ravel() for grid in np.meshgrid(front[:-1], share[:-1], indexing="ij"))
    high_s, high_t = (grid.ravel() for grid in np.meshgrid(front[1:], share[1:], indexing="ij"))
    best, at, where, bound, looked = np.inf, 0.0, np.zeros(3), np.inf, 0
    for depth in range(MAX_DEPTH + 1):
        middle, reach = strip_cells(curve, length, low_s, high_s, low_t, high_t)
        value = wall.clearance(middle) if depth == 0 else wall.distance(middle)
        looked += len(value)
        if value.min() < best:
            k = int(np.argmin(value))
            best, at, where = float(value[k]), float(0.5 * (low_s[k] + high_s[k])), middle[k]
        loose = value - reach < min(best - tolerance, limit)
        if looked > MAX_CELLS or depth == MAX_DEPTH:
            # What is left counts with its bound as it is.
            loose[:] = False
        if not loose.all():
            bound = min(bound, float((value - reach)[~loose].min()))
        if not loose.any():
            break
        low_s, high_s, low_t, high_t = quarters(*(part[loose] for part in (low_s, high_s, low_t, high_t)))
    x, y, z = (float(v) for v in where)
    return TipClearance(min(bound, best), best, at, (x, y, z), largest_deviation(curve, length, front))


def strip_cells(
    curve: SplineCurve, length: float, low_s: FloatArray, high_s: FloatArray, low_t: FloatArray, high_t: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Middle point of each cell of the strip (m, 3), and how far a point of the cell can be from it (m,), mm."""
    s = np.unique(np.concatenate([low_s, high_s, 0.5 * (low_s + high_s)]))
    back = back_of_tip(curve, length, s)
    front_points, back_points = curve(curve.parameter(s)), curve(curve.parameter(back))
    i0, i1, im = (np.searchsorted(s, part) for part in (low_s, high_s, 0.5 * (low_s + high_s)))
    share = 0.5 * (low_t + high_t)[:, None]
    middle = share * front_points[im] + (1.0 - share) * back_points[im]
    # Along the chord, then with the chord: its front moves by at most half the cell, its back by what lies behind.
    half = 0.5 * (high_s - low_s)
    back_move = np.maximum(back[i1] - back[im], back[im] - back[i0])
    along = 0.5 * (high_t - low_t) * np.minimum(length, curve.length)
    return middle, np.maximum(half, back_move) + along


def quarters(
    low_s: FloatArray, high_s: FloatArray, low_t: FloatArray, high_t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Every cell cut into four."""
    mid_s, mid_t = 0.5 * (low_s + high_s), 0.5 * (low_t + high_t)
    return (
        np.concatenate([low_s, low_s, mid_s, mid_s]),
        np.concatenate([mid_s, mid_s, high_s, high_s]),
        np.concatenate([low_t, mid_t, low_t, mid_t]),
        np.concatenate([mid_t, high_t, mid_t, high_t]),
    )


def back_of_tip(curve: SplineCurve, length: float, front: FloatArray) -> FloatArray:
    """Arc length of the tip's back for each arc length of its front: the nearest place behind at the tip's length.

    Never falls while the front advances; 0 where the tip is not yet wholly on the path.
    """
    # A chord is never longer than the arc: the back lies at least the tip's length behind.
    here = curve(curve.parameter(front))
    near = np.maximum(front - length, 0.0)
    table_s = np.linspace(0.0, curve.length, max(int(np.ceil(curve.length / 0.1)), 2) + 1)
    table = curve(curve.parameter(table_s))
    back = np.zeros_like(front)
    for k in np.flatnonzero(front > length):
        stop = int(np.searchsorted(table_s, near[k], side="right"))
        gap = np.linalg.norm(table[:stop] - here[k], axis=1)
        beyond = np.flatnonzero(gap >= length)
        back[k] = near[k] if not len(beyond) else crossing_back(table_s, gap, int(beyond[-1]), near[k], length)
        if not len(beyond):
            back[k] = 0.0
    for _ in range(4):
        inner = back > 0.0
        if not inner.any():
            break
        u = curve.parameter(back[inner])
        offset = here[inner] - curve(u)
        gap = np.linalg.norm(offset, axis=1)
        slope = np.einsum("ij,ij->i", offset, curve.tangent(u)) / gap
        move = np.where(slope > 0.2, (gap - length) / np.maximum(slope, 0.2), 0.0)
        back[inner] = np.clip(back[inner] + np.clip(move, -0.1, 0.1), 0.0, near[inner])
    return np.maximum.accumulate(back)


def crossing_back(table_s: FloatArray, gap: FloatArray, k: int, near: float, length: float) -> float:
    """Arc length between table entry k and the next at which the gap falls to the length."""
    if k + 1 >= len(gap):
        return float(min(table_s[k], near))
    share = (gap[k] - length) / max(gap[k] - gap[k + 1], 1e-12)
    return float(min(table_s[k] + share * (table_s[k + 1] - table_s[k]), near))


def largest_deviation(curve: SplineCurve, length: float, front: FloatArray) -> float:
    """Largest distance from the path to the chord that replaces it, over all fronts."""
    back = back_of_tip(curve, length, front)
    share = np.linspace(0.0, 1.0, 17)
    s = back[:, None] + (front - back)[:, None] * share
    points = curve(curve.parameter(s.ravel())).reshape(*s.shape, 3)
    chord = points[:, -1] - points[:, 0]
    square = np.maximum(np.einsum("ij,ij->i", chord, chord), 1e-12)
    offset = points - points[:, :1]
    along = np.einsum("ijk,ik->ij", offset, chord) / square[:, None]
    return float(np.linalg.norm(offset - along[..., None] * chord[:, None], axis=2).max())
