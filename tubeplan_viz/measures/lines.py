"""Middle lines as measures need them: places by arc length, directions, diameters of cross-sections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.centerline import Centerline, CenterlineTree
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.measures.edges import CtSections, PlainSections

# A direction is that of the chord over this length: a centerline's own noise turns shorter ones.
CHORD_MM = 3.0
SECTION_STEP_MM = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Lumen:
    """What all measures of a lumen use.

    Attributes
    ----------
    tree : CenterlineTree
        From the ureter's or trachea's end to every tip.
    labels : tuple of str
        Of the tree's targets.
    wall : WallDistance
    sections : CtSections or PlainSections
        By the CT's grey where there is one, by the surface where there is none.
    frame : {"LPS", "mesh"}
    """

    tree: CenterlineTree
    labels: tuple[str, ...]
    wall: WallDistance
    sections: CtSections | PlainSections
    frame: str

    def diameters(self, line: Centerline, begin: float, end: float) -> FloatArray:
        """Diameters of the cross-sections of a stretch, (k,) mm; places without a section are left out."""
        return self._along(self.sections.diameter, line, begin, end)

    def widths(self, line: Centerline, begin: float, end: float) -> FloatArray:
        """Widths of the cross-sections of a stretch, (k,) mm; places without a section are left out."""
        return self._along(self.sections.width, line, begin, end)

    def _along(
        self, measured: Callable[[FloatArray, FloatArray], float | None], line: Centerline, begin: float, end: float
    ) -> FloatArray:
        if end <= begin:
            return np.empty(0)
        places = np.linspace(begin, end, max(int(np.ceil((end - begin) / SECTION_STEP_MM)), 1) + 1)
        return np.array([d for s in places if (d := measured(place(line, s), direction(line, s))) is not None])


def place(line: Centerline, s: float) -> FloatArray:
    """Point of a line at an arc length, (3,) mm."""
    return np.array([np.interp(s, line.arc_length, line.points[:, k]) for k in range(3)])


def direction(line: Centerline, s: float) -> FloatArray:
    """Unit direction of a line at an arc length, from a chord of `CHORD_MM` around it, (3,)."""
    length = float(line.arc_length[-1])
    half = 0.5 * min(CHORD_MM, length)
    middle = float(np.clip(s, half, length - half))
    chord = place(line, middle + half) - place(line, middle - half)
    return chord / np.linalg.norm(chord)


def fitted_direction(points: FloatArray) -> FloatArray:
    """Unit direction of the best line through points in the sense of least squares, from the first to the last, (3,)."""
    axis = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    return np.asarray(axis if axis @ (points[-1] - points[0]) >= 0.0 else -axis)


def angle_between(one: FloatArray, other: FloatArray) -> float:
    """Angle between two vectors, degrees; exact near 0 and 180 too."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))
