"""A curve measured against its wall: profiles, flagged stretches and metrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.centerline import Centerline, even_points
from tubeplan_viz.geometry import SplineCurve, WallDistance, clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.plan import Certificate, FlaggedInterval, FlagKind, Limits, PathProfile

# result.json promises at most 0.25 mm; flagged stretches are found on a finer grid.
PROFILE_SPACING = 0.25
FLAG_SPACING = 0.05


def measure_path(curve: SplineCurve, wall: WallDistance, *, spacing: float = PROFILE_SPACING) -> PathProfile:
    """Sample a curve evenly in arc length, at most `spacing` mm apart, with exact clearances."""
    return profile_at(curve, wall, curve.uniform_parameters(spacing))


def measure_closely(curve: SplineCurve, wall: WallDistance, limits: Limits) -> PathProfile:
    """Sample a curve so that no stretch that breaks a limit slips through between the samples.

    Every `FLAG_SPACING`, at the knots, where the curvature of a cubic spline has its kinks,
    and ten times as fine where a limit is so near that it could be broken in between.
    """
    u = np.union1d(curve.uniform_parameters(FLAG_SPACING), curve.knots)
    profile = profile_at(curve, wall, u)
    gaps = np.diff(profile.arc_length)
    # The clearance is 1-Lipschitz: between two samples it falls by half their distance at most.
    # The curvature is smooth between the knots: it rises by far less than 1 % over 0.05 mm.
    lowest = np.minimum(profile.clearance[:-1], profile.clearance[1:])
    highest = np.maximum(profile.curvature[:-1], profile.curvature[1:])
    near = (np.abs(lowest - limits.clearance_min) < gaps) | (np.abs(highest / limits.curvature_max - 1.0) < 0.01)
    if not near.any():
        return profile
    share = np.arange(1, 10) / 10.0
    between = (u[:-1][near, None] + np.diff(u)[near, None] * share).ravel()
    return profile_at(curve, wall, np.union1d(u, between))


def profile_at(curve: SplineCurve, wall: WallDistance, u: FloatArray) -> PathProfile:
    """A curve measured at increasing parameters, with exact clearances."""
    points = curve(u)
    return PathProfile(
        arc_length=curve.arc_length(u),
        points=points,
        tangents=curve.tangent(u),
        curvature=curve.curvature(u),
        torsion=curve.torsion(u),
        clearance=wall.clearance(points),
    )


def flag_stretches(profile: PathProfile, limits: Limits) -> tuple[FlaggedInterval, ...]:
    """Stretches of a profile on which a limit is broken, in order along the path.

    The ends are where the linear interpolation between samples meets the limit.
    """
    s = profile.arc_length
    found = []
    for kind, excess in (
        (FlagKind.CURVATURE, profile.curvature - limits.curvature_max),
        (FlagKind.CLEARANCE, limits.clearance_min - profile.clearance),
    ):
        bad = np.concatenate([[False], excess > 0, [False]])
        edges = np.flatnonzero(bad[1:] != bad[:-1])
        for first, stop in zip(edges[::2], edges[1::2], strict=True):
            last = stop - 1
            worst = first + int(np.argmax(excess[first:stop]))
            value = profile.curvature[worst] if kind is FlagKind.CURVATURE else profile.clearance[worst]
            start = s[first] if first == 0 else crossing(s, excess, first - 1)
            end = s[last] if last == len(s) - 1 else crossing(s, excess, last)
            found.append(
                FlaggedInterval(kind=kind, start=float(start), end=float(end), worst=float(value), worst_at=float(s[worst]))
            )
    return tuple(sorted(found, key=lambda f: (f.start, f.kind)))


def with_peaks(flagged: tuple[FlaggedInterval, ...], curve: SplineCurve, wall: WallDistance) -> tuple[FlaggedInterval, ...]:
    """Flags whose worst value is that of the curve and not of the sample next to it.

    Beside a kink curvature changes by several percent between samples; around the worst
    sample of each stretch the curve is measured every micrometre or two.
    """
    found = []
    for flag in flagged:
        s = around(flag.worst_at, flag.start, flag.end)
        u = curve.parameter(s)
        bad = curve.curvature(u) if flag.kind is FlagKind.CURVATURE else -wall.clearance(curve(u))
        k = int(np.argmax(bad))
        value = float(abs(bad[k])) if flag.kind is FlagKind.CURVATURE else -float(bad[k])
        worse = value > flag.worst if flag.kind is FlagKind.CURVATURE else value < flag.worst
        found.append(replace(flag, worst=value, worst_at=float(s[k])) if worse else flag)
    return tuple(found)


def sharpest_place(curve: SplineCurve) -> float:
    """Arc length, mm, at which the curvature is largest, to a micrometre or two."""
    u = np.union1d(curve.uniform_parameters(FLAG_SPACING), curve.knots)
    at = float(curve.arc_length(u)[int(np.argmax(curve.curvature(u)))])
    s = around(at, 0.0, curve.length)
    return float(s[int(np.argmax(curve.curvature(curve.parameter(s))))])


def around(at: float, low: float, high: float) -> FloatArray:
    """Arc lengths, mm, on both sides of a sample up to where its neighbours can be, within an interval."""
    return np.linspace(max(at - FLAG_SPACING, low), min(at + FLAG_SPACING, high), 61)


def crossing(s: FloatArray, excess: FloatArray, i: int) -> float:
    """Arc length between samples i and i + 1 at which `excess` is zero."""
    a, b = excess[i], excess[i + 1]
    return float(s[i] + (s[i + 1] - s[i]) * a / (a - b))


def certify(curve: SplineCurve, wall: WallDistance, limits: Limits) -> Certificate:
    """Bounds on curvature and clearance between the samples too, and whether both meet the limits."""
    curvature = curvature_upper_bound(curve, limit=limits.curvature_max)
    clearance = clearance_lower_bound(curve, wall, limit=limits.clearance_min)
    return Certificate(
        holds=curvature.bound <= limits.curvature_max and clearance.bound >= limits.clearance_min,
        curvature_upper_bound=min(curvature.bound, 1e9),
        clearance_lower_bound=clearance.bound,
        method="curvature: Bernstein bounds of the spline's pieces, subdivided to 0.5 %; "
        "clearance: planes that keep each triangle from each piece, subdivided to 0.01 mm",
    )


def path_metrics(profile: PathProfile, centerline: Centerline) -> dict[str, float]:
    """The metrics of result.json that any curved path has."""
    dense = even_points(centerline.points, 0.05)
    return {
        "length_mm": profile.length,
        "curvature_max_per_mm": float(profile.curvature.max()),
        "curvature_mean_per_mm": float(profile.curvature.mean()),
        "clearance_min_mm": float(profile.clearance.min()),
        "clearance_mean_mm": float(profile.clearance.mean()),
        "centerline_distance_mean_mm": float(cKDTree(dense).query(profile.points)[0].mean()),
    }
