"""Cross-sections of a lumen in its CT: the outline half way between what fills the lumen and its wall."""

# Strategy: the surface is a compromise over the whole lumen and is off by a few tenths of a millimetre where
# wall, fat, vessels and kidney lie side by side. What bounds a ureter, calyx or bronchus is everywhere its own
# wall, a millimetre of soft tissue, so a blurred edge stands where the grey is half way between the filling and
# soft tissue, whatever lies behind. Rays from the middle line sample the CT across the lumen; noise is averaged
# along the lumen and around it before that grey is sought near the surface.

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates

from segmentation.arrays import FloatArray
from segmentation.volume import Volume
from tubeplan_viz.geometry.section import SurfaceSections

# Soft tissue of walls, HU: 30 to 70 unenhanced and in the late phases in which contrast medium fills a lumen.
WALL_HU = 50.0
CONTRAST_MIN = 100.0  # below it the edge drowns in noise
RAYS = 48
STEP_MM = 0.1
WINDOW_MM = 1.0  # the surface is known to be nearer to the edge than this
ALONG_MM = (-1.0, -0.5, 0.0, 0.5, 1.0)
SMOOTH_AROUND_MM = 0.7
CORE_SHARE = 0.4  # of the section's least radius: inside it the filling is seen unblurred
SEEN_LEAST = 0.25  # share of rays that must meet a wall


class PlainSections:
    """Diameters of a lumen's cross-sections by its surface alone, for a lumen without a CT.

    Parameters
    ----------
    surface : SurfaceSections
    """

    def __init__(self, surface: SurfaceSections) -> None:
        self._surface = surface

    def diameter(self, point: FloatArray, normal: FloatArray) -> float | None:
        """Diameter in mm of the circle with the section's area; None where there is no closed section."""
        return self._surface.diameter(point, normal)

    def width(self, point: FloatArray, normal: FloatArray) -> float | None:
        """Median over all directions of the section's chords through the point, mm; None as for `diameter`."""
        outline = self._surface.outline(point, normal)
        return None if outline is None else median_chord(outline.radii(ray_angles()))


class CtSections:
    """Diameters of a lumen's cross-sections by the grey of the CT.

    Parameters
    ----------
    volume : Volume
    surface : SurfaceSections
        Of the surface that was made from the volume.
    """

    def __init__(self, volume: Volume, surface: SurfaceSections) -> None:
        self._volume, self._surface = volume, surface

    def diameter(self, point: FloatArray, normal: FloatArray) -> float | None:
        """Diameter in mm of the circle with the section's area.

        Parameters
        ----------
        point : (3,) float array, mm
            On the middle line.
        normal : (3,) float array
            Along the lumen.

        Returns
        -------
        float or None
            None where the surface has no closed section, or the CT shows no wall around it.
        """
        measured = self._measured(point, normal)
        if measured is None:
            return None
        area, known, offset = measured
        # Where a ray cannot see the whole section, the surface's area carries what the rays find.
        return float(np.sqrt(4.0 / np.pi * area * ((known + offset) ** 2).sum() / (known**2).sum()))

    def width(self, point: FloatArray, normal: FloatArray) -> float | None:
        """Median over all directions of the section's chords through the point, mm; None as for `diameter`.

        Beside a branching the section takes in the neighbour; most chords do not.
        """
        measured = self._measured(point, normal)
        return None if measured is None else median_chord(measured[1] + measured[2])

    def _measured(self, point: FloatArray, normal: FloatArray) -> tuple[float, FloatArray, FloatArray] | None:
        """The surface's area, its radii on the rays and how far outside them the edge lies."""
        outline = self._surface.outline(point, normal)
        if outline is None:
            return None
        angles = ray_angles()
        known = outline.radii(angles)
        offset = self._offset(point, normal, outline.plane, angles, known)
        return None if offset is None else (outline.area, known, offset)

    def _offset(
        self, point: FloatArray, normal: FloatArray, plane: FloatArray, angles: FloatArray, known: FloatArray
    ) -> FloatArray | None:
        """How far outside the surface the edge lies on each ray, (rays,) mm; None where no wall is seen."""
        axis = normal / np.linalg.norm(normal)
        heading = np.cos(angles)[:, None] * plane[0] + np.sin(angles)[:, None] * plane[1]  # (rays, 3)
        inner = np.linspace(0.0, CORE_SHARE * float(known.min()), 4)
        core = float(np.median(self._grey(point, axis, heading, np.broadcast_to(inner, (len(angles), 4)))))
        if abs(core - WALL_HU) < CONTRAST_MIN:
            return None
        steps = np.arange(-WINDOW_MM, WINDOW_MM + 0.5 * STEP_MM, STEP_MM)  # (m,)
        grey = self._grey(point, axis, heading, np.maximum(known[:, None] + steps, 0.0))
        apart = max(2.0 * np.pi * float(np.median(known)) / RAYS, 1e-3)
        grey = gaussian_filter1d(grey, SMOOTH_AROUND_MM / apart, axis=0, mode="wrap")
        # 1 in the filling, 0 in the wall; the edge is the first crossing of a half from inside.
        filled = (grey - WALL_HU) / (core - WALL_HU)
        down = (filled[:, :-1] >= 0.5) & (filled[:, 1:] < 0.5)
        rows, first = np.arange(len(angles)), down.argmax(axis=1)
        before, after = filled[rows, first], filled[rows, first + 1]
        met = down.any(axis=1) & (known > 0.0)
        if met.mean() < SEEN_LEAST:
            return None
        found = steps[first] + STEP_MM * (before - 0.5) / np.where(met, before - after, 1.0)
        return np.where(met, found, float(np.median(found[met])))

    def _grey(self, point: FloatArray, axis: FloatArray, heading: FloatArray, reach: FloatArray) -> FloatArray:
        """Grey on rays at their distances (rays, m), averaged along the lumen, HU."""
        sites = point + reach[..., None] * heading[:, None]
        sites = sites + np.array(ALONG_MM)[:, None, None, None] * axis
        index = np.moveaxis(self._volume.to_index(sites), -1, 0)
        grey = map_coordinates(self._volume.voxels, index, output=np.float64, order=1, mode="nearest")
        return np.asarray(grey.mean(axis=0))


def ray_angles() -> FloatArray:
    """Directions of the rays, (RAYS,) rad; opposite ones are half the array apart."""
    return 2.0 * np.pi * np.arange(RAYS) / RAYS


def median_chord(radii: FloatArray) -> float:
    """Median of the lengths of opposite rays together, mm."""
    half = len(radii) // 2
    return float(np.median(radii[:half] + radii[half:]))
