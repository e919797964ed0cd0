"""A pinhole camera at the instrument's tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import FloatArray, frozen_array
from tubeplan_viz.geometry import moving_frames

FIELD_OF_VIEW = float(np.deg2rad(95.0))  # within the 85 to 120 degrees of flexible endoscopes


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """A camera with a square picture.

    Attributes
    ----------
    position : (3,) float array, mm
    right, up, forward : (3,) float array
        Unit vectors; ``right = forward x up``.
    field_of_view : float
        Angle between opposite sides of the picture, rad.
    """

    position: FloatArray
    right: FloatArray
    up: FloatArray
    forward: FloatArray
    field_of_view: float = FIELD_OF_VIEW

    def __post_init__(self) -> None:
        for name in ("position", "right", "up", "forward"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (3,), name))

    def rays(self, size: int) -> FloatArray:
        """Unit direction of each pixel of a picture of `size` by `size`, rows from the top, (size * size, 3)."""
        reach = np.tan(0.5 * self.field_of_view)
        places = (2.0 * (np.arange(size) + 0.5) / size - 1.0) * reach
        x, y = np.meshgrid(places, -places)
        rays = x.reshape(-1, 1) * self.right + y.reshape(-1, 1) * self.up + self.forward
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def project(self, points: ArrayLike) -> FloatArray:
        """Where points appear, (n, 3): column and row from 0 to 1, and the depth along the view in mm."""
        away = np.atleast_2d(np.asarray(points, dtype=float)) - self.position
        depth = away @ self.forward
        reach = np.tan(0.5 * self.field_of_view) * np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        return np.column_stack([0.5 + 0.5 * (away @ self.right) / reach, 0.5 - 0.5 * (away @ self.up) / reach, depth])


def path_cameras(points: FloatArray) -> tuple[Camera, ...]:
    """A camera at each place of a path, looking along it.

    The picture turns as little as possible along the way. At the first place its top is
    superior; on a path that begins along the body's axis, anterior (LPS).

    Parameters
    ----------
    points : (n, 3) float array, mm
        n >= 2, no two neighbours equal.
    """
    frames = moving_frames(points)
    return tuple(
        Camera(position=point, right=frame[:, 1], up=frame[:, 0], forward=frame[:, 2])
        for point, frame in zip(points, frames, strict=True)
    )
