"""Several bends in a row that are too sharp together: an upper bound on the clearance of any path under a curvature limit."""

# Strategy: each bend alone may let an instrument pass that cannot pass them all, since what one leaves the next one asks for.
# Along stretches where the centerline turns about as much as a path may, every place whose cross-section parts the lumen is a
# candidate, and chains of three to five of them are tried in the order of how much too sharp the centerline's own chords
# are, less what the room at both ends gives. Whichever chain is tried, a proof holds; only what is found depends on the choice.

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.tube.cells import Cells, first_cells
from tubeplan_viz.tube.chain import ChainMaker, Station
from tubeplan_viz.tube.impassable import impassable

# Cubes that cover the lumen: more than for one bend, since each cross-section has to be cut off from what branches beside it.
COUNT = 300_000
# The bound is closed to this share of what is known without.
CLOSE = 0.05
# Distance of neighbouring cross-sections and length of a chain, in bend radii.
NEAREST, FARTHEST, LONGEST = 0.4, 1.4, 3.0
MOST_SECTIONS = 5
# A cross-section wider than this, in bend radii, lies along another branch.
WIDEST = 0.6
# A stretch is looked at where its centerline turns by this share of what a path may.
TURNING = 0.8
# Chains looked at for one clearance, and those of them tried that the path is proved to pass shortly.
LOOKED_AT, TRIED = 300, 12


def row_bound(
    wall: WallDistance, way: Centerline, *, curvature: float, ceiling: float, limit: float, known: float
) -> tuple[float, tuple[Station, ...]] | None:
    """Bound the clearance of all paths that keep a curvature limit by several bends in a row.

    Parameters
    ----------
    wall : WallDistance
    way : Centerline
        From start to goal, its points evenly spaced.
    curvature : float, 1/mm
    ceiling : float, mm
        Bound that is known already.
    limit : float, mm
        Clearance asked for: where it is not excluded, nothing else is tried.
    known : float, mm
        Clearance that some path is known to keep; nothing is tried below it.

    Returns
    -------
    float, mm, and sections, or None
        No path keeps that clearance, since none passes those sections; None where less than the ceiling is not proved.
    """
    places = turning_places(way, curvature)
    if not places or ceiling - known <= CLOSE * ceiling:
        return None
    # What is asked for, if that is less than is known already by more than the bound is to be closed to.
    tried = float(np.clip(limit, known, ceiling - CLOSE * (ceiling - known)))
    cells = first_cells(wall, known, count=COUNT)
    best = excluding_row(cells, way, places, curvature=curvature, clearance=tried)
    if best is None:
        return None
    low, high = known, tried
    # Where no path is known there may be none at all.
    tried = known if known == 0.0 else 0.5 * (low + high)
    while high - low > CLOSE * ceiling:
        found = excluding_row(cells, way, places, curvature=curvature, clearance=tried)
        if found is None:
            low = tried
        else:
            high, best = tried, found
        tried = 0.5 * (low + high)
    return high, best


def excluding_row(
    cells: Cells, way: Centerline, places: Sequence[int], *, curvature: float, clearance: float
) -> tuple[Station, ...] | None:
    """Cross-sections that no path with this curvature and clearance passes; None when none are proved to be such."""
    maker = ChainMaker(cells, way, clearance=clearance, curvature=curvature)
    good = [place for place in places if maker.width(place) <= WIDEST / curvature]
    tried = 0
    for at in likely_chains(way, good, curvature, clearance):
        chain = maker.chain(at)
        if chain is None:
            continue
        if impassable(cells.wall, chain, curvature=curvature, clearance=clearance):
            return chain.stations
        tried += 1
        if tried == TRIED:
            break
    return None


def turning_places(way: Centerline, curvature: float) -> list[int]:
    """Points of the line on stretches where it turns about as much as a path may."""
    step = way.arc_length[-1] / (len(way.points) - 1)
    unit = max(round(1.0 / (curvature * step)), 1)
    length = round(LONGEST * unit)
    found: set[int] = set()
    last = len(way.points) - 1
    for end in range(last, min(length, last) - 1, -max(unit // 5, 1)):
        begin = max(end - length, 0)
        at = np.linspace(begin, end, 4).astype(int)
        if len(set(at.tolist())) == len(at):
            turn, allowed = turns(way.points[at], curvature)
            if turn > TURNING * allowed:
                found |= set(range(begin, end + 1))
    return sorted(found)


def turns(points: FloatArray, curvature: float) -> tuple[float, float]:
    """Sum of the angles between neighbouring chords of a line, and what a path through its points may have of it, rad."""
    chord = np.diff(points, axis=0)
    length = np.linalg.norm(chord, axis=1)
    unit = chord / length[:, None]
    turn = np.arccos(np.clip(np.einsum("ki,ki->k", unit[:-1], unit[1:]), -1.0, 1.0))
    half = np.arcsin(np.minimum(0.5 * curvature * length, 1.0))
    return float(turn.sum()), float((half[:-1] + half[1:]).sum())


def likely_chains(way: Centerline, places: Sequence[int], curvature: float, clearance: float) -> list[tuple[int, ...]]:
    """Chains of places, those first whose chords turn most beyond what is allowed and what the room at both ends gives."""
    s, room = way.arc_length, np.maximum(way.radii - clearance, 0.0)
    room[[0, -1]] = 0.0
    found: list[tuple[float, tuple[int, ...]]] = []

    def lengthened(at: tuple[int, ...]) -> None:
        if len(at) >= 3:
            turn, allowed = turns(way.points[list(at)], curvature)
            ends = (room[at[0]] + room[at[1]]) / (s[at[1]] - s[at[0]]) + (room[at[-2]] + room[at[-1]]) / (s[at[-1]] - s[at[-2]])
            found.append((turn - allowed - float(ends), at))
        if len(at) == MOST_SECTIONS:
            return
        for place in places:
            gap, whole = s[at[0]] - s[place], s[at[-1]] - s[place]
            if NEAREST <= curvature * gap <= FARTHEST and curvature * whole <= LONGEST:
                lengthened((place, *at))

    for place in places:
        lengthened((place,))
    return [at for _, at in sorted(found, key=lambda one: (-one[0], one[1]))[:LOOKED_AT]]
