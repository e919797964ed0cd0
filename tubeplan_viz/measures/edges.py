"""Cross-sections of a lumen in its CT: the outline half way between what fills the lumen and its wall."""

# Strategy: the surface is a compromise over the whole lumen and is off by a few tenths of a millimetre where
# wall, fat, vessels and kidney lie side by side. What bounds a ureter, calyx or bronchus is everywhere its own
# wall, a millimetre of soft tissue, so a blurred edge stands where the grey is half way between the filling and
# soft tissue, also where darker fat is near. A lumen brighter than its wall may lie in tissue brighter than the wall
# (enhanced kidney); that is then the other side of the edge. Rays from the middle line sample the CT across the lumen;
# noise is averaged along the lumen and around it before that grey is sought near the surface.
# Blur moves the edge of a round lumen inward: a disc of radius r that is blurred by a Gaussian of deviation s keeps
# half its grey at about r - s^2 / (2 r) (the second term of the heat equation on the disc, curvature 1 / r). The blur
# is read off the edge itself, and taken back.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from segmentation.volume import Volume
from tubeplan_viz.geometry.section import SurfaceSections
from tubeplan_viz.measures.outward import OutwardWall

# Soft tissue of walls, HU: 30 to 70 unenhanced and in the late phases in which contrast medium fills a lumen.
WALL_HU = 50.0
CONTRAST_MIN = 100.0  # below it the edge drowns in noise
RAYS = 48
STEP_MM = 0.1
WINDOW_MM = 1.0  # the surface is known to be nearer to the edge than this
WINDOW_DARK_MM = 2.0  # an airway is grown to a limit near air's, which leaves a voxel of its edge outside
BEYOND_MM = (0.8, 2.4)  # outside the surface: past the blur of its edge, before the next organ
INNER_LEVEL = 0.841345  # of a blurred straight edge, one deviation of the blur inside it
BLUR_MM = (0.2, 1.2)  # deviations that scanners have
AHEAD_SHARE = 0.8  # of the way back: a papilla dents the lumen, blur and noise fill the dent, and the surface lies far behind it
BUNDLE_MM = 0.7  # radius of the lines that are averaged ahead of a point
NEAR_MM = 1.5  # vertices of the surface around a place, whose profiles are averaged
INSIDE_MM = 1.5  # from the wall: past its blur in a wide lumen, the middle of a narrow one
CORE_ROOM = 0.25  # of the step from wall to filling: contrast medium settles, narrow lumens lose a part of their grey
DEEP_MM = 2.5  # inside the surface, where the filling is seen
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

    def outside(self, points: FloatArray, normals: FloatArray) -> tuple[float, float]:
        """How far outside the surface the edge lies, and its blur, mm: the surface is the edge."""
        return 0.0, 0.0

    def ahead(self, point: FloatArray, heading: FloatArray, known: float) -> float:
        """Distance to the edge ahead of a point, mm: that of the surface."""
        return known


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
        wall = OutwardWall(surface.surface)
        inner = self._volume.to_index(wall.points - INSIDE_MM * wall.normals)
        grey = map_coordinates(self._volume.voxels, inner.T, output=np.float64, order=1, mode="nearest")
        self._filling = float(np.median(grey))

    def _core(self, grey: FloatArray) -> float:
        """Grey of the filling at a place, HU: what fills the whole lumen holds within limits, so that a stone is no filling."""
        room = CORE_ROOM * abs(self._filling - WALL_HU)
        return float(np.clip(np.median(grey), self._filling - room, self._filling + room))

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
        core = self._core(self._grey(point, axis, heading, np.broadcast_to(inner, (len(angles), 4))))
        if abs(core - WALL_HU) < CONTRAST_MIN:
            return None
        steps = np.arange(-WINDOW_MM, BEYOND_MM[1] + 0.5 * STEP_MM, STEP_MM)  # (m,)
        grey = self._grey(point, axis, heading, np.maximum(known[:, None] + steps, 0.0))
        apart = max(2.0 * np.pi * float(np.median(known)) / RAYS, 1e-3)
        grey = gaussian_filter1d(grey, SMOOTH_AROUND_MM / apart, axis=0, mode="wrap")
        edge = edges(grey, steps, core)
        met = ~np.isnan(edge.place) & (known > 0.0)
        if met.mean() < SEEN_LEAST:
            return None
        radius = known + np.where(met, edge.place, float(np.median(edge.place[met])))
        return radius + 0.5 * edge.blur**2 / float(np.median(radius[met])) - known

    def outside(self, points: FloatArray, normals: FloatArray) -> tuple[float, float]:
        """How far outside the surface the edge lies around places of it, the median, and its blur, mm; 0 where no wall is seen.

        Parameters
        ----------
        points, normals : (n, 3) float array, mm
            Vertices of the surface and their outward unit normals.
        """
        steps = np.arange(-DEEP_MM, BEYOND_MM[1] + 0.5 * STEP_MM, STEP_MM)
        sites = points[:, None] + steps[:, None] * normals[:, None]
        grey = map_coordinates(
            self._volume.voxels, np.moveaxis(self._volume.to_index(sites), -1, 0), output=np.float64, order=1, mode="nearest"
        )
        near = cKDTree(points).query_ball_point(points, NEAR_MM)
        grey = np.array([grey[rows].mean(axis=0) for rows in near])
        core = self._core(grey[:, steps <= 0.5 - DEEP_MM])
        if abs(core - WALL_HU) < CONTRAST_MIN:
            return 0.0, 0.0
        found = edges(grey[:, steps >= -WINDOW_MM], steps[steps >= -WINDOW_MM], core)
        if (~np.isnan(found.place)).mean() < SEEN_LEAST:
            return 0.0, 0.0
        return float(np.nanmedian(found.place)), found.blur

    def ahead(self, point: FloatArray, heading: FloatArray, known: float) -> float:
        """Distance to the edge ahead of a point, mm; that of the surface where the CT shows no edge beside it.

        Parameters
        ----------
        point : (3,) float array, mm
            Where the filling is seen.
        heading : (3,) float array
            Unit direction.
        known : float, mm
            Distance to the surface.
        """
        plane = np.linalg.svd(heading[None])[2][1:]
        turn = 2.0 * np.pi * np.arange(6) / 6.0
        ring = np.cos(turn)[:, None] * plane[0] + np.sin(turn)[:, None] * plane[1]
        beside = np.vstack([np.zeros(3), 0.5 * BUNDLE_MM * ring, BUNDLE_MM * ring])
        steps = np.arange(-AHEAD_SHARE * known, BEYOND_MM[1] + 0.5 * STEP_MM, STEP_MM)
        inner = np.linspace(0.0, CORE_SHARE * known, 4)
        grey = self._on_line(point, heading, np.concatenate([inner, known + steps]), beside)
        core = self._core(grey[:4])
        if abs(core - WALL_HU) < CONTRAST_MIN:
            return known
        place = float(edges(grey[None, 4:], steps, core).place[0])
        return known if np.isnan(place) else known + place

    def _on_line(self, point: FloatArray, heading: FloatArray, reach: FloatArray, beside: FloatArray) -> FloatArray:
        """Grey along a line, (m,) HU, averaged over parallel lines beside it."""
        sites = point + reach[:, None, None] * heading + beside
        index = np.moveaxis(self._volume.to_index(sites), -1, 0)
        grey = map_coordinates(self._volume.voxels, index, output=np.float64, order=1, mode="nearest")
        return np.asarray(grey.mean(axis=1))

    def _grey(self, point: FloatArray, axis: FloatArray, heading: FloatArray, reach: FloatArray) -> FloatArray:
        """Grey on rays at their distances (rays, m), averaged along the lumen, HU."""
        sites = point + reach[..., None] * heading[:, None]
        sites = sites + np.array(ALONG_MM)[:, None, None, None] * axis
        index = np.moveaxis(self._volume.to_index(sites), -1, 0)
        grey = map_coordinates(self._volume.voxels, index, output=np.float64, order=1, mode="nearest")
        return np.asarray(grey.mean(axis=0))


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges on profiles: where each is, (n,) mm, NaN where there is none; and the blur that they show, mm."""

    place: FloatArray
    blur: float


def edges(grey: FloatArray, steps: FloatArray, core: float) -> Edges:
    """Where profiles from inside to outside fall half way from the filling to what bounds it.

    Parameters
    ----------
    grey : (n, m) float array, HU
    steps : (m,) float array, mm
        Places on the profiles, 0 on the surface.
    core : float, HU
        Grey of the filling.
    """
    bound = np.full((len(grey), 1), WALL_HU)
    if core > WALL_HU:
        bound[:, 0] = np.maximum(WALL_HU, grey[:, steps >= BEYOND_MM[0]].min(axis=1))
        bound = np.where(core - bound < CONTRAST_MIN, WALL_HU, bound)  # another lumen lies there
    else:
        # Half way to the brightest of the wall: a bronchus's is too thin for its whole grey to be seen (full width at half
        # maximum, Nakano et al., Am J Respir Crit Care Med 2000; 162: 1102).
        bound[:, 0] = np.minimum(WALL_HU, grey[:, steps >= 0.0].max(axis=1))
        bound = np.where(bound - core < CONTRAST_MIN, WALL_HU, bound)
    filled = (grey - bound) / (core - bound)  # 1 in the filling, 0 in what bounds it
    window = steps <= (WINDOW_MM if core > WALL_HU else WINDOW_DARK_MM) + 1e-9
    half = first_below(filled[:, window], steps[window], 0.5)
    width = half - first_below(filled[:, window], steps[window], INNER_LEVEL)
    seen = width[~np.isnan(width)]
    return Edges(half, float(np.clip(np.median(seen), *BLUR_MM)) if len(seen) else BLUR_MM[0])


def first_below(values: FloatArray, steps: FloatArray, level: float) -> FloatArray:
    """Where rows of values first cross a level downwards, linear between steps, (n,); NaN where they do not."""
    down = (values[:, :-1] >= level) & (values[:, 1:] < level)
    rows, first = np.arange(len(values)), down.argmax(axis=1)
    before, after = values[rows, first], values[rows, first + 1]
    met = down.any(axis=1)
    share = np.divide(before - level, before - after, out=np.zeros(len(values)), where=met)
    return np.where(met, steps[first] + share * (steps[1] - steps[0]), np.nan)


def ray_angles() -> FloatArray:
    """Directions of the rays, (RAYS,) rad; opposite ones are half the array apart."""
    return 2.0 * np.pi * np.arange(RAYS) / RAYS


def median_chord(radii: FloatArray) -> float:
    """Median of the lengths of opposite rays together, mm."""
    half = len(radii) // 2
    return float(np.median(radii[:half] + radii[half:]))
