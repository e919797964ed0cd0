"""From a plan to the content of result.json, and that content to text."""

from __future__ import annotations

import json
import math
import platform as running
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import Enum
from importlib.metadata import version as installed_version
from typing import Any

import numpy as np

from tubeplan_viz.plan import Plan, PlanStep
from tubeplan_viz.result.errors import ResultError
from tubeplan_viz.result.schema import validate_result

SOFTWARE = "tubeplan"
SCHEMA_VERSION = 1
METRICS = (
    "length_mm",
    "curvature_max_per_mm",
    "curvature_mean_per_mm",
    "clearance_min_mm",
    "clearance_mean_mm",
    "centerline_distance_mean_mm",
    "tip_error_mm",
)


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _platform() -> str:
    """Operating system, machine type and Python version: what may change a number, and nothing of whose machine it is."""
    return f"{running.system()} {running.machine()}, Python {running.python_version()}"


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """What made a result.

    Attributes
    ----------
    inputs : tuple of (name, sha256)
        Names without folders, and no patient's name.
    rng_seed : int or None
        None for a planner without randomness.
    settings : mapping
        The case with every default resolved, as in case.toml.
    version : str
    created_utc : str
        ``YYYY-MM-DDTHH:MM:SSZ``.
    platform : str
        Operating system and Python version; no host, no user.
    """

    inputs: tuple[tuple[str, str], ...]
    rng_seed: int | None
    settings: Mapping[str, Any] = field(default_factory=dict)
    software: str = SOFTWARE
    version: str = field(default_factory=lambda: installed_version(SOFTWARE))
    created_utc: str = field(default_factory=_now)
    platform: str = field(default_factory=_platform)

    def details(self) -> dict[str, Any]:
        """The table ``provenance`` of result.json."""
        return {
            "software": self.software,
            "version": self.version,
            "inputs": [{"name": name, "sha256": sha256} for name, sha256 in self.inputs],
            "rng_seed": self.rng_seed,
            "settings": self.settings,
            "created_utc": self.created_utc,
            "platform": self.platform,
        }


