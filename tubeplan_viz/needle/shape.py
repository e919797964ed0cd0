"""Obstacles as surfaces, for drawing: where their signed distance has one value."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from skimage.measure import marching_cubes

from segmentation.arrays import FloatArray, IntArray

STEP_MM = 1.5


def level_surface(
    distance: Callable[[FloatArray], FloatArray], points: FloatArray, *, beside: float, level: float = 0.0
) -> tuple[FloatArray, IntArray]:
    """Where a signed distance has the value `level`, in the box of some points.

    Parameters
    ----------
    distance : callable
        Signed distance, mm, of (k, 3) points, (k,).
    points : (n, 3) float array, mm
    beside : float, mm
        How far the box reaches beyond the points.
    level : float, mm
        0 for the obstacles, the safety distance for their shells.

    Returns
    -------
    (v, 3) float array, mm, and (f, 3) int array
        Vertices and faces, `STEP_MM` coarse; none where the value is not taken.
    """
    low, high = points.min(axis=0) - beside, points.max(axis=0) + beside
    axes = [np.arange(a, b + STEP_MM, STEP_MM) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    field = distance(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    if not field.min() < level < field.max():
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    vertices, faces, *_ = marching_cubes(field, level, spacing=(STEP_MM,) * 3)
    return np.asarray(vertices + low, float), np.asarray(faces, np.int64)
