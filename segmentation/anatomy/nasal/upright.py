"""The head as arrays that run upwards, backwards and to the patient's left, whatever the scan's order was."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from segmentation.arrays import FloatArray, VoxelArray
from segmentation.errors import VolumeError
from segmentation.volume import Volume

# Directions of the three axes in LPS: up, backwards, left.
_TOWARDS = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
_LEAN_MAX = 0.8
"""Least cosine between an axis of the grid and its direction: a head may be tilted by 37 degrees against the grid."""


class Upright:
    """Views on a volume's arrays whose axes run up, back and left; nothing is copied or resampled.

    Attributes
    ----------
    volume : Volume
    spacing : (up, back, left) distances, mm

    Raises
    ------
    VolumeError
        If the grid's axes lie askew to the patient's.
    """

    def __init__(self, volume: Volume) -> None:
        self.volume = volume
        directions = (volume.index_to_lps[:3, :3] / volume.spacing).T  # one row per array axis
        cosines = _TOWARDS @ directions.T
        self._axes = tuple(int(axis) for axis in np.argmax(np.abs(cosines), axis=1))
        best = np.abs(cosines).max(axis=1)
        if len(set(self._axes)) != 3 or best.min() < _LEAN_MAX:
            raise VolumeError(
                f"the scan's axes lie {np.degrees(np.arccos(min(float(best.min()), 1.0))):.0f} degrees askew to the patient's, "
                f"expected at most {np.degrees(np.arccos(_LEAN_MAX)):.0f}; resample the CT to axial slices"
            )
        signs = cosines[np.arange(3), self._axes]
        self._flips = tuple(slice(None) if sign > 0.0 else slice(None, None, -1) for sign in signs)
        self.spacing = volume.spacing[list(self._axes)]

    def turn(self, array: NDArray[Any]) -> NDArray[Any]:
        """An array on the volume's voxels as [up, back, left]; a view."""
        return array.transpose(self._axes)[self._flips]

    def restore(self, array: NDArray[Any]) -> NDArray[Any]:
        """Inverse of `turn`, contiguous."""
        return np.ascontiguousarray(array[self._flips].transpose(np.argsort(self._axes)))

    @cached_property
    def voxels(self) -> VoxelArray:
        """HU, [up, back, left]."""
        return self.turn(self.volume.voxels)

    @cached_property
    def index_to_lps(self) -> FloatArray:
        """(4, 4) mm, acts on [up, back, left]."""
        matrix = np.eye(4)
        shape = np.array(self.volume.voxels.shape)[list(self._axes)]
        for place, (axis, flip) in enumerate(zip(self._axes, self._flips, strict=True)):
            column = self.volume.index_to_lps[:3, axis]
            matrix[:3, place] = column if flip.step is None else -column
            if flip.step is not None:
                matrix[:3, 3] += column * (shape[place] - 1)
        matrix[:3, 3] += self.volume.index_to_lps[:3, 3]
        return matrix

    def to_lps(self, index: ArrayLike) -> FloatArray:
        """LPS mm of (..., 3) indices [up, back, left]."""
        return np.asarray(index, dtype=float) @ self.index_to_lps[:3, :3].T + self.index_to_lps[:3, 3]

    def to_index(self, lps: ArrayLike) -> FloatArray:
        """Fractional [up, back, left] of (..., 3) points in LPS mm."""
        inverse = np.linalg.inv(self.index_to_lps)
        return np.asarray(lps, dtype=float) @ inverse[:3, :3].T + inverse[:3, 3]
