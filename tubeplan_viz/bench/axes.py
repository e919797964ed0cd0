"""Axes of model tubes: curves of known arc length, and the rings that stand on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, frozen_array


@dataclass(frozen=True, eq=False)
class Axis:
    """A space curve made of pieces of constant curvature and torsion.

    Each piece is exactly a line, a circular arc or a helix, so points, tangents and
    normals are exact at every arc length.

    Attributes
    ----------
    pieces : tuple of (length, curvature, torsion)
        mm, 1/mm, 1/mm; a negative curvature bends the other way. Neighbours are tangent.
    start : (3,) float array, mm
    frame : (3, 3) float array
        Columns tangent, normal, binormal at the start; a positive curvature bends towards the normal.
    """

    pieces: tuple[tuple[float, float, float], ...]
    start: FloatArray
    frame: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", frozen_array(self.start, (3,), "start"))
        object.__setattr__(self, "frame", frozen_array(self.frame, (3, 3), "frame"))

    @property
    def length(self) -> float:
        """Arc length, mm."""
        return float(sum(piece[0] for piece in self.pieces))

    @cached_property
    def _joints(self) -> list[tuple[float, FloatArray, FloatArray]]:
        """Arc length, point and frame at the beginning of each piece, and at the end."""
        s, point, frame = 0.0, np.asarray(self.start), np.asarray(self.frame)
        joints = [(s, point, frame)]
        for length, curvature, torsion in self.pieces:
            points, frames = _piece(np.array([length]), curvature, torsion)
            point, frame, s = point + frame @ points[0], frame @ frames[0], s + length
            joints.append((s, point, frame))
        return joints

    def at(self, arc_length: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n, 3) in mm and frames (n, 3, 3) with columns tangent, normal, binormal.

        Beyond either end the axis goes on straight.
        """
        s = np.asarray(arc_length, dtype=float)
        points, frames = np.empty((len(s), 3)), np.empty((len(s), 3, 3))
        stretches = [(-np.inf, 0.0, self._joints[0], (0.0, 0.0))]
        for (_, curvature, torsion), first, last in zip(self.pieces, self._joints, self._joints[1:], strict=False):
            stretches.append((first[0], last[0], first, (curvature, torsion)))
        stretches.append((self.length, np.inf, self._joints[-1], (0.0, 0.0)))
        for lower, upper, (s0, point, frame), (curvature, torsion) in stretches:
            inside = (s >= lower) & (s <= upper)
            local, turned = _piece(s[inside] - s0, curvature, torsion)
            points[inside] = point + local @ frame.T
            frames[inside] = frame @ turned
        return points, frames

    def nearest(self, points: FloatArray, within: float, lead: float = 3.0) -> tuple[FloatArray, FloatArray]:
        """Distance to the axis and arc length of the nearest point on it, both (n,) mm.

        `lead` mm of straight axis are added at both ends. Points farther than `within`
        get an infinite distance.
        """
        step = 0.05
        s = np.linspace(-lead, self.length + lead, int(np.ceil((self.length + 2 * lead) / step)) + 1)
        sites, frames = self.at(s)
        distance, index = cKDTree(sites).query(points, distance_upper_bound=within + step)
        near = np.isfinite(distance)
        arc = np.zeros(len(points))
        arc[near] = s[index[near]]
        for _ in range(2):  # Newton steps on (x - c(s)) . c'(s) = 0, with the curvature term left out: it converges at once
            foot, frames = self.at(arc[near])
            offset = points[near] - foot
            arc[near] += np.einsum("ij,ij->i", offset, frames[:, :, 0])
        foot, _ = self.at(arc[near])
        distance[near] = np.linalg.norm(points[near] - foot, axis=1)
        return distance, arc


def _piece(s: FloatArray, curvature: float, torsion: float) -> tuple[FloatArray, FloatArray]:
    """Points and frames along a curve of constant curvature and torsion from the origin, frame = identity."""
    # Strategy: the Frenet frame turns at the constant rate of the Darboux vector
    # (torsion, 0, curvature) in the starting frame: Rodrigues' formula and its integral.
    rate = np.hypot(curvature, torsion)
    if rate == 0.0:
        return s[:, None] * np.array([1.0, 0.0, 0.0]), np.broadcast_to(np.eye(3), (len(s), 3, 3)).copy()
    k = np.array([torsion, 0.0, curvature]) / rate
    cross = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    angle = rate * s
    frames = np.eye(3) + np.sin(angle)[:, None, None] * cross + (1.0 - np.cos(angle))[:, None, None] * (cross @ cross)
    tangent = np.array([1.0, 0.0, 0.0])
    points = (
        s[:, None] * tangent
        + ((1.0 - np.cos(angle)) / rate)[:, None] * (cross @ tangent)
        + (s - np.sin(angle) / rate)[:, None] * (cross @ cross @ tangent)
    )
    return points, frames


def planar_axis(
    pieces: Sequence[tuple[float, float]], *, start: Sequence[float] = (0.0, 0.0, 0.0), heading: float = np.pi / 2
) -> Axis:
    """Lines and arcs in the plane z = const from (length mm, signed curvature 1/mm) pairs.

    Parameters
    ----------
    heading : float, rad
        Direction at the start, from +x towards +y. A positive curvature turns left.
    """
    tangent = np.array([np.cos(heading), np.sin(heading), 0.0])
    normal = np.array([-tangent[1], tangent[0], 0.0])
    frame = np.column_stack([tangent, normal, [0.0, 0.0, 1.0]])
    return Axis(tuple((length, curvature, 0.0) for length, curvature in pieces), np.asarray(start, dtype=float), frame)
