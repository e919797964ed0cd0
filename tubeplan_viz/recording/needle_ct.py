"""The CT in a needle's recording: three planes through a place of the path, with outlines of obstacles and safety shells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rerun as rr
from skimage.measure import find_contours

from segmentation.arrays import FloatArray
from segmentation.volume import Volume
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.sink import Sink
from tubeplan_viz.recording.slices import AXES, FIELD_MM, PIXEL_MM, Slicer, log_overlay, log_planes

STEP_MM = 4.0  # of the walk along the path
OUTLINE_MM = 1.0  # between places where the distance to obstacles is asked
BODY, SHELL = (255, 176, 46), (255, 176, 46, 110)


def log_ct(
    sink: Sink,
    volume: Volume,
    distance: Callable[[FloatArray], FloatArray] | None,
    s: FloatArray,
    points: FloatArray,
    *,
    safety: float,
    tightest: int,
    last: int,
) -> None:
    """Planes through the tightest place at the last iteration, and along the path on the timeline of its arc length.

    Parameters
    ----------
    sink : Sink
    volume : Volume
    distance : callable or None
        Signed distance, mm, of (k, 3) points to the nearest obstacle.
    s, points : (n,) and (n, 3) float arrays, mm
        The path.
    safety : float, mm
    tightest : int
        Index into `points`.
    last : int
        The last iteration.
    """
    slicer = Slicer(volume, None)
    stops = [(at.ITERATION, last, tightest)]
    for place in np.unique(np.append(np.arange(0.0, s[-1], STEP_MM), s[-1])):
        stops.append((at.ARC_LENGTH, int(place * at.TICKS_PER_MM), int(np.abs(s - place).argmin())))
    for timeline, tick, index in stops:
        sink.at(timeline, tick)
        log_planes(sink, slicer, points[index])
        log_overlay(sink, slicer, points[index], points[::5], safety)
        if distance is not None:
            log_outlines(sink, points[index], distance, safety)


def log_outlines(sink: Sink, center: FloatArray, distance: Callable[[FloatArray], FloatArray], safety: float) -> None:
    """Outlines of obstacles and of their safety shells over the three planes through `center`."""
    count = round(FIELD_MM / OUTLINE_MM)
    steps = (np.arange(count) + 0.5 - 0.5 * count) * OUTLINE_MM
    for plane in at.PLANES:
        right, down = AXES[plane]
        places = center + steps[None, :, None] * right + steps[:, None, None] * down
        gaps = distance(places.reshape(-1, 3)).reshape(count, count)
        strips, colors = [], []
        for level, color in ((0.0, BODY), (safety, SHELL)):
            lines = find_contours(gaps, level)
            strips += [(line[:, ::-1] + 0.5) * OUTLINE_MM / PIXEL_MM for line in lines]
            colors += [color] * len(lines)
        sink.log(
            at.plane_path(plane, "lumen"),
            rr.LineStrips2D(strips, colors=colors, radii=rr.Radius.ui_points(0.9), draw_order=10.0),
        )
