"""The tables of the report: before and after, feature points, facts, folds, and the numbers behind the charts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reports.numbers import Figure, Phrase, Source, phrase, printed
from reports.words import part_at
from tubeplan_viz.result import STRAIGHT_MM

KINDS = {
    "start": "Start",
    "goal": "Goal",
    "extremum": "Curvature extremum",
    "segment": "Bend end",
    "inflection": "Inflection",
    "node": "Wide-range node",
    "clearance": "Added for clearance",
}


@dataclass(frozen=True)
class MeasureRow:
    """One measure before and after planning, with its limit; `tone` marks a limit that is broken."""

    name: str
    before: Phrase
    after: Phrase
    limit: Phrase
    tone: str = ""


@dataclass(frozen=True)
class FeatureRow:
    """One feature point; `clearance` and `curvature` are those of the planned path there."""

    index: int
    kind: str
    name: str
    part: str
    arc: Phrase
    clearance: Phrase
    curvature: Phrase
    position: Phrase
    tight: bool
    sharp: bool
    go: float | None


DASH = phrase("–")


def or_dash(figure: Figure | None) -> Phrase:
    """The figure, or a dash where the result has none."""
    return DASH if figure is None else phrase(figure)


def radius_or_straight(figure: Figure | None) -> Phrase:
    """A bend radius, or the word where there is no bend to speak of; a dash where the result has none."""
    return phrase("straight") if figure is not None and figure.value >= STRAIGHT_MM else or_dash(figure)


def measures(source: Source, first: Mapping[str, Any]) -> tuple[MeasureRow, ...]:
    """Before (iteration 0) against planned, row by row; measures that the planner does not give are left out."""
    limits = source.result.get("limits") or {}
    allowed, asked = limits.get("curvature_max_per_mm"), limits.get("clearance_min_mm")
    sharp = "curvature" if (source.value("derived:curvature_excess_percent") or 0.0) > 0.0 else ""
    tight = "clearance" if (source.value("derived:margin_mm") or 0.0) < 0.0 else ""
    flags = source.result.get("flagged_intervals") or []
    kinds = {flag["kind"] for flag in flags}

    def mean(name: str, digits: int) -> Phrase:
        """Mean over arc length of a profile of iteration 0, which result.json does not hold."""
        values, arc = first.get(name), first.get("s_mm")
        if not values or not arc or len(values) < 2:
            return DASH
        return phrase(printed(float(np.trapezoid(values, arc) / (arc[-1] - arc[0])), digits))

    rows = [
        (
            "metrics.curvature_max_per_mm",
            MeasureRow(
                "Largest curvature, 1/mm",
                or_dash(source.figure("iterations.0.curvature_max_per_mm", 4)),
                or_dash(source.figure("metrics.curvature_max_per_mm", 4)),
                or_dash(source.figure("limits.curvature_max_per_mm", 4)),
                sharp,
            ),
        ),
        (
            "derived:bend_radius_mm",
            MeasureRow(
                "Least bend radius, mm",
                radius_or_straight(source.figure("derived:bend_radius_before_mm", 2)),
                radius_or_straight(source.figure("derived:bend_radius_mm", 2)),
                or_dash(source.figure("derived:bend_radius_limit_mm", 2)),
                sharp,
            ),
        ),
        (
            "metrics.curvature_max_per_mm",
            MeasureRow(
                "Bent beyond the limit, mm",
                _beyond(first, "curvature_per_mm", allowed, 1.0),
                or_dash(source.figure("derived:flagged_curvature_mm", 1)),
                phrase("0.0"),
                "curvature" if "curvature" in kinds else "",
            ),
        ),
        (
            "metrics.curvature_mean_per_mm",
            MeasureRow(
                "Mean curvature, 1/mm",
                mean("curvature_per_mm", 4),
                or_dash(source.figure("metrics.curvature_mean_per_mm", 4)),
                DASH,
            ),
        ),
        (
            "metrics.clearance_min_mm",
            MeasureRow(
                "Least clearance, mm",
                or_dash(source.figure("iterations.0.clearance_min_mm", 3)),
                or_dash(source.figure("metrics.clearance_min_mm", 3)),
                or_dash(source.figure("limits.clearance_min_mm", 3)),
                tight,
            ),
        ),
        (
            "metrics.clearance_min_mm",
            MeasureRow(
                "Short of clearance, mm",
                _beyond(first, "clearance_mm", asked, -1.0),
                or_dash(source.figure("derived:flagged_clearance_mm", 1)),
                phrase("0.0"),
                "clearance" if "clearance" in kinds else "",
            ),
        ),
        (
            "metrics.clearance_mean_mm",
            MeasureRow(
                "Mean clearance, mm", mean("clearance_mm", 3), or_dash(source.figure("metrics.clearance_mean_mm", 3)), DASH
            ),
        ),
        (
            "metrics.centerline_distance_mean_mm",
            MeasureRow(
                "Mean distance to centerline, mm", DASH, or_dash(source.figure("metrics.centerline_distance_mean_mm", 3)), DASH
            ),
        ),
        ("metrics.tip_error_mm", MeasureRow("Tip error, mm", DASH, or_dash(source.figure("metrics.tip_error_mm", 3)), DASH)),
        (
            "metrics.length_mm",
            MeasureRow(
                "Length, mm",
                phrase(printed(float(first["s_mm"][-1]), 1)) if first.get("s_mm") else DASH,
                or_dash(source.figure("metrics.length_mm", 1)),
                DASH,
            ),
        ),
    ]
    return tuple(row for key, row in rows if source.value(key) is not None)


def _beyond(first: Mapping[str, Any], name: str, limit: float | None, sign: float) -> Phrase:
    """Arc length of iteration 0 on which the limit is broken, from its samples."""
    if limit is None or not first.get(name) or not first.get("s_mm"):
        return DASH
    values, arc = np.asarray(first[name], float), np.asarray(first["s_mm"], float)
    share = ((values - limit) * sign > 0).astype(float)
    return phrase(printed(float(np.trapezoid(share, arc)), 1))


def feature_rows(source: Source, parts: Sequence[Mapping[str, Any]]) -> tuple[FeatureRow, ...]:
    """The feature points in the order of result.json."""
    limits, path = source.result.get("limits") or {}, source.result.get("path") or {}
    arc = np.asarray(path.get("s_mm") or [], float)
    allowed, asked = limits.get("curvature_max_per_mm"), limits.get("clearance_min_mm")
    rows = []
    for k, feature in enumerate(source.result.get("feature_points") or []):
        at = feature.get("s_mm")
        nearest = int(np.abs(arc - at).argmin()) if at is not None and len(arc) else None
        clearance = None if nearest is None else source.figure(f"path.clearance_mm.{nearest}", 2)
        curvature = None if nearest is None else source.figure(f"path.curvature_per_mm.{nearest}", 3)
        kind = str(feature["kind"])
        x, y, z = (source.need(f"feature_points.{k}.point_mm.{axis}", 1) for axis in range(3))
        rows.append(
            FeatureRow(
                index=k + 1,
                kind=kind,
                name=KINDS.get(kind, kind),
                part=part_at(parts, at) if at is not None else "",
                arc=or_dash(source.figure(f"feature_points.{k}.s_mm", 1)),
                clearance=or_dash(clearance),
                curvature=or_dash(curvature),
                position=phrase(x, ", ", y, ", ", z),
                tight=clearance is not None and asked is not None and clearance.value < asked,
                sharp=curvature is not None and allowed is not None and curvature.value > allowed,
                go=at,
            )
        )
    return tuple(rows)
