"""One recording per run, fed while the run goes on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from segmentation.region_growing import GrowthCurve, Region
from segmentation.volume import Volume
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.endoluminal import Film
from tubeplan_viz.plan import Limits, PlanStep
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.base import RunRecording, begin

# rerun takes more than half a second to load; it is imported by the first recording, not by this module,
# so that commands which record nothing start at once.
if TYPE_CHECKING:
    from tubeplan_viz.recording.blueprint import Contents, Viewpoint
    from tubeplan_viz.recording.plans import Track
    from tubeplan_viz.recording.sink import Sink
    from tubeplan_viz.recording.slices import Slicer

LEVELS = ("INFO", "WARN", "ERROR")
WALK_SLICE_STEP_MM = 4.0
OVERLAY_SPACING_MM = 1.0
# As many of the wall's vertices tell how far the first view must reach.
WALL_POINTS = 2000


class Recording(RunRecording):
    """A recording that is being written; `open` makes one.

    Attributes
    ----------
    warnings : tuple of str
        What the user should know of the live viewer, as sentences.
    """

    def __init__(self, sink: Sink, contents: Contents, *, case_id: str, light: bool) -> None:
        super().__init__(sink)
        self._contents = contents
        self._case_id = case_id
        self._light = light
        self._slicer: Slicer | None = None
        self._center: FloatArray | None = None
        self._seen: FloatArray | None = None
        self._wall: FloatArray | None = None
        self._last = 0

    @classmethod
    def open(
        cls,
        path: Path,
        *,
        case_id: str,
        limits: Limits,
        planner: str,
        method: str,
        frame: str,
        connect: str | None = None,
        light: bool = False,
    ) -> Self:
        """Start the recording of one run.

        Parameters
        ----------
        path : Path
            The file to write, usually ``recording.rrd`` in the run folder being made.
        case_id : str
            The case's own name; never a patient's.
        limits : Limits
        planner, method : str
            As in result.json.
        frame : {"LPS", "mesh"}
        connect : str or None
            Address of a running viewer that is to see everything at once: ``host:port``
            or ``rerun+http://host:port/proxy``. Where none listens, `warnings` says so.
        light : bool
            A small file for recorded examples: coarse mesh, no CT, plots every 2 mm and the walk every 5 mm in single precision.

        Raises
        ------
        RecordingError
            If the file cannot be made.
        """
        from tubeplan_viz.recording.blueprint import Contents, blueprint
        from tubeplan_viz.recording.plans import log_legend

        contents = Contents(limits=limits, frame=frame)
        sink = begin(
            path,
            case_id=case_id,
            frame=frame,
            connect=connect,
            planner=planner,
            method=method,
            curvature_max_per_mm=limits.curvature_max,
            clearance_min_mm=limits.clearance_min,
            arc_length_ticks_per_mm=at.TICKS_PER_MM,
        )
        with sink:
            sink.show(blueprint(contents, None))
            log_legend(sink, limits)
            sink.flush()
        return cls(sink, contents, case_id=case_id, light=light)

    def log_volume(self, volume: Volume, region: Region | None) -> None:
        """CT and mask around the lumen at half resolution or less; nothing in a light recording."""
        from tubeplan_viz.recording import anatomy
        from tubeplan_viz.recording.slices import Slicer, log_planes

        if self._light:
            return
        self._slicer = Slicer(volume, region)
        middle, kept = anatomy.log_volume(self._sink, volume, region)
        self._contents = replace(self._contents, has_ct=True, middle_slice=middle)
        self._sink.at(at.ITERATION, 0)
        log_planes(self._sink, self._slicer, self._slicer.home)
        self._center = self._slicer.home
        self.log_decision(kept)
        self._show()

    def log_surface(self, surface: Surface) -> None:
        """Wall and caps."""
        from tubeplan_viz.recording import anatomy

        anatomy.log_surface(self._sink, surface, light=self._light)
        self._seen = surface.bounds
        self._wall = surface.vertices[:: max(len(surface.vertices) // WALL_POINTS, 1)]
        self._show()

    def log_centerline(self, centerline: Centerline) -> None:
        """Centerline and its inscribed spheres."""
        from tubeplan_viz.recording import anatomy

        anatomy.log_centerline(self._sink, centerline, light=self._light)
        self._seen = centerline.points
        self._show()

    def log_growth(self, curve: GrowthCurve) -> None:
        """Grown volume against the HU limit."""
        from tubeplan_viz.recording import anatomy

        anatomy.log_growth(self._sink, curve)
        self._contents = replace(self._contents, has_growth=True)
        self._show()

    def log_film(self, film: Film) -> None:
        """Pictures from the tip along the planned path."""
        from tubeplan_viz.recording.film import log_film

        log_film(self._sink, film)
        self._contents = replace(self._contents, has_film=True)
        self._show()

    def log_decision(self, text: str, *, level: str = "INFO") -> None:
        """One line of the log, at the current iteration.

        Raises
        ------
        ValueError
            If the level is none of INFO, WARN and ERROR.
        """
        import rerun as rr

        if level not in LEVELS:
            raise ValueError(f"level is {level!r}, expected one of {', '.join(LEVELS)}")
        self._sink.at(at.ITERATION, self._last)
        self._sink.log(at.DECISIONS, rr.TextLog(text, level=level))
        self._sink.flush()

    def log_step(self, step: PlanStep) -> None:
        """One iteration, at once in the file and in the live viewer."""
        import rerun as rr

        from tubeplan_viz.recording import plans
        from tubeplan_viz.recording.summary import iteration_text

        limits, profile = self._contents.limits, step.profile
        self._last = step.index
        self._sink.at(at.ITERATION, step.index)
        plans.log_step(self._sink, step, limits, light=self._light)
        track = plans.step_track(step)
        self._log_slices(track, track.points[track.tightest()])
        text = iteration_text(
            step.index,
            length=profile.length,
            curvature_max=float(profile.curvature.max()),
            clearance_min=float(profile.clearance.min()),
            features=len(step.features),
            flagged=step.flagged,
            limits=limits,
        )
        self._sink.log(at.SUMMARY, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        for decision in step.decisions:
            self._sink.log(at.DECISIONS, rr.TextLog(decision, level="INFO"))
        worst = ", ".join(plans.flag_label(flag) for flag in step.flagged)
        counts = f"{len(step.features)} features, {step.moved} moved, {step.added} added"
        line = f"iteration {step.index}: {counts}; {worst or 'both limits hold'}"
        self._sink.log(at.DECISIONS, rr.TextLog(line, level="WARN" if step.flagged else "INFO"))
        if self._seen is None or step.index == 0:
            self._seen = profile.points
            self._show()
        self._sink.flush()

    def finish(self, result: Mapping[str, Any]) -> None:
        """Final state, the walk along the path and the case summary, from the content of result.json."""
        import rerun as rr

        from tubeplan_viz.recording import plans
        from tubeplan_viz.recording.summary import case_text
        from tubeplan_viz.recording.walk import log_walk

        limits = self._contents.limits
        flagged = plans.result_flags(result.get("flagged_intervals", ()))
        path = result.get("path")
        self._sink.at(at.ITERATION, self._last)
        self._sink.log(
            at.SUMMARY, rr.TextDocument(case_text(self._case_id, result, flagged, limits), media_type=rr.MediaType.MARKDOWN)
        )
        verdict = f"{result['status']}: {result.get('reason') or 'both limits hold along the whole path'}"
        self._sink.log(at.DECISIONS, rr.TextLog(verdict, level="INFO" if result["status"] == "ok" else "WARN"))
        if path is not None and len(path["s_mm"]) > 1:
            track = plans.result_track(path)
            self._seen = track.points
            self._contents = replace(self._contents, has_camera=not self._light)
            self._sink.at(at.ARC_LENGTH, 0)
            plans.log_track(self._sink, track, limits, light=self._light)
            plans.log_flagged(self._sink, track, flagged)
            plans.log_features(self._sink, plans.result_features(result.get("feature_points", ()), float(track.arc_length[-1])))
            log_walk(self._sink, track, flagged, limits, light=self._light)
            if self._slicer is not None:
                from tubeplan_viz.recording.reformation import log_reformation

                log_reformation(self._sink, self._slicer, track, flagged, limits)
                self._contents = replace(self._contents, has_reformation=True)
            self._walk_slices(track)
        self._show()
        self._sink.flush()

    def _blueprint(self) -> Any:
        from tubeplan_viz.recording.blueprint import blueprint

        return blueprint(self._contents, self._eye())

    def _log_slices(self, track: Track, center: FloatArray) -> None:
        """Overlay of the three planes through `center`; the pictures only where the planes have moved."""
        from tubeplan_viz.recording.slices import REDRAW_MM, log_overlay, log_planes

        if self._slicer is None:
            return
        if self._center is None or np.linalg.norm(center - self._center) > REDRAW_MM:
            log_planes(self._sink, self._slicer, center)
            self._center = center
        log_overlay(
            self._sink, self._slicer, self._center, track.thinned(OVERLAY_SPACING_MM).points, self._contents.limits.clearance_min
        )

    def _walk_slices(self, track: Track) -> None:
        length = float(track.arc_length[-1])
        for s in np.unique(np.append(np.arange(0.0, length, WALK_SLICE_STEP_MM), length)):
            self._sink.at(at.ARC_LENGTH, int(s * at.TICKS_PER_MM))
            self._center = None
            self._log_slices(track, track.at([s])[0])

    def _eye(self) -> Viewpoint | None:
        from tubeplan_viz.recording.blueprint import viewpoint

        if self._seen is None:
            return None
        return viewpoint(np.asarray(self._seen), self._contents.frame, radius=4.0, wall=self._wall)

    def _show(self) -> None:
        self._sink.show(self._blueprint())
        self._sink.flush()
