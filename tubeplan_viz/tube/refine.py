"""Feature iteration: insert for clearance, relax for curvature (Dai 2024, section 2.3)."""

# Strategy: every round builds the spline through the features, slices the wall for short
# clearances and measures curvature. Short runs add the nearest centerline point as a
# feature; runs that are bent too sharply move their features towards the centre of the
# circle through each and its neighbours. It ends when nothing is above the limits, when
# neither set nor worst curvature has changed for three rounds, or at the round limit.

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import SplineCurve, circumcenter
from tubeplan_viz.plan import Feature, FeatureKind, Limits
from tubeplan_viz.tube.features import FeatureSettings, scan_features
from tubeplan_viz.tube.slices import SliceClearance
from tubeplan_viz.tube.spline import spline_through


@dataclass(frozen=True, kw_only=True)
class RefineSettings:
    """Numbers of the iteration (Dai 2024, table 1, unless said otherwise).

    Attributes
    ----------
    sigma : float
        Share of the way to the circle's centre that a feature moves in one round.
    sigma_extremum : float
        The same for curvature extrema (0.003 for the renal models).
    sigma_growth : float
        The rate is sigma (1 + growth m) for a feature moved m times before. The text
        says that it grows and not how; 0.01 keeps the number of rounds near the published one.
    sample_spacing : float, mm
        Distance between samples of the curve.
    short_run : float, mm
        Only runs of short clearance longer than this add a feature (U_th).
    slice_again : float, mm
        The wall is sliced again once a sample has moved this far, and before the iteration
        ends. A round moves the curve by some 0.01 mm; slicing it every time changes nothing.
    slice_pairs : int
        sigma of algorithm 1: pairs of slices per sample.
    unchanged_rounds : int
        Rounds without change after which the iteration gives up.
    max_rounds : int
    aim : float
        Share of the curvature limit aimed at, so that the bound between the samples
        still meets the limit. Not in the text, which checks samples only.
    """

    sigma: float = 0.001
    sigma_extremum: float = 0.001
    sigma_growth: float = 0.01
    sample_spacing: float = 0.25
    short_run: float = 1.0
    slice_again: float = 0.1
    slice_pairs: int = 2
    unchanged_rounds: int = 3
    max_rounds: int = 400
    aim: float = 0.999

    def __post_init__(self) -> None:
        if not 0 < self.sigma < 1 or not 0 < self.sigma_extremum < 1:
            raise CaseError(
                f"sigma is {self.sigma:g} and {self.sigma_extremum:g} for extrema, expected between 0 and 1 (Dai 2024: 0.001)"
            )
        if self.max_rounds < 0:
            raise CaseError(f"max_rounds is {self.max_rounds}, expected 0 or more")
        if not 0.01 <= self.sample_spacing <= 10.0:
            raise CaseError(f"sample_spacing is {self.sample_spacing:g} mm, expected 0.01 to 10")
        if min(self.slice_pairs, self.unchanged_rounds) < 1:
            raise CaseError(
                f"slice_pairs is {self.slice_pairs} and unchanged_rounds {self.unchanged_rounds}; expected at least 1 of each"
            )
        if not 0.0 <= self.short_run <= 1000.0 or not 0.0 <= self.sigma_growth <= 100.0:
            raise CaseError(
                f"short_run is {self.short_run:g} mm and sigma_growth {self.sigma_growth:g}; expected 0 to 1000 and 0 to 100"
            )
        if not 0.5 <= self.aim <= 1.0:
            raise CaseError(f"aim is {self.aim:g}, expected 0.5 to 1 (share of the curvature limit)")


@dataclass(frozen=True, eq=False, kw_only=True)
class Round:
    """State after one round: the curve, the features that carry it, and what was done to get there."""

    index: int
    curve: SplineCurve
    features: tuple[Feature, ...]
    moved: int
    added: int
    decisions: tuple[str, ...]