def build_result(
    plan: Plan,
    *,
    frame: str,
    timings_s: Mapping[str, float],
    provenance: Provenance,
    details: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The content of result.json as plain JSON values, in the order of its schema.

    Parameters
    ----------
    plan : Plan
    frame : {"LPS", "mesh"}
    timings_s : mapping of stage to seconds
    provenance : Provenance
    details : mapping, optional
        Joined with ``plan.details``; a key in both is an error.

    Returns
    -------
    dict
        Valid by result.schema.json.

    Raises
    ------
    ResultError
        If a number is not finite, or the outcome does not follow the schema.
    """
    details = details or {}
    twice = sorted(set(details) & set(plan.details))
    if twice:
        raise ResultError(
            f"result.json: details {', '.join(twice)} come from the planner and the pipeline, expected from one of them"
        )
    return assemble_result(
        {
            "status": plan.status,
            "reason": plan.reason,
            "planner": {"name": plan.planner, "method": plan.method},
            "frame": frame,
            "limits": {"curvature_max_per_mm": plan.limits.curvature_max, "clearance_min_mm": plan.limits.clearance_min},
            "path": {
                "s_mm": plan.profile.arc_length,
                "points_mm": plan.profile.points,
                "curvature_per_mm": plan.profile.curvature,
                "clearance_mm": plan.profile.clearance,
            },
            "spline": {"degree": plan.curve.degree, "knots": plan.curve.knots, "control_points_mm": plan.curve.control_points},
            "centerline": {"points_mm": plan.centerline.points, "radius_mm": plan.centerline.radii},
            "feature_points": _feature_points(plan),
            "metrics": plan.metrics,
            "certificate": {
                "holds": plan.certificate.holds,
                "curvature_upper_bound_per_mm": plan.certificate.curvature_upper_bound,
                "clearance_lower_bound_mm": plan.certificate.clearance_lower_bound,
                "method": plan.certificate.method,
            },
            "flagged_intervals": [
                {"kind": flag.kind, "from_mm": flag.start, "to_mm": flag.end, "worst": flag.worst, "worst_at_mm": flag.worst_at}
                for flag in plan.flagged
            ],
            "iterations": [_iteration(step) for step in plan.steps],
            "details": {**plan.details, **details},
        },
        timings_s=timings_s,
        provenance=provenance,
    )


def assemble_result(content: Mapping[str, Any], *, timings_s: Mapping[str, float], provenance: Provenance) -> dict[str, Any]:
    """The content of result.json from what a planner says, for paths of every kind.

    Parameters
    ----------
    content : mapping
        Keys of result.json from ``status`` to ``details``; those left out that do not apply become null (or an empty list).
    timings_s : mapping of stage to seconds
    provenance : Provenance

    Returns
    -------
    dict
        Valid by result.schema.json.

    Raises
    ------
    ResultError
        If a number is not finite, or the outcome does not follow the schema.
    """
    metrics = content["metrics"]
    result = plain(
        {
            "schema_version": SCHEMA_VERSION,
            "status": content["status"],
            "reason": content["reason"],
            "planner": {**content["planner"], "version": provenance.version},
            "frame": content["frame"],
            "limits": content["limits"],
            **{name: content.get(name) for name in ("path", "spline", "centerline", "feature_points")},
            "metrics": {name: metrics.get(name) for name in (*METRICS, *(key for key in metrics if key not in METRICS))},
            "certificate": content.get("certificate"),
            "flagged_intervals": content.get("flagged_intervals", []),
            "iterations": content.get("iterations"),
            "details": content.get("details", {}),
            "timings_s": timings_s,
            "provenance": provenance.details(),
        }
    )
    validate_result(result)
    document: dict[str, Any] = result
    return document


def _feature_points(plan: Plan) -> list[dict[str, Any]]:
    if not plan.features:
        return []
    places = plan.curve.arc_length([feature.u for feature in plan.features])
    return [
        {"point_mm": feature.point, "kind": feature.kind, "s_mm": place}
        for feature, place in zip(plan.features, places, strict=True)
    ]


def _iteration(step: PlanStep) -> dict[str, Any]:
    return {
        "index": step.index,
        "feature_count": len(step.features),
        "curvature_max_per_mm": step.profile.curvature.max(),
        "clearance_min_mm": step.profile.clearance.min(),
        "moved": step.moved,
        "added": step.added,
    }


def plain(value: Any, place: str = "") -> Any:
    """`value` as dicts with text keys, lists, text, bool, int, finite float and None only.

    Arrays, NumPy scalars, enumerations and tuples are turned into these.

    Raises
    ------
    ResultError
        Naming the key that holds a number that is not finite or another kind of object.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item, f"{place}.{key}" if place else str(key)) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "biuf" and (value.dtype.kind != "f" or np.isfinite(value).all()):
            return value.tolist()
        return plain(value.tolist(), place)
    if isinstance(value, Enum):
        return plain(value.value, place)
    if isinstance(value, (list, tuple)):
        return [plain(item, f"{place}.{index}") for index, item in enumerate(value)]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        if not math.isfinite(value):
            raise ResultError(f"result.json: {place} is {float(value)}, expected a finite number or null where none applies")
        return float(value)
    if value is None or isinstance(value, str):
        return value
    raise ResultError(f"result.json: {place} is of type {type(value).__name__}, expected a number, text, list or table")


def result_text(result: Mapping[str, Any]) -> str:
    """JSON text: keys in their order, a line for each key, row or point, numbers in their shortest exact form."""
    return _layout(result, 0) + "\n"


def _layout(value: Any, depth: int) -> str:
    inner, outer = "  " * (depth + 1), "  " * depth
    if isinstance(value, Mapping) and value and depth < 3:
        rows = [f"{inner}{json.dumps(str(key))}: {_layout(item, depth + 1)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{outer}}}"
    rows_inside = isinstance(value, Sequence) and not isinstance(value, str) and value and isinstance(value[0], (list, dict))
    if rows_inside and depth < 4:
        return "[\n" + ",\n".join(inner + json.dumps(item, allow_nan=False) for item in value) + f"\n{outer}]"
    return json.dumps(value, allow_nan=False)
