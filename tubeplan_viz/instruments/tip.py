"""A rigid tip on a curved path: the straight chord that it makes, at every place that it passes."""

# Strategy: with the front of the tip at parameter u its back is the nearest point behind it at the
# tip's length. The chords sweep a strip, parameters (front, share of the chord). Cells of the strip
# are halved until none can hold a clearance below the least one found: the distance to the wall is
# 1-Lipschitz, and no point of a cell is farther from its middle than the corners' moves allow. Cells that the
# path's own clearance, less their distance from it, already shows to be clear are not asked about at all.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import GeometryError
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.instruments.track import Track

# Fronts are taken this far apart at first, mm; the bound does not depend on it.
STEP = 0.5
# Of cells that need no question the tightest are asked all the same, for the least value met.
ASKED_ANYWAY = 64
MAX_DEPTH = 24
# Keeps the worst case, a tube of even width, at a few seconds; what is left then counts with its bound as it is.
MAX_CELLS = 40_000
# How often cells are halved for the place where a tip is caught: until clearance is known to 0.01 mm there.
UNTIL_DEPTH = 6
UNTIL_CELLS = 1_000


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
    curve: SplineCurve,
    wall: WallDistance,
    length: float,
    *,
    limit: float = np.inf,
    tolerance: float = 0.05,
    track: Track | None = None,
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
    track : Track, optional
        Of the same curve and wall, when it was made before.

    Raises
    ------
    GeometryError
        If the length is not positive.
    """
    if not length > 0.0:
        raise GeometryError(f"the rigid tip is {length:g} mm long, expected more than 0")
    track = track or Track.of(curve, wall)
    front, (low_s, high_s, low_t, high_t) = whole_strip(length, track.length)
    middle, reach, lower = strip_cells(track, length, low_s, high_s, low_t, high_t)
    asked = lower < limit
    asked[np.argsort(lower)[:ASKED_ANYWAY]] = True
    best, at, where, looked = np.inf, 0.0, np.zeros(3), 0
    bound = float(lower[~asked].min(initial=np.inf))
    low_s, high_s, low_t, high_t, middle, reach = (part[asked] for part in (low_s, high_s, low_t, high_t, middle, reach))
    for depth in range(MAX_DEPTH + 1):
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
        middle, reach, _ = strip_cells(track, length, low_s, high_s, low_t, high_t)
    x, y, z = (float(v) for v in where)
    return TipClearance(min(bound, best), best, at, (x, y, z), largest_deviation(track, length, front))


def tip_until(track: Track, wall: WallDistance, length: float, clearance: float, *, until: float) -> float:
    """How far the front of a straight tip comes while all of it is proved to keep a clearance.

    Parameters
    ----------
    track : Track
        Of a path inside the lumen.
    wall : WallDistance
    length : float, mm
        Of the rigid tip.
    clearance, until : float, mm
        What is to be kept, and the arc length that the front goes to at most.

    Returns
    -------
    float, mm
    """
    if not (length > 0.0 and until > 0.0):
        return until
    _, cells = whole_strip(length, until)
    stop = until
    for depth in range(UNTIL_DEPTH + 1):
        middle, reach, lower = strip_cells(track, length, *cells)
        asked = np.flatnonzero((lower < clearance) & (cells[0] < stop))
        value = wall.distance(middle[asked])
        front = 0.5 * (cells[0] + cells[1])[asked]
        stop = min(stop, float(front[value < clearance].min(initial=np.inf)))
        left = asked[(value - reach[asked] < clearance) & (cells[0][asked] < stop)]
        if not len(left):
            return stop
        if len(left) > UNTIL_CELLS:
            # Where the clearance hardly differs from what is asked: no more is proved than what lies before.
            left = left[np.argsort(cells[0][left], kind="stable")]
            stop, left = float(cells[0][left[UNTIL_CELLS]]), left[:UNTIL_CELLS]
        if depth < UNTIL_DEPTH:
            cells = quarters(*(part[left] for part in cells))
    return min(stop, float(cells[0][left].min()))


def whole_strip(length: float, until: float) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Places of the front up to one, and the cells between them: least and largest front, least and largest share."""
    # Arc length stands for the parameter: fronts move at unit speed.
    front = np.linspace(0.0, until, max(int(np.ceil(until / STEP)), 2) + 1)
    share = np.linspace(0.0, 1.0, max(int(np.ceil(min(length, until) / STEP)), 2) + 1)
    low_s, low_t = (grid.ravel() for grid in np.meshgrid(front[:-1], share[:-1], indexing="ij"))
    high_s, high_t = (grid.ravel() for grid in np.meshgrid(front[1:], share[1:], indexing="ij"))
    return front, (low_s, high_s, low_t, high_t)


def strip_cells(
    track: Track, length: float, low_s: FloatArray, high_s: FloatArray, low_t: FloatArray, high_t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Cells of the strip: middle points (m, 3), how far a point of a cell can be from them (m,), and least clearance (m,).

    The last comes from the path's own clearance at the place that the middle stands for, less how far it is from there.
    """
    s = np.unique(np.concatenate([low_s, high_s, 0.5 * (low_s + high_s)]))
    back = track.behind(s, length)
    front_points, back_points = track.at(s), track.at(back)
    i0, i1, im = (np.searchsorted(s, part) for part in (low_s, high_s, 0.5 * (low_s + high_s)))
    share = 0.5 * (low_t + high_t)
    middle = share[:, None] * front_points[im] + (1.0 - share)[:, None] * back_points[im]
    # Along the chord, then with the chord: its front moves by at most half the cell, its back by what lies behind.
    half = 0.5 * (high_s - low_s)
    back_move = np.maximum(back[i1] - back[im], back[im] - back[i0])
    along = 0.5 * (high_t - low_t) * np.minimum(length, track.length)
    reach = np.maximum(half, back_move) + along
    beside = share * s[im] + (1.0 - share) * back[im]
    lower = track.at_least(beside) - np.linalg.norm(middle - track.at(beside), axis=1) - reach
    return middle, reach, lower


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


def largest_deviation(track: Track, length: float, front: FloatArray) -> float:
    """Largest distance from the path to the chord that replaces it, over all fronts."""
    back = track.behind(front, length)
    share = np.linspace(0.0, 1.0, 17)
    s = back[:, None] + (front - back)[:, None] * share
    points = track.at(s.ravel()).reshape(*s.shape, 3)
    chord = points[:, -1] - points[:, 0]
    square = np.maximum(np.einsum("ij,ij->i", chord, chord), 1e-12)
    offset = points - points[:, :1]
    along = np.einsum("ijk,ik->ij", offset, chord) / square[:, None]
    return float(np.linalg.norm(offset - along[..., None] * chord[:, None], axis=2).max())
