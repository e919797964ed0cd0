"""Figures that the report prints and result.json does not hold: one formula each.

A reader, or ``tubeplan verify``, can work each of them out from result.json alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from tubeplan_viz.result import kept_until

DERIVED: Mapping[str, str] = MappingProxyType(
    {
        "derived:margin_mm": "metrics.clearance_min_mm - limits.clearance_min_mm",
        "derived:narrow_by_mm": "limits.clearance_min_mm - details.bottleneck.clearance_upper_bound_mm",
        "derived:kept_until_mm": "path.s_mm at the last sample but one below the least flagged_intervals.N.from_mm",
        "derived:clearance_min_at_mm": "path.s_mm at the first least value of path.clearance_mm",
        "derived:curvature_max_at_mm": "path.s_mm at the first largest value of path.curvature_per_mm",
        "derived:bend_radius_mm": "1 / metrics.curvature_max_per_mm",
        "derived:bend_radius_limit_mm": "1 / limits.curvature_max_per_mm",
        "derived:bend_radius_before_mm": "1 / iterations.0.curvature_max_per_mm",
        "derived:curvature_excess_percent": "100 * (metrics.curvature_max_per_mm / limits.curvature_max_per_mm - 1)",
        "derived:instrument_diameter_mm": "2 * limits.clearance_min_mm",
        "derived:path_diameter_mm": "2 * metrics.clearance_min_mm",
        "derived:flagged_clearance_mm": "sum of to_mm - from_mm over flagged_intervals of kind clearance",
        "derived:flagged_curvature_mm": "sum of to_mm - from_mm over flagged_intervals of kind curvature",
        "derived:flag.N.length_mm": "flagged_intervals.N.to_mm - flagged_intervals.N.from_mm",
        "derived:flag.N.radius_mm": "1 / flagged_intervals.N.worst, kind curvature",
        "derived:flag.N.short_mm": "limits.clearance_min_mm - flagged_intervals.N.worst, kind clearance",
        "derived:time_s": "sum of the values of timings_s",
    }
)


def derived_values(result: Mapping[str, Any]) -> dict[str, float]:
    """The derived figures of one result, by key; those whose terms are absent or zero are left out.

    Parameters
    ----------
    result : mapping
        The content of result.json; lengths in mm, curvatures in 1/mm.

    Returns
    -------
    dict of str to float
        Keys as in `DERIVED`, with ``N`` replaced by the index of the flagged interval.
    """
    limits, metrics, path = (result.get(name) or {} for name in ("limits", "metrics", "path"))
    least, asked = metrics.get("clearance_min_mm"), limits.get("clearance_min_mm")
    sharpest, allowed = metrics.get("curvature_max_per_mm"), limits.get("curvature_max_per_mm")
    flags = result.get("flagged_intervals") or []
    values: dict[str, float] = {}
    if least is not None:
        values["derived:path_diameter_mm"] = 2.0 * least
    if asked is not None:
        values["derived:instrument_diameter_mm"] = 2.0 * asked
    if least is not None and asked is not None:
        values["derived:margin_mm"] = least - asked
    bound = ((result.get("details") or {}).get("bottleneck") or {}).get("clearance_upper_bound_mm")
    if bound is not None and asked is not None:
        values["derived:narrow_by_mm"] = asked - bound
    if (kept := kept_until(result)) is not None:
        values["derived:kept_until_mm"] = kept[0]
    if sharpest:
        values["derived:bend_radius_mm"] = 1.0 / sharpest
    if allowed:
        values["derived:bend_radius_limit_mm"] = 1.0 / allowed
        if sharpest is not None:
            values["derived:curvature_excess_percent"] = 100.0 * (sharpest / allowed - 1.0)
    if path.get("clearance_mm"):
        values["derived:clearance_min_at_mm"] = path["s_mm"][int(np.argmin(path["clearance_mm"]))]
    if path.get("curvature_per_mm"):
        values["derived:curvature_max_at_mm"] = path["s_mm"][int(np.argmax(path["curvature_per_mm"]))]
    iterations = result.get("iterations") or []
    if iterations and iterations[0].get("curvature_max_per_mm"):
        values["derived:bend_radius_before_mm"] = 1.0 / iterations[0]["curvature_max_per_mm"]
    if result.get("timings_s"):
        values["derived:time_s"] = float(sum(result["timings_s"].values()))
    return values | _flag_values(flags, asked)


def _flag_values(flags: list[Mapping[str, Any]], asked: float | None) -> dict[str, float]:
    values = {"derived:flagged_clearance_mm": 0.0, "derived:flagged_curvature_mm": 0.0}
    for index, flag in enumerate(flags):
        length = flag["to_mm"] - flag["from_mm"]
        values[f"derived:flag.{index}.length_mm"] = length
        values[f"derived:flagged_{flag['kind']}_mm"] += length
        if flag["kind"] == "curvature" and flag["worst"]:
            values[f"derived:flag.{index}.radius_mm"] = 1.0 / flag["worst"]
        if flag["kind"] == "clearance" and asked is not None:
            values[f"derived:flag.{index}.short_mm"] = asked - flag["worst"]
    return values
