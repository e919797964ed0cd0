"""What changes with every iteration: curve, features, flagged intervals, profiles, convergence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike

from segmentation.arrays import BoolArray, FloatArray
from tubeplan_viz.plan import Feature, FeatureKind, FlaggedInterval, FlagKind, Limits, PlanStep
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.sink import Sink

LIGHT_SPACING_MM = 2.0
CURVE_SPACING_MM = 0.5
FLAG_RADIUS = {FlagKind.CURVATURE: 3.6, FlagKind.CLEARANCE: 5.2}
LABELLED = (FeatureKind.START, FeatureKind.GOAL)


@dataclass(frozen=True, eq=False, kw_only=True)
class Track:
    """A sampled path as the recording draws it: (n,) arc lengths in mm, (n, 3) points, (n,) curvature and clearance."""

    arc_length: FloatArray
    points: FloatArray
    curvature: FloatArray
    clearance: FloatArray

    def values(self, kind: FlagKind) -> FloatArray:
        """The quantity that a limit of this kind bounds."""
        return self.curvature if kind is FlagKind.CURVATURE else self.clearance

    def at(self, arc_length: ArrayLike) -> FloatArray:
        """Points at (k,) arc lengths in mm, interpolated: (k, 3)."""
        s = np.asarray(arc_length, dtype=float)
        return np.column_stack([np.interp(s, self.arc_length, self.points[:, k]) for k in range(3)])

    def tightest(self) -> int:
        """Index of the least clearance."""
        return int(np.argmin(self.clearance))

    def broken(self, kind: FlagKind, limits: Limits) -> BoolArray:
        """Samples that break the limit."""
        return np.asarray(
            self.curvature > limits.curvature_max if kind is FlagKind.CURVATURE else self.clearance < limits.clearance_min
        )

    def thinned(self, spacing: float) -> Track:
        """Samples about `spacing` apart, together with the ends and the extremes."""
        stride = max(round(spacing / max(self.arc_length[-1] / max(len(self.arc_length) - 1, 1), 1e-9)), 1)
        extremes = [len(self.arc_length) - 1, int(np.argmax(self.curvature)), self.tightest()]
        keep = np.unique([*range(0, len(self.arc_length), stride), *extremes])
        return Track(
            arc_length=self.arc_length[keep],
            points=self.points[keep],
            curvature=self.curvature[keep],
            clearance=self.clearance[keep],
        )


def step_track(step: PlanStep) -> Track:
    """The samples of one iteration."""
    profile = step.profile
    return Track(arc_length=profile.arc_length, points=profile.points, curvature=profile.curvature, clearance=profile.clearance)


def log_legend(sink: Sink, limits: Limits) -> None:
    """Names and colours of the plots, once and for all times."""
    series = {
        f"{at.CONVERGENCE}/curvature": at.FLAG_COLORS[FlagKind.CURVATURE],
        f"{at.CONVERGENCE}/limit": at.LIMIT[:3],
        f"{at.COUNTS}/features": at.PATH,
        f"{at.COUNTS}/moved": at.CENTERLINE_COLOR,
        f"{at.COUNTS}/added": at.OK,
    }
    if limits.clearance_min > 0.0:
        series[f"{at.CONVERGENCE}/clearance"] = at.FLAG_COLORS[FlagKind.CLEARANCE]
    for entity, color in series.items():
        name = entity.rpartition("/")[2]
        # The points show a run of a single iteration, which has no line.
        sink.log(entity, rr.SeriesLines(names=name, colors=color, widths=1.8), static=True)
        if name != "limit":
            sink.log(entity, rr.SeriesPoints(names=name, colors=color, marker_sizes=2.6), static=True)


def log_step(sink: Sink, step: PlanStep, limits: Limits, *, light: bool) -> None:
    """Everything of one iteration at the current time, but the slices and the summary."""
    track = step_track(step)
    sink.log(
        at.SPLINE,
        rr.AnyValues(degree=step.curve.degree, knots=step.curve.knots, control_points_mm=step.curve.control_points.ravel()),
    )
    sink.log(
        at.FACTS,
        rr.AnyValues(
            curvature_max_per_mm=float(track.curvature.max()),
            clearance_min_mm=float(track.clearance.min()),
            length_mm=float(track.arc_length[-1]),
        ),
    )
    log_track(sink, track, limits, light=light)
    log_flagged(sink, track, step.flagged)
    log_features(sink, step.features)
    _log_convergence(sink, step, track, limits)


def log_track(sink: Sink, track: Track, limits: Limits, *, light: bool) -> None:
    """Curve in 3D, and curvature and clearance over arc length beside their limits."""
    drawn = track.thinned(LIGHT_SPACING_MM if light else CURVE_SPACING_MM)
    sink.log(at.CURVE, rr.LineStrips3D([drawn.points], colors=at.PATH, radii=rr.Radius.ui_points(2.0)))
    bars = drawn if light else track
    for kind in FlagKind:
        limit = limits.curvature_max if kind is FlagKind.CURVATURE else limits.clearance_min
        log_bars(sink, kind, bars.arc_length, bars.values(kind), bars.broken(kind, limits), limit, single=light)


def log_bars(
    sink: Sink,
    kind: FlagKind,
    arc_length: FloatArray,
    values: FloatArray,
    broken: BoolArray,
    limit: float,
    *,
    single: bool = False,
    static: bool = False,
) -> None:
    """One quantity over arc length as bars, those that break the limit in its colour, with the limit behind them.

    Parameters
    ----------
    sink : Sink
    kind : FlagKind
    arc_length, values, broken : (n,) arrays
        Places in mm, the quantity there, and whether it breaks its limit.
    limit : float
    single : bool
        Keep single precision.
    static : bool
        Log for all times instead of the present one.
    """
    number = np.float32 if single else np.float64
    # A little overlap, or the viewer leaves dark seams between bars that are two pixels wide.
    widths = 1.15 * np.diff(arc_length, append=2.0 * arc_length[-1] - arc_length[-2])
    for part, chosen, color in (("ok", ~broken, at.OK), ("flagged", broken, at.FLAG_COLORS[kind])):
        bars = rr.BarChart(
            values[chosen].astype(number), abscissa=arc_length[chosen].astype(number), widths=widths[chosen], color=color
        )
        if not static:
            sink.log_some(at.profile_path(kind, part), int(chosen.sum()), bars)
        elif chosen.any():
            sink.log(at.profile_path(kind, part), bars, static=True)
    span = rr.BarChart([limit], abscissa=[0.0], widths=[float(arc_length[-1])], color=at.LIMIT)
    sink.log(at.profile_path(kind, "limit"), span, static=static)


def log_flagged(sink: Sink, track: Track, flagged: Sequence[FlaggedInterval]) -> None:
    """Flagged stretches in 3D, red for curvature and orange for clearance, each with its worst place and value."""
    drawn = track.thinned(CURVE_SPACING_MM)
    for kind in FlagKind:
        mine = [flag for flag in flagged if flag.kind is kind]
        strips = [_stretch(drawn, flag.start, flag.end) for flag in mine]
        sink.log_some(
            at.flagged_path(kind),
            len(mine),
            rr.LineStrips3D(
                strips,
                colors=at.FLAG_COLORS[kind],
                radii=rr.Radius.ui_points(FLAG_RADIUS[kind]),
            ),
            rr.AnyValues(
                start_mm=np.array([flag.start for flag in mine], dtype=float),
                end_mm=np.array([flag.end for flag in mine], dtype=float),
                worst=np.array([flag.worst for flag in mine], dtype=float),
                worst_at_mm=np.array([flag.worst_at for flag in mine], dtype=float),
            ),
        )
        sink.log_some(
            f"{at.flagged_path(kind)}/worst",
            len(mine),
            rr.Points3D(
                track.at([flag.worst_at for flag in mine]),
                colors=at.FLAG_COLORS[kind],
                radii=rr.Radius.ui_points(FLAG_RADIUS[kind] + 1.5),
                labels=[worst_label(flag) for flag in mine],
                show_labels=True,
            ),
        )


def log_features(sink: Sink, features: Sequence[Feature]) -> None:
    """Features by kind; only start and goal show their names until the others are asked for."""
    for kind in FeatureKind:
        mine = [feature for feature in features if feature.kind is kind]
        sink.log_some(
            at.feature_path(kind),
            len(mine),
            rr.Points3D(
                [feature.point for feature in mine],
                colors=at.FEATURE_COLORS[kind],
                radii=rr.Radius.ui_points(5.0 if kind in LABELLED else 3.6),
                labels=[kind.value if not feature.moved else f"{kind.value}, moved {feature.moved} x" for feature in mine],
                show_labels=kind in LABELLED,
            ),
        )
    sink.log(
        at.FEATURES,
        rr.AnyValues(
            kind=[feature.kind.value for feature in features],
            point_mm=np.array([feature.point for feature in features], dtype=float).ravel(),
            u=np.array([feature.u for feature in features], dtype=float),
            moved=np.array([feature.moved for feature in features], dtype=np.int64),
        ),
    )


def flag_label(flag: FlaggedInterval) -> str:
    """One flagged interval in words."""
    return f"{worst_label(flag)} between {flag.start:.1f} and {flag.end:.1f} mm"


def worst_label(flag: FlaggedInterval) -> str:
    """The worst value of a flagged interval in words."""
    return f"{flag.kind.value} " + (f"{flag.worst:.3f} 1/mm" if flag.kind is FlagKind.CURVATURE else f"{flag.worst:.2f} mm")


def result_track(path: Mapping[str, Any]) -> Track:
    """The planned path of result.json as samples."""
    return Track(
        arc_length=np.asarray(path["s_mm"], dtype=float),
        points=np.asarray(path["points_mm"], dtype=float),
        curvature=np.asarray(path["curvature_per_mm"], dtype=float),
        clearance=np.asarray(path["clearance_mm"], dtype=float),
    )


def result_flags(intervals: Sequence[Mapping[str, Any]]) -> tuple[FlaggedInterval, ...]:
    """The flagged intervals of result.json."""
    return tuple(
        FlaggedInterval(
            kind=FlagKind(each["kind"]),
            start=float(each["from_mm"]),
            end=float(each["to_mm"]),
            worst=float(each["worst"]),
            worst_at=float(each["worst_at_mm"]),
        )
        for each in intervals
    )


def result_features(points: Sequence[Mapping[str, Any]], length: float) -> tuple[Feature, ...]:
    """The feature points of result.json; `u` is their share of the arc length."""
    return tuple(
        Feature(kind=FeatureKind(each["kind"]), point=each["point_mm"], u=float(each["s_mm"]) / max(length, 1e-9))
        for each in points
    )


def _log_convergence(sink: Sink, step: PlanStep, track: Track, limits: Limits) -> None:
    sink.log(f"{at.CONVERGENCE}/curvature", rr.Scalars(float(track.curvature.max()) / limits.curvature_max))
    if limits.clearance_min > 0.0:
        sink.log(f"{at.CONVERGENCE}/clearance", rr.Scalars(float(track.clearance.min()) / limits.clearance_min))
    sink.log(f"{at.CONVERGENCE}/limit", rr.Scalars(1.0))
    for name, count in (("features", len(step.features)), ("moved", step.moved), ("added", step.added)):
        sink.log(f"{at.COUNTS}/{name}", rr.Scalars(float(count)))


def _stretch(track: Track, start: float, end: float) -> FloatArray:
    """Points of the path from `start` to `end` mm, both interpolated."""
    inner = (track.arc_length > start) & (track.arc_length < end)
    return track.at(np.concatenate([[start], track.arc_length[inner], [end]]))
