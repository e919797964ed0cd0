"""The middle line of one tube."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from segmentation.arrays import FloatArray, frozen_array


@dataclass(frozen=True, eq=False)
class Centerline:
    """Points along the middle of one tube, from proximal to distal.

    Attributes
    ----------
    points : (n, 3) float array, mm
        Vertices in order.
    radii : (n,) float array, mm
        Radius of the largest sphere inside the lumen at each vertex (caps are not wall).
    """

    points: FloatArray
    radii: FloatArray

    def __post_init__(self) -> None:
        points = frozen_array(self.points, (None, 3), "points")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "radii", frozen_array(self.radii, (len(points),), "radii"))

    @cached_property
    def arc_length(self) -> FloatArray:
        """Arc length at each vertex, (n,) mm."""
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return frozen_array(np.concatenate([[0.0], np.cumsum(steps)]), (len(self.points),), "arc_length")
