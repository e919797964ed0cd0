"""Walking along the planned path: marker, moving frame, the instrument's disc, a camera, readouts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from segmentation.arrays import IntArray
from tubeplan_viz.geometry import moving_frames
from tubeplan_viz.plan import FlaggedInterval, FlagKind, Limits
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.plans import Track
from tubeplan_viz.recording.sink import Sink
from tubeplan_viz.recording.summary import place_text

STEP_MM = 0.5
LIGHT_STEP_MM = 5.0
CAMERA_FOV = np.deg2rad(95.0)
MARKER = f"{at.WALK}/marker"
CIRCLE = np.linspace(0.0, 2.0 * np.pi, 49)


def walk_ticks(length: float, step: float = STEP_MM) -> IntArray:
    """Ticks of the arc-length timeline, every `step` mm and the end: tenths of a millimetre."""
    return np.unique(
        np.append(np.arange(0.0, length, step) * at.TICKS_PER_MM, np.floor(length * at.TICKS_PER_MM)).round()
    ).astype(np.int64)


def log_walk(sink: Sink, track: Track, flagged: Sequence[FlaggedInterval], limits: Limits, *, light: bool) -> None:
    """The whole walk on the arc-length timeline; a light one has marker and readouts alone."""
    length = float(track.arc_length[-1])
    ticks = walk_ticks(length, LIGHT_STEP_MM if light else STEP_MM)
    s = np.minimum(ticks / at.TICKS_PER_MM, length)
    places = track.at(s)
    curvature, clearance = np.interp(s, track.arc_length, track.curvature), np.interp(s, track.arc_length, track.clearance)

    sink.at(at.ARC_LENGTH, 0)
    sink.log(MARKER, rr.Points3D([[0.0, 0.0, 0.0]], colors=at.HERE, radii=rr.Radius.ui_points(4.0), show_labels=True))
    if not light:
        _log_instrument(sink, limits.clearance_min)
    frames = moving_frames(places).transpose(0, 2, 1).reshape(-1, 9)  # the viewer takes columns one after the other
    sink.columns(at.WALK, at.ARC_LENGTH, ticks, rr.Transform3D.columns(translation=places, mat3x3=frames))
    rows = list(zip(s, curvature, clearance, strict=True))
    labels = [f"{a:.1f} mm: clearance {c:.2f} mm, curvature {b:.3f} 1/mm" for a, b, c in rows]
    sink.columns(MARKER, at.ARC_LENGTH, ticks, rr.Points3D.columns(labels=labels))
    texts = [place_text(a, length, b, c, limits, flagged) for a, b, c in rows]
    sink.columns(at.SUMMARY, at.ARC_LENGTH, ticks, rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts)))
    ratios = {"curvature": curvature / limits.curvature_max, "limit": np.ones(len(ticks))}
    if limits.clearance_min > 0.0:
        ratios["clearance"] = clearance / limits.clearance_min
    for name, ratio in ratios.items():
        sink.columns(f"{at.CONVERGENCE}/{name}", at.ARC_LENGTH, ticks, rr.Scalars.columns(scalars=ratio))
    if not light:
        _log_cursors(sink, track, ticks[::2], limits)


def _log_instrument(sink: Sink, radius: float) -> None:
    """Frame, disc and camera, once: they ride on the moving frame of the walk."""
    arm = max(1.5 * radius, 2.0)
    axes = [(240, 90, 90), (90, 200, 90), (100, 150, 255)]
    sink.log(f"{at.WALK}/frame", rr.Arrows3D(vectors=np.eye(3) * arm, colors=axes, radii=rr.Radius.ui_points(1.0)))
    if radius > 0.0:
        circle = radius * np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE), 0.0 * CIRCLE])
        fan = np.array([[0, k, k + 1] for k in range(1, len(CIRCLE))])
        sink.log(
            f"{at.WALK}/instrument",
            rr.Mesh3D(vertex_positions=np.vstack([np.zeros(3), circle]), triangle_indices=fan, albedo_factor=(*at.HERE, 90)),
            rr.LineStrips3D([circle], colors=at.HERE, radii=rr.Radius.ui_points(1.2)),
        )
    # Looking down the lumen: z forward along the tangent, x right along the binormal, y down against the normal.
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    eye = rr.Pinhole(fov_y=CAMERA_FOV, aspect_ratio=1.0, image_plane_distance=0.05 * arm, line_width=0.0)
    sink.log(at.WALK_CAMERA, rr.Transform3D(mat3x3=turn), eye)


def _log_cursors(sink: Sink, track: Track, ticks: IntArray, limits: Limits) -> None:
    """A thin white bar at the walk's place in both plots."""
    length = float(track.arc_length[-1])
    tops = {
        FlagKind.CURVATURE: max(float(track.curvature.max()), limits.curvature_max),
        FlagKind.CLEARANCE: max(float(track.clearance.max()), limits.clearance_min),
    }
    for tick in ticks.tolist():
        sink.at(at.ARC_LENGTH, tick)
        for kind, top in tops.items():
            bar = rr.BarChart([top], abscissa=[tick / at.TICKS_PER_MM], widths=[length / 250.0], color=at.HERE)
            sink.log(at.profile_path(kind, "here"), bar)
