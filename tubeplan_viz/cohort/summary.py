"""What a cohort's cases came to: cohort.json, cohort.csv and index.html, made anew from the run folders and the journal."""

from __future__ import annotations

import csv
import io
import json
import platform as running
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from reports import render_cohort
from tubeplan_viz import __version__
from tubeplan_viz.cohort.errors import CohortError
from tubeplan_viz.cohort.manifest import CohortCase, Manifest
from tubeplan_viz.cohort.tasks import CaseStatus
from tubeplan_viz.cohort.words import kind_of_reason
from tubeplan_viz.result import RESULT, check_schema, plain, shipped_schema, write_whole
from tubeplan_viz.result.document import METRICS

SUMMARY_FILES = ("cohort.json", "cohort.csv", "index.html")
# The gravest first: what has to be looked at before the numbers of the others are used.
GRAVITY = (1, 2, 4, 3, 0)
EXIT = {
    CaseStatus.OK: 0,
    CaseStatus.FLAGGED: 3,
    CaseStatus.INFEASIBLE: 4,
    CaseStatus.TIME_LIMIT: 4,
    CaseStatus.BAD_INPUT: 2,
    CaseStatus.DIED: 1,
    CaseStatus.FAULT: 1,
}
COSTS = ("wall_s", "cpu_s", "peak_memory_mb")


def row_of(case: CohortCase, folder: Path, ended: Mapping[str, Any]) -> dict[str, Any]:
    """One case of cohort.json.

    Parameters
    ----------
    case : CohortCase
    folder : Path
        The cohort's folder.
    ended : mapping
        What the journal says of the end of the case.
    """
    settled = case.planner_table
    row: dict[str, Any] = {
        "id": case.id,
        "planner": case.planner,
        "method": settled["method"],
        "rng_seed": settled.get("rng_seed"),
        "status": ended["status"],
        "reason": ended["reason"],
        "folder": None,
        "has_report": False,
        "frame": None,
        "margin_mm": None,
        "limits": dict.fromkeys(("curvature_max_per_mm", "clearance_min_mm")),
        "metrics": dict.fromkeys(METRICS),
        "certificate_holds": None,
        "flagged_intervals": 0,
        "verification": ended["verification"],
        "inputs": [],
        "planning_s": None,
        **{name: ended[name] for name in COSTS},
    }
    if ended["result_sha256"] is None:
        return row
    result = json.loads((folder / case.id / RESULT).read_text(encoding="utf-8"))
    least, limit = result["metrics"]["clearance_min_mm"], result["limits"]["clearance_min_mm"]
    certificate = result["certificate"]
    return row | {
        "folder": case.id,
        "has_report": (folder / case.id / "report.html").is_file(),
        "frame": result["frame"],
        "margin_mm": None if least is None or limit is None else least - limit,
        "limits": {key: result["limits"][key] for key in row["limits"]},
        "metrics": {key: result["metrics"][key] for key in METRICS},
        "certificate_holds": None if certificate is None else certificate["holds"],
        "flagged_intervals": len(result["flagged_intervals"]),
        "inputs": result["provenance"]["inputs"],
        "planning_s": sum(result["timings_s"].values()),
    }


def exit_status(rows: Sequence[Mapping[str, Any]]) -> int:
    """The exit status of a cohort: of the gravest of its cases, see `GRAVITY`."""
    found = {EXIT[CaseStatus(row["status"])] for row in rows}
    if any(row["verification"] is not None and not row["verification"]["holds"] for row in rows):
        found.add(3)  # as `tubeplan verify` ends
    return min(found, key=GRAVITY.index, default=0)


