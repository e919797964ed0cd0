"""The recording of a needle's plan: obstacles with their safety shells, the swarm as it searches, forms, front and insertion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.volume import Volume
from tubeplan_viz.needle.bodies import Polygon, Sphere
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.plan import FlagKind
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.base import RunRecording, begin

# rerun takes more than half a second to load; it is imported by the first recording, not by this module.
if TYPE_CHECKING:
    from tubeplan_viz.recording.sink import Sink

OBSTACLES, ENDS = f"{at.CASE}/obstacles", f"{at.CASE}/ends"
SWARM, CLOUD, FORMS = f"{at.CASE}/swarm/best", f"{at.CASE}/swarm/population", f"{at.CASE}/forms"
INSERTION, FRONT, FRONT_PATHS = f"{at.CASE}/insertion", f"{at.CASE}/pareto", f"{at.CASE}/pareto_paths"
TRIALS, TIPS = f"{at.CASE}/insertions/paths", f"{at.CASE}/insertions/tips"
GOALS = ("error", "length", "danger")
FRONT_COLOR, PUSHED_COLOR = (150, 130, 220, 120), (80, 205, 220)
FRONT_SIZE = 100.0  # of the front's picture, which has no unit: the labels tell the figures
CLEARANCE = f"{at.CASE}/path/clearance"
END_COLORS = {"entry": (130, 225, 130), "target": (240, 120, 220), "entry asked": (150, 156, 170)}
MOVED_MM = 0.05  # an entry that was free to move and did
TRIAL_COLOR, TIP_COLOR = (200, 200, 210, 90), (255, 255, 255)
FORM_COLORS = ((96, 165, 255), (84, 178, 128), (195, 160, 255), (245, 150, 35))


class NeedleRecording(RunRecording):
    """A recording that is being written; `open` makes one, `close` publishes it, `abort` leaves no file.

    Attributes
    ----------
    warnings : tuple of str
        What the user should know of the live viewer, as sentences.
    """

    def __init__(self, sink: Sink, *, case_id: str, planner: str, frame: str, light: bool) -> None:
        super().__init__(sink)
        self._case_id, self._planner, self._frame, self._light = case_id, planner, frame, light
        self._seen = np.zeros((0, 3))
        self._scene: Scene | None = None
        self._volume: Volume | None = None
        self._last = 0
        self._limits: dict[FlagKind, float] = {}  # of the quantities that are plotted

    @classmethod
    def open(cls, path: Path, *, case_id: str, planner: str, frame: str, connect: str | None = None, light: bool = False) -> Self:
        """Start the recording of one run; parameters as `Recording.open`.

        Raises
        ------
        RecordingError
            If the file cannot be made.
        """
        sink = begin(path, case_id=case_id, frame=frame, connect=connect, planner=planner)
        return cls(sink, case_id=case_id, planner=planner, frame=frame, light=light)

    def log_scene(self, entry: FloatArray, target: FloatArray, scene: Scene, safety: float, volume: Volume | None = None) -> None:
        """Entry, target, obstacles and the shells that the path must stay out of; `volume` is the CT for planes at the end."""

        from tubeplan_viz.recording.needle_scene import shapes

        ends = np.vstack([entry, target])
        flat = [body for body in scene.obstacles if isinstance(body, Sphere | Polygon)] if self._planner == "needle2d" else []
        self._seen = np.vstack([ends, *(rim_of(body) for body in flat)])
        self._scene, self._volume = scene, None if self._light else volume
        self._log_ends({"entry": entry, "target": target})
        for k, body in enumerate(scene.obstacles):
            entity = f"{OBSTACLES}/{k + 1}"
            for suffix, shape in shapes(body, safety, ends):
                self._sink.log(f"{entity}{suffix}", shape, static=True)
        self._sink.flush()

    def _log_ends(self, places: Mapping[str, FloatArray]) -> None:
        """Named places; a later call stands in for the one before."""
        import rerun as rr

        points = rr.Points3D(
            list(places.values()),
            labels=list(places),
            colors=[END_COLORS[name] for name in places],
            radii=rr.Radius.ui_points(5.0),
        )
        self._sink.log(ENDS, points, static=True)

    def log_round(self, index: int, best: FloatArray, cloud: Sequence[FloatArray] | None, goals: Mapping[str, float]) -> None:
        """The swarm's best path after one round, some of its population, and the goals of eq. 14."""
        import rerun as rr

        self._last = index
        self._sink.at(at.ITERATION, index)
        self._sink.log(SWARM, rr.LineStrips3D([best], colors=at.PATH, radii=rr.Radius.ui_points(1.5)))
        if cloud is not None and not self._light:
            self._sink.log(CLOUD, rr.LineStrips3D(list(cloud), colors=[(150, 160, 180, 110)], radii=rr.Radius.ui_points(0.6)))
        for name in GOALS:
            if np.isfinite(goals[name]):
                self._sink.log(f"{at.CONVERGENCE}/{name}", rr.Scalars(float(goals[name])))
        self._sink.flush()

    def finish(self, result: Mapping[str, Any]) -> None:
        """The chosen path, forms, front, insertions, CT planes and summary, from the content of result.json."""
        import rerun as rr

        self._log_forms(result["details"])
        self._log_front(result["details"])
        self._log_insertions(result["details"])
        path = result["path"]
        if path is not None:
            self._seen = np.vstack([self._seen, path["points_mm"]])
            strip = rr.LineStrips3D([path["points_mm"]], colors=at.PATH, radii=rr.Radius.ui_points(2.5))
            self._sink.log(at.CURVE, strip, static=True)
            ends = np.array([path["points_mm"][0], result["details"]["target_mm"]], float)
            asked = self._seen[0]
            moved = {"entry asked": asked} if np.linalg.norm(ends[0] - asked) > MOVED_MM else {}
            self._log_ends({"entry": ends[0], "target": ends[1], **moved})
            gaps = path["clearance_mm"] or [None] * len(path["s_mm"])
            for tick, here, gap in zip(path["s_mm"][::5], path["points_mm"][::5], gaps[::5], strict=True):
                self._sink.at(at.ARC_LENGTH, int(tick * at.TICKS_PER_MM))
                self._sink.log(at.WALK, rr.Points3D([here], colors=at.HERE, radii=rr.Radius.ui_points(5.0)))
                if gap is not None:
                    self._sink.log(CLEARANCE, rr.Scalars(float(gap)))
            self._log_profile(result)
            if self._volume is not None and self._scene is not None:
                from tubeplan_viz.recording.needle_ct import log_ct

                points, gaps = np.array(path["points_mm"], float), path["clearance_mm"]
                log_ct(
                    self._sink,
                    self._volume,
                    self._scene.body_distances if len(self._scene) else None,
                    np.array(path["s_mm"], float),
                    points,
                    safety=result["limits"]["clearance_min_mm"],
                    tightest=len(points) // 2 if gaps is None else int(np.argmin(gaps)),
                    last=self._last,
                )
        document = rr.TextDocument(summary(self._case_id, result), media_type=rr.MediaType.MARKDOWN)
        self._sink.log(at.SUMMARY, document, static=True)
        self._sink.flush()

    def _log_profile(self, result: Mapping[str, Any]) -> None:
        """Clearance and curvature over arc length with their limits; without obstacles there is no clearance."""
        from tubeplan_viz.recording.plans import log_bars

        path = result["path"]
        s = np.array(path["s_mm"], float)
        for kind, key, limit in (
            (FlagKind.CLEARANCE, "clearance_mm", "clearance_min_mm"),
            (FlagKind.CURVATURE, "curvature_per_mm", "curvature_max_per_mm"),
        ):
            if not path[key]:
                continue
            broken = np.zeros(len(s), dtype=bool)
            for flag in result["flagged_intervals"]:
                broken |= (flag["kind"] == kind) & (s >= flag["from_mm"]) & (s <= flag["to_mm"])
            self._limits[kind] = float(result["limits"][limit])
            log_bars(self._sink, kind, s, np.array(path[key], float), broken, self._limits[kind], single=self._light, static=True)

    def _log_forms(self, details: Mapping[str, Any]) -> None:
        import rerun as rr

        for form in details.get("forms", ()):
            if form["feasible"]:
                color = FORM_COLORS[form["degree"] - 1]
                label = f"{form['form']}, {form['length_mm']:.2f} mm"
                line = rr.LineStrips3D(
                    [form["points_mm"]], colors=color, labels=label, show_labels=False, radii=rr.Radius.ui_points(1.0)
                )
                self._sink.log(f"{FORMS}/degree_{form['degree']}/{form['form']}", line, static=True)

    def _log_front(self, details: Mapping[str, Any]) -> None:
        import rerun as rr

        front = details.get("pareto", ())
        if not front:
            return
        goals = np.array([(p["length_mm"], p["danger"]) for p in front], float)
        share = (goals - goals.min(axis=0)) / np.maximum(np.ptp(goals, axis=0), 1e-9)
        points = FRONT_SIZE * np.column_stack([share[:, 0], 0.5 * (1.0 - share[:, 1])])  # danger upwards
        names = [f"error {p['error_mm']:.3f} mm, length {p['length_mm']:.2f} mm, danger {p['danger']:.2f}" for p in front]
        dots = rr.Points2D(points, labels=names, show_labels=False, radii=rr.Radius.ui_points(4.0))
        self._sink.log(FRONT, dots, static=True)
        lines = rr.LineStrips3D(
            [p["points_mm"] for p in front], labels=names, show_labels=False, colors=FRONT_COLOR, radii=rr.Radius.ui_points(0.7)
        )
        self._sink.log(FRONT_PATHS, lines, static=True)

    def _log_insertions(self, details: Mapping[str, Any]) -> None:
        import rerun as rr

        insertion = details.get("insertion")
        if insertion:
            strip = rr.LineStrips3D([insertion["points_mm"]], colors=PUSHED_COLOR, radii=rr.Radius.ui_points(2.5))
            self._sink.log(INSERTION, strip, static=True)
            for k, step in enumerate(insertion["replans"]):
                self._sink.at(at.ARC_LENGTH, int(step["at_mm"] * at.TICKS_PER_MM))
                told = f"{step['at_mm']:.1f} mm: {step['cause']}; " + ("replanned" if step["found"] else "no path from here")
                self._sink.log(at.DECISIONS, rr.TextLog(f"{k + 1}. {told}", level="INFO" if step["found"] else "WARN"))
        chances = details.get("monte_carlo")
        if chances:
            lines = rr.LineStrips3D(list(chances["paths_mm"]), colors=[TRIAL_COLOR], radii=rr.Radius.ui_points(0.6))
            self._sink.log(TRIALS, lines, static=True)
            if chances["offsets_mm"]:
                tips = np.array(details["target_mm"], float) + np.array(chances["offsets_mm"], float)
                self._sink.log(TIPS, rr.Points3D(tips, colors=TIP_COLOR, radii=rr.Radius.ui_points(2.0)), static=True)

    def _blueprint(self) -> Any:
        import rerun.blueprint as rrb

        from tubeplan_viz.recording.blueprint import SCENE_NAME, Viewpoint, bars_view, folded, scene_view, viewpoint

        if self._planner == "needle2d":  # the plane x = 0, seen along x with the depth downwards
            middle = 0.5 * (self._seen.min(axis=0) + self._seen.max(axis=0))
            reach = 2.2 * float(np.linalg.norm(self._seen - middle, axis=1).max())
            # From -x the y axis points to the right, as in the report.
            eye = Viewpoint(position=middle - np.array([reach, 0.0, 0.0]), target=middle, up=np.array([0.0, 0.0, -1.0]))
        else:
            eye = viewpoint(self._seen, self._frame, radius=12.0)
        space = scene_view(SCENE_NAME, eye, contents=["$origin/**", f"- {FRONT}", f"- {at.CT}/**"])
        words: list[Any] = [
            rrb.TextDocumentView(origin=at.SUMMARY, name="Summary"),
            rrb.TextLogView(origin=at.DECISIONS, name="Events"),
        ]
        side: list[Any] = [bars_view(kind, limit) for kind, limit in self._limits.items()]
        if self._planner == "needle3d":
            search = [
                rrb.TimeSeriesView(
                    origin=f"{at.CONVERGENCE}/{name}",
                    name=f"{name.capitalize()} by round",
                    plot_legend=rrb.PlotLegend(visible=False),
                )
                for name in GOALS
            ]
            front = rrb.Spatial2DView(origin=FRONT, name="Pareto front: danger over length")
            side.append(rrb.Tabs(*search, front, active_tab=0))
        side.append(rrb.Tabs(*words, active_tab=0))
        scene: rrb.View | rrb.Container = space
        if self._volume is not None:
            from tubeplan_viz.recording.slices import FIELD_MM, PIXEL_MM

            pixels = FIELD_MM / PIXEL_MM
            bounds = rrb.VisualBounds2D(x_range=(0.0, pixels), y_range=(0.0, pixels))
            planes = [
                rrb.Spatial2DView(origin=f"{at.CT}/{plane}", name=f"CT, {plane}", background=(0, 0, 0), visual_bounds=bounds)
                for plane in at.PLANES
            ]
            scene = rrb.Vertical(space, rrb.Horizontal(*planes), row_shares=[3, 2])
        return folded(
            rrb.Horizontal(scene, rrb.Vertical(*side, row_shares=[3] * (len(side) - 1) + [4]), column_shares=[5, 4]),
            timeline=at.ITERATION if self._planner == "needle3d" else at.ARC_LENGTH,
        )


