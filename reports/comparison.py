"""From runs side by side to what the page prints.

Every printed figure stands in compare.json and carries its dotted path into it, as in
`reports.views`; the figures of a run's own verdict that no result.json holds have keys
``runs.N.derived:...`` with the formulas of `reports.derived`, applied to ``runs.N``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.derived import derived_values
from reports.numbers import Phrase, Source, phrase, printed
from reports.overlay import Line, Overlay, overlay_chart
from reports.still import Label, View, choose_view, still_picture
from reports.svg import in_all_widths
from reports.tables import DASH
from reports.turnable import placed, rounded
from reports.wall import LightMesh, light_mesh
from reports.words import Verdict, verdict
from segmentation.arrays import FloatArray
from tubeplan_viz.result import STRAIGHT_MM, ComparedRun, Comparison

VERBS = {"ok": ("holds", "hold"), "flagged": ("is flagged", "are flagged"), "infeasible": ("finds no path", "find no path")}
KINDS = {"clearance": ("clearance_mm", "clearance_min_mm"), "curvature": ("curvature_per_mm", "curvature_max_per_mm")}
TOLD_FIRST = {"margin_mm": "Best margin", "bend_radius_mm": "Gentlest bend", "metrics.length_mm": "Shortest path"}


@dataclass(frozen=True)
class Card:
    """The verdict of one run beside the others; `color` counts from 1."""

    color: int
    label: str
    name: str
    planner: str
    case_id: str
    verdict: Verdict


@dataclass(frozen=True)
class Cell:
    """One value of the difference table and how far it is from the first run's."""

    value: Phrase
    difference: Phrase | None
    better: bool


@dataclass(frozen=True)
class DifferenceRow:
    """One measure of all runs; `better` says which direction is the better one."""

    name: str
    better: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Told:
    """A setting, an input or a checksum of each run, as text."""

    key: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class ComparisonPage:
    """What the template of several runs prints, in its order."""

    title: str
    heading: str
    names: str
    frame: str
    lead: tuple[Phrase, ...]
    notes: tuple[str, ...]
    cards: tuple[Card, ...]
    rows: tuple[DifferenceRow, ...]
    overlaid: bool
    reason: str
    still: Markup
    drawn: tuple[Card, ...]
    along: Mapping[str, Markup]
    shares: Mapping[str, Markup]
    differences: tuple[Told, ...]
    origins: tuple[Told, ...]
    document: Mapping[str, Any]
    scene: Mapping[str, Any]


def make_comparison_page(comparison: Comparison) -> ComparisonPage:
    """Everything that the page of several runs shows."""
    document, runs = comparison.document, comparison.runs
    source = Source(document)
    cards = tuple(_card(k, run) for k, run in enumerate(runs))
    labels = ", ".join(run.label for run in runs)
    drawn = [k for k, run in enumerate(runs) if len((run.result.get("path") or {}).get("s_mm") or ()) > 1]
    mesh = light_mesh(comparison.surface) if comparison.surface is not None else None
    view = _view(comparison, drawn, mesh)
    marks = _labels(runs, drawn)
    words = f"The wall of the lumen with the paths of {labels}."
    lines = [(f"run-line run-{k + 1}", np.asarray(runs[k].result["path"]["points_mm"], float)) for k in drawn]
    # Beside the scene there is room for the width of a path's charts, alone for two halves.
    room = "plot" if view is not None else "half"
    return ComparisonPage(
        title=f"Comparison: {labels}",
        heading=_heading(runs),
        names=", ".join(dict.fromkeys(run.case_id for run in runs)),
        frame=str(runs[0].result["frame"]),
        lead=_lead(source, document, runs),
        notes=tuple(str(note) for note in document["notes"]),
        cards=cards,
        rows=tuple(_row(source, k, row) for k, row in enumerate(document["rows"])),
        overlaid=comparison.overlaid,
        reason=str(document["overlay"]["reason"]),
        still=still_picture(mesh, np.empty((0, 3)), [], marks, view, words, lines=lines) if view is not None else Markup(""),
        drawn=tuple(cards[k] for k in drawn),
        along=_charts(runs, drawn, "mm", room),
        shares=_charts(runs, drawn, "share", "half"),
        differences=tuple(Told(str(row["key"]), tuple(map(_plain, row["values"]))) for row in document["differences"]),
        origins=_origins(document),
        document=document,
        scene={
            "mesh": mesh.packed() if mesh is not None else None,
            "view": {"toward": rounded(view.toward), "up": rounded(view.up)} if view is not None else None,
            "labels": placed(marks),
            "clearance": runs[0].result["limits"].get("clearance_min_mm"),
            "start": _start(runs, drawn),
        },
    )


