"""Endoscope and shaver, coupled with parallel axes, as two convex bodies with closed-form distances.

# Strategy: both are solid cylinders; the shaver's front end is a ball, the endoscope's is flat. Pushed along its own axis
# a cylinder only gets longer, so what the instrument sweeps on a straight segment is again two such bodies: no sampling of
# the way is needed, and only turns at the nodes are a matter of small steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import CaseError

UP = np.array([0.0, 0.0, 1.0])  # LPS: superior; where the endoscope lies without roll
PARTS = ("shaver", "endoscope")


@dataclass(frozen=True, kw_only=True)
class CoupledInstrument:
    """An endoscope above a shaver, axes parallel and in one plane; lengths in mm.

    The defaults are those of the patent text (2021), paragraphs 89 to 93.

    Attributes
    ----------
    scope_diameter, scope_length : float
    shaver_diameter, shaver_length : float
    working_distance : float
        From the endoscope's front centre to the shaver's tip (`d_w`).
    offset : float
        How far the endoscope's axis lies above the shaver's (`h_es`).
    view_angle : float, radian
        Between the endoscope's axis and its view, towards the shaver; drawn only.

    Raises
    ------
    CaseError
        If a length is not positive, or the offset is not between the sum of the radii and the working distance.
    """

    scope_diameter: float = 4.0
    scope_length: float = 175.0
    shaver_diameter: float = 2.9
    shaver_length: float = 110.0
    working_distance: float = 10.0
    offset: float = 6.0
    view_angle: float = np.pi / 6.0

    def __post_init__(self) -> None:
        for name in ("scope_diameter", "scope_length", "shaver_diameter", "shaver_length", "working_distance"):
            value = getattr(self, name)
            if not 0.5 <= value <= 500.0:
                raise CaseError(f"{name}_mm is {value:g}, expected 0.5 to 500")
        low = self.scope_radius + self.shaver_radius
        if not low < self.offset < self.working_distance:
            raise CaseError(
                f"offset_mm is {self.offset:g}, expected between {low:g} (both radii together) and "
                f"{self.working_distance:g} (the working distance)"
            )

    @property
    def scope_radius(self) -> float:
        """Half the endoscope's diameter."""
        return 0.5 * self.scope_diameter

    @property
    def shaver_radius(self) -> float:
        """Half the shaver's diameter: that of its near-spherical tip."""
        return 0.5 * self.shaver_diameter

    @property
    def setback(self) -> float:
        """How far the endoscope's front lies behind the shaver's tip, `l_es = sqrt(d_w^2 - h_es^2)`.

        Examples
        --------
        >>> CoupledInstrument(offset=6.0).setback
        8.0
        """
        return float(np.sqrt(self.working_distance**2 - self.offset**2))

    @property
    def reach(self) -> float:
        """Largest distance of a point of either body from the shaver's axis line."""
        return max(self.offset + self.scope_radius, self.shaver_radius)


