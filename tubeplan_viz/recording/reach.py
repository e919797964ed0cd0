"""The reach map as one recording: the airway coloured by verdict, and the robot at the end of each plan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial import cKDTree

from segmentation.mesh import Surface
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.blueprint import Viewpoint, folded, scene_axes, scene_view, viewpoint
from tubeplan_viz.recording.matrix import COLORS as SIGNALS
from tubeplan_viz.recording.names import log_names
from tubeplan_viz.recording.sink import Sink

BRANCH = "branch"
WORDS = {"reached": "reached", "diameter": "too narrow", "bend": "no way: bend", "collision": "no way: wall"}
COLORS: dict[str, at.Color] = {
    "reached": SIGNALS["feasible"],
    "diameter": SIGNALS["impossible"],
    "bend": SIGNALS["flagged"],
    "collision": SIGNALS["flagged"],
}


def log_reach(document: Mapping[str, Any], surface: Surface, path: Path) -> None:
    """Write the recording of a reach map.

    Parameters
    ----------
    document : mapping
        The content of reach.json.
    surface : Surface
    path : Path

    Raises
    ------
    RecordingError
        If it cannot be written or does not read back.
    """
    sink = Sink(path, case_id=str(document["case_id"]), connect=None)
    rows = document["branches"]
    with sink:
        sink.log("/case", scene_axes(str(document["frame"])), static=True)
        log_colored_wall(sink, rows, surface)
        lines = [np.asarray(row["points_mm"], float) for row in rows]
        colors = [COLORS[row["verdict"]] for row in rows]
        sink.log("/case/branches/lines", rr.LineStrips3D(lines, colors=colors, radii=rr.Radius.ui_points(2.0)), static=True)
        eye = viewpoint(np.asarray(surface.vertices[::50]), str(document["frame"]), radius=8.0)
        log_branch_names(sink, rows, eye)
        for number, row in enumerate(rows):
            sink.at(BRANCH, number)
            body = row["body_mm"]
            if body is None:
                sink.log("/case/robot", rr.Clear(recursive=False))
            else:
                radius = 0.5 * float(document["robot"]["diameter_mm"])
                sink.log("/case/robot", rr.LineStrips3D([body], colors=at.PATH, radii=radius))
            words = rr.TextDocument(told(row), media_type=rr.MediaType.MARKDOWN)
            sink.log("/case/branch", words)
        sink.log("/case/table", rr.TextDocument(table(document), media_type=rr.MediaType.MARKDOWN), static=True)
        sink.flush()
        sink.publish(layout(eye))


def log_colored_wall(sink: Sink, rows: list[Mapping[str, Any]], surface: Surface) -> None:
    """The wall in the colours of the branches, each face that of the branch whose middle line is nearest."""
    sites = np.concatenate([np.asarray(row["points_mm"], float) for row in rows])
    owner = np.concatenate([np.full(len(row["points_mm"]), k) for k, row in enumerate(rows)])
    nearest = owner[np.asarray(cKDTree(sites).query(surface.vertices)[1])]
    verdicts = np.array([list(COLORS).index(row["verdict"]) for row in rows])[nearest][surface.wall_faces[:, 0]]
    for k, (name, color) in enumerate(COLORS.items()):
        chosen = surface.wall_faces[verdicts == k]
        if len(chosen):
            used, index = np.unique(chosen, return_inverse=True)
            mesh = rr.Mesh3D(
                vertex_positions=surface.vertices[used], triangle_indices=index.reshape(-1, 3), albedo_factor=(*color, 90)
            )
            sink.log(f"{at.WALL}/{name}", mesh, static=True)


def log_branch_names(sink: Sink, rows: list[Mapping[str, Any]], eye: Viewpoint) -> None:
    """Names off the tips of the branches where the robot's way ends: reached and last, or refused first; the others on demand."""
    ends = [
        row["leaf"] if row["verdict"] == "reached" else row["parent"] is None or rows[row["parent"]]["verdict"] == "reached"
        for row in rows
    ]
    shown = [row for row, end in zip(rows, ends, strict=True) if end]
    tips = np.array([row["points_mm"][-1] for row in shown], float).reshape(-1, 3)
    log_names(
        sink,
        "/case/branches/names",
        tips,
        [str(row["name"]) for row in shown],
        [COLORS[row["verdict"]] for row in shown],
        eye,
        static=True,
    )
    others = [row for row, end in zip(rows, ends, strict=True) if not end]
    if others:
        passed = rr.Points3D(
            [row["middle_mm"] for row in others],
            labels=[row["name"] for row in others],
            colors=[COLORS[row["verdict"]] for row in others],
            radii=rr.Radius.ui_points(3.0),
            show_labels=False,
        )
        sink.log("/case/branches/passed", passed, static=True)


def told(row: Mapping[str, Any]) -> str:
    """One branch as markdown."""
    why = "" if row["reason"] is None else f"\n\n{row['reason']}"
    return (
        f"## {row['name']}: {WORDS[row['verdict']]}{why}\n\n"
        f"diameter {row['diameter_mm']:.1f} mm, least {row['least_diameter_mm']:.1f} mm, "
        f"length {row['length_mm']:.1f} mm; reached {row['depth_mm']:.1f} mm of it"
    )


def table(document: Mapping[str, Any]) -> str:
    """All branches as markdown, and below them why some are not reached: the viewer's tables break no lines.

    Its text ends at the sign for a diameter (rerun 0.41), which is written out.
    """
    rows = document["branches"]
    lines = ["## Branches", "| # | branch | verdict | reached mm | of mm | diameter mm |", "|--|--|--|--|--|--|"]
    lines += [
        f"| {number} | {row['name']} | {WORDS[row['verdict']]} | {row['depth_mm']:.1f} | {row['length_mm']:.1f} "
        f"| {row['diameter_mm']:.1f} |"
        for number, row in enumerate(rows)
    ]
    why = [f"* **{row['name']}**: {WORDS[row['verdict']]}; {row['reason']}" for row in rows if row["reason"] is not None]
    refused = "\n\n## Not reached\n\n" + "\n".join(why) if why else ""
    return "\n".join(lines) + f"{refused}\n\n{document['rule']}\n\n*{at.NOTICE}*"


def layout(eye: Viewpoint) -> rrb.Blueprint:
    """The airway beside the table; the timeline steps through the branches."""
    scene = scene_view("Airway by verdict; step through the timeline `branch` (research use, not for clinical decisions)", eye)
    words = rrb.Vertical(
        rrb.TextDocumentView(origin="/case/table", name="All branches"),
        rrb.TextDocumentView(origin="/case/branch", name="This branch"),
        row_shares=[4, 1],
    )
    return folded(
        rrb.Horizontal(scene, words, column_shares=[1, 1]),
        timeline=BRANCH,
        play_state="paused",
    )