def _card(k: int, run: ComparedRun) -> Card:
    source = Source(run.result, derived_values(run.result), prefix=f"runs.{k}.")
    planner = run.result["planner"]
    return Card(
        color=k + 1,
        label=run.label,
        name=run.name,
        planner=f"{planner['name']}, {str(planner['method']).replace('_', ' ')}",
        case_id=run.case_id,
        verdict=verdict(source, (run.result.get("details") or {}).get("parts") or ()),
    )


def _heading(runs: Sequence[ComparedRun]) -> str:
    """Who holds and who does not, in one line."""
    said = []
    for status, (one, many) in VERBS.items():
        mine = [run.label for run in runs if run.result["status"] == status]
        if mine:
            said.append(f"{_and(mine)} {one if len(mine) == 1 else many}")
    return ", ".join(said)


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _lead(source: Source, document: Mapping[str, Any], runs: Sequence[ComparedRun]) -> tuple[Phrase, ...]:
    """Who is best in what matters most, with the figure; nothing where several are."""
    said = []
    for k, row in enumerate(document["rows"]):
        if row["key"] in TOLD_FIRST and len(row["best"]) == 1:
            best = row["best"][0]
            if row["key"] == "bend_radius_mm" and row["values"][best] >= STRAIGHT_MM:
                said.append(phrase(f"{runs[best].label} is straight"))
                continue
            figure = source.need(
                f"rows.{k}.values.{best}", row["digits"], row["unit"], signed=row["key"] == "margin_mm", strong=True
            )
            said.append(phrase(f"{TOLD_FIRST[row['key']]}: {runs[best].label} with ", figure))
    return tuple(said)


def _row(source: Source, k: int, row: Mapping[str, Any]) -> DifferenceRow:
    digits = row["digits"]
    cells = []
    for n, value in enumerate(row["values"]):
        if value is None:
            cells.append(Cell(DASH, None, False))
            continue
        shown = source.need(f"rows.{k}.values.{n}", digits, signed=row["key"] == "margin_mm")
        gap = row["difference"][n]
        seen = gap is not None and round(gap, digits) != 0.0
        apart = source.figure(f"rows.{k}.difference.{n}", digits, signed=seen) if n else None
        straight = row["key"] == "bend_radius_mm" and value >= STRAIGHT_MM
        gap_shown = None if apart is None else phrase(apart)
        cells.append(Cell(phrase("straight") if straight else phrase(shown), gap_shown, n in row["best"]))
    unit = f", {row['unit']}" if row["unit"] else ""
    return DifferenceRow(f"{row['title']}{unit}", str(row["better"] or ""), tuple(cells))


def _charts(runs: Sequence[ComparedRun], drawn: Sequence[int], axis: str, room: str) -> dict[str, Markup]:
    """The charts of clearance and curvature of all runs that have a path."""
    charts: dict[str, Markup] = {}
    over = "arc length" if axis == "mm" else "the share of each path"
    for kind, (values, limit) in KINDS.items():
        lines = [
            Line(
                number=k,
                label=runs[k].label,
                arc=np.asarray(runs[k].result["path"]["s_mm"], float),
                values=np.asarray(runs[k].result["path"][values], float),
                limit=runs[k].result["limits"].get(limit),
                worst=[
                    (flag["worst_at_mm"], flag["worst"]) for flag in runs[k].result["flagged_intervals"] if flag["kind"] == kind
                ],
            )
            for k in drawn
            if runs[k].result["path"].get(values)
        ]
        if lines:
            extremes = "; ".join(f"{line.label} {_extreme(kind, line.values)}" for line in lines)
            words = f"{kind.capitalize()} of all runs over {over}. {'Least' if kind == 'clearance' else 'Largest'}: {extremes}."
            spec = Overlay(kind=kind, axis=axis, lines=lines, words=words)
            charts[kind] = in_all_widths(partial(overlay_chart, spec, room=room))
    return charts


