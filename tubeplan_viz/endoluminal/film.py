"""The walk as pictures: one every few millimetres, the way ahead drawn in."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from tubeplan_viz.endoluminal.camera import Camera, path_cameras
from tubeplan_viz.endoluminal.render import Interior
from tubeplan_viz.plan import FlaggedInterval, FlagKind

PATH_RGB = (108, 190, 250)
FLAG_RGB = {FlagKind.CLEARANCE: (255, 176, 46), FlagKind.CURVATURE: (255, 110, 70)}
AHEAD_RADII = (1.0, 12.0)  # the way is drawn from here to here ahead, in radii of the lumen


@dataclass(frozen=True, kw_only=True)
class FilmSettings:
    """How the film is made.

    Attributes
    ----------
    size : int
        Pixels along a picture's side.
    step : float
        Least distance between pictures, mm.
    most : int
        Pictures at most; a longer path has them farther apart.
    quality : int
        JPEG quality.
    """

    size: int = 208
    step: float = 1.0
    most: int = 90
    quality: int = 78

    def __post_init__(self) -> None:
        if not (16 <= self.size <= 2048 and self.step > 0.0 and self.most >= 2 and 1 <= self.quality <= 100):
            raise CaseError(
                f"the film is asked for with size {self.size}, step {self.step:g} mm, {self.most} pictures and quality "
                f"{self.quality}; expected 16 to 2048 pixels, a step above 0, at least 2 pictures and quality 1 to 100"
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class Still:
    """One picture of the walk.

    Attributes
    ----------
    arc_length : float, mm
    camera : Camera
    jpeg : bytes
    """

    arc_length: float
    camera: Camera
    jpeg: bytes


@dataclass(frozen=True, eq=False, kw_only=True)
class Film:
    """Pictures from the tip, in order along the path.

    Attributes
    ----------
    size : int
        Pixels along a side.
    step : float, mm
        Distance between neighbours.
    stills : tuple of Still
    """

    size: int
    step: float
    stills: tuple[Still, ...]

    def nearest(self, arc_length: float) -> int:
        """Number of the picture nearest to an arc length."""
        return int(np.abs(np.array([still.arc_length for still in self.stills]) - arc_length).argmin())


def make_film(
    surface: Surface,
    arc_length: FloatArray,
    points: FloatArray,
    clearance: FloatArray,
    flagged: Sequence[FlaggedInterval] = (),
    settings: FilmSettings | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Film:
    """Pictures along a path inside a lumen.

    Parameters
    ----------
    surface : Surface
    arc_length : (n,) float array, mm
    points : (n, 3) float array, mm
    clearance : (n,) float array, mm
        Sets how deep the light reaches at each place.
    flagged : sequence of FlaggedInterval
        Stretches that break a limit are drawn in their own colour.
    progress : callable, optional
        Called with pictures done and of how many.
    """
    settings = settings or FilmSettings()
    length = float(arc_length[-1])
    count = int(np.clip(round(length / settings.step) + 1, 2, settings.most))
    places = np.linspace(0.0, length, count)
    here = np.column_stack([np.interp(places, arc_length, points[:, k]) for k in range(3)])
    cameras = path_cameras(here)
    stills = film_stills(surface, places, cameras, arc_length, points, clearance, flagged, settings, progress=progress)
    return Film(size=settings.size, step=length / (count - 1), stills=stills)


def film_stills(
    surface: Surface,
    places: FloatArray,
    cameras: Sequence[Camera],
    arc_length: FloatArray,
    points: FloatArray,
    clearance: FloatArray,
    flagged: Sequence[FlaggedInterval],
    settings: FilmSettings,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Still, ...]:
    """Pictures of given cameras at given arc lengths of a path; parameters as `make_film`."""
    room = np.interp(places, arc_length, clearance)
    interior = Interior(surface)
    stills = []
    for number, (s, camera) in enumerate(zip(places, cameras, strict=True)):
        # In a narrow place the light must not die at once: the lumen ahead sets the scale as well.
        radius = float(max(room[number], np.median(clearance)))
        picture = Image.fromarray(interior.picture(camera, settings.size, radius=radius).astype(np.uint8))
        draw_way(picture, interior, camera, float(s), arc_length, points, radius, flagged)
        stills.append(Still(arc_length=float(s), camera=camera, jpeg=packed(picture, settings.quality)))
        if progress is not None:
            progress(number + 1, len(cameras))
    return tuple(stills)


def draw_way(
    picture: Image.Image,
    interior: Interior,
    camera: Camera,
    s: float,
    arc_length: FloatArray,
    points: FloatArray,
    radius: float,
    flagged: Sequence[FlaggedInterval],
) -> None:
    """Draw the path ahead as far as it is seen; flagged stretches in their colour."""
    first, last = (np.searchsorted(arc_length, s + k * max(radius, 0.5)) for k in AHEAD_RADII)
    ahead = points[first:last:2]
    at = arc_length[first:last:2]
    if len(ahead) < 2:
        return
    places = camera.project(ahead)
    seen = interior.visible(camera.position, ahead) & (places[:, 2] > 0.05)
    pen = ImageDraw.Draw(picture)
    for k in range(len(ahead) - 1, 0, -1):  # the near end is drawn last, over the far one
        if not (seen[k - 1] and seen[k]):
            continue
        kinds = [flag.kind for flag in flagged if flag.start <= at[k] <= flag.end]
        near = 0.5 * (places[k - 1, 2] + places[k, 2])
        width = int(np.clip(round(0.12 * radius * picture.width / (2.2 * near)), 1, 5))
        ends = [tuple(float(v) * picture.width for v in places[j, :2]) for j in (k - 1, k)]
        pen.line([ends[0], ends[1]], fill=FLAG_RGB[kinds[0]] if kinds else PATH_RGB, width=width)


def packed(picture: Image.Image, quality: int) -> bytes:
    """A picture as JPEG."""
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=quality, optimize=True)
    return out.getvalue()