def first_features(centerline: Centerline, settings: FeatureSettings) -> tuple[Feature, ...]:
    """Features of the scans as frozen points, with parameters by chord length."""
    found = scan_features(centerline.points, settings)
    if len(found) == 2:
        # A line too short for any scan still needs a third point to carry a cubic.
        found.insert(1, (len(centerline.points) // 2, FeatureKind.NODE))
    points = centerline.points[[i for i, _ in found]]
    _, u = spline_through(points)
    return tuple(Feature(kind=kind, point=p, u=float(v)) for (_, kind), p, v in zip(found, points, u, strict=True))


def refine(
    features: tuple[Feature, ...], centerline: Centerline, slices: SliceClearance, limits: Limits, settings: RefineSettings
) -> Iterator[Round]:
    """Yield the state before any repair, then the state after every round.

    Parameters
    ----------
    features : tuple of Feature
        At least three, start first and goal last; these two are never moved.
    centerline : Centerline
        Where features for clearance are taken from.
    slices : SliceClearance
        Set to `limits.clearance_min`.
    """
    tree = cKDTree(centerline.points)
    target = limits.curvature_max * settings.aim
    curve, features = through(features)
    yield Round(
        index=0, curve=curve, features=features, moved=0, added=0, decisions=(f"spline through {len(features)} features",)
    )
    grid = np.linspace(0.0, 1.0, max(int(np.ceil(curve.length / settings.sample_spacing)), 8) + 1)
    unchanged, last_sharp, last_worst = 0, np.empty(0, dtype=np.int64), np.inf
    sliced: FloatArray | None = None
    for index in range(1, settings.max_rounds + 1):
        decisions: list[str] = []
        knots = np.array([f.u for f in features])
        u = np.union1d(grid, knots)
        curvature = curve.curvature(u)
        sharp = np.flatnonzero(curvature > target)
        moving = features_of_runs(sharp, u, knots)
        added: list[tuple[Feature, float]] = []
        place = curve(grid)
        if not len(moving) or sliced is None or np.abs(place - sliced).max() > settings.slice_again:
            short, values = slices.short_samples(curve, grid)
            added = missing_features(features, curve, grid, short, values, centerline, tree, settings)
            # What was added changes the curve around it at once: slice it again next time.
            sliced = None if added else place
        decisions += [
            f"clearance {r:.2f} mm of {limits.clearance_min:g} mm: centerline point added as a feature" for _, r in added
        ]
        if not added and not len(moving):
            return
        worst = float(curvature.max())
        same = not added and np.array_equal(sharp, last_sharp) and worst > last_worst * (1.0 - 1e-6)
        unchanged = unchanged + 1 if same else 0
        if unchanged >= settings.unchanged_rounds:
            return
        last_sharp, last_worst = sharp, worst
        curve, features, moved = relax_inside(features, moving, [f for f, _ in added], slices, grid, settings)
        if len(moving):
            decisions.append(
                f"curvature {worst:.4f} 1/mm of {limits.curvature_max:g}: "
                f"{moved} features moved towards their circles' centres"
                + (f", {len(moving) - moved} held, the path would leave the lumen" if moved < len(moving) else "")
            )
        yield Round(index=index, curve=curve, features=features, moved=moved, added=len(added), decisions=tuple(decisions))


def through(features: tuple[Feature, ...]) -> tuple[SplineCurve, tuple[Feature, ...]]:
    """Spline through the features, and the features with their parameters on it."""
    curve, u = spline_through(np.array([f.point for f in features]))
    return curve, tuple(replace(f, u=float(v)) for f, v in zip(features, u, strict=True))


def runs(indices: IntArray) -> list[IntArray]:
    """Split increasing indices where they are not consecutive."""
    return [run for run in np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1) if len(run)]


def missing_features(
    features: tuple[Feature, ...],
    curve: SplineCurve,
    grid: FloatArray,
    short: IntArray,
    values: FloatArray,
    centerline: Centerline,
    tree: cKDTree,
    settings: RefineSettings,
) -> list[tuple[Feature, float]]:
    """For each long run of short clearance: the centerline point nearest to its worst sample, and that clearance.

    A point closer to a feature than two centerline steps is not added: it would put a
    kink into the spline where the centerline itself is too near to the wall. Where the path
    leaves the lumen, however briefly, the nearest point is taken in any case.

    Parameters
    ----------
    features : tuple of Feature
    curve : SplineCurve
    grid : (n,) float array
        Parameters of the curve at the evenly spaced samples.
    short : (k,) int array
        Indices into `grid` of the samples that are short of clearance, rising.
    values : (k,) float array, mm
        Clearance of those samples.
    centerline : Centerline
    tree : cKDTree
        Of its points.
    settings : RefineSettings
    """
    found: list[tuple[Feature, float]] = []
    taken = np.array([f.point for f in features])
    step = float(np.diff(centerline.arc_length).mean())
    for run in runs(short):
        depths = values[np.searchsorted(short, run)]
        leaves = bool(depths.min() <= 0)
        if (run[-1] - run[0]) * settings.sample_spacing < settings.short_run and not leaves:
            continue
        position = int(run[0] + np.argmin(depths))
        place = curve(grid[[position]])[0]
        point = centerline.points[int(tree.query(place)[1])]
        if np.linalg.norm(taken - point, axis=1).min() < (0.5 if leaves else 2.0) * step:
            continue
        taken = np.vstack([taken, point])
        value = float(values[np.searchsorted(short, position)])
        found.append((Feature(kind=FeatureKind.CLEARANCE, point=point, u=nearest_parameter(curve, grid, point)), value))
    return found


def nearest_parameter(curve: SplineCurve, grid: FloatArray, point: FloatArray) -> float:
    """Grid parameter of the curve point nearest to `point`, kept off the ends."""
    nearest = int(np.argmin(np.linalg.norm(curve(grid) - point, axis=1)))
    return float(grid[np.clip(nearest, 1, len(grid) - 2)])


def features_of_runs(sharp: IntArray, u: FloatArray, knots: FloatArray) -> IntArray:
    """Features to move: those inside each run, or the two around a run that holds none (algorithm 2)."""
    chosen: set[int] = set()
    last = len(knots) - 1
    for run in runs(sharp):
        first = int(np.searchsorted(knots, u[run[0]], side="left"))
        stop = int(np.searchsorted(knots, u[run[-1]], side="right"))
        # Start and goal stay; a run at an end of the path moves the feature next to it.
        inside = set(range(first, stop)) - {0, last}
        chosen |= inside or {first - 1, stop} & set(range(1, last))
    return np.array(sorted(chosen), dtype=np.int64)


def relax_inside(
    features: tuple[Feature, ...],
    moving: IntArray,
    added: list[Feature],
    slices: SliceClearance,
    grid: FloatArray,
    settings: RefineSettings,
) -> tuple[SplineCurve, tuple[Feature, ...], int]:
    """Relax and insert features; those whose move would take the path out of the lumen stay where they are.

    The text relaxes whatever the wall does. In a lumen narrower than its bends that walks
    the path through the wall, and a path outside is no answer: a bend that stays too sharp
    is flagged instead.

    Parameters
    ----------
    features : tuple of Feature
    moving : (k,) int array
        Indices of the features that carry too sharp a bend, or stand beside one; never the first or last.
    added : list of Feature
        To be inserted in the same round.
    slices : SliceClearance
    grid : (n,) float array
        Parameters at which the new curve is looked at.
    settings : RefineSettings

    Returns
    -------
    curve : SplineCurve
    features : tuple of Feature
    moved : int
        How many features were moved.
    """
    knots = np.array([f.u for f in features])
    while True:
        relaxed = relax(features, moving, settings)
        curve, merged = through(tuple(sorted((*relaxed, *added), key=lambda f: f.u)))
        outside = slices.outside(curve, grid)
        if not len(outside) or not len(moving):
            return curve, merged, len(moving)
        right = np.searchsorted(knots, grid[outside])
        kept = np.setdiff1d(moving, np.concatenate([right - 1, right]))
        # With no mover beside the place a farther one did it; then none may move.
        moving = kept if len(kept) < len(moving) else moving[:0]


def relax(features: tuple[Feature, ...], moving: IntArray, settings: RefineSettings) -> tuple[Feature, ...]:
    """Move features towards the centres of the circles through them and their neighbours (eq. 25).

    All circles are taken before any feature moves.
    """
    moved = list(features)
    for i in moving:
        feature = features[i]
        center = circumcenter(features[i - 1].point, feature.point, features[i + 1].point)
        if center is None:
            continue
        base = settings.sigma_extremum if feature.kind is FeatureKind.EXTREMUM else settings.sigma
        rate = min(base * (1.0 + settings.sigma_growth * feature.moved), 0.5)
        moved[i] = replace(feature, point=feature.point + rate * (center - feature.point), moved=feature.moved + 1)
    return tuple(moved)