@dataclass(frozen=True, eq=False)
class Bodies:
    """Solid cylinders, n of them, mm; those of one instrument stand one after the other, shaver first.

    Attributes
    ----------
    tail, front : (n, 3) float array
        Ends of the axis. A round front has its ball's centre at `front`.
    radius : (n,) float array
    round_front : (n,) bool array
    """

    tail: FloatArray
    front: FloatArray
    radius: FloatArray
    round_front: BoolArray

    def __len__(self) -> int:
        return len(self.tail)

    @property
    def length(self) -> FloatArray:
        """Of each axis, (n,) mm."""
        return np.asarray(np.linalg.norm(self.front - self.tail, axis=1))

    @property
    def axis(self) -> FloatArray:
        """Unit vectors from tail to front, (n, 3)."""
        return unit(self.front - self.tail)

    def take(self, rows: IntArray) -> Bodies:
        """Some of the bodies."""
        return Bodies(self.tail[rows], self.front[rows], self.radius[rows], self.round_front[rows])

    def cut(self, tips: FloatArray, depth: FloatArray) -> Bodies:
        """Bodies without what lies more than `depth` mm behind the tip of the same row."""
        along = np.einsum("ij,ij->i", tips - self.tail, self.axis)
        shorter = np.clip(along - depth, 0.0, 0.9 * self.length)
        return Bodies(self.tail + shorter[:, None] * self.axis, self.front, self.radius, self.round_front)

    def grown(self, by: FloatArray | float) -> Bodies:
        """Bodies that hold everything within `by` mm of these ones: wider, and longer at their flat ends."""
        by = np.broadcast_to(np.asarray(by, float), self.radius.shape)
        axis = self.axis
        more = np.where(self.round_front, 0.0, by)
        return Bodies(self.tail - by[:, None] * axis, self.front + more[:, None] * axis, self.radius + by, self.round_front)

    def nearest(self, points: FloatArray) -> FloatArray:
        """The point of each body nearest to the point of the same row, (n, 3)."""
        axis = self.front - self.tail
        length = np.linalg.norm(axis, axis=1)
        axis = axis / length[:, None]
        offset = points - self.tail
        along = np.einsum("ij,ij->i", offset, axis)
        inside = np.clip(along, 0.0, length)
        ball = self.round_front & (along > length)
        # Ahead of a round front the way to the ball's centre counts, elsewhere the way to the axis line.
        base = self.tail + inside[:, None] * axis
        across = np.where(ball[:, None], points - self.front, offset - along[:, None] * axis)
        gap = np.linalg.norm(across, axis=1)
        share = np.minimum(1.0, self.radius / np.maximum(gap, 1e-300))
        return np.asarray(base + share[:, None] * across)

    def gap(self, points: FloatArray) -> FloatArray:
        """Distance of each body to the point of the same row, (n,); 0 inside.

        For a flat end this is the text's formula: `d_a - r` beside the cylinder, `sqrt((d_a - r)^2 + h^2)` beyond an end
        by h, and h where `d_a <= r`.
        """
        return np.asarray(np.linalg.norm(points - self.nearest(points), axis=1))

    def support(self, directions: FloatArray) -> FloatArray:
        """Greatest coordinate of each body along the unit direction of the same row, (n,)."""
        axis = self.axis
        along = np.einsum("ij,ij->i", directions, axis)
        disc = self.radius * np.sqrt(np.maximum(1.0 - along**2, 0.0))
        at_tail = np.einsum("ij,ij->i", directions, self.tail) + disc
        at_front = np.einsum("ij,ij->i", directions, self.front)
        at_front = at_front + np.where(self.round_front & (along > 0.0), self.radius, disc)
        return np.asarray(np.maximum(at_tail, at_front))


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors of length 1 along the last axis."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def up_of(directions: FloatArray, roll: FloatArray | float) -> FloatArray:
    """Where the endoscope lies, seen from the shaver's axis: (n, 3) unit vectors across the directions.

    Without roll it is the part of the patient's upward direction that is perpendicular to the axis; a roll turns it about
    the axis by the right-hand rule. In the text's angles this is `Rz(alpha) Rx(g) Ry(beta)` with
    `tan g = tan gamma cos alpha`: alpha and gamma are angles of projections, and turning by gamma itself would leave the
    segment wherever both are not 0.

    Parameters
    ----------
    directions : (n, 3) float array
        Unit vectors from the handle to the tip, LPS.
    roll : (n,) float array or float, radian
        `beta`.
    """
    level = UP - (directions @ UP)[:, None] * directions
    flat = np.linalg.norm(level, axis=1) < 1e-9
    # Straight up or down there is no "above"; the patient's front takes its place.
    level[flat] = np.array([0.0, -1.0, 0.0]) - (directions[flat] @ np.array([0.0, -1.0, 0.0]))[:, None] * directions[flat]
    level = unit(level)
    angle = np.broadcast_to(np.asarray(roll, float), (len(directions),))[:, None]
    return np.asarray(np.cos(angle) * level + np.sin(angle) * np.cross(directions, level))


def pose_angles(direction: FloatArray) -> tuple[float, float]:
    """The text's `alpha` and `gamma`, radian: of +y to the direction's projections on the planes xOy and yOz.

    Examples
    --------
    >>> np.degrees(pose_angles(np.array([-1.0, 1.0, 1.0]))).round(6).tolist()
    [45.0, 45.0]
    """
    x, y, z = direction
    return float(np.arctan2(-x, y)), float(np.arctan2(z, y))


def swept(instrument: CoupledInstrument, start: FloatArray, end: FloatArray, roll: FloatArray | float) -> Bodies:
    """All that the instrument passes through while its tip moves from `start` to `end`, both (n, 3): 2 n bodies.

    The shaver's axis lies along the segment. Its tip is the foremost point of its ball.
    """
    direction = unit(end - start)
    return posed(instrument, end, direction, roll, run=np.linalg.norm(end - start, axis=1))


def posed(
    instrument: CoupledInstrument,
    tip: FloatArray,
    direction: FloatArray,
    roll: FloatArray | float,
    *,
    run: FloatArray | float = 0.0,
) -> Bodies:
    """The instrument with its tip at (n, 3) points along (n, 3) unit directions, drawn out backwards by `run` mm: 2 n bodies."""
    n = len(tip)
    run = np.broadcast_to(np.asarray(run, float), (n,))[:, None]
    up = up_of(direction, roll)
    shaver_front = tip - instrument.shaver_radius * direction
    scope_front = tip - instrument.setback * direction + instrument.offset * up
    tails = (tip - (instrument.shaver_length + run) * direction, scope_front - (instrument.scope_length + run) * direction)
    return Bodies(
        np.stack(tails, axis=1).reshape(-1, 3),
        np.stack([shaver_front, scope_front], axis=1).reshape(-1, 3),
        np.tile([instrument.shaver_radius, instrument.scope_radius], n),
        np.tile([True, False], n),
    )
