"""Runs side by side: what compare.json holds, which figure is the better one, and whether the paths may be overlaid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.mesh import Surface
from segmentation.mesh_files import read_ply
from tubeplan_viz.result.document import SOFTWARE, Provenance, plain
from tubeplan_viz.result.errors import RunFolderError
from tubeplan_viz.result.folder import file_sha256, read_result

COMPARISON_FILES = ("compare.json", "report.html", "recording.rrd")  # the first names the kind of folder
LABELS = "ABCDEF"
STRAIGHT_MM = 1000.0  # bends of a larger radius are called straight, and compared as equal
ENDS_APART_MM = 0.5  # two spacings of the path in result.json
TAKEN_OVER = (
    "status",
    "reason",
    "planner",
    "frame",
    "limits",
    "metrics",
    "certificate",
    "flagged_intervals",
    "path",
    "timings_s",
)


@dataclass(frozen=True)
class Measure:
    """One row of the difference table.

    `key` leads into a run of compare.json, or is worked out by `figure_of`; `better` is
    ``higher``, ``lower`` or empty where neither is better.
    """

    key: str
    title: str
    unit: str
    digits: int
    better: str


MEASURES = (
    Measure("margin_mm", "Worst margin: least clearance less its limit", "mm", 2, "higher"),
    Measure("metrics.clearance_min_mm", "Least clearance", "mm", 2, "higher"),
    Measure("metrics.clearance_mean_mm", "Mean clearance", "mm", 2, "higher"),
    Measure("flagged_clearance_mm", "Short of clearance", "mm", 1, "lower"),
    Measure("certificate.clearance_lower_bound_mm", "Proved least clearance", "mm", 2, "higher"),
    Measure("bend_radius_mm", "Least bend radius", "mm", 2, "higher"),
    Measure("metrics.curvature_max_per_mm", "Largest curvature", "1/mm", 4, "lower"),
    Measure("metrics.curvature_mean_per_mm", "Mean curvature", "1/mm", 4, "lower"),
    Measure("bend_used_percent", "Largest curvature, share of its limit", "%", 0, "lower"),
    Measure("flagged_curvature_mm", "Bent beyond the limit", "mm", 1, "lower"),
    Measure("certificate.curvature_upper_bound_per_mm", "Proved largest curvature", "1/mm", 4, "lower"),
    Measure("metrics.length_mm", "Length", "mm", 1, "lower"),
    Measure("metrics.tip_error_mm", "Tip error", "mm", 2, "lower"),
    Measure("metrics.centerline_distance_mean_mm", "Mean distance to the centerline", "mm", 2, ""),
    Measure("time_s", "Computing time", "s", 1, "lower"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class ComparedRun:
    """One finished run as it is compared.

    Attributes
    ----------
    label : str
        ``A``, ``B``, ... in the order given.
    name : str
        The run folder's name.
    result : mapping
        The content of result.json.
    sha256 : str
        Of result.json.
    surface : Surface or None
        From mesh.ply; None for a run without one.
    """

    label: str
    name: str
    result: Mapping[str, Any]
    sha256: str
    surface: Surface | None

    @property
    def case_id(self) -> str:
        """The case's own name."""
        return str((self.result.get("details") or {}).get("case_id") or "case")


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """Runs side by side; `document` is the content of compare.json and `overlaid` whether they share frame and wall."""

    runs: tuple[ComparedRun, ...]
    document: Mapping[str, Any]
    overlaid: bool

    @property
    def surface(self) -> Surface | None:
        """The wall that all runs share; None where they do not, or have none."""
        return self.runs[0].surface if self.overlaid else None


