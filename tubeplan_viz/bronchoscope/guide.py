"""The line that the robot is steered along: the route's middle, no sharper than the sections bend where the lumen allows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded
from scipy.ndimage import binary_dilation

from segmentation.arrays import FloatArray, frozen_array
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import menger_curvature

STEP = 0.5
# The sharpest bend of the guide as a share of the robot's: what is left is for steering.
BEND_SHARE = 0.85
# The guide may use the room beside the middle but for this, mm.
RESERVE = 0.25
LEAST_ROOM = 0.05
ROUNDS = 60
FIRST_WEIGHT, LEAST_WEIGHT, FIXED = 0.3, 1e-6, 1e6
AROUND = 10.0  # mm of the guide on both sides of a place that is too sharp


@dataclass(frozen=True, eq=False)
class Guide:
    """A line with even spacing that goes on straight beyond both ends.

    Attributes
    ----------
    points : (n, 3) float array, mm
        About 0.5 mm apart.
    radii : (n,) float array, mm
        Of the lumen beside it.
    """

    points: FloatArray
    radii: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_array(self.points, (None, 3), "guide"))
        object.__setattr__(self, "radii", frozen_array(self.radii, (len(self.points),), "radii"))

    @cached_property
    def arc_length(self) -> FloatArray:
        """Arc length at each point, (n,) mm."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @property
    def length(self) -> float:
        """Length, mm."""
        return float(self.arc_length[-1])

    def at(self, s: ArrayLike) -> FloatArray:
        """Places at arc lengths, (..., 3) mm; beyond the ends along the end's direction."""
        wanted = np.asarray(s, dtype=float)
        made = np.stack([np.interp(wanted, self.arc_length, column) for column in self.points.T], axis=-1)
        before, beyond = np.minimum(wanted, 0.0), np.maximum(wanted - self.length, 0.0)
        if before.any() or beyond.any():
            made = made + before[..., None] * self.direction(0.0) + beyond[..., None] * self.direction(self.length)
        return np.asarray(made)

    def direction(self, s: float) -> FloatArray:
        """Unit tangent at an arc length, (3,), over 2 mm."""
        low, high = max(s - 1.0, 0.0), min(s + 1.0, self.length)
        step = [np.interp(high, self.arc_length, c) - np.interp(low, self.arc_length, c) for c in self.points.T]
        return np.asarray(np.array(step) / np.linalg.norm(step))

    def radius(self, s: ArrayLike) -> FloatArray:
        """The lumen's radius at arc lengths, (...,) mm."""
        return np.asarray(np.interp(np.asarray(s, dtype=float), self.arc_length, self.radii))

    def nearest(self, point: FloatArray, low: float, high: float) -> float:
        """Arc length of the nearest place between two arc lengths, mm."""
        first, last = np.searchsorted(self.arc_length, [low, high])
        rows = slice(max(int(first) - 1, 0), min(int(last) + 1, len(self.points)))
        best = rows.start + int(np.argmin(np.linalg.norm(self.points[rows] - point, axis=1)))
        # One Newton step on the tangent.
        return float(self.arc_length[best] + (point - self.points[best]) @ self.direction(float(self.arc_length[best])))

    @cached_property
    def curvature(self) -> FloatArray:
        """Curvature over chords of 2 mm, (n,) 1/mm; 0 within 1 mm of the ends."""
        k = max(round(1.0 / STEP), 1)
        if len(self.points) < 2 * k + 1:
            return np.zeros(len(self.points))
        found = np.zeros(len(self.points))
        for i in range(k):
            values = menger_curvature(self.points[i::k])
            found[i + k :: k][: len(values)] = values
        return found


def make_guide(line: Centerline, robot: Robot) -> Guide:
    """The centerline, bent no sharper than the robot can where the lumen has the room for it.

    Minimises ``sum |D2 p|^2 + sum weight |p - c|^2 / room^2`` over points p beside the centerline's points c, room
    being the lumen's radius less the robot's. About places where p is too sharp the weights are halved, where it leaves
    its room they are doubled, until neither is so or the rounds are used up; the round that was best is kept.

    Parameters
    ----------
    line : Centerline
        From the entrance to the goal.
    robot : Robot
    """
    count = max(int(np.ceil(line.arc_length[-1] / STEP)), 8)
    s = np.linspace(0.0, float(line.arc_length[-1]), count + 1)
    middle = CubicSpline(line.arc_length, line.points)(s)
    radii = np.interp(s, line.arc_length, line.radii)
    room = np.maximum(radii - robot.radius - RESERVE, LEAST_ROOM)
    limit = BEND_SHARE * robot.curvature_max
    bands = bending_bands(len(s))
    weights = np.full(len(s), FIRST_WEIGHT)
    best, least = Guide(middle, radii), np.inf
    for _ in range(ROUNDS):
        pull = weights / room**2
        pull[[0, -1]] = FIXED
        matrix = bands.copy()
        matrix[2] += pull
        moved = solveh_banded(matrix, pull[:, None] * middle)
        made = Guide(moved, radii)
        sharp, wide = made.curvature / limit, np.linalg.norm(moved - middle, axis=1) / room
        worst = max(float(sharp.max()), float(wide.max()))
        if worst < least:
            best, least = made, worst
        if worst <= 1.0:
            break
        near = binary_dilation(sharp > 1.0, iterations=round(AROUND / STEP))
        factor = np.where(near, 0.6, 1.0) * np.where(wide > 1.0, 2.5, 1.0)
        weights = np.maximum(weights * factor, LEAST_WEIGHT)
    return best


def bending_bands(count: int) -> FloatArray:
    """Upper bands of ``D2^T D2`` for `count` points, (3, count), as `scipy.linalg.solveh_banded` takes them."""
    bands = np.zeros((3, count))
    for row in range(count - 2):
        for i, a in enumerate((1.0, -2.0, 1.0)):
            for j, b in enumerate((1.0, -2.0, 1.0)):
                if j >= i:
                    bands[2 - (j - i), row + j] += a * b
    return bands