def _extreme(kind: str, values: FloatArray) -> str:
    return f"{printed(float(values.min()), 2)} mm" if kind == "clearance" else f"{printed(float(values.max()), 4)} 1/mm"


def _view(comparison: Comparison, drawn: Sequence[int], mesh: LightMesh | None) -> View | None:
    """Where the scene is looked at from; None where paths must not be drawn together."""
    if not comparison.overlaid or not drawn:
        return None
    lines = [np.asarray(comparison.runs[k].result["path"]["points_mm"], float) for k in drawn]
    spots = [lines[0][:1], *([mesh.vertices] if mesh is not None else lines), lines[0][-1:]]
    return choose_view(np.vstack(spots), str(comparison.runs[0].result["frame"]))


def _labels(runs: Sequence[ComparedRun], drawn: Sequence[int]) -> tuple[Label, ...]:
    """Start and goal, shared or each run's own, and the gravest flagged place of each run."""
    labels: list[Label] = []
    for end, index in (("Start", 0), ("Goal", -1)):
        spots = [np.asarray(runs[k].result["path"]["points_mm"][index], float) for k in drawn]
        groups: list[tuple[FloatArray, list[str]]] = []
        for k, spot in zip(drawn, spots, strict=True):
            near = next((names for place, names in groups if np.linalg.norm(place - spot) < 1.0), None)
            if near is None:
                groups.append((spot, [runs[k].label]))
            else:
                near.append(runs[k].label)
        for spot, names in groups:
            whose = "" if len(names) == len(drawn) else f" {_and(names)}"
            labels.append(Label(spot, f"{end}{whose}", end.lower(), 0))
    for k in drawn:
        result = runs[k].result
        for kind, better in (("clearance", 1.0), ("curvature", -1.0)):
            mine = sorted(
                (flag for flag in result["flagged_intervals"] if flag["kind"] == kind), key=lambda f: better * f["worst"]
            )
            for flag in mine[:1]:
                arc = np.asarray(result["path"]["s_mm"], float)
                spot = np.asarray(result["path"]["points_mm"][int(np.abs(arc - flag["worst_at_mm"]).argmin())], float)
                text = (
                    f"{printed(flag['worst'], 2)} mm" if kind == "clearance" else f"radius {printed(1.0 / flag['worst'], 1)} mm"
                )
                labels.append(Label(spot, f"{runs[k].label}: {text}", kind, 1))
    return tuple(labels)


def _start(runs: Sequence[ComparedRun], drawn: Sequence[int]) -> float:
    """The share at which the cursor begins: the tightest place of the first path, else its middle."""
    if not drawn:
        return 0.0
    path = runs[drawn[0]].result["path"]
    if not path.get("clearance_mm"):
        return 0.5
    return float(path["s_mm"][int(np.argmin(path["clearance_mm"]))] / path["s_mm"][-1])


def _origins(document: Mapping[str, Any]) -> tuple[Told, ...]:
    """Where each run comes from."""
    runs = document["runs"]
    rows = [
        Told("Run folder", tuple(str(run["name"]) for run in runs)),
        Told("Case", tuple(str(run["case_id"]) for run in runs)),
        Told("Planner", tuple(f"{run['planner']['name']}, {run['planner']['method']}" for run in runs)),
        Told("Frame", tuple(str(run["frame"]) for run in runs)),
        Told("Made (UTC)", tuple(str(run["provenance"]["created_utc"]) for run in runs)),
        Told("tubeplan", tuple(str(run["provenance"]["version"]) for run in runs)),
        Told("Input, SHA-256", tuple(", ".join(each["sha256"][:16] for each in run["provenance"]["inputs"]) for run in runs)),
        Told("result.json, SHA-256", tuple(str(run["result_sha256"])[:16] for run in runs)),
    ]
    return tuple(rows)


def _plain(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


__all__ = ["Card", "ComparisonPage", "make_comparison_page"]
