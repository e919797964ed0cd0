"""Runs side by side as one recording: paths, walls, and profiles on the timelines ``arc_length`` and ``share``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.plan import FlagKind
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.anatomy import log_wall
from tubeplan_viz.recording.blueprint import PLAY_FPS, folded, scene_axes, scene_view, viewpoint
from tubeplan_viz.recording.plans import CURVE_SPACING_MM, FLAG_RADIUS, Track, result_flags, result_track, worst_label
from tubeplan_viz.recording.sink import Sink
from tubeplan_viz.result import STRAIGHT_MM, ComparedRun, Comparison

SHARE = "share"
SHARE_TICKS = 1000  # #250 is a quarter of the path
STEP_MM = 0.5
RUNS = "/runs"
PROFILES = "/profiles"
# Okabe and Ito's colours that keep apart on the dark ground and from the red and orange of flags.
COLORS: tuple[at.Color, ...] = ((86, 180, 233), (230, 130, 200), (240, 228, 66), (0, 190, 140), (235, 235, 235), (150, 140, 255))
NAMES = {FlagKind.CLEARANCE: "Clearance, mm", FlagKind.CURVATURE: "Curvature, 1/mm"}


def log_comparison(comparison: Comparison, path: Path) -> None:
    """Write the recording of a comparison.

    Raises
    ------
    RecordingError
        If it cannot be written or does not read back.
    """
    sink = Sink(path, case_id="comparison", connect=None)
    with sink:
        for run, color in zip(comparison.runs, COLORS, strict=False):
            beside = [other for other in comparison.runs if other is not run] if comparison.overlaid else []
            _log_run(sink, run, color, beside, own_wall=not comparison.overlaid)
        if comparison.surface is not None:
            log_wall(sink, comparison.surface, entity=f"{RUNS}/wall")
        if comparison.overlaid:
            sink.log(RUNS, scene_axes(str(comparison.runs[0].result["frame"])), static=True)
        sink.log("/summary", rr.TextDocument(summary(comparison), media_type=rr.MediaType.MARKDOWN), static=True)
        sink.flush()
        sink.publish(_layout(comparison))


def name_place(run: ComparedRun, others: Sequence[ComparedRun]) -> FloatArray:
    """Where a path is farthest from all others, (3,) mm; its middle where it has none beside it."""
    points = np.asarray(run.result["path"]["points_mm"], float)
    beside = [np.asarray(other.result["path"]["points_mm"], float) for other in others if other.result.get("path")]
    if not beside:
        return np.asarray(points[len(points) // 2])
    gap = np.min([cKDTree(line).query(points)[0] for line in beside], axis=0)
    return np.asarray(points[int(np.argmax(gap))])


def _log_run(sink: Sink, run: ComparedRun, color: at.Color, others: Sequence[ComparedRun], *, own_wall: bool) -> None:
    root = f"{RUNS}/{run.label}"
    if own_wall:
        sink.log(root, scene_axes(str(run.result["frame"])), static=True)
        if run.surface is not None:
            log_wall(sink, run.surface, entity=f"{root}/wall")
    path = run.result.get("path")
    if not path or len(path["s_mm"]) < 2:
        return
    # A needle among no obstacles has no clearance.
    blind = path["clearance_mm"] is None
    track = result_track({**path, "clearance_mm": np.full(len(path["s_mm"]), np.nan)} if blind else path)
    drawn = track.thinned(CURVE_SPACING_MM)
    sink.log(
        f"{root}/path",
        rr.LineStrips3D([drawn.points], colors=color, radii=rr.Radius.ui_points(2.2)),
        static=True,
    )
    sink.log(
        f"{root}/name",
        rr.Points3D(
            [name_place(run, others)], colors=color, radii=rr.Radius.ui_points(3.0), labels=[run.label], show_labels=True
        ),
        static=True,
    )
    _log_flags(sink, run, track, root)
    limits = run.result["limits"]
    asked = {FlagKind.CURVATURE: limits["curvature_max_per_mm"]} | (
        {} if blind else {FlagKind.CLEARANCE: limits["clearance_min_mm"]}
    )
    length = float(track.arc_length[-1])
    ticks = np.unique(np.append(np.arange(0.0, length, STEP_MM), length))
    shares = np.linspace(0.0, 1.0, SHARE_TICKS // 4 + 1)
    for timeline, places, numbers in (
        (at.ARC_LENGTH, ticks, np.floor(ticks * at.TICKS_PER_MM + 1e-6)),
        (SHARE, shares * length, shares * SHARE_TICKS),
    ):
        _log_profile(sink, run.label, track, asked, color, timeline, places, numbers.round().astype(np.int64))


def _log_profile(
    sink: Sink,
    label: str,
    track: Track,
    asked: Mapping[FlagKind, float],
    color: at.Color,
    timeline: str,
    places: FloatArray,
    ticks: IntArray,
) -> None:
    """Values, limits and the marker of one run at (k,) arc lengths, as rows of a timeline."""
    for kind, limit in asked.items():
        entity = f"{PROFILES}/{kind.value}/{label}"
        for name, values, width in (
            (label, np.interp(places, track.arc_length, track.values(kind)), 2.0),
            (f"{label} limit", np.full(len(places), limit), 0.8),
        ):
            part = entity if name == label else f"{entity}/limit"
            sink.log(part, rr.SeriesLines(names=name, colors=color, widths=width), static=True)
            sink.columns(part, timeline, ticks, rr.Scalars.columns(scalars=values))
    marker = f"{RUNS}/{label}/here"
    sink.log(marker, rr.Points3D.from_fields(colors=color, radii=rr.Radius.ui_points(6.0)), static=True)
    sink.columns(marker, timeline, ticks, rr.Points3D.columns(positions=track.at(places)))


def _log_flags(sink: Sink, run: ComparedRun, track: Track, root: str) -> None:
    flags = result_flags(run.result["flagged_intervals"])
    for kind in FlagKind:
        mine = [flag for flag in flags if flag.kind is kind]
        if mine:
            sink.log(
                f"{root}/flagged/{kind.value}",
                rr.Points3D(
                    track.at([flag.worst_at for flag in mine]),
                    colors=at.FLAG_COLORS[kind],
                    radii=rr.Radius.ui_points(FLAG_RADIUS[kind]),
                    labels=[f"{run.label}: {worst_label(flag)}" for flag in mine],
                    show_labels=True,
                ),
                static=True,
            )


def summary(comparison: Comparison) -> str:
    """Verdicts and the difference table as markdown; the better figure is in bold."""
    document = comparison.document
    labels = [run.label for run in comparison.runs]
    lines = ["## Runs side by side", "| | run | planner | verdict |", "|--|--|--|--|"]
    for run in comparison.runs:
        planner = run.result["planner"]
        lines.append(f"| {run.label} | {run.name} | {planner['name']} ({planner['method']}) | {run.result['status']} |")
    lines += ["", "| measure | better | " + " | ".join(labels) + " |", "|--|--|" + "--|" * len(labels)]
    for row in document["rows"]:
        unit = f", {row['unit']}"
        cells = [
            "" if value is None else f"**{shown(row, value)}**" if k in row["best"] else shown(row, value)
            for k, value in enumerate(row["values"])
        ]
        lines.append(f"| {row['title']}{unit} | {row['better'] or ''} | " + " | ".join(cells) + " |")
    overlay = "" if document["overlay"]["drawn"] else f"\n\nNot overlaid: {document['overlay']['reason']}."
    notes = "".join(f"\n\n{note}" for note in document["notes"])
    return "\n".join(lines) + overlay + notes + f"\n\n*{at.NOTICE}*"


def shown(row: Mapping[str, Any], value: float) -> str:
    """One figure of the difference table; a bend of more than a metre of radius is none."""
    straight = row["key"] == "bend_radius_mm" and value >= STRAIGHT_MM
    return "straight" if straight else f"{value:.{row['digits']}f}"


def _layout(comparison: Comparison) -> rrb.Blueprint:
    if comparison.overlaid:
        space: rrb.View | rrb.Container = _scene(comparison.runs, RUNS, "Paths in their common frame")
    else:
        scenes = [_scene([run], f"{RUNS}/{run.label}", f"{run.label}: {run.name}") for run in comparison.runs]
        space = rrb.Grid(*scenes)
    plots = [
        rrb.TimeSeriesView(
            origin=f"{PROFILES}/{kind.value}",
            name=f"{NAMES[kind]}; thin: limit (timeline arc_length in 0.1 mm, or share in 0.1 %)",
            plot_legend=rrb.PlotLegend(visible=True),
            axis_y=rrb.ScalarAxis(zoom_lock=False),
        )
        for kind in (FlagKind.CLEARANCE, FlagKind.CURVATURE)
    ]
    words = rrb.TextDocumentView(origin="/summary", name=f"Summary ({at.NOTICE.lower().rstrip('.')})")
    return folded(
        rrb.Horizontal(space, rrb.Vertical(*plots, words, row_shares=[3, 3, 4]), column_shares=[1, 1]),
        timeline=at.ARC_LENGTH,
        fps=PLAY_FPS,
        play_state="paused",
    )


def _scene(runs: Sequence[ComparedRun], origin: str, name: str) -> rrb.Spatial3DView:
    paths = [np.asarray(run.result["path"]["points_mm"], float) for run in runs if run.result.get("path")]
    walls = [run.surface.vertices for run in runs if run.surface is not None]
    seen = np.vstack(paths or [wall[::50] for wall in walls]) if paths or walls else None
    eye = None if seen is None else viewpoint(seen, str(runs[0].result["frame"]), radius=4.0)
    return scene_view(name, eye, origin=origin)
