"""Discrete curvature of polylines and the circle through three points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import FloatArray
from segmentation.errors import GeometryError


def menger_curvature(points: ArrayLike) -> FloatArray:
    """Curvature of a polyline at its interior vertices (Dai 2024, eq. 2).

    The curvature at a vertex is the reciprocal radius of the circle through it and
    its two neighbours. It is exact on circular arcs, however unevenly sampled.

    Parameters
    ----------
    points : (n, 3) array_like, mm
        Vertices in order, n >= 3.

    Returns
    -------
    (n - 2,) float array, 1/mm
        Zero where three consecutive vertices are collinear.

    Raises
    ------
    GeometryError
        If two of three consecutive vertices coincide.

    Examples
    --------
    >>> angle = np.linspace(0.0, np.pi, 5)
    >>> arc = 20.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    >>> menger_curvature(arc).round(3)
    array([0.05, 0.05, 0.05])
    """
    p = np.asarray(points, dtype=float)
    if p.ndim != 2 or len(p) < 3:
        raise GeometryError(f"curvature needs at least 3 vertices, found {len(np.atleast_2d(p))}")
    back, forth, across = p[:-2] - p[1:-1], p[2:] - p[1:-1], p[2:] - p[:-2]
    sides = np.linalg.norm(back, axis=1) * np.linalg.norm(forth, axis=1) * np.linalg.norm(across, axis=1)
    if np.any(sides <= 0):
        vertex = int(np.argmin(sides)) + 1
        raise GeometryError(f"vertices {vertex - 1} to {vertex + 1} of the polyline coincide; curvature is not defined there")
    return np.asarray(2.0 * np.linalg.norm(np.cross(back, forth), axis=1) / sides)


def circumcenter(a: ArrayLike, b: ArrayLike, c: ArrayLike) -> FloatArray | None:
    """Centre of the circle through three points, (3,) mm; None when they are collinear."""
    b = np.asarray(b, dtype=float)
    ba, bc = np.asarray(a, dtype=float) - b, np.asarray(c, dtype=float) - b
    cross = np.cross(ba, bc)
    square = float(cross @ cross)
    # Collinear to rounding: a circle of more than a million chord lengths.
    if square <= 1e-12 * float(ba @ ba) * float(bc @ bc):
        return None
    return np.asarray(b + np.cross(float(ba @ ba) * bc - float(bc @ bc) * ba, cross) / (2.0 * square))