def read_runs(folders: Sequence[Path]) -> tuple[ComparedRun, ...]:
    """The runs in these folders, labelled in the order given.

    Raises
    ------
    RunFolderError
        If there are fewer than two or more than six, one is named twice, or one is no run.
    ResultError
        If a result.json does not follow the schema.
    """
    if not 2 <= len(folders) <= len(LABELS):
        raise RunFolderError(
            f"{len(folders)} run folder{'' if len(folders) == 1 else 's'} given, expected 2 to {len(LABELS)} to lay side by side"
        )
    places = [folder.resolve() for folder in folders]
    for place in places:
        if places.count(place) > 1:
            raise RunFolderError(f"{place.name} is named twice; name different runs")
    names = [place.name for place in places]
    # Folders of one name in different places are told apart by what they stand in.
    shown = [f"{place.parent.name}/{name}" if names.count(name) > 1 else name for place, name in zip(places, names, strict=True)]
    runs = []
    for label, name, place in zip(LABELS, shown, places, strict=False):
        mesh = place / "mesh.ply"
        runs.append(
            ComparedRun(
                label=label,
                name=name,
                result=read_result(place),
                sha256=file_sha256(place / "result.json"),
                surface=read_ply(mesh) if mesh.is_file() else None,
            )
        )
    return tuple(runs)


def compare_runs(runs: Sequence[ComparedRun]) -> Comparison:
    """The runs with what tells them apart, figure by figure."""
    apart = why_not_overlaid(runs)
    entries = [
        {"label": run.label, "name": run.name, "case_id": run.case_id, "result_sha256": run.sha256}
        | {key: run.result.get(key) for key in TAKEN_OVER}
        | {"provenance": {key: run.result["provenance"].get(key) for key in ("version", "created_utc", "inputs", "rng_seed")}}
        for run in runs
    ]
    origin = Provenance(inputs=tuple((run.name, run.sha256) for run in runs), rng_seed=None)
    document: dict[str, Any] = plain(
        {
            "schema_version": 1,
            "use": "research use, not for clinical decisions",
            "runs": entries,
            "rows": [row for measure in MEASURES if (row := _row(measure, runs)) is not None],
            "differences": differences(runs),
            "overlay": {"drawn": not apart, "reason": apart or "all runs share one frame and one wall"},
            "notes": list(_notes(runs)),
            "provenance": {
                "software": SOFTWARE,
                "version": origin.version,
                "created_utc": origin.created_utc,
                "inputs": [{"name": name, "sha256": digest} for name, digest in origin.inputs],
            },
        }
    )
    return Comparison(runs=tuple(runs), document=document, overlaid=not apart)


def figure_of(result: Mapping[str, Any], key: str) -> float | None:
    """One figure of a result by the key of its measure, or None where it has none."""
    metrics, limits = result["metrics"], result["limits"]
    least, sharpest = metrics.get("clearance_min_mm"), metrics.get("curvature_max_per_mm")
    asked, allowed = limits.get("clearance_min_mm"), limits.get("curvature_max_per_mm")
    if key == "margin_mm":
        return None if least is None or asked is None else least - asked
    if key == "bend_radius_mm":
        return 1.0 / sharpest if sharpest else None
    if key == "bend_used_percent":
        return 100.0 * sharpest / allowed if allowed and sharpest is not None else None
    if key in ("flagged_clearance_mm", "flagged_curvature_mm"):
        if not result.get("path"):
            return None
        kind = key.split("_")[1]
        return float(sum(flag["to_mm"] - flag["from_mm"] for flag in result["flagged_intervals"] if flag["kind"] == kind))
    if key == "time_s":
        return float(sum(result["timings_s"].values())) if result.get("timings_s") else None
    found: Any = result
    for name in key.split("."):
        found = found.get(name) if isinstance(found, Mapping) else None
    return None if found is None else float(found)


def _row(measure: Measure, runs: Sequence[ComparedRun]) -> dict[str, Any] | None:
    values = [figure_of(run.result, measure.key) for run in runs]
    if all(value is None for value in values):
        return None
    first = values[0]
    straight = [measure.key == "bend_radius_mm" and value is not None and value >= STRAIGHT_MM for value in values]
    compared = [STRAIGHT_MM if none_bent else value for value, none_bent in zip(values, straight, strict=True)]
    return {
        "key": measure.key,
        "title": measure.title,
        "unit": measure.unit,
        "digits": measure.digits,
        "better": measure.better or None,
        "values": values,
        "difference": [
            None if value is None or first is None or straight[0] or none_bent else value - first
            for value, none_bent in zip(values, straight, strict=True)
        ],
        "best": better_of(compared, measure.better, measure.digits),
    }


