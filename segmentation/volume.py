"""A CT volume: Hounsfield units and where each voxel lies in the patient."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import FloatArray, VoxelArray, frozen_array
from segmentation.errors import VolumeError


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxels in HU with their place in the patient.

    Attributes
    ----------
    voxels : (slices, rows, columns) int16 array, HU
        Indexed ``[slice, row, column]``. Large arrays are held, not copied: the
        maker hands over ownership.
    index_to_lps : (4, 4) float array, mm
        Acts on ``(slice, row, column, 1)`` at voxel centres and gives LPS patient
        coordinates.
    """

    voxels: VoxelArray
    index_to_lps: FloatArray

    def __post_init__(self) -> None:
        voxels = frozen_array(self.voxels, (None, None, None), "voxels", dtype=np.int16)
        matrix = frozen_array(self.index_to_lps, (4, 4), "index_to_lps")
        if min(voxels.shape) < 3:
            raise VolumeError(f"the volume has {voxels.shape} voxels, expected at least 3 along every axis")
        if abs(float(np.linalg.det(matrix[:3, :3]))) < 1e-9:
            raise VolumeError("the volume's axes lie in one plane; its geometry cannot be right")
        object.__setattr__(self, "voxels", voxels)
        object.__setattr__(self, "index_to_lps", matrix)

    @cached_property
    def lps_to_index(self) -> FloatArray:
        """Inverse of `index_to_lps`, (4, 4)."""
        return frozen_array(np.linalg.inv(self.index_to_lps), (4, 4), "lps_to_index")

    @cached_property
    def spacing(self) -> FloatArray:
        """Distance between voxel centres along slice, row and column index, (3,) mm."""
        return frozen_array(np.linalg.norm(self.index_to_lps[:3, :3], axis=0), (3,), "spacing")

    @property
    def voxel_ml(self) -> float:
        """Volume of one voxel, ml."""
        return abs(float(np.linalg.det(self.index_to_lps[:3, :3]))) / 1000.0

    def to_lps(self, index: ArrayLike) -> FloatArray:
        """LPS coordinates in mm of (..., 3) indices ``[slice, row, column]``."""
        return np.asarray(index, dtype=float) @ self.index_to_lps[:3, :3].T + self.index_to_lps[:3, 3]

    def to_index(self, lps: ArrayLike) -> FloatArray:
        """Fractional indices ``[slice, row, column]`` of (..., 3) LPS points in mm."""
        return np.asarray(lps, dtype=float) @ self.lps_to_index[:3, :3].T + self.lps_to_index[:3, 3]

    def contains(self, lps: ArrayLike) -> bool:
        """Whether one LPS point lies in the box of the voxels (outer faces included)."""
        index = self.to_index(lps)
        return bool(np.all(index >= -0.5) and np.all(index <= np.array(self.voxels.shape) - 0.5))

    def crop(self, lower: ArrayLike, upper: ArrayLike) -> Volume:
        """The part ``lower <= index < upper`` as a view on the same voxels."""
        lo, up = np.asarray(lower, dtype=int), np.asarray(upper, dtype=int)
        matrix = self.index_to_lps.copy()
        matrix[:3, 3] = self.to_lps(lo)
        return Volume(self.voxels[lo[0] : up[0], lo[1] : up[1], lo[2] : up[2]], matrix)
