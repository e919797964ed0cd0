"""The C2 cubic B-spline through feature points (Dai 2024, eq. 16-24)."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from segmentation.arrays import FloatArray
from tubeplan_viz.geometry import SplineCurve


def spline_through(points: FloatArray) -> tuple[SplineCurve, FloatArray]:
    """Interpolating spline with normalised accumulated chord length and Bessel end tangents.

    Parameters
    ----------
    points : (n, 3) float array, mm
        n >= 3, no two neighbours equal.

    Returns
    -------
    curve : SplineCurve
    u : (n,) float array
        Parameter of every point.
    """
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    u = np.concatenate([[0.0], np.cumsum(chords)])
    u /= u[-1]
    u[-1] = 1.0
    start, end = bessel_tangent(u[:3], points[:3]), bessel_tangent(u[:-4:-1], points[:-4:-1])
    spline = make_interp_spline(u, points, k=3, bc_type=([(1, start)], [(1, end)]))
    return SplineCurve(3, spline.t, spline.c), u


def bessel_tangent(u: FloatArray, points: FloatArray) -> FloatArray:
    """Derivative at the first of three points of the parabola through them, (3,)."""
    first = (points[1] - points[0]) / (u[1] - u[0])
    second = (points[2] - points[1]) / (u[2] - u[1])
    return np.asarray(first - (second - first) * (u[1] - u[0]) / (u[2] - u[0]))
