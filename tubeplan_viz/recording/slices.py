"""Three CT planes through one point, axial, coronal and sagittal in the patient, with the path drawn over them."""

from __future__ import annotations

import io
import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import rerun as rr
from PIL import Image
from scipy.ndimage import map_coordinates
from skimage.measure import find_contours

from segmentation.arrays import FloatArray
from segmentation.region_growing import Region
from segmentation.volume import Volume
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.anatomy import crop_box, grey, hu_window
from tubeplan_viz.recording.sink import Sink

FIELD_MM = 110.0
PIXEL_MM = 0.7
JPEG_QUALITY = 82
NEAR_MM = 3.0
REDRAW_MM = 0.5

# In-plane directions as shown: to the right of the screen, then down. Patient left is on the
# right of an axial or coronal picture, anterior on the left of a sagittal one (radiological use).
AXES: dict[str, tuple[FloatArray, FloatArray]] = {
    "axial": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    "coronal": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])),
    "sagittal": (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])),
}


@dataclass(frozen=True, eq=False)
class Slicer:
    """Cuts planes out of a volume held by reference.

    Attributes
    ----------
    volume : Volume
    region : Region or None
    """

    volume: Volume
    region: Region | None

    @cached_property
    def window(self) -> tuple[float, float]:
        """HU shown as black and white."""
        return hu_window(self.region)

    @property
    def pixels(self) -> int:
        """Width and height of every picture."""
        return round(FIELD_MM / PIXEL_MM)

    @cached_property
    def home(self) -> FloatArray:
        """Middle of the shown part of the CT, (3,) mm LPS."""
        lower, upper = crop_box(self.volume, self.region)
        return self.volume.to_lps((lower + upper - 1) / 2.0)

    def to_pixels(self, plane: str, center: FloatArray, points: FloatArray) -> FloatArray:
        """(n, 2) pixel coordinates, and so right and down, of LPS points dropped onto the plane through `center`."""
        offset = (np.asarray(points) - center) / PIXEL_MM + 0.0
        return np.column_stack([offset @ axis for axis in AXES[plane]]) + 0.5 * self.pixels

    def cut(self, plane: str, center: FloatArray) -> tuple[Any, list[FloatArray]]:
        """Grey picture of the plane through `center`, and the mask's outline in pixel coordinates."""
        right, down = AXES[plane]
        steps = (np.arange(self.pixels) + 0.5 - 0.5 * self.pixels) * PIXEL_MM
        points = center + steps[None, :, None] * right + steps[:, None, None] * down
        index = np.moveaxis(self.volume.to_index(points), -1, 0)
        hu = map_coordinates(self.volume.voxels, index, output=np.float32, order=1, mode="constant", cval=self.window[0])
        outline: list[FloatArray] = []
        if self.region is not None:
            inside = index - np.asarray(self.region.lower, dtype=float)[:, None, None]
            # Only the slab that the plane crosses is made floating-point: the whole mask may be large.
            low = np.clip(np.floor(inside.min(axis=(1, 2))).astype(int), 0, np.array(self.region.mask.shape) - 1)
            high = np.clip(np.ceil(inside.max(axis=(1, 2))).astype(int) + 1, low + 1, self.region.mask.shape)
            slab = self.region.mask[tuple(slice(a, b) for a, b in zip(low, high, strict=True))].astype(np.float32)
            mask = map_coordinates(slab, inside - low[:, None, None], order=1, mode="constant", cval=0.0)
            outline = [line[:, ::-1] + 0.5 for line in find_contours(mask, 0.5)]
        return grey(hu, self.window), outline


def log_planes(sink: Sink, slicer: Slicer, center: FloatArray) -> None:
    """Pictures of the three planes through `center` at the current time."""
    for plane in at.PLANES:
        picture, outline = slicer.cut(plane, center)
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, format="JPEG", quality=JPEG_QUALITY)
        sink.log(
            at.plane_path(plane, "image"), rr.EncodedImage(contents=buffer.getvalue(), media_type="image/jpeg", draw_order=0.0)
        )
        sink.log(
            at.plane_path(plane, "lumen"),
            rr.LineStrips2D(outline, colors=at.LUMEN, radii=rr.Radius.ui_points(0.8), draw_order=10.0),
        )


def log_overlay(sink: Sink, slicer: Slicer, center: FloatArray, points: FloatArray, ring_mm: float) -> None:
    """The path over the three planes: bright within 3 mm of the plane, dim beyond; the instrument's size at `center`."""
    for plane in at.PLANES:
        flat = slicer.to_pixels(plane, center, points)
        normal = np.cross(*AXES[plane])
        near = np.abs((points - center) @ normal) <= NEAR_MM
        strips, colors = [], []
        for first, last in _runs(near):
            strips.append(flat[first : last + 2])
            colors.append((*at.PATH, 255 if near[first] else 90))
        sink.log(
            at.plane_path(plane, "path"),
            rr.LineStrips2D(strips, colors=colors, radii=rr.Radius.ui_points(1.4), draw_order=20.0),
        )
        middle = np.full(2, 0.5 * slicer.pixels)
        angle = np.linspace(0.0, 2.0 * np.pi, 49)
        ring = middle + max(ring_mm, 0.5) / PIXEL_MM * np.column_stack([np.cos(angle), np.sin(angle)])
        sink.log(
            at.plane_path(plane, "here"), rr.LineStrips2D([ring], colors=at.HERE, radii=rr.Radius.ui_points(1.2), draw_order=30.0)
        )


def _runs(flags: Any) -> list[tuple[int, int]]:
    """First and last index of each run of equal values."""
    borders = np.flatnonzero(np.diff(flags.astype(np.int8))) + 1
    edges = [0, *borders.tolist(), len(flags)]
    return [(a, b - 1) for a, b in itertools.pairwise(edges)]
