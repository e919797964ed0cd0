"""Instruments against targets as one recording: the tree of paths per instrument on the timeline ``instrument``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from tubeplan_viz.geometry import across
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.anatomy import log_surface
from tubeplan_viz.recording.blueprint import Viewpoint, folded, scene_axes, scene_view, viewpoint
from tubeplan_viz.recording.names import log_names
from tubeplan_viz.recording.sink import Sink
from tubeplan_viz.result import digits_apart, part_words

INSTRUMENT = "instrument"
TREE = "/case/instruments"
# Bluish green, orange and reddish purple (Okabe and Ito): told apart with any colour vision, and named in the table.
COLORS: dict[str, at.Color] = {"feasible": (0, 158, 115), "flagged": (230, 159, 0), "impossible": (204, 121, 167)}
SIGNS = {"feasible": "holds", "flagged": "flagged", "impossible": "impossible"}
# A unit circle, closed.
CIRCLE = np.column_stack([np.cos(np.linspace(0.0, 2.0 * np.pi, 49)), np.sin(np.linspace(0.0, 2.0 * np.pi, 49))])
# Of the table, whose columns have to be narrow: ten targets stand side by side. No signs: some of them end the viewer.
MARKS = {"feasible": "yes", "flagged": "flag", "impossible": "no"}


def log_matrix(document: Mapping[str, Any], surface: Surface, path: Path) -> None:
    """Write the recording of a matrix.

    Parameters
    ----------
    document : mapping
        The content of matrix.json.
    surface : Surface
    path : Path

    Raises
    ------
    RecordingError
        If it cannot be written or does not read back.
    """
    sink = Sink(path, case_id=str(document["case_id"]), connect=None)
    seen = np.array([document["start_mm"], *(target["point_mm"] for target in document["targets"])], float)
    eye = viewpoint(seen, str(document["frame"]), radius=8.0, wall=np.asarray(surface.vertices[::20]))
    with sink:
        sink.log("/case", scene_axes(str(document["frame"])), static=True)
        log_surface(sink, surface, light=False)
        for number, (one, row) in enumerate(zip(document["instruments"], document["cells"], strict=True)):
            sink.at(INSTRUMENT, number)
            log_row(sink, document, row, eye)
            words = rr.TextDocument(told(document, one, row), media_type=rr.MediaType.MARKDOWN)
            sink.log("/case/instrument", words)
        sink.log("/case/table", rr.TextDocument(table(document), media_type=rr.MediaType.MARKDOWN), static=True)
        sink.flush()
        sink.publish(layout(eye))


def log_row(sink: Sink, document: Mapping[str, Any], row: list[Mapping[str, Any]], eye: Viewpoint) -> None:
    """The paths of one instrument, and its targets, coloured by verdict."""
    colors = [COLORS[cell["verdict"]] for cell in row]
    lines, line_colors = [], []
    for paths, cell, color in zip(document["paths"], row, colors, strict=True):
        if cell["path"] is not None:
            lines.append(np.asarray(paths[cell["path"]]["points_mm"], float))
            line_colors.append(color)
        elif cell["reached_path"] is not None:
            lines.append(beginning(np.asarray(paths[cell["reached_path"]]["points_mm"], float), cell["reached_mm"]))
            line_colors.append(color)
    sink.log(f"{TREE}/paths", rr.LineStrips3D(lines, colors=line_colors, radii=rr.Radius.ui_points(2.5)))
    labels = [
        f"{target['label']}: {SIGNS[cell['verdict']]}"
        + ("" if cell["margin_mm"] is None else f" {margin_text(cell['margin_mm'])} mm")
        for target, cell in zip(document["targets"], row, strict=True)
    ]
    points = np.array([target["point_mm"] for target in document["targets"]], float)
    sink.log(f"{TREE}/targets", rr.Points3D(points, colors=colors, radii=rr.Radius.ui_points(6.0)))
    log_names(sink, f"{TREE}/names", points, labels, colors, eye, static=False)
    rings = section_rings(document, row)
    sink.log(f"{TREE}/bends", rr.LineStrips3D(rings, colors=COLORS["impossible"], radii=rr.Radius.ui_points(1.5)))
    worst = [
        (cell["margin_point_mm"], color)
        for cell, color in zip(row, colors, strict=True)
        if cell["verdict"] != "feasible" and cell["margin_point_mm"] is not None
    ]
    sink.log(
        f"{TREE}/worst",
        rr.Points3D([point for point, _ in worst], colors=[color for _, color in worst], radii=rr.Radius.ui_points(4.0)),
    )


def margin_text(margin: float) -> str:
    """A margin in mm with as many decimals, 2 to 6, as tell it from none: what does not fit never shows 0.00."""
    text = f"{margin:+.{digits_apart(margin, 0.0, 2)}f}"
    return text if float(text) else f"{0.0:.2f}"


def beginning(points: FloatArray, length: float) -> FloatArray:
    """The points of a line up to some mm from its first, two at least."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return points[: max(int(np.searchsorted(s, length, side="right")), 2)]


