"""The recording of a needle's plan: obstacles with their safety shells, the swarm as it searches, forms, front and insertion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.needle.obstacles import Capsule, MaskObstacle, MeshObstacle, Obstacle, Polygon, Sphere
from tubeplan_viz.recording import entities as at

# rerun takes more than half a second to load; it is imported by the first recording, not by this module.
if TYPE_CHECKING:
    from tubeplan_viz.recording.sink import Sink

OBSTACLES, ENDS = f"{at.CASE}/obstacles", f"{at.CASE}/ends"
SWARM, CLOUD, FORMS = f"{at.CASE}/swarm/best", f"{at.CASE}/swarm/population", f"{at.CASE}/forms"
INSERTION, FRONT = f"{at.CASE}/insertion", f"{at.CASE}/pareto"
GOALS = ("error", "length", "danger")
BODY, SHELL = (205, 110, 95), (205, 110, 95, 45)
FORM_COLORS = ((96, 165, 255), (84, 178, 128), (195, 160, 255), (245, 150, 35))
MASK_POINTS = 20_000


class NeedleRecording:
    """A recording that is being written; `open` makes one, `close` publishes it, `abort` leaves no file.

    Attributes
    ----------
    warnings : tuple of str
        What the user should know of the live viewer, as sentences.
    """

    def __init__(self, sink: Sink, *, case_id: str, planner: str, frame: str, light: bool) -> None:
        self._sink, self._case_id, self._planner, self._frame, self._light = sink, case_id, planner, frame, light
        self._seen = np.zeros((0, 3))
        self._open = True

    @classmethod
    def open(cls, path: Path, *, case_id: str, planner: str, frame: str, connect: str | None = None, light: bool = False) -> Self:
        """Start the recording of one run; parameters as `Recording.open`.

        Raises
        ------
        RecordingError
            If the file cannot be made.
        """
        import rerun as rr

        from tubeplan_viz.recording.blueprint import scene_axes
        from tubeplan_viz.recording.sink import Sink

        sink = Sink(path, case_id=case_id, connect=connect)
        try:
            sink.property("case", rr.AnyValues(case_id=case_id, planner=planner, frame=frame, units="mm", notice=at.NOTICE))
            sink.log(at.CASE, scene_axes(frame), static=True)
        except BaseException:
            sink.discard()
            raise
        return cls(sink, case_id=case_id, planner=planner, frame=frame, light=light)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about the live viewer."""
        return self._sink.warnings

    def log_scene(self, entry: FloatArray, target: FloatArray, obstacles: Sequence[Obstacle], safety: float) -> None:
        """Entry, target, obstacles and the shells that the path must stay out of."""
        import rerun as rr

        self._seen = np.vstack([entry, target])
        self._sink.log(
            ENDS,
            rr.Points3D(
                [entry, target],
                labels=["entry", "target"],
                colors=[(130, 225, 130), (240, 120, 220)],
                radii=rr.Radius.ui_points(5.0),
            ),
            static=True,
        )
        for k, body in enumerate(obstacles):
            entity = f"{OBSTACLES}/{k + 1}"
            for suffix, shape in _shapes(body, safety):
                self._sink.log(f"{entity}{suffix}", shape, static=True)
        self._sink.flush()

    def log_round(self, index: int, best: FloatArray, cloud: Sequence[FloatArray] | None, goals: Mapping[str, float]) -> None:
        """The swarm's best path after one round, some of its population, and the goals of eq. 14."""
        import rerun as rr

        self._sink.at(at.ITERATION, index)
        self._sink.log(SWARM, rr.LineStrips3D([best], colors=at.PATH, radii=rr.Radius.ui_points(1.5)))
        if cloud is not None and not self._light:
            self._sink.log(CLOUD, rr.LineStrips3D(list(cloud), colors=[(150, 160, 180, 110)], radii=rr.Radius.ui_points(0.6)))
        for name in GOALS:
            if np.isfinite(goals[name]):
                self._sink.log(f"{at.CONVERGENCE}/{name}", rr.Scalars(float(goals[name])))
        self._sink.flush()

    def finish(self, result: Mapping[str, Any]) -> None:
        """The chosen path, forms, front, insertion and summary, from the content of result.json."""
        import rerun as rr

        details = result["details"]
        for form in details.get("forms", ()):
            if form["feasible"]:
                color = FORM_COLORS[form["degree"] - 1]
                label = f"{form['form']}, {form['length_mm']:.2f} mm"
                line = rr.LineStrips3D(
                    [form["points_mm"]], colors=color, labels=label, show_labels=False, radii=rr.Radius.ui_points(1.0)
                )
                self._sink.log(f"{FORMS}/degree_{form['degree']}/{form['form']}", line, static=True)
        front = details.get("pareto", ())
        if front:
            points = [(p["length_mm"], p["danger"]) for p in front]
            names = [f"error {p['error_mm']:.3f} mm, length {p['length_mm']:.2f} mm, danger {p['danger']:.2f}" for p in front]
            self._sink.log(
                FRONT, rr.Points2D(points, labels=names, show_labels=False, radii=rr.Radius.ui_points(4.0)), static=True
            )
        insertion = details.get("insertion")
        if insertion:
            strip = rr.LineStrips3D([insertion["points_mm"]], colors=(80, 205, 220), radii=rr.Radius.ui_points(2.5))
            self._sink.log(INSERTION, strip, static=True)
            for k, step in enumerate(insertion["replans"]):
                self._sink.at(at.ARC_LENGTH, int(step["at_mm"] * at.TICKS_PER_MM))
                told = f"{step['at_mm']:.1f} mm: {step['cause']}; " + ("replanned" if step["found"] else "no path from here")
                self._sink.log(at.DECISIONS, rr.TextLog(f"{k + 1}. {told}", level="INFO" if step["found"] else "WARN"))
        path = result["path"]
        if path is not None:
            self._seen = np.vstack([self._seen, path["points_mm"]])
            strip = rr.LineStrips3D([path["points_mm"]], colors=at.PATH, radii=rr.Radius.ui_points(2.5))
            self._sink.log(at.CURVE, strip, static=True)
            for tick, here in zip(path["s_mm"][::5], path["points_mm"][::5], strict=True):
                self._sink.at(at.ARC_LENGTH, int(tick * at.TICKS_PER_MM))
                self._sink.log(at.WALK, rr.Points3D([here], colors=at.HERE, radii=rr.Radius.ui_points(5.0)))
        document = rr.TextDocument(summary(self._case_id, result), media_type=rr.MediaType.MARKDOWN)
        self._sink.log(at.SUMMARY, document, static=True)
        self._sink.flush()

    def close(self) -> None:
        """Publish the file; a second call does nothing."""
        if self._open:
            self._open = False
            try:
                self._sink.publish(self._blueprint())
            except BaseException:
                self._sink.discard()
                raise

    def abort(self) -> None:
        """Leave no file; a second call, or one after `close`, does nothing."""
        if self._open:
            self._open = False
            self._sink.discard()

    def _blueprint(self) -> Any:
        import rerun.blueprint as rrb

        from tubeplan_viz.recording.blueprint import BACKGROUND, viewpoint

        eye = viewpoint(self._seen, self._frame, radius=12.0)
        if self._planner == "needle2d":  # the plane x = 0, seen along x with the depth downwards
            middle = self._seen.mean(axis=0)
            reach = 2.2 * float(np.linalg.norm(self._seen - middle, axis=1).max())
            position, up = middle + np.array([reach, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
        else:
            middle, position, up = eye.target, eye.position, eye.up
        controls = rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=middle, eye_up=up)
        space = rrb.Spatial3DView(
            origin=at.CASE,
            name="3D (research use, not for clinical decisions)",
            contents=["$origin/**", f"- {FRONT}"],
            background=rrb.Background(color=BACKGROUND),
            line_grid=False,
            eye_controls=controls,
        )
        words: list[Any] = [
            rrb.TextDocumentView(origin=at.SUMMARY, name="Summary"),
            rrb.TextLogView(origin=at.DECISIONS, name="Events"),
        ]
        side: list[Any] = [rrb.Tabs(*words, active_tab=0)]
        if self._planner == "needle3d":
            plots = [
                rrb.TimeSeriesView(origin=f"{at.CONVERGENCE}/{name}", name=f"{name.capitalize()} by round of the swarm")
                for name in GOALS
            ]
            side = [rrb.Tabs(*plots, active_tab=0), rrb.Spatial2DView(origin=FRONT, name="Pareto front: length, danger"), *side]
        return rrb.Blueprint(
            rrb.Horizontal(space, rrb.Vertical(*side), column_shares=[5, 4]),
            rrb.TopPanel(state="collapsed"),
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            rrb.TimePanel(state="collapsed", timeline=at.ITERATION if self._planner == "needle3d" else at.ARC_LENGTH),
            auto_views=False,
            auto_layout=False,
        )


def summary(case_id: str, result: Mapping[str, Any]) -> str:
    """The case in words, markdown."""
    metrics = result["metrics"]
    rows = [
        ("length", metrics["length_mm"], "mm"),
        ("tip error", metrics["tip_error_mm"], "mm"),
        ("least clearance", metrics["clearance_min_mm"], f"mm (asked: {result['limits']['clearance_min_mm']:g})"),
        ("insertion angle", result["details"].get("insertion_angle_deg"), "degrees"),
    ]
    lines = [f"| {name} | {value:.4g} {unit} |" for name, value, unit in rows if value is not None]
    head = "The target is reached and every distance is kept" if result["status"] == "ok" else str(result["reason"])
    table = "| | |\n|--|--|\n" + "\n".join(lines) if lines else ""
    planner = f"{result['planner']['name']} ({result['planner']['method']})"
    return f"## {head}\n\nCase **{case_id}**, {planner}\n\n{table}\n\n*{at.NOTICE}*"


def _shapes(body: Obstacle, safety: float) -> list[tuple[str, Any]]:
    """An obstacle and its safety shell as things of the scene."""
    import rerun as rr

    if isinstance(body, Sphere):
        made = []
        for suffix, size, color in (("", body.radius, (*BODY, 255)), ("/shell", body.radius + safety, SHELL)):
            half = [(1e-3 if body.kind == "circle" else size, size, size)]
            made.append((suffix, rr.Ellipsoids3D(centers=[body.center], half_sizes=half, colors=[color], fill_mode="solid")))
        return made if safety > 0.0 else made[:1]
    if isinstance(body, Capsule):
        lines = [("", rr.LineStrips3D([body.points], colors=BODY, radii=body.radius))]
        shell = rr.LineStrips3D([body.points], colors=[SHELL], radii=body.radius + safety)
        return [*lines, ("/shell", shell)] if safety > 0.0 else list(lines)
    if isinstance(body, Polygon):
        ring = np.column_stack([np.zeros(len(body.corners) + 1), np.vstack([body.corners, body.corners[:1]])])
        return [("", rr.LineStrips3D([ring], colors=BODY, radii=rr.Radius.ui_points(2.0)))]
    if isinstance(body, MeshObstacle):
        mesh = rr.Mesh3D(vertex_positions=body.surface.vertices, triangle_indices=body.surface.faces, albedo_factor=(*BODY, 190))
        return [("", mesh)]
    assert isinstance(body, MaskObstacle)
    rim = body.rim()
    step = max(1, len(rim) // MASK_POINTS)
    return [("", rr.Points3D(rim[::step], colors=BODY, radii=0.5 * float(np.mean(body.volume.spacing))))]
