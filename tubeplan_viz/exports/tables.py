"""The run's lists as comma-separated tables; every number is result.json's, in its shortest exact form."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Comma-separated text with one header line; numbers read back to the same double, None is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(["" if cell is None else repr(cell) if isinstance(cell, float) else cell for cell in row] for row in rows)
    return text.getvalue()


def flags_csv(result: Mapping[str, Any]) -> str:
    """Flagged stretches in their order."""
    keys = ("kind", "from_mm", "to_mm", "worst", "worst_at_mm")
    return table(keys, ([flag[key] for key in keys] for flag in result["flagged_intervals"]))


def features_csv(result: Mapping[str, Any]) -> str:
    """Points that carry the spline."""
    rows = ([point["kind"], point["s_mm"], *point["point_mm"]] for point in result["feature_points"] or [])
    return table(("kind", "s_mm", "x_mm", "y_mm", "z_mm"), rows)


def centerline_csv(result: Mapping[str, Any]) -> str:
    """Middle line of the lumen with inscribed radii; the header alone where there is none."""
    line = result["centerline"] or {"points_mm": [], "radius_mm": []}
    rows = ([*point, radius] for point, radius in zip(line["points_mm"], line["radius_mm"], strict=True))
    return table(("x_mm", "y_mm", "z_mm", "radius_mm"), rows)


def metrics_csv(result: Mapping[str, Any]) -> str:
    """Limits and key figures by their names in result.json."""
    rows = [
        (f"{group}.{name}", value)
        for group in ("limits", "metrics", "certificate")
        for name, value in (result[group] or {}).items()
        if not isinstance(value, str)
    ]
    return table(("key", "value"), rows)


def measures_csv(result: Mapping[str, Any]) -> str:
    """Clinical measures, one a line, with the reason where one could not be computed."""
    keys = ("key", "of", "name", "value", "unit", "reason")
    items = (result["details"].get("measures") or {}).get("items", [])
    return table(keys, ([item[key] for key in keys] for item in items))


TABLES = {
    "metrics.csv": metrics_csv,
    "flags.csv": flags_csv,
    "features.csv": features_csv,
    "centerline.csv": centerline_csv,
    "measures.csv": measures_csv,
}