def section_rings(document: Mapping[str, Any], row: list[Mapping[str, Any]]) -> list[FloatArray]:
    """Rims of the cross-sections of each bend that keeps one instrument out; an end of the path has none."""
    found = []
    for bends, cell in zip(document["bends"], row, strict=True):
        if cell["bend"] is None:
            continue
        for section in bends[cell["bend"]]["sections"]:
            side, up = across(np.array([section["normal"]], float))
            if section["radius_mm"] > 0.0:
                found.append(
                    np.asarray(section["point_mm"], float) + section["radius_mm"] * (CIRCLE @ np.concatenate([side, up]))
                )
    return found


def told(document: Mapping[str, Any], one: Mapping[str, Any], row: list[Mapping[str, Any]]) -> str:
    """One instrument and what holds or hinders it, as markdown."""
    head = (
        f"## {one['name']}\n\ndiameter {one['outer_diameter_mm']:g} mm, bend radius {one['bend_radius_min_mm']:g} mm, "
        f"rigid tip {one['rigid_tip_mm']:g} mm, working length {one['working_length_mm']:g} mm\n\n"
    )
    lines = [
        f"* **{called(target)}**: {SIGNS[cell['verdict']]}; {cell['reason']}"
        for target, cell in zip(document["targets"], row, strict=True)
    ]
    return head + "\n".join(lines)


def called(target: Mapping[str, Any]) -> str:
    """A target's label with the name of its part, where that is known; a label that is in the name stands once."""
    return " ".join(filter(None, (target["label"], part_words(target["label"], target["name"]))))


def table(document: Mapping[str, Any]) -> str:
    """All cells as markdown."""
    labels = [target["label"] for target in document["targets"]]
    lines = ["## Instruments and targets", "| # | instrument | " + " | ".join(labels) + " |", "|--|--|" + "--|" * len(labels)]
    for number, (one, row) in enumerate(zip(document["instruments"], document["cells"], strict=True)):
        cells = [
            MARKS[cell["verdict"]] + ("" if cell["margin_mm"] is None else f" {margin_text(cell['margin_mm'])}") for cell in row
        ]
        lines.append(f"| {number} | {one['name']} | " + " | ".join(cells) + " |")
    names = [called(target) for target in document["targets"] if target["name"]]
    legend = ("; ".join(names) + ". " if names else "") + ", ".join(f"{MARKS[verdict]}: {SIGNS[verdict]}" for verdict in MARKS)
    return "\n".join(lines) + f"\n\n{legend}; margins in mm. {document['rule']}\n\n*{at.NOTICE}*"


def layout(eye: Viewpoint) -> rrb.Blueprint:
    """The tree beside the table; the timeline steps through the instruments."""
    scene = scene_view("Paths of one instrument; step through the timeline `instrument`", eye)
    words = rrb.Vertical(
        rrb.TextDocumentView(origin="/case/table", name=f"All cells ({at.NOTICE.lower().rstrip('.')})"),
        rrb.TextDocumentView(origin="/case/instrument", name="This instrument"),
        row_shares=[1, 1],
    )
    return folded(
        rrb.Horizontal(scene, words, column_shares=[2, 3]),
        timeline=INSTRUMENT,
        play_state="paused",
    )
