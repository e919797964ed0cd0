"""Signed distances of simple solids, smooth textures, and painting them with partial volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, CubicSpline

from segmentation.arrays import FloatArray

Box = tuple[slice, slice, slice]


def round_cone_distance(points: FloatArray, a: FloatArray, b: FloatArray, ra: float, rb: float) -> FloatArray:
    """Signed distance to the convex hull of two balls, negative inside [1]_.

    Parameters
    ----------
    points : (..., 3) float array, mm
    a, b : (3,) float array, mm
        Centres of the balls.
    ra, rb : float, mm
        Their radii.

    Returns
    -------
    (...,) float array, mm
        Exact inside and outside.

    References
    ----------
    .. [1] Barbier, A., Galin, E. (2004). Fast distance computation between a point and cylinders,
       cones, line-swept spheres and cone-spheres. Journal of Graphics Tools 9(2), 11-19.
    """
    axis = b - a
    length = float(np.linalg.norm(axis))
    offset = points - a
    if length <= abs(ra - rb):  # one ball holds the other
        return np.asarray(np.linalg.norm(offset if ra >= rb else points - b, axis=-1) - max(ra, rb))
    # In the half plane of the axis: t along it, h across it. The common tangent of the two circles leans by
    # sin = (ra - rb) / length, so the nearest surface point belongs to the cone between the two normals.
    sine = (ra - rb) / length
    cosine = np.sqrt(1.0 - sine * sine)
    t = offset @ (axis / length)
    h = np.sqrt(np.maximum(np.einsum("...i,...i->...", offset, offset) - t * t, 0.0))
    along = t * cosine - h * sine  # coordinate along the tangent line, 0 at a's touching point
    cone = h * cosine + t * sine - ra
    ball_a = np.sqrt(t * t + h * h) - ra
    ball_b = np.sqrt((t - length) ** 2 + h * h) - rb
    return np.asarray(np.where(along < 0.0, ball_a, np.where(along > length * cosine, ball_b, cone)))


def ellipsoid_level(
    points: Sequence[FloatArray], center: Sequence[float] | FloatArray, radii: Sequence[float] | FloatArray
) -> FloatArray:
    """About the signed distance in mm to an ellipsoid or elliptic cylinder: exact on it and first-order near it.

    `points` are coordinate arrays that broadcast; a radius of infinity makes a cylinder.
    """
    scaled = [(p - c) / r for p, c, r in zip(points, center, radii, strict=True)]
    norm = np.sqrt(sum(s * s for s in scaled) + 1e-12)
    gradient = np.sqrt(sum((s / r) ** 2 for s, r in zip(scaled, radii, strict=True)) + 1e-12)
    return np.asarray(norm * (norm - 1.0) / gradient)


@dataclass(eq=False)
class Canvas:
    """A CT under construction: HU on a grid whose axes run along x (left), y (posterior) and z (superior).

    Attributes
    ----------
    x, y, z : (n,) float array, mm
        Voxel centres.
    hu : (len(z), len(y), len(x)) float array, HU
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    hu: FloatArray

    @property
    def pixel(self) -> float:
        """In-plane spacing, mm: the width over which an edge is shared between voxels."""
        return float(self.x[1] - self.x[0])

    def box(self, lower: Sequence[float] | FloatArray, upper: Sequence[float] | FloatArray) -> Box:
        """Index box of the grid points between two corners (x, y, z) in mm; may be empty."""
        ranges = [
            slice(int(np.searchsorted(axis, lo)), int(np.searchsorted(axis, up)))
            for axis, lo, up in zip((self.x, self.y, self.z), lower, upper, strict=True)
        ]
        return ranges[2], ranges[1], ranges[0]

    def axes(self, box: Box | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y and z of a box as arrays that broadcast to [slice, row, column]."""
        iz, iy, ix = box or (slice(None),) * 3
        return self.x[ix][None, None, :], self.y[iy][None, :, None], self.z[iz][:, None, None]

    def points(self, box: Box) -> FloatArray:
        """All grid points of a box, (slices, rows, columns, 3) mm."""
        return np.stack(np.broadcast_arrays(*self.axes(box)), axis=-1)

    def paint(self, box: Box, level: FloatArray, hu: FloatArray | float, *, soft: float | None = None) -> None:
        """Mix `hu` in where `level` (signed distance, mm, negative inside) covers the voxel."""
        part = self.hu[box]
        level = np.broadcast_to(level, part.shape)
        values = np.broadcast_to(np.asarray(hu, dtype=float), part.shape)
        for k in range(len(part)):  # slice by slice, so that temporaries stay small
            cover = np.clip(0.5 - level[k] / (soft or self.pixel), 0.0, 1.0)
            part[k] += cover * (values[k] - part[k])

    def tube(self, points: FloatArray, radii: FloatArray, margin: float) -> tuple[Box, FloatArray]:
        """Box around a chain of round cones and the signed distance in it, cut off at `margin` mm."""
        widest = margin + float(radii.max())
        box = self.box(points.min(axis=0) - widest, points.max(axis=0) + widest)
        iz, iy, ix = box
        level = np.full((iz.stop - iz.start, iy.stop - iy.start, ix.stop - ix.start), margin)
        for a, b, ra, rb in zip(points[:-1], points[1:], radii[:-1], radii[1:], strict=True):
            reach = max(ra, rb) + margin
            jz, jy, jx = self.box(np.minimum(a, b) - reach, np.maximum(a, b) + reach)
            if jz.stop <= jz.start or jy.stop <= jy.start or jx.stop <= jx.start:
                continue
            inner = level[
                jz.start - iz.start : jz.stop - iz.start,
                jy.start - iy.start : jy.stop - iy.start,
                jx.start - ix.start : jx.stop - ix.start,
            ]
            np.minimum(inner, round_cone_distance(self.points((jz, jy, jx)), a, b, float(ra), float(rb)), out=inner)
        return box, level


def smooth_field(
    shape: tuple[int, int, int], spacing: tuple[float, float, float], scale: float, *, rng: np.random.Generator
) -> FloatArray:
    """A random field of about unit deviation that varies over `scale` mm: cubic B-splines with random coefficients.

    `spacing` is in mm along the three array axes.
    """
    if min(shape) == 0:  # beside the image
        return np.zeros(shape)
    matrices = []
    for n, step in zip(shape, spacing, strict=True):
        spans = max(int(np.ceil(n * step / scale)), 1)
        knots = np.arange(-3, spans + 4, dtype=float)
        matrices.append(BSpline.design_matrix(np.linspace(0.0, spans - 1e-9, n), knots, 3).toarray())
    field = rng.standard_normal(tuple(m.shape[1] for m in matrices))
    for m in matrices:
        field = np.tensordot(field, m, axes=([0], [1]))
    # The squared weights of a cubic B-spline average 151/315 along each axis.
    return np.asarray(field / (151.0 / 315.0) ** 1.5)


def smooth_curve(waypoints: FloatArray, step: float = 1.0, start_tangent: FloatArray | None = None) -> FloatArray:
    """A C2 curve through waypoints, sampled about every `step` mm, ends included: (n, 3) mm."""
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
    first = (2, np.zeros(3)) if start_tangent is None else (1, start_tangent / np.linalg.norm(start_tangent))
    spline = CubicSpline(chord, waypoints, bc_type=(first, (2, np.zeros(3))))
    return np.asarray(spline(np.linspace(0.0, chord[-1], max(int(np.ceil(chord[-1] / step)), 2) + 1)))
