"""Another line past the places where the refinement is left with an excess of curvature."""

# Strategy: a refinement that cannot keep the curvature limit gives up clearance for curvature, so that the sharp places are where
# its path touches the wall. A stretch of the line about each is searched over place and direction (`lattice`), from the
# end of the path that is near, if one is, else from the line before it: at a curvature that sharp places with a way past them
# are passed with, then at lesser ones. The chain found is refined alone, where a round costs little, and put in
# the line's place.

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.geometry import SplineCurve
from tubeplan_viz.plan import NoPathError
from tubeplan_viz.tube.lattice import VOXEL, ClearanceGrid, Stretch, way_through
from tubeplan_viz.tube.optimal import optimise
from tubeplan_viz.tube.passage import OptimalSettings, Passage

# All lengths in bend radii, or in so many times the median clearance of the line if that is less.
WIDTHS = 6.0
# Distance of the line's points, and the width of its smoothing.
SPACING, SMOOTH = 0.03, 0.19
# Sharp places nearer to one another are passed together; an end of the path nearer than this is where the search begins.
TOGETHER, NEAR_END = 8.0, 4.0
# The search begins so far before a sharp place, may meet the line from so far beyond it on, and must have met it so far on.
BEFORE, BEYOND, MEETING = 2.0, 0.75, 3.0
# So much of the line on either side is refined with the chain.
ALONG = 3.0
# A path touches the wall where it keeps less than this share of the clearance of its tighter end.
TOUCH = 0.25
# Curvatures of the search, as multiples of the limit: tried first, and if that gets through. The lattice needs more than the
# limit, ways of the HuBMAP ureters that have a path 1.25 to 1.5; none that needed more was brought within the limit.
HIGH, LOW = 1.5, 1.25
# Clearance that the search keeps, as a share of the least of the line there.
KEPT = 0.15


@dataclass(frozen=True, eq=False, kw_only=True)
class Detour:
    """A line that passes the sharp places.

    Attributes
    ----------
    line : (n, 3) float array, mm
        From start to goal.
    excess : float
        Share by which the stretch that was refined worst exceeds the curvature limit.
    places : tuple of (3,) float array, mm
        Where the path was too sharp.
    """

    line: FloatArray
    excess: float
    places: tuple[FloatArray, ...]


