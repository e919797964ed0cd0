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
from tubeplan_viz.recording.blueprint import folded, scene_axes, scene_view, viewpoint
from tubeplan_viz.recording.matrix import COLORS as SIGNALS
from tubeplan_viz.recording.sink import Sink

BRANCH = "branch"
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
        names = [f"{row['name']}: {row['verdict']}" for row in rows]
        middles = [row["middle_mm"] for row in rows]
        marks = rr.Points3D(middles, labels=names, colors=colors, radii=rr.Radius.ui_points(3.0), show_labels=len(rows) < 16)
        sink.log("/case/branches/names", marks, static=True)
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
        sink.publish(layout(document, surface))


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


def told(row: Mapping[str, Any]) -> str:
    """One branch as markdown."""
    why = "" if row["reason"] is None else f"\n\n{row['reason']}"
    return (
        f"## {row['name']}: {row['verdict']}{why}\n\n"
        f"diameter {row['diameter_mm']:.1f} mm, least {row['least_diameter_mm']:.1f} mm, "
        f"length {row['length_mm']:.1f} mm; reached {row['depth_mm']:.1f} mm of it"
    )


def table(document: Mapping[str, Any]) -> str:
    """All branches as markdown; the viewer of rerun 0.41 ends at the sign for a diameter."""
    lines = ["## Branches", "| # | branch | diameter mm | verdict | reached mm | why |", "|--|--|--|--|--|--|"]
    for number, row in enumerate(document["branches"]):
        why = row["reason"] or ""
        lines.append(
            f"| {number} | {row['name']} | {row['diameter_mm']:.1f} | {row['verdict']} | {row['depth_mm']:.1f} | {why} |"
        )
    return "\n".join(lines) + f"\n\n{document['rule']}\n\n*{at.NOTICE}*"


def layout(document: Mapping[str, Any], surface: Surface) -> rrb.Blueprint:
    """The airway beside the table; the timeline steps through the branches."""
    view = viewpoint(np.asarray(surface.vertices[::50]), str(document["frame"]), radius=8.0)
    scene = scene_view("Airway by verdict; step through the timeline `branch` (research use, not for clinical decisions)", view)
    words = rrb.Vertical(
        rrb.TextDocumentView(origin="/case/table", name="All branches"),
        rrb.TextDocumentView(origin="/case/branch", name="This branch"),
        row_shares=[3, 1],
    )
    return folded(
        rrb.Horizontal(scene, words, column_shares=[1, 1]),
        timeline=BRANCH,
        play_state="paused",
    )
