"""tubeplan bench certificate: the bounds between the samples, held against samples a million to the path."""

# Strategy: random splines in random tubes, a tenth of them through the wall. Curvature is evaluated at a million even
# parameters of every spline, from polynomials made for the purpose. Clearance is asked at those of the same million
# parameters that could hold the least one: an interval of parameters whose middle shows that the
# wall is too far for any of its samples to fall below the least found is left out, the others are halved down to a single
# sample. What is found is the least of all million samples, and most of them need no query.

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.bench.random_tubes import random_path, random_tube
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.geometry import Bound, SplineCurve, WallDistance, clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.pipeline import Notify

SPLINES, QUICK_SPLINES = 1000, 40
SAMPLES = 1_000_000
CURVATURE_TIGHT = 0.01
CLEARANCE_TIGHT = 0.01
# Share of the splines that may leave the lumen, and how far their control points sway, in radii.
LEAVING, SWAY_INSIDE, SWAY_OUTSIDE = 0.1, 0.75, 1.6
# Points of the grid that the search for the least clearance begins with.
COARSE = 256


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One spline in one tube.

    Attributes
    ----------
    curvature, clearance : Bound, 1/mm and mm
    sharpest : float, 1/mm
        Largest of all samples.
    tightest : float, mm
        Least of all samples, negative outside the lumen.
    queries : int
        Samples whose distance to the wall was asked.
    """

    curvature: Bound
    clearance: Bound
    sharpest: float
    tightest: float
    queries: int

    @property
    def violated(self) -> bool:
        """Whether a sample is worse than a bound; the rounding of the evaluation is not counted."""
        return self.sharpest > self.curvature.bound * (1.0 + 1e-12) or self.tightest < self.clearance.bound - 1e-12


def certificate(*, quick: bool, notify: Notify) -> list[Row]:
    """Bounds on random splines in random tubes: never violated, and tight.

    Parameters
    ----------
    quick : bool
        40 splines instead of 1000.
    notify : Notify
    """
    count = QUICK_SPLINES if quick else SPLINES
    trials = []
    for number, seed in enumerate(np.random.SeedSequence(20240).spawn(count)):
        notify("random splines", number, count)
        trials.append(trial(np.random.default_rng(seed)))
    case = f"{count} random splines in {count} random tubes"
    broken = sum(one.violated for one in trials)
    curvature = max(one.curvature.bound / max(one.sharpest, one.curvature.sampled) - 1.0 for one in trials)
    clearance = max(one.tightest - one.clearance.bound for one in trials)
    return [
        Row(
            case=case, figure=f"bounds violated by one of {SAMPLES:.0e} samples each", ours=broken, target="0", holds=broken == 0
        ),
        Row(
            case=case,
            figure="curvature bound above its largest sample %, worst",
            ours=100.0 * curvature,
            target=f"at most {100.0 * CURVATURE_TIGHT:g}",
            holds=curvature <= CURVATURE_TIGHT,
        ),
        Row(
            case=case,
            figure="clearance bound below its least sample mm, worst",
            ours=clearance,
            target=f"at most {CLEARANCE_TIGHT:g}",
            # The least of finitely many samples lies above the least of all points, by less than a micrometre at this density.
            holds=clearance <= CLEARANCE_TIGHT + 1e-6,
        ),
        Row(case=case, figure="paths that leave the lumen", ours=sum(one.tightest < 0.0 for one in trials)),
        Row(case=case, figure="sharpest curvature 1/mm", ours=max(one.sharpest for one in trials)),
        Row(case=case, figure="distances asked per path, mean", ours=float(np.mean([one.queries for one in trials]))),
    ]


def trial(rng: np.random.Generator, *, samples: int = SAMPLES) -> Trial:
    """A random spline in a random tube, bounded and sampled."""
    tube = random_tube(rng)
    sway = SWAY_OUTSIDE if rng.random() < LEAVING else float(rng.uniform(0.0, SWAY_INSIDE))
    curve = random_path(tube, rng, sway=sway)
    wall = WallDistance(tube.surface)
    tightest, queries = least_clearance(curve, wall, samples)
    return Trial(
        curvature=curvature_upper_bound(curve),
        clearance=clearance_lower_bound(curve, wall),
        sharpest=largest_curvature(curve, samples),
        tightest=tightest,
        queries=queries,
    )


def largest_curvature(curve: SplineCurve, samples: int) -> float:
    """Largest curvature, 1/mm, at `samples` parameters or a few more, the same number between each two knots."""
    breaks = np.unique(curve.knots)
    per_span = int(np.ceil(samples / (len(breaks) - 1)))
    t = np.linspace(0.0, 1.0, per_span)
    largest = 0.0
    for a, b in pairwise(breaks):
        # Derivatives of a cubic between two knots are quadratic and linear: their values at three and two places fix them.
        first, middle, last = curve([a, 0.5 * (a + b), b], 1)
        square, slope = 2.0 * (first - 2.0 * middle + last), -3.0 * first + 4.0 * middle - last
        rate = (first[:, None] + t * (slope[:, None] + t * square[:, None])) * (b - a)  # (3, n), per unit of t
        turn = (slope[:, None] + 2.0 * t * square[:, None]) * (b - a)
        speed = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
        cross = (
            (rate[1] * turn[2] - rate[2] * turn[1]) ** 2
            + (rate[2] * turn[0] - rate[0] * turn[2]) ** 2
            + (rate[0] * turn[1] - rate[1] * turn[0]) ** 2
        )
        largest = max(largest, float((cross / speed**3).max()))
    return float(np.sqrt(largest))


def least_clearance(curve: SplineCurve, wall: WallDistance, samples: int) -> tuple[float, int]:
    """Least signed clearance, mm, of `samples` even parameters, and how many of them asked for a distance.

    Notes
    -----
    Within an interval of parameters no point is farther from the middle one than the longest leg of
    the curve's control polygon there allows. While that is less than the middle's distance to wall
    and caps, all of the interval lies on the same side of them and its clearance is at least the middle's less
    that reach; otherwise the interval is halved.
    """
    last = samples - 1
    # |F'| is at most the largest of its control points: of the derivative's Bernstein form over all spans.
    fastest = float(np.linalg.norm(derivative_polygon(curve), axis=1).max())
    borders = np.unique(np.linspace(0, last, COARSE).astype(int))
    low, high = borders[:-1], borders[1:]
    least, queries = np.inf, 0
    while len(low):
        middle = (low + high) // 2
        points = curve(middle / last)
        distance, inside = wall.distance(points), wall.inside(points)
        queries += len(points)
        clearance = np.where(inside, distance, -distance)
        least = min(least, float(clearance.min()))
        reach = np.maximum(middle - low, high - middle) / last * fastest
        same_side = np.minimum(distance, wall.cap_distance(points)) > reach
        beaten = same_side & (clearance - reach >= least)
        # Outside, the clearance is at least minus the distance, less the reach, too.
        beaten |= ~inside & (clearance - reach >= least)
        wide = (high - low > 1) & ~beaten
        low, high, middle = low[wide], high[wide], middle[wide]
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        # Halves that hold nothing but their two borders are asked once, at both.
        single = high - low <= 1
        if single.any():
            ends = np.unique(np.concatenate([low[single], high[single]]))
            queries += len(ends)
            least = min(least, float(wall.clearance(curve(ends / last)).min()))
            low, high = low[~single], high[~single]
    return least, queries


def derivative_polygon(curve: SplineCurve) -> FloatArray:
    """Control points of the derivative, (n - 1, 3) mm: the derivative lies in their convex hull."""
    p, knots, control = curve.degree, curve.knots, curve.control_points
    width = knots[p + 1 : p + len(control)] - knots[1 : len(control)]
    return np.asarray(p * np.diff(control, axis=0) / width[:, None])