def find_detour(passage: Passage, settings: OptimalSettings, curve: SplineCurve) -> Detour | None:
    """Search a line past the sharp places of a path.

    Parameters
    ----------
    passage : Passage
    settings : OptimalSettings
        Directions at the ends are left free.
    curve : SplineCurve
        The path that the refinement ended with, of more curvature than the limit.

    Returns
    -------
    Detour or None
        None where the search found no way past one of the places.
    """
    # A bend radius far above the lumen's width would make for arcs that overlook its bends.
    scale = min(1.0 / passage.limits.curvature_max, WIDTHS * float(np.median(passage.wall.distance(passage.line))))
    line = smooth_line(passage.line, scale)
    grid = ClearanceGrid(passage.wall, VOXEL * scale)
    pieces, places = [], []
    done, excess = 0, 0.0
    for first, last in sharp_places(passage, curve, line, scale):
        passed = past(passage, settings, grid, line, (first, last), scale)
        if passed is None:
            return None
        low, high, piece, over = passed
        pieces += [line[done:low], piece]
        places.append(line[(first + last) // 2])
        done, excess = high, max(excess, over)
    return Detour(line=np.concatenate([*pieces, line[done:]]), excess=excess, places=tuple(places))


def smooth_line(line: FloatArray, scale: float) -> FloatArray:
    """Evenly spaced points of a line without its kinks, its ends kept, (n, 3)."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    even = np.linspace(0.0, s[-1], max(int(np.ceil(s[-1] / (SPACING * scale))), 2) + 1)
    points = np.column_stack([np.interp(even, s, line[:, k]) for k in range(3)])
    # Mirrored through its ends, a line keeps them when it is smoothed.
    width = min(int(4.0 * SMOOTH / SPACING), len(points) - 1)
    before, after = 2.0 * points[0] - points[width:0:-1], 2.0 * points[-1] - points[-2 : -width - 2 : -1]
    smooth = gaussian_filter1d(np.concatenate([before, points, after]), SMOOTH / SPACING, axis=0, mode="nearest")
    return np.concatenate([points[:1], smooth[width + 1 : -width - 1], points[-1:]])


def sharp_places(passage: Passage, curve: SplineCurve, line: FloatArray, scale: float) -> list[tuple[int, int]]:
    """First and last point of the line about each place where the path touches the wall, or comes nearest to it."""
    points = curve(curve.uniform_parameters(SPACING * scale))
    clearance = passage.wall.clearance(points)
    near = max(TOUCH * float(passage.wall.distance(passage.line[[0, -1]]).min()), float(clearance.min()))
    touching = points[clearance <= near]
    index = np.unique(cKDTree(line).query(touching)[1])
    groups = np.split(index, np.flatnonzero(np.diff(index) > TOGETHER / SPACING) + 1)
    return [(int(group[0]), int(group[-1])) for group in groups]


def past(
    passage: Passage, settings: OptimalSettings, grid: ClearanceGrid, line: FloatArray, sharp: tuple[int, int], scale: float
) -> tuple[int, int, FloatArray, float] | None:
    """From and to which point of the line to put in the points of a better piece, and that piece's excess of curvature."""
    count = 1.0 / SPACING
    size = len(line)
    turned = sharp[0] > NEAR_END * count and size - 1 - sharp[1] <= NEAR_END * count
    way, (first, last) = (line[::-1], (size - 1 - sharp[1], size - 1 - sharp[0])) if turned else (line, sharp)
    begin = 0 if first <= NEAR_END * count else int(first - BEFORE * count)
    leave = min(int(last + BEYOND * count), int(size - 1 - 0.5 * BEYOND * count))
    end = min(int(leave + MEETING * count), size)
    low, high = max(int(begin - ALONG * count), 0), min(int(end + ALONG * count), size)
    best: tuple[FloatArray, float] | None = None
    for chain in chains(passage, grid, Stretch(line=way[begin:end], free=begin == 0, leave=leave - begin), scale):
        found = refined(replace(passage, line=np.concatenate([way[low:begin], chain, way[end:high]])), settings)
        if found is not None and (best is None or found[1] < best[1]):
            best = found
        if best is not None and best[1] == 0.0:
            break
    if best is None:
        return None
    piece, excess = best
    return (size - high, size - low, piece[::-1], excess) if turned else (low, high, piece, excess)


def chains(passage: Passage, grid: ClearanceGrid, stretch: Stretch, scale: float) -> list[FloatArray]:
    """Chains through a stretch, the least curved first."""
    limit = passage.limits.curvature_max
    clearance = KEPT * float(passage.wall.distance(stretch.line).min())

    def at(share: float) -> FloatArray | None:
        return way_through(stretch, grid, curvature=share * limit, clearance=clearance, scale=scale)

    high = at(HIGH)
    if high is None:
        return []
    low = at(LOW)
    if low is None:
        low = at(0.5 * (LOW + HIGH))
    return [high] if low is None else [low, high]


def refined(passage: Passage, settings: OptimalSettings) -> tuple[FloatArray, float] | None:
    """Points of the path of largest least clearance along a short line, and its excess of curvature; None without a spline."""
    limit = passage.limits.curvature_max
    settings = replace(settings, start_direction=None, goal_direction=None)
    try:
        proposal = next(proposal for proposal in optimise(passage, settings) if proposal.clearance is not None)
    except NoPathError:
        return None
    curve = proposal.curve
    return curve(curve.uniform_parameters(SPACING / limit)), max(proposal.curvature / limit - 1.0, 0.0)
