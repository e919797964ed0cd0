"""The reach map as one recording: the airway coloured by verdict, and the robot at the end of each plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.blueprint import FIELD_OF_VIEW, Viewpoint, folded, scene_axes, scene_view, viewpoint
from tubeplan_viz.recording.matrix import COLORS as SIGNALS
from tubeplan_viz.recording.sink import Sink

BRANCH = "branch"
WORDS = {"reached": "reached", "diameter": "too narrow", "bend": "no way: bend", "collision": "no way: wall"}
# Of the airway's extent: how far names stand off the tips that they name at least, and how much farther at each try.
OFF, FARTHER = 0.04, 0.03
# What a label takes of the first view's height: a line, and a letter across; the viewer has them in pixels.
LINE_SHARE, LETTER_SHARE = 0.04, 0.0105
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
        log_names(sink, rows, eye)
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


def log_names(sink: Sink, rows: list[Mapping[str, Any]], eye: Viewpoint) -> None:
    """Names off the tips of the branches that end the tree or are refused, each on a thin line; the others on demand."""
    shown = [row for row in rows if row["leaf"] or row["verdict"] != "reached"]
    tips = np.array([row["points_mm"][-1] for row in shown], float).reshape(-1, 3)
    spots = stand_off(tips, [str(row["name"]) for row in shown], eye)
    colors = [COLORS[row["verdict"]] for row in shown]
    leaders = [np.stack(pair) for pair in zip(tips, spots, strict=True)]
    sink.log("/case/branches/leaders", rr.LineStrips3D(leaders, colors=colors, radii=rr.Radius.ui_points(0.5)), static=True)
    names = rr.Points3D(
        spots, labels=[row["name"] for row in shown], colors=colors, radii=rr.Radius.ui_points(1.0), show_labels=len(shown) < 24
    )
    sink.log("/case/branches/names", names, static=True)
    others = [row for row in rows if not row["leaf"] and row["verdict"] == "reached"]
    passed = rr.Points3D(
        [row["middle_mm"] for row in others],
        labels=[row["name"] for row in others],
        colors=[COLORS[row["verdict"]] for row in others],
        radii=rr.Radius.ui_points(3.0),
        show_labels=False,
    )
    if others:
        sink.log("/case/branches/passed", passed, static=True)


def stand_off(tips: FloatArray, names: Sequence[str], eye: Viewpoint) -> FloatArray:
    """Places for names, (n, 3) mm: away from the middle of all tips in the plane of the screen, so far that none lies on another.

    Parameters
    ----------
    tips : (n, 3) float array, mm
    names : sequence of str
    eye : Viewpoint
        From which the names must not overlap; from elsewhere they may.
    """
    ahead = eye.target - eye.position
    far = float(np.linalg.norm(ahead))
    right = np.cross(ahead, eye.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead) / far
    height = 2.0 * far * float(np.tan(0.5 * FIELD_OF_VIEW))
    flat = np.column_stack([tips @ right, tips @ up])
    away = flat - flat.mean(axis=0)
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    width = LETTER_SHARE * height * np.array([len(name) + 3 for name in names], float)
    line, placed = LINE_SHARE * height, np.empty((0, 2))
    for k in range(len(tips)):
        off = OFF * height
        while True:
            spot = flat[k] + off * away[k]
            apart = np.abs(placed - spot)
            if not np.any((apart[:, 0] < 0.5 * (width[:k] + width[k])) & (apart[:, 1] < line)):
                break
            off += FARTHER * height
        placed = np.vstack([placed, spot])
    moved = placed - flat
    return np.asarray(tips + moved[:, :1] * right + moved[:, 1:] * up)


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
