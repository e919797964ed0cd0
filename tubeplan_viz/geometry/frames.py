"""Directions across a line: any at each tangent, and frames that turn as little as possible along it."""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray


def across(tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors perpendicular to each tangent and to each other, (k, 3) each."""
    unit = tangents / np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-12)
    helper = np.eye(3)[np.argmin(np.abs(unit), axis=1)]
    side = np.cross(unit, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(unit, side)


def moving_frames(points: FloatArray, *, first: FloatArray | None = None) -> FloatArray:
    """Rotation-minimising frames along a polyline by double reflection [1]_.

    Parameters
    ----------
    points : (n, 3) float array, mm
        n >= 2, no two neighbours equal.
    first : (3,) float array, optional
        Direction, not along the line's first edge, to which the first normal points as far as it
        can; without it up (+z), or forward (-y) where the line itself begins upwards.

    Returns
    -------
    (n, 3, 3) float array
        Columns are normal, binormal and tangent; right-handed.

    References
    ----------
    .. [1] Wang, W., Juettler, B., Zheng, D., Liu, Y. (2008). Computation of rotation
       minimizing frames. ACM Transactions on Graphics, 27(1), 2.
    """
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    normals = np.empty_like(points)
    if first is None:
        first = np.array([0.0, 0.0, 1.0]) if abs(tangents[0, 2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    normals[0] = first - (first @ tangents[0]) * tangents[0]
    normals[0] /= np.linalg.norm(normals[0])
    for i in range(len(points) - 1):
        chord = points[i + 1] - points[i]
        square = chord @ chord
        normal = normals[i] - (2.0 / square) * (chord @ normals[i]) * chord
        tangent = tangents[i] - (2.0 / square) * (chord @ tangents[i]) * chord
        bend = tangents[i + 1] - tangent
        square = bend @ bend
        if square > 1e-24:
            normal = normal - (2.0 / square) * (bend @ normal) * bend
        normal -= (normal @ tangents[i + 1]) * tangents[i + 1]
        normals[i + 1] = normal / np.linalg.norm(normal)
    return np.stack([normals, np.cross(tangents, normals), tangents], axis=2)
