"""Labels of a still picture: each beside its place, where it hides least of what is drawn, with a leader."""

# Strategy: what is drawn is a raster of weights, one for the wall and more for a path. A label may stand anywhere on a
# coarse grid; the cost of a stand is what the plate hides, how far it is from its place and what its leader crosses. Labels
# are set one after another, those of least rank first, and never overlap.

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.ndimage import map_coordinates, maximum_filter

from segmentation.arrays import FloatArray, IntArray

# Size of a plate: of each letter, of its rim, and its height.
LETTER, RIM, HEIGHT = 6.6, 12.0, 19.0
# Between plates, and between plates and the picture's edge.
GAP = 3.0
STEP = 6.0
# Drawing units that a plate may be moved away so as to uncover all of its own area.
HIDING = 220.0
LEADER = 1.5
# Length of a leader where nothing is in the way.
AWAY = 14.0
WALL, PATH = 1.0, 4.0


def raster(size: tuple[int, int], dots: FloatArray, lines: Sequence[FloatArray]) -> FloatArray:
    """Weight of what is drawn on each pixel, (height, width).

    Parameters
    ----------
    size : (height, width), drawing units
    dots : (n, 2) float array
        Corners of the wall, right and down.
    lines : sequence of (m, 2) float array
    """
    weights = np.zeros(size)
    weights[pixels(dots, size)] = WALL
    # The wall's corners stand some pixels apart.
    weights = maximum_filter(weights, 5)
    along = np.zeros(size)
    for line in lines:
        for a, b in pairwise(line):
            share = np.linspace(0.0, 1.0, int(np.abs(b - a).max()) + 2)[:, None]
            along[pixels(a + share * (b - a), size)] = PATH
    return np.maximum(weights, maximum_filter(along, 3))


def pixels(points: FloatArray, size: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Row and column of each point that lies on the raster."""
    column, row = np.floor(points.reshape(-1, 2)).astype(int).T
    seen = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    return row[seen], column[seen]


def stand(spots: FloatArray, widths: Sequence[float], drawn: FloatArray, *, bottom: float) -> FloatArray:
    """Upper left corner of each label's plate, (k, 2); not a number where no room is left.

    Parameters
    ----------
    spots : (k, 2) float array
        Places that the labels name, right and down, the most important first.
    widths : sequence of float
    drawn : (height, width) float array
        From `raster`.
    bottom : float
        No plate comes below it.
    """
    sums = np.pad(drawn.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    taken: list[tuple[float, float, float]] = []
    corners: list[tuple[float, float]] = []
    for spot, width in zip(spots, widths, strict=True):
        columns = np.arange(GAP, max(drawn.shape[1] - width - GAP, GAP + 1.0), STEP)
        rows = np.arange(GAP, max(bottom - HEIGHT - GAP, GAP + 1.0), STEP)
        left, top = (axis.ravel() for axis in np.meshgrid(columns, rows))
        across, down = np.maximum(np.abs(spot[0] - left - 0.5 * width) - 0.5 * width, 0.0), np.abs(spot[1] - top - 0.5 * HEIGHT)
        cost = np.abs(np.hypot(across, np.maximum(down - 0.5 * HEIGHT, 0.0)) - AWAY)
        cost += HIDING * hidden(sums, left, top, width) / (width * HEIGHT)
        cost += LEADER * crossed(drawn, spot, left, top, width)
        # A plate never covers the place that it names.
        cost[(across < GAP) & (down < 0.5 * HEIGHT + GAP)] = np.inf
        for other_left, other_top, other_width in taken:
            clash = (left < other_left + other_width + GAP) & (left + width + GAP > other_left)
            clash &= np.abs(top - other_top) < HEIGHT + GAP
            cost[clash] = np.inf
        best = int(np.argmin(cost))
        if not np.isfinite(cost[best]):
            corners.append((np.nan, np.nan))
            continue
        taken.append((float(left[best]), float(top[best]), width))
        corners.append((float(left[best]), float(top[best])))
    return np.array(corners).reshape(-1, 2)


def hidden(sums: FloatArray, left: FloatArray, top: FloatArray, width: float) -> FloatArray:
    """Sum of the weights under plates at these corners."""
    x0, y0 = left.astype(int), top.astype(int)
    x1, y1 = np.minimum(x0 + int(width), sums.shape[1] - 1), np.minimum(y0 + int(HEIGHT), sums.shape[0] - 1)
    return np.asarray(sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0])


def crossed(drawn: FloatArray, spot: FloatArray, left: FloatArray, top: FloatArray, width: float) -> FloatArray:
    """Sum of the weights along each leader, at eight places between the spot and the plate."""
    end = nearest_edge(spot, left, top, width)
    share = np.linspace(0.2, 1.0, 8)[:, None]
    x = spot[0] + share * (end[:, 0] - spot[0])
    y = spot[1] + share * (end[:, 1] - spot[1])
    return np.asarray(map_coordinates(drawn, [y, x], order=0, mode="nearest").sum(axis=0))


def nearest_edge(spot: FloatArray, left: FloatArray, top: FloatArray, width: float) -> FloatArray:
    """Where a leader from the spot meets each plate, (n, 2): the nearest point of its rim."""
    return np.column_stack([np.clip(spot[0], left, left + width), np.clip(spot[1], top, top + HEIGHT)])
