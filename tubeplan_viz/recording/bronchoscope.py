"""The recording of the bronchoscope robot: airway, the tree as it grows, sub-goal spheres, the robot step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from tubeplan_viz.bronchoscope.mover import Step
from tubeplan_viz.bronchoscope.robot_plan import Node
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.base import RunRecording, begin

# rerun takes more than half a second to load; it is imported by the first recording, not by this module.
if TYPE_CHECKING:
    from tubeplan_viz.recording.sink import Sink

STEP = "step"
"""Sequence timeline: the number of the command in the plan."""
TREE, REFUSED, ROBOT, DISC = f"{at.CASE}/tree/poses", f"{at.CASE}/tree/collided", f"{at.CASE}/robot/axis", f"{at.CASE}/robot/disc"
CONTACTS, SUBGOALS, TARGET = f"{at.CASE}/robot/contacts", f"{at.CASE}/stages", f"{at.CASE}/target"
BRANCHES, ACTUATION, CLEARANCES = f"{at.CASE}/branches", f"{at.CASE}/actuation", f"{at.CASE}/clearance"
ROBOT_COLOR, ACTIVE_COLOR = (150, 160, 180), (255, 226, 120)
FORCE = f"{at.CASE}/force"
ANGLES = ("phi_proximal_deg", "phi_distal_deg")
SERIES: dict[str, tuple[str, at.Color]] = {
    f"{ACTUATION}/phi_proximal_deg": ("proximal", at.CENTERLINE_COLOR),
    f"{ACTUATION}/phi_distal_deg": ("distal", at.PATH),
    f"{CLEARANCES}/disc_clearance_mm": ("front disc", at.PATH),
    f"{CLEARANCES}/body_clearance_mm": ("body", at.CENTERLINE_COLOR),
    f"{FORCE}/largest_n": ("largest", at.LEAK),
}
"""Name and colour of each line in the plots by step."""


class BronchoscopeRecording(RunRecording):
    """A recording that is being written; `open` makes one, `close` publishes it, `abort` leaves no file.

    Attributes
    ----------
    warnings : tuple of str
        What the user should know of the live viewer, as sentences.
    """

    def __init__(self, sink: Sink, *, case_id: str, frame: str, light: bool) -> None:
        super().__init__(sink)
        self._case_id, self._frame, self._light = case_id, frame, light
        self._seen = np.zeros((0, 3))
        self._tips: list[FloatArray] = []
        self._branches: list[tuple[FloatArray, FloatArray]] = []
        self._refused: list[FloatArray] = []
        self._radius = 1.0
        self._has_forces = False
        self._wall = np.zeros((0, 3))

    @classmethod
    def open(cls, path: Path, *, case_id: str, method: str, frame: str, connect: str | None = None, light: bool = False) -> Self:
        """Start the recording of one run; parameters as `Recording.open`.

        Raises
        ------
        RecordingError
            If the file cannot be made.
        """
        sink = begin(path, case_id=case_id, frame=frame, connect=connect, planner="bronchoscope", method=method)
        return cls(sink, case_id=case_id, frame=frame, light=light)

    def log_airway(self, surface: Surface, branches: Sequence[tuple[str, FloatArray]], radius: float) -> None:
        """The wall, the named middle lines of its branches, and the robot's radius, mm."""
        import rerun as rr

        from tubeplan_viz.recording.anatomy import log_surface

        self._radius = radius
        self._wall = np.asarray(surface.vertices[::20])
        log_surface(self._sink, surface, light=self._light)
        lines = rr.LineStrips3D([line for _, line in branches], colors=at.CENTERLINE_COLOR, radii=rr.Radius.ui_points(0.8))
        self._sink.log(f"{BRANCHES}/lines", lines, static=True)
        named = rr.Points3D(
            [line[len(line) // 2] for _, line in branches],
            labels=[name for name, _ in branches],
            colors=at.CENTERLINE_COLOR,
            radii=rr.Radius.ui_points(1.5),
            show_labels=False,
        )
        self._sink.log(f"{BRANCHES}/names", named, static=True)
        self._sink.flush()

    def log_node(self, node: Node, number: int) -> None:
        """One pose of the growing tree: its track from the pose before, red when it collided."""
        import rerun as rr

        self._sink.at(at.ITERATION, number)
        if node.accepted:
            self._tips.append(node.tip)
            if node.parent >= 0:
                self._branches.append((np.asarray(node.step.track[0]), np.asarray(node.step.track)))
            strips = [track for _, track in self._branches if len(track) > 1]
            if strips:
                self._sink.log(TREE, rr.LineStrips3D(strips, colors=at.OK, radii=rr.Radius.ui_points(1.2)))
        else:
            self._refused.append(node.tip)
            self._sink.log(REFUSED, rr.Points3D(self._refused, colors=at.LEAK, radii=rr.Radius.ui_points(2.5)))
        self._sink.flush()

    def finish(self, result: Mapping[str, Any], steps: Sequence[Step]) -> None:
        """Stages, the robot at every step, its actuation, the tip's track and the summary."""
        import rerun as rr

        details = result["details"]
        goals = [stage["goal_mm"] for stage in details["stages"]]
        names = [f"{k + 1} {stage['name']}" for k, stage in enumerate(details["stages"])]
        spheres = rr.Ellipsoids3D(
            centers=goals,
            half_sizes=[(stage["sphere_radius_mm"],) * 3 for stage in details["stages"]],
            colors=[(84, 178, 128, 60)],
            labels=names,
            show_labels=False,
            fill_mode="solid",
        )
        self._sink.log(SUBGOALS, spheres, static=True)
        target = details["target"]
        places, words = [target["point_mm"]], [f"target in {target['branch']}"]
        if target["lesion_mm"] is not None:
            places.append(target["lesion_mm"])
            words.append("lesion")
        colors = [(240, 120, 220), (226, 58, 52)][: len(places)]
        self._sink.log(TARGET, rr.Points3D(places, labels=words, colors=colors, radii=rr.Radius.ui_points(6.0)), static=True)
        if result["centerline"] is not None:
            line = np.asarray(result["centerline"]["points_mm"], float)
            strip = rr.LineStrips3D([line], colors=at.CENTERLINE_COLOR, radii=rr.Radius.ui_points(1.0))
            self._sink.log(at.CENTERLINE, strip, static=True)
            self._seen = line
        path = np.asarray(result["path"]["points_mm"], float)
        self._sink.log(at.CURVE, rr.LineStrips3D([path], colors=at.PATH, radii=rr.Radius.ui_points(2.0)), static=True)
        self._seen = np.vstack([self._seen, path])
        active = float(details["robot"]["proximal_length_mm"] + details["robot"]["distal_length_mm"])
        self._has_forces = any(told["forces_n"] for told in details["steps"])
        for entity, (name, color) in SERIES.items():
            if self._has_forces or not entity.startswith(FORCE):
                self._sink.log(entity, rr.SeriesLines(names=name, colors=color, widths=1.8), static=True)
        for number, (step, told) in enumerate(zip(steps, details["steps"], strict=True)):
            self._sink.at(STEP, number)
            self._log_robot(step, active)
            self._log_numbers(told)
            angles = told["command"]
            said = f"{told['stage']}: at rest at the entrance" if angles is None else _said(told["stage"], angles)
            level = "INFO" if told["disc_clearance_mm"] >= 0.0 else "WARN"
            self._sink.log(at.DECISIONS, rr.TextLog(f"{number}. {said}", level=level))
        document = rr.TextDocument(summary(self._case_id, result), media_type=rr.MediaType.MARKDOWN)
        self._sink.log(at.SUMMARY, document, static=True)
        self._sink.flush()

    def _log_robot(self, step: Step, active: float) -> None:
        import rerun as rr

        body = np.asarray(step.body)
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(body, axis=0), axis=1))])
        split = max(int(np.searchsorted(s, s[-1] - active)), 0)
        strips, colors = [body[split:]], [ACTIVE_COLOR]
        if split > 0:
            strips, colors = [body[: split + 1], *strips], [ROBOT_COLOR, *colors]
        self._sink.log(ROBOT, rr.LineStrips3D(strips, colors=colors, radii=self._radius))
        turn = np.linspace(0.0, 2.0 * np.pi, 33)[:, None]
        rim = step.tip[:3, 3] + self._radius * (np.cos(turn) * step.tip[:3, 0] + np.sin(turn) * step.tip[:3, 1])
        color = at.OK if step.disc_clearance >= 0.0 else at.LEAK
        self._sink.log(DISC, rr.LineStrips3D([rim], colors=color, radii=rr.Radius.ui_points(1.5)))
        self._sink.log(
            CONTACTS,
            rr.Points3D(step.contacts, colors=at.FLAG_COLORS[next(iter(at.FLAG_COLORS))], radii=rr.Radius.ui_points(4.0))
            if len(step.contacts)
            else rr.Clear(recursive=False),
        )

    def _log_numbers(self, told: Mapping[str, Any]) -> None:
        import rerun as rr

        for name in ("disc_clearance_mm", "body_clearance_mm"):
            self._sink.log(f"{CLEARANCES}/{name}", rr.Scalars(float(told[name])))
        if told["command"] is not None:
            for name in ANGLES:
                self._sink.log(f"{ACTUATION}/{name}", rr.Scalars(float(told["command"][name])))
        if told["forces_n"]:
            self._sink.log(f"{FORCE}/largest_n", rr.Scalars(float(max(told["forces_n"]))))

    def _blueprint(self) -> Any:
        import rerun.blueprint as rrb

        from tubeplan_viz.recording.blueprint import SCENE_NAME, folded, scene_view, viewpoint

        eye = viewpoint(self._seen, self._frame, wall=self._wall)
        space = scene_view(SCENE_NAME, eye)
        words = rrb.Tabs(
            rrb.TextDocumentView(origin=at.SUMMARY, name="Summary"),
            rrb.TextLogView(origin=at.DECISIONS, name="Steps"),
            active_tab=0,
        )
        # Bends grow on the way and room shrinks: where they begin, and where it ends, a legend hides least.
        rising, falling = rrb.PlotLegend(rrb.Corner2D.LeftTop), rrb.PlotLegend(rrb.Corner2D.RightTop)
        plots = [
            rrb.TimeSeriesView(origin=ACTUATION, name="Bend of each section by step, degrees", plot_legend=rising),
            rrb.TimeSeriesView(origin=CLEARANCES, name="Distance to the wall by step, mm", plot_legend=falling),
        ]
        if self._has_forces:
            off = rrb.PlotLegend(visible=False)
            plots.append(rrb.TimeSeriesView(origin=FORCE, name="Largest contact force by step, N", plot_legend=off))
        return folded(
            rrb.Horizontal(space, rrb.Vertical(*plots, words, row_shares=[3] * len(plots) + [4]), column_shares=[5, 4]),
            timeline=STEP,
        )


def _said(stage: str, angles: Mapping[str, float]) -> str:
    return (
        f"{stage}: proximal {angles['phi_proximal_deg']:.1f}°, distal {angles['phi_distal_deg']:.1f}°, "
        f"push {angles['push_mm']:.2f} mm"
    )


def summary(case_id: str, result: Mapping[str, Any]) -> str:
    """The case in words, markdown."""
    details, metrics = result["details"], result["metrics"]
    head = "The target is reached" if details["reached"] else str(result["reason"])
    route = " → ".join(part["name"] for part in details["route"])
    lines = ["| stage | samples | pushes | collided |", "|--|--|--|--|"]
    lines += [f"| {s['name']} | {s['samples']} | {s['pushes']} | {s['collided']} |" for s in details["stages"]]
    figures = (
        f"tip error {metrics['tip_error_mm']:.2f} mm, least clearance of the body {metrics['body_clearance_min_mm']:.2f} mm, "
        f"of the front disc at the end {metrics['disc_clearance_end_mm']:.2f} mm"
    )
    return f"## {head}\n\nCase **{case_id}**: {route}\n\n{figures}\n\n" + "\n".join(lines) + f"\n\n*{at.NOTICE}*"
