"""The recording of a rigid plan: labels, entry voxels and why not, corridor, instrument at every node, CT along the way."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from segmentation.arrays import FloatArray
from segmentation.volume import Volume
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.base import RunRecording, begin
from tubeplan_viz.rigid import BORDER, Bodies, CoupledInstrument, Problem, RigidPlan, posed, swept
from tubeplan_viz.rigid.instrument import unit

# rerun takes more than half a second to load; it is imported by the first recording, not by this module.
if TYPE_CHECKING:
    from tubeplan_viz.recording.sink import Sink

ANATOMY, ENTRY, CORRIDOR, BEST, NODES = (f"{at.CASE}/{name}" for name in ("anatomy", "entry", "corridor", "best", "nodes"))
TOOL, DISTANCES, PARETO = f"{at.CASE}/walk/instrument", f"{at.CASE}/distances", f"{at.CASE}/pareto"
COLORS: dict[str, tuple[int, int, int]] = {
    "brain": (205, 150, 170),
    "orbit_left": (230, 190, 90),
    "orbit_right": (230, 190, 90),
    "septum": (110, 170, 235),
    "turbinate_left": (215, 110, 95),
    "turbinate_right": (215, 110, 95),
    BORDER: (150, 156, 170),
}
FEASIBLE = at.OK
SCOPE_COLOR, SHAVER_COLOR = (120, 200, 235), (235, 235, 240)
CELLS_SHOWN = 25_000
WALK_STEP_MM, SLICE_STEP_MM = 1.0, 4.0
FIELD_MM, PIXEL_MM = 110.0, 0.7
HU_RANGE = (-1000.0, 1000.0)
SHOWN_BEHIND_MM = 60.0
PLANES: dict[str, tuple[FloatArray, FloatArray]] = {
    "axial": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    "coronal": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])),
    "sagittal": (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])),
}


class RigidRecording(RunRecording):
    """A recording that is being written; `open` makes one, `close` publishes it, `abort` leaves no file.

    Attributes
    ----------
    warnings : tuple of str
        What the user should know of the live viewer, as sentences.
    """

    def __init__(self, sink: Sink, *, case_id: str, light: bool) -> None:
        super().__init__(sink)
        self._case_id, self._light = case_id, light
        self._seen = np.zeros((1, 3))
        self._walked = self._ranked = False

    @classmethod
    def open(cls, path: Path, *, case_id: str, connect: str | None = None, light: bool = False) -> Self:
        """Start the recording of one run; parameters as `Recording.open`.

        Raises
        ------
        RecordingError
            If the file cannot be made.
        """
        sink = begin(path, case_id=case_id, frame="LPS", connect=connect, planner="rigid")
        return cls(sink, case_id=case_id, light=light)

    def log_scene(self, problem: Problem) -> None:
        """Structures near the way, the border of the entry region and the lesion."""
        import rerun as rr

        obstacles = problem.obstacles
        # Only what lies near the way is shown; the surface of the face is not among it.
        for k, name in enumerate(obstacles.names):
            cells = obstacles.frame.to_lps(obstacles.cells[obstacles.rows[k]])
            cells = cells[:: max(1, len(cells) // (CELLS_SHOWN // (5 if self._light else 1)))]
            # One label for many points stands in their middle.
            points = rr.Points3D(cells, colors=COLORS[name], radii=0.3, labels=[name.replace("_", " ")], show_labels=True)
            self._sink.log(f"{ANATOMY}/{name.replace(' ', '_')}", points, static=True)
        goal = rr.Points3D([problem.goal], colors=(240, 120, 220), radii=rr.Radius.ui_points(6.0), labels=["lesion"])
        self._sink.log(f"{ANATOMY}/lesion", goal, static=True)
        self._seen = np.vstack([problem.starts, problem.goal])
        self._sink.flush()

    def finish(self, plan: RigidPlan, result: Mapping[str, Any]) -> None:
        """Entry voxels, best paths, instrument, planes, goals and summary."""
        import rerun as rr

        self._log_entry(plan)
        if plan.ranking is not None:
            self._log_best(plan)
            path = plan.paths[plan.ranking.best["overall"]]
            bodies = swept(plan.problem.instrument, path.nodes[:-1], path.nodes[1:], path.roll)
            self._sink.log(CORRIDOR, capsules(bodies, plan.problem.instrument, alpha=50), static=True)
            for k, (a, b) in enumerate(zip(path.nodes[:-1], path.nodes[1:], strict=True), start=1):
                pose = posed(plan.problem.instrument, b[None], unit(b - a)[None], path.roll)
                self._sink.log(f"{NODES}/{k}", capsules(pose, plan.problem.instrument), static=True)
            self._log_walk(plan, result, path.roll)
            self._walked = True
            self._ranked = self._log_pareto(result)
        elif not self._light:
            # Without a way the planes stand at the lesion, where a reader sees what lies before it.
            self._sink.at(at.ARC_LENGTH, 0)
            for plane in PLANES:
                self._sink.log(f"{at.CT}/{plane}", plane_picture(plan.problem, plan.problem.goal, plane))
        document = rr.TextDocument(summary(self._case_id, result), media_type=rr.MediaType.MARKDOWN)
        self._sink.log(at.SUMMARY, document, static=True)
        self._sink.flush()

    def _log_entry(self, plan: RigidPlan) -> None:
        import rerun as rr

        found, names = plan.searched, plan.problem.obstacles.names
        groups = {"feasible": (found.feasible, FEASIBLE)}
        for k, name in enumerate(names):
            groups[f"blocked_by_{name.replace(' ', '_')}"] = (~found.feasible & (found.blocked_by == k), COLORS[name])
        for name, (rows, color) in groups.items():
            if rows.any():
                points = rr.Points3D(
                    plan.problem.starts[rows], colors=color, radii=0.45, labels=[name.replace("_", " ")], show_labels=False
                )
                self._sink.log(f"{ENTRY}/{name}", points, static=True)
        level = "INFO" if found.feasible.any() else "WARN"
        told = f"{int(found.feasible.sum())} of {len(found.feasible)} entry voxels are feasible"
        self._sink.log(at.DECISIONS, rr.TextLog(told, level=level), static=True)

    def _log_best(self, plan: RigidPlan) -> None:
        import rerun as rr

        assert plan.ranking is not None
        colors = {"overall": at.PATH, "brain": (205, 150, 170), "length": (84, 178, 128), "tissue": (110, 170, 235)}
        for name, index in plan.ranking.best.items():
            strip = rr.LineStrips3D(
                [plan.paths[index].nodes], colors=colors[name], radii=rr.Radius.ui_points(2.5), labels=[name], show_labels=False
            )
            self._sink.log(f"{BEST}/{name}", strip, static=True)

    def _log_walk(self, plan: RigidPlan, result: Mapping[str, Any], roll: float) -> None:
        import rerun as rr

        path, problem = result["path"], plan.problem
        s, points = np.array(path["s_mm"]), np.array(path["points_mm"])
        ways = unit(np.diff(points, axis=0))
        ways = np.vstack([ways, ways[-1:]])
        named = result["details"]["structure_distances_mm"]
        for name in named:
            line = rr.SeriesLines(colors=COLORS[name], names=name.replace("_", " "), widths=2.0)
            self._sink.log(f"{DISTANCES}/{name}", line, static=True)
        last_slice = -np.inf
        for place in np.arange(0.0, s[-1] + WALK_STEP_MM, WALK_STEP_MM * (3 if self._light else 1)):
            k = int(np.abs(s - place).argmin())
            self._sink.at(at.ARC_LENGTH, round(float(s[k]) * at.TICKS_PER_MM))
            pose = posed(problem.instrument, points[k : k + 1], ways[k : k + 1], roll)
            self._sink.log(TOOL, capsules(pose, problem.instrument))
            for name, values in named.items():
                if values[k] is not None:
                    self._sink.log(f"{DISTANCES}/{name}", rr.Scalars(float(values[k])))
            if not self._light and (s[k] - last_slice >= SLICE_STEP_MM or place > s[-1] - WALK_STEP_MM):
                last_slice = s[k]
                for plane in PLANES:
                    self._sink.log(f"{at.CT}/{plane}", plane_picture(problem, points[k], plane))
        self._sink.flush()

    def _log_pareto(self, result: Mapping[str, Any]) -> bool:
        """The ranked paths that have a distance to the brain; whether there are any."""
        import rerun as rr

        rows = [row for row in result["details"]["candidates"] if row["brain_mm"] is not None]
        if rows:
            points = [
                (100.0 * brain, -60.0 * tissue)
                for brain, tissue in zip(
                    shares([row["brain_mm"] for row in rows]), shares([row["tissue_voxels"] for row in rows]), strict=True
                )
            ]
            colors = [at.PATH if row["pareto"] else (110, 116, 130) for row in rows]
            self._sink.log(PARETO, rr.Points2D(points, colors=colors, radii=rr.Radius.ui_points(2.5)), static=True)
        return bool(rows)

    def _blueprint(self) -> Any:
        import rerun as rr
        import rerun.blueprint as rrb

        from tubeplan_viz.recording.blueprint import SCENE_NAME, Viewpoint, folded, scene_view

        middle = 0.5 * (self._seen.min(axis=0) + self._seen.max(axis=0))
        reach = float(np.linalg.norm(self._seen - middle, axis=1).max())
        side = 1.0 if middle[0] >= 0.0 else -1.0
        away = 2.6 * reach * unit(np.array([side * 1.0, -0.9, 0.35]))
        eye = Viewpoint(position=middle + away, target=middle, up=np.array([0.0, 0.0, 1.0]))
        scene = scene_view(SCENE_NAME, eye, contents=["$origin/**", f"- {at.CT}/**", f"- {PARETO}", f"- {CORRIDOR}"])
        corridor = scene_view(
            "Corridor and best paths",
            eye,
            contents=[f"{ANATOMY}/**", f"{ENTRY}/feasible", f"{BEST}/**", CORRIDOR],
            overrides={f"{ANATOMY}/brain": rr.Points3D.from_fields(radii=0.15)},
        )
        left: Any = rrb.Tabs(scene, corridor, active_tab=0) if self._walked else scene
        if not self._light:
            planes = [rrb.Spatial2DView(origin=f"{at.CT}/{plane}", name=f"CT and labels, {plane}") for plane in PLANES]
            left = rrb.Vertical(left, rrb.Horizontal(*planes), row_shares=[6, 4])
        told = rrb.Tabs(
            rrb.TextDocumentView(origin=at.SUMMARY, name="Summary"),
            rrb.TextLogView(origin=at.DECISIONS, name="Decisions"),
            active_tab=0,
        )
        # A view that could only say "no data" is left out.
        right: Any = told
        if self._walked:
            distances = rrb.TimeSeriesView(origin=DISTANCES, name="Instrument to each structure, mm, along the path")
            ranked = rrb.Spatial2DView(origin=PARETO, name="Paths: to the brain (right), tissue (down); Pareto set bright")
            views = [distances, *([ranked] if self._ranked else []), told]
            right = rrb.Vertical(*views, row_shares=[3, 2, 3] if self._ranked else [3, 3])
        return folded(
            rrb.Horizontal(left, right, column_shares=[3, 2]),
            timeline=at.ARC_LENGTH,
            play_state="following",
        )


def shares(values: list[float]) -> FloatArray:
    """Where each value stands between the least, 0, and the largest, 1; 0 where all are one."""
    span = float(np.ptp(values))
    return (np.array(values, float) - min(values)) / (span if span > 0.0 else 1.0)


def capsules(bodies: Bodies, instrument: CoupledInstrument, *, alpha: int = 255) -> Any:
    """Bodies as lines with a radius, cut to what lies near the head."""
    import rerun as rr

    from_front = np.minimum(bodies.length, SHOWN_BEHIND_MM + np.linalg.norm(bodies.front[0] - bodies.front[-1]))
    tail = bodies.front - from_front[:, None] * bodies.axis
    # A line is drawn with round ends: a flat end is moved back by its radius, which draws the cylinder's inside.
    front = bodies.front - np.where(bodies.round_front, 0.0, bodies.radius)[:, None] * bodies.axis
    colors = [(*(SHAVER_COLOR if round_ else SCOPE_COLOR), alpha) for round_ in bodies.round_front]
    return rr.LineStrips3D(list(np.stack([tail, front], axis=1)), colors=colors, radii=bodies.radius)


def plane_picture(problem: Problem, center: FloatArray, plane: str) -> Any:
    """One CT plane through a point with the labels laid over it, as a JPEG."""
    import rerun as rr

    right, down = PLANES[plane]
    count = round(FIELD_MM / PIXEL_MM)
    offset = ((np.arange(count) + 0.5) / count - 0.5) * FIELD_MM
    places = center + offset[:, None, None] * down + offset[None, :, None] * right
    picture = overlaid(problem.scene.volume, problem, places)
    middle = count // 2
    picture[middle - 1 : middle + 2, middle - 4 : middle + 5] = at.HERE
    picture[middle - 4 : middle + 5, middle - 1 : middle + 2] = at.HERE
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "JPEG", quality=80)
    return rr.EncodedImage(contents=buffer.getvalue(), media_type="image/jpeg")


def overlaid(volume: Volume, problem: Problem, places: FloatArray) -> NDArray[np.uint8]:
    """Grey values at (h, w, 3) LPS places with the labels' colours mixed in, (h, w, 3)."""
    index = np.rint(volume.to_index(places)).astype(int)
    inside = ((index >= 0) & (index < np.array(volume.voxels.shape))).all(axis=-1)
    index[~inside] = 0
    key = tuple(np.moveaxis(index, -1, 0))
    low, high = HU_RANGE
    grey = np.clip((volume.voxels[key].astype(float) - low) / (high - low), 0.0, 1.0) * 255.0 * inside
    picture = np.repeat(grey[..., None], 3, axis=-1)
    for name, mask in problem.scene.structures.items():
        here = mask[key] & inside
        picture[here] = 0.6 * picture[here] + 0.4 * np.array(COLORS[name])
    return picture.astype(np.uint8)


def summary(case_id: str, result: Mapping[str, Any]) -> str:
    """The case in words, markdown."""
    details, metrics = result["details"], result["metrics"]
    counts = details["entry"]["counts"]
    head = "A way in for this instrument" if result["status"] == "ok" else str(result["reason"])
    lines = [f"| feasible entry voxels | {counts['feasible']} of {counts['starts']} |"]
    if result["path"] is not None:
        lines += [
            f"| length | {metrics['length_mm']:.1f} mm |",
            f"| least distance to a structure | {metrics['clearance_min_mm']:.2f} mm |",
            f"| proved | {result['certificate']['clearance_lower_bound_mm']:.2f} mm |",
        ]
    for row in details["shrinkage"]:
        lines.append(f"| mucosa shrunk {100 * row['amount']:.0f} % | {row['feasible_starts']} of {row['starts']} |")
    tool = details["instrument"]
    lines.append(f"| instrument | {tool['endoscope']} + {tool['shaver']} |")
    return (
        f"## {head}\n\nCase **{case_id}**, {details['side']} side\n\n| | |\n|--|--|\n" + "\n".join(lines) + f"\n\n*{at.NOTICE}*"
    )