def better_of(values: Sequence[float | None], better: str, digits: int) -> list[int]:
    """Which values are the better ones: none where a value is missing or all print alike.

    Values that print alike count as equal, so that nothing is marked which a reader cannot see.

    Examples
    --------
    >>> better_of([1.18, 1.88, 1.879], "higher", 2), better_of([3.0, 3.001], "lower", 2)
    ([1, 2], [])
    """
    known = [value for value in values if value is not None]
    if not better or len(known) < len(values):
        return []
    seen = [round(value, digits) for value in known]
    best = max(seen) if better == "higher" else min(seen)
    found = [index for index, value in enumerate(seen) if value == best]
    return [] if len(found) == len(values) else found


def why_not_overlaid(runs: Sequence[ComparedRun]) -> str:
    """Why the paths must not be drawn into one picture, in a sentence; empty where they may."""
    first = runs[0]
    for run in runs[1:]:
        pair = f"{first.label} and {run.label}"
        if run.result["frame"] != first.result["frame"]:
            return (
                f"{pair} have different frames ({first.result['frame']} and {run.result['frame']}), "
                "so their points do not mean the same places"
            )
        if (run.surface is None) != (first.surface is None):
            return f"only one of {pair} has a mesh, so it is not known whether they share a frame"
        if first.surface is None or run.surface is None:
            if _inputs(run) != _inputs(first):
                return f"{pair} were made from different inputs and have no mesh, so it is not known whether they share a frame"
        elif not np.array_equal(first.surface.vertices, run.surface.vertices):
            same = " of the same image" if _inputs(run) == _inputs(first) else ""
            return f"{pair} run in different meshes{same}, so one wall cannot stand for both"
    return ""


def _inputs(run: ComparedRun) -> list[str]:
    return sorted(each["sha256"] for each in run.result["provenance"]["inputs"])


def differences(runs: Sequence[ComparedRun]) -> list[dict[str, Any]]:
    """Settings, inputs and versions that are not the same in all runs; what a run lacks is null."""
    flat = [_flat(run) for run in runs]
    keys = dict.fromkeys(key for one in flat for key in one)
    rows = [{"key": key, "values": [one.get(key) for one in flat]} for key in keys]
    return [row for row in rows if any(value != row["values"][0] for value in row["values"])]


def _flat(run: ComparedRun) -> dict[str, Any]:
    """Settings as one level, lists as text, and what else tells runs apart."""
    provenance = run.result["provenance"]
    told: dict[str, Any] = {"case": run.case_id}
    for table, values in (provenance.get("settings") or {}).items():
        for key, value in values.items() if isinstance(values, Mapping) else [("", values)]:
            told[f"{table}.{key}".rstrip(".")] = _told(value)
    told["input (SHA-256)"] = ", ".join(digest[:12] for digest in _inputs(run))
    told["tubeplan"] = provenance.get("version")
    told["random seed"] = provenance.get("rng_seed")
    return told


def _told(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return ", ".join(str(_told(each)) for each in value)
    if isinstance(value, float):
        return float(f"{value:.6g}")
    return value if isinstance(value, (bool, int, str)) or value is None else str(value)


def _notes(runs: Sequence[ComparedRun]) -> list[str]:
    """What a reader must know before he believes a difference."""
    notes = []
    limits = [run.result["limits"] for run in runs]
    if any(limit != limits[0] for limit in limits):
        notes.append("The runs were held against different limits: compare margins and shares of the limit, not verdicts alone.")
    ends = [_ends(run) for run in runs]
    known = [end for end in ends if end is not None]
    if not why_not_overlaid(runs) and len(known) > 1:
        apart = max(math.dist(end[k], known[0][k]) for end in known for k in (0, 1))
        if apart > ENDS_APART_MM:
            notes.append(
                f"The paths do not start and end at the same places (up to {apart:.1f} mm apart): "
                "their lengths and means are of different stretches."
            )
    missing = [run.label for run, end in zip(runs, ends, strict=True) if end is None]
    if missing:
        notes.append(f"{', '.join(missing)} {'has' if len(missing) == 1 else 'have'} no path; nothing is marked as better there.")
    return notes


def _ends(run: ComparedRun) -> tuple[Sequence[float], Sequence[float]] | None:
    points = (run.result.get("path") or {}).get("points_mm") or []
    return (points[0], points[-1]) if points else None
