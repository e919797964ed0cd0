"""The case in words: markdown for the summary panel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tubeplan_viz.plan import FlaggedInterval, FlagKind, Limits, PlanStatus
from tubeplan_viz.recording import entities as at
from tubeplan_viz.result import place_words, worst_at

VERDICTS = {
    PlanStatus.OK: "Every limit holds along the whole path",
    PlanStatus.FLAGGED: "Planned, with stretches that break a limit",
    PlanStatus.INFEASIBLE: "No path",
}
UNPROVED = "Planned; the limits hold at the samples but are not proved between them"


def iteration_text(
    index: int,
    *,
    length: float,
    curvature_max: float,
    clearance_min: float,
    features: int,
    flagged: Sequence[FlaggedInterval],
    limits: Limits,
) -> str:
    """Summary of one iteration."""
    verdict = "both limits hold" if not flagged else f"{len(flagged)} flagged {'interval' if len(flagged) == 1 else 'intervals'}"
    return "\n\n".join(
        [
            f"## Iteration {index}: {verdict}",
            _table([("path length", f"{length:.1f} mm"), ("features", str(features))], curvature_max, clearance_min, limits),
            flag_table(flagged),
            f"*{at.NOTICE}*",
        ]
    )


def case_text(case_id: str, result: Mapping[str, Any], flagged: Sequence[FlaggedInterval], limits: Limits) -> str:
    """Summary of the finished case from result.json; a row whose metric does not apply is left out."""
    planner, metrics, proof = result["planner"], result.get("metrics", {}), result.get("certificate") or {}
    rows = [
        _row("path length", "{:.1f} mm", metrics.get("length_mm")),
        _row(
            "largest curvature",
            "{:.4f} 1/mm",
            metrics.get("curvature_max_per_mm"),
            limits.curvature_max,
            proof.get("curvature_upper_bound_per_mm"),
            where=_where(result, "curvature"),
        ),
        _row(
            "least clearance",
            "{:.2f} mm",
            metrics.get("clearance_min_mm"),
            limits.clearance_min,
            proof.get("clearance_lower_bound_mm"),
            where=_where(result, "clearance"),
        ),
        _row("mean curvature", "{:.4f} 1/mm", metrics.get("curvature_mean_per_mm")),
        _row("mean clearance", "{:.2f} mm", metrics.get("clearance_mean_mm")),
        _row("mean distance to the centerline", "{:.2f} mm", metrics.get("centerline_distance_mean_mm")),
        _row("tip error", "{:.2f} mm", metrics.get("tip_error_mm")),
    ]
    unproved = result["status"] == PlanStatus.FLAGGED and not flagged
    parts = [f"## {UNPROVED if unproved else VERDICTS[PlanStatus(result['status'])]}"]
    if result.get("reason"):
        parts.append(str(result["reason"]))
    count = len(result.get("iterations", ()))
    states = f"{count} recorded {'state' if count == 1 else 'states'}"
    parts.append(f"Case **{case_id}**, planner {planner['name']} ({planner['method']}), {states}")
    if any(rows):
        parts.append("| | found | limit | proved bound |\n|--|--|--|--|\n" + "\n".join(row for row in rows if row))
    return "\n\n".join([*parts, flag_table(flagged), f"*{at.NOTICE}*"])


def place_text(
    s: float, length: float, curvature: float, clearance: float, limits: Limits, flagged: Sequence[FlaggedInterval]
) -> str:
    """Readout at one place of the path."""
    here = [flag for flag in flagged if flag.start - 1e-9 <= s <= flag.end + 1e-9]
    if here:
        verdict = "breaks the " + " and the ".join(f"{kind} limit" for kind in sorted({flag.kind.value for flag in here}))
    else:
        verdict = "both limits hold here"
    bend = f"{1.0 / curvature:.1f} mm" if curvature > 1e-4 else "straight"
    return "\n\n".join(
        [
            f"## {s:.1f} mm of {length:.1f} mm: {verdict}",
            _table(
                [("bend radius", bend), ("room beyond the instrument", f"{clearance - limits.clearance_min:+.2f} mm")],
                curvature,
                clearance,
                limits,
            ),
            f"*{at.NOTICE}*",
        ]
    )


def flag_table(flagged: Sequence[FlaggedInterval]) -> str:
    """Flagged intervals as a markdown table, or one sentence without any."""
    if not flagged:
        return "No flagged interval."
    rows = [
        f"| {flag.kind.value} | {flag.start:.1f} | {flag.end:.1f} | "
        + (f"{flag.worst:.4f} 1/mm" if flag.kind is FlagKind.CURVATURE else f"{flag.worst:.2f} mm")
        + f" | {flag.worst_at:.1f} |"
        for flag in flagged
    ]
    return "| flagged | from mm | to mm | worst | at mm |\n|--|--|--|--|--|\n" + "\n".join(rows)


def _where(result: Mapping[str, Any], kind: str) -> str:
    """Where the case is worst, for its table."""
    at = worst_at(result, kind)
    return "" if at is None else f", at {place_words(result, at)}"


def _row(
    name: str, form: str, found: float | None, limit: float | None = None, bound: float | None = None, *, where: str = ""
) -> str:
    """One line of the case table, empty without a value."""
    if found is None:
        return ""
    cells = [form.format(value) if value is not None else "" for value in (found, limit, bound)]
    cells[0] += where
    return f"| {name} | " + " | ".join(cells) + " |"


def _table(rows: Sequence[tuple[str, str]], curvature: float, clearance: float, limits: Limits) -> str:
    lines = [f"| {name} | {value} | |" for name, value in rows]
    lines.append(f"| curvature | {curvature:.4f} 1/mm | {limits.curvature_max:.4f} |")
    lines.append(f"| clearance | {clearance:.2f} mm | {limits.clearance_min:.2f} |")
    return "| | found | limit |\n|--|--|--|\n" + "\n".join(lines)