def rim_of(body: Sphere | Polygon) -> FloatArray:
    """Corners of the box of a circle or polygon in the plane x = 0, (k, 3) mm."""
    if isinstance(body, Sphere):
        return np.asarray(body.center + body.radius * np.array([[0.0, -1.0, -1.0], [0.0, 1.0, 1.0]]))
    return np.column_stack([np.zeros(len(body.corners)), body.corners])


def summary(case_id: str, result: Mapping[str, Any]) -> str:
    """The case in words, markdown."""
    metrics = result["metrics"]
    rows = [
        ("length", metrics["length_mm"], 2, "mm"),
        ("tip error", metrics["tip_error_mm"], 3, "mm"),
        ("least clearance", metrics["clearance_min_mm"], 3, f"mm (asked: {result['limits']['clearance_min_mm']:g})"),
        ("insertion angle", result["details"].get("insertion_angle_deg"), 2, "degrees"),
    ]
    lines = [f"| {name} | {value:.{digits}f} {unit} |" for name, value, digits, unit in rows if value is not None]
    head = "The target is reached and every distance is kept" if result["status"] == "ok" else str(result["reason"])
    table = "| | |\n|--|--|\n" + "\n".join(lines) if lines else ""
    planner = f"{result['planner']['name']} ({result['planner']['method']})"
    return f"## {head}\n\nCase **{case_id}**, {planner}\n\n{table}\n\n*{at.NOTICE}*"