def reasons_of(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Cases that do not hold, those together whose reasons differ in numbers alone; the most frequent first."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["reason"] is not None:
            groups.setdefault((row["status"], kind_of_reason(row["reason"])), []).append(row)
    made = [
        {
            "status": status,
            "reason": same[0]["reason"],
            "same": len({row["reason"] for row in same}) == 1,
            "count": len(same),
            "cases": [row["id"] for row in same],
        }
        for (status, _), same in groups.items()
    ]
    return sorted(made, key=lambda one: -one["count"])


def cohort_document(
    manifest: Manifest, rows: Sequence[Mapping[str, Any]], *, kept: int, seconds: float, others: Sequence[str], scheduler: bool
) -> dict[str, Any]:
    """The content of cohort.json.

    Parameters
    ----------
    manifest : Manifest
    rows : sequence of mapping
        From `row_of`, in the order of the manifest.
    kept : int
        Cases that were done already.
    seconds : float
        Wall time of this call.
    others : sequence of str
        Run folders that stand there and are no case of the manifest.
    scheduler : bool
        Whether a cluster did the cases.

    Raises
    ------
    CohortError
        If it does not follow its schema.
    """
    document: dict[str, Any] = plain(
        {
            "schema_version": 1,
            "use": "research use, not for clinical decisions",
            "exit_status": exit_status(rows),
            "counts": {status.value: sum(row["status"] == status for row in rows) for status in CaseStatus},
            "reasons": reasons_of(rows),
            "cases": rows,
            "others": others,
            "pass": {"done": len(rows) - kept, "kept": kept, "wall_s": round(seconds, 3), "cluster": scheduler},
            "provenance": {
                "software": "tubeplan",
                "version": __version__,
                "manifest": {"name": manifest.name, "sha256": manifest.sha256},
                "rng_seed": manifest.rng_seed,
                "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
                "platform": f"{running.system()} {running.machine()}, Python {running.python_version()}",
            },
        }
    )
    validate_cohort(document)
    return document


def cohort_schema() -> dict[str, Any]:
    """The schema of cohort.json (JSON Schema 2020-12)."""
    return shipped_schema("tubeplan_viz.cohort", "cohort")


def validate_cohort(document: Mapping[str, Any]) -> None:
    """Check a cohort, made of plain JSON values, against the schema and its own counts.

    Raises
    ------
    CohortError
        Naming the first key that is wrong.
    """
    check_schema(document, cohort_schema(), name="cohort", remedy="run it again", error=CohortError)
    counted = {status: sum(row["status"] == status for row in document["cases"]) for status in document["counts"]}
    if counted != document["counts"]:
        raise CohortError(f"cohort.json: counts are {document['counts']}, its cases give {counted}; run it again")


def cohort_csv(document: Mapping[str, Any]) -> str:
    """One line per case; numbers in the shortest form that reads back to the same double."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    head = ["id", "planner", "method", "status", "reason", "margin_mm", *METRICS, "clearance_limit_mm", "curvature_limit_per_mm"]
    head += ["certificate_holds", "flagged_intervals", "verified", "rng_seed", "planning_s", *COSTS, "folder"]
    writer.writerow(head)
    for row in document["cases"]:
        limits, checked = row["limits"], row["verification"]
        values = {
            **row,
            **row["metrics"],
            "clearance_limit_mm": limits["clearance_min_mm"],
            "curvature_limit_per_mm": limits["curvature_max_per_mm"],
            "verified": None if checked is None else checked["holds"],
        }
        cells = (values[name] for name in head)
        writer.writerow(["" if cell is None else str(cell).lower() if isinstance(cell, bool) else cell for cell in cells])
    return text.getvalue()


def write_summary(document: Mapping[str, Any], folder: Path) -> None:
    """Write the three files, each whole or not at all.

    Raises
    ------
    CohortError
        If one cannot be written.
    """
    page = render_cohort(document)
    text = json.dumps(document, allow_nan=False, indent=1) + "\n"
    for name, content in zip(SUMMARY_FILES, (text, cohort_csv(document), page), strict=True):
        try:
            write_whole(folder / name, content.encode("utf-8"))
        except OSError as fault:
            reason = (fault.strerror or "unknown reason").lower()
            raise CohortError(f"{name} cannot be written ({reason}); make room and run the same command again") from None
