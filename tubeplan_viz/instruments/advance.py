"""How far an instrument comes along a path that it cannot follow to the end."""

# Strategy: what is proved of a whole path can be proved of its beginning. The distance to the wall is 1-Lipschitz: between two
# places of clearance a and b that lie d apart along the path it is at least (a + b - d) / 2. Spans where this falls short are
# halved, and those behind a place that is certainly too narrow left out, until the first one left is no longer than can be
# told. The same with the Bernstein bounds of the curvature, and with the strip that a rigid tip sweeps (`tip`).

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.geometry.bounds import bezier_pieces, halves, piece_curvature_bounds
from tubeplan_viz.instruments.catalogue import Instrument
from tubeplan_viz.instruments.tip import tip_until
from tubeplan_viz.instruments.track import Track

# Half a millimetre, and pieces of a few, to a few micrometres.
HALVINGS = 10


@dataclass(frozen=True, kw_only=True)
class Advance:
    """The farthest place that an instrument is proved to reach along the paths found to a target.

    Attributes
    ----------
    arc_length : float, mm
        Up to here the path keeps clearance, bend radius, rigid tip and working length. Proved.
    point : 3 floats, mm
    short : float, mm
        Length of path that is left to the target.
    path : int
        Index into the target's witnesses.
    """

    arc_length: float
    point: tuple[float, float, float]
    short: float
    path: int


def farthest(
    instrument: Instrument, wall: WallDistance, curves: Sequence[SplineCurve], tracks: Mapping[int, Track], *, used: float
) -> Advance | None:
    """How far an instrument comes along some paths; None where it does not leave the start.

    Parameters
    ----------
    instrument : Instrument
    wall : WallDistance
    curves : sequence of SplineCurve
        From the start to the target.
    tracks : mapping
        Of those curves that are proved to lie in the lumen, by their numbers.
    used : float, mm
        Length of instrument that is spent before the start.
    """
    best: Advance | None = None
    shaft = {number: shaft_until(curves[number], wall, track, instrument, used=used) for number, track in tracks.items()}
    for number in sorted(tracks, key=lambda number: tracks[number].length - shaft[number]):
        track = tracks[number]
        if best is not None and track.length - shaft[number] >= best.short:
            break
        front = tip_until(track, wall, instrument.rigid_tip_mm, instrument.radius, until=shaft[number])
        if front > 0.0 and (best is None or track.length - front < best.short):
            x, y, z = (float(v) for v in track.at(np.array([front]))[0])
            best = Advance(arc_length=front, point=(x, y, z), short=track.length - front, path=number)
    return best


def shaft_until(curve: SplineCurve, wall: WallDistance, track: Track, instrument: Instrument, *, used: float) -> float:
    """Arc length up to which the shaft keeps all its limits, mm; `used` is the length of instrument spent before the start."""
    return min(
        max(instrument.working_length_mm - used, 0.0),
        clear_until(track, wall, instrument.radius),
        curved_until(curve, instrument.limits.curvature_max),
    )


def clear_until(track: Track, wall: WallDistance, clearance: float) -> float:
    """Arc length up to which a path inside the lumen is proved to keep a clearance, mm."""
    low, high = track.known[:-1], track.known[1:]
    before, after = track.clearance[:-1], track.clearance[1:]
    stop = track.length
    for _ in range(HALVINGS):
        narrow = np.concatenate([low[before < clearance], high[after < clearance]])
        stop = min(stop, float(narrow.min(initial=np.inf)))
        left = (0.5 * (before + after - (high - low)) < clearance) & (low < stop)
        if not left.any():
            return stop
        low, high, before, after = low[left], high[left], before[left], after[left]
        middle = 0.5 * (low + high)
        value = wall.clearance(track.at(middle))
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        before, after = np.concatenate([before, value]), np.concatenate([value, after])
    return min(stop, float(low.min()))


def curved_until(curve: SplineCurve, curvature: float) -> float:
    """Arc length up to which a spline is proved to bend no more than a curvature, mm."""
    control, ranges = bezier_pieces(curve)
    stop = float(ranges[-1, 1])
    for _ in range(HALVINGS):
        ends = ranges.ravel()
        stop = min(stop, float(ends[curve.curvature(ends) > curvature].min(initial=np.inf)))
        left = (piece_curvature_bounds(control) > curvature) & (ranges[:, 0] < stop)
        if not left.any():
            return length_at(curve, stop)
        control, ranges = halves(control[left], ranges[left])
    return length_at(curve, min(stop, float(ranges[:, 0].min())))


def length_at(curve: SplineCurve, u: float) -> float:
    """Arc length at a parameter, mm."""
    found: FloatArray = curve.arc_length([u])
    return float(found[0])
