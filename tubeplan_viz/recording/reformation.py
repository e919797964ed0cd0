"""The CT straightened along the planned path, in two planes, with the clearance band, the flags and the walk's cursor."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import rerun as rr
from PIL import Image
from scipy.ndimage import map_coordinates

from segmentation.arrays import FloatArray
from tubeplan_viz.geometry import moving_frames
from tubeplan_viz.plan import FlaggedInterval, Limits
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.anatomy import grey
from tubeplan_viz.recording.plans import Track
from tubeplan_viz.recording.sink import Sink
from tubeplan_viz.recording.slices import JPEG_QUALITY, Slicer

PIXEL_MM = 0.4
HALF_MM = 16.0  # shown to either side of the path
GAP_PIXELS = 6  # between the two planes
CURSOR_STEP_MM = 1.0


def log_reformation(sink: Sink, slicer: Slicer, track: Track, flagged: Sequence[FlaggedInterval], limits: Limits) -> None:
    """Both planes once, what is drawn over them, and the cursor along the walk."""
    length = float(track.arc_length[-1])
    columns = np.arange(0.5 * PIXEL_MM, length, PIXEL_MM)
    if len(columns) < 2:
        return
    points = track.at(columns)
    frames = moving_frames(points)
    rows = round(2.0 * HALF_MM / PIXEL_MM)
    planes = [straightened(slicer, points, frames[:, :, axis], rows) for axis in (0, 1)]
    picture = np.vstack([planes[0], np.zeros((GAP_PIXELS, len(columns)), np.uint8), planes[1]])
    packed = io.BytesIO()
    Image.fromarray(picture).save(packed, format="JPEG", quality=JPEG_QUALITY)
    image = rr.EncodedImage(contents=packed.getvalue(), media_type="image/jpeg", draw_order=0.0)
    sink.log(f"{at.REFORMATION}/0_image", image, static=True)
    middles = np.array([0.5 * rows, 1.5 * rows + GAP_PIXELS])
    width = float(len(columns))
    band = limits.clearance_min / PIXEL_MM
    edges = [[[0.0, m + side * band], [width, m + side * band]] for m in middles for side in (-1.0, 1.0)]
    thin = rr.Radius.ui_points(0.8)
    sink.log(f"{at.REFORMATION}/1_band", rr.LineStrips2D(edges, colors=(*at.PATH, 150), radii=thin, draw_order=10.0), static=True)
    bars = [[[flag.start / PIXEL_MM, m], [flag.end / PIXEL_MM, m]] for flag in flagged for m in middles]
    colors = [at.FLAG_COLORS[flag.kind] for flag in flagged for _ in middles]
    sink.log(
        f"{at.REFORMATION}/2_flags",
        rr.LineStrips2D(bars, colors=colors, radii=rr.Radius.ui_points(2.2), draw_order=20.0),
        static=True,
    )
    for s in np.unique(np.append(np.arange(0.0, length, CURSOR_STEP_MM), length)):
        sink.at(at.ARC_LENGTH, int(s * at.TICKS_PER_MM))
        x = s / PIXEL_MM
        cursor = rr.LineStrips2D([[[x, 0.0], [x, float(picture.shape[0])]]], colors=at.HERE, radii=thin, draw_order=30.0)
        sink.log(f"{at.REFORMATION}/3_here", cursor)


def straightened(slicer: Slicer, points: FloatArray, across: FloatArray, rows: int) -> np.ndarray:
    """Grey values with one column per point, rows from one side of the path to the other along `across`."""
    offset = (0.5 * rows - 0.5 - np.arange(rows)) * PIXEL_MM
    places = points[None] + offset[:, None, None] * across[None]
    index = np.moveaxis(slicer.volume.to_index(places), -1, 0)
    hu = map_coordinates(slicer.volume.voxels, index, output=np.float32, order=1, mode="constant", cval=slicer.window[0])
    return np.asarray(grey(hu, slicer.window))
