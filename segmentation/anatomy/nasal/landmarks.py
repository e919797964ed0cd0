"""What the search for structures starts from: the head's tissue, the tip of the nose, the plane of symmetry."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from segmentation.anatomy.nasal import solids
from segmentation.anatomy.nasal.upright import Upright
from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import VolumeError
from segmentation.smoothing import block_mean

COARSE = 2.0
"""Edge of the blocks in which the whole head is judged, mm."""
NOSE_WIDTH = 50.0
"""Greatest width 8 mm behind the tip, mm: a forehead, chin or cheek is wider."""
NOSE_DEPTH = 8.0
_SEAL = 10.0
"""Openings up to twice this width count as part of the head's outer surface, mm: nostrils, ears, lips."""


@dataclass(frozen=True, eq=False)
class Coarse:
    """Block means of the head on cells of about `COARSE` mm.

    Attributes
    ----------
    factor : (3,) int tuple
        Voxels per cell along up, back, left.
    hu : (up, back, left) float array, HU
    spacing : (3,) float array, mm
    """

    factor: tuple[int, int, int]
    hu: NDArray[np.float32]
    spacing: FloatArray

    @classmethod
    def of(cls, upright: Upright, *, size: float = COARSE) -> Coarse:
        """Cells of about `size` mm; where a voxel is larger it is the cell."""
        up, back, left = np.maximum(np.round(size / upright.spacing), 1).astype(int).tolist()
        factor = (up, back, left)
        return cls(factor, block_mean(upright.voxels, factor), upright.spacing * factor)

    def fine(self, mask: BoolArray, shape: tuple[int, ...]) -> BoolArray:
        """A mask of cells on the voxels; voxels of an incomplete last block get the last cell's value."""
        for axis, (count, size) in enumerate(zip(self.factor, shape, strict=True)):
            mask = np.take(mask, np.minimum(np.arange(size) // count, mask.shape[axis] - 1), axis=axis)
        return mask

    def to_fine(self, index: FloatArray | IntArray) -> FloatArray:
        """Fractional voxel index of fractional cell indices."""
        return (np.asarray(index, dtype=float) + 0.5) * self.factor - 0.5

    def to_cell(self, index: FloatArray | IntArray) -> FloatArray:
        """Fractional cell index of fractional voxel indices."""
        return (np.asarray(index, dtype=float) + 0.5) / self.factor - 0.5


class Landmarks:
    """The head in a scan, on voxels [up, back, left].

    Parameters
    ----------
    upright : Upright
    air_max, bone_min : float, HU
    """

    def __init__(self, upright: Upright, *, air_max: float, bone_min: float) -> None:
        self.upright = upright
        self.spacing = upright.spacing
        self.air_max, self.bone_min = air_max, bone_min
        self.coarse = Coarse.of(upright)

    @cached_property
    def body_cells(self) -> BoolArray:
        """Cells of the head, without table and headrest."""
        tissue = self.coarse.hu > self.air_max
        # A headrest touches the back of the head in a few cells only; thin walls of the nose lie in front.
        core = solids.largest(solids.shrunk(tissue, 2.5, self.coarse.spacing))
        if not core.any():
            raise VolumeError("the scan holds no tissue thicker than 5 mm; this is no head")
        near = solids.grown(core, 6.0, self.coarse.spacing)
        near[:, : int(np.argwhere(core)[:, 1].mean())] = True
        return solids.largest(near & tissue)

    @cached_property
    def hull_cells(self) -> BoolArray:
        """The head with nostrils, mouth and ears closed."""
        sealed = solids.closed(self.body_cells, _SEAL, self.coarse.spacing)
        outside, _ = ndimage.label(~np.pad(sealed, ((0, 0), (1, 1), (1, 1))))
        return np.asarray(outside != outside[0, 0, 0])[:, 1:-1, 1:-1]

    @cached_property
    def skin(self) -> BoolArray:
        """Soft tissue and bone of the head."""
        near = self.coarse.fine(solids.grown(self.body_cells, 3.0, self.coarse.spacing), self.upright.voxels.shape)
        tissue: BoolArray = (self.upright.voxels > self.air_max) & near
        return solids.largest(tissue)

    @cached_property
    def hull(self) -> BoolArray:
        """`hull_cells` on the voxels."""
        return self.coarse.fine(self.hull_cells, self.upright.voxels.shape) | self.skin

    @cached_property
    def tip(self) -> IntArray:
        """Foremost voxel of the nose, [up, back, left].

        Raises
        ------
        VolumeError
            If what lies foremost is cut by the image or too wide for a nose.
        """
        row = int(self.skin.any(axis=(0, 2)).argmax())
        if row == 0:
            raise VolumeError(
                "the head runs out of the image in front, so the tip of the nose is not in it; take a scan that holds it"
            )
        places = np.argwhere(self.skin[:, row, :])
        middle = places[np.abs(places - places.mean(axis=0)).sum(axis=1).argmin()]
        tip: IntArray = np.array([middle[0], row, middle[1]])
        behind = row + round(NOSE_DEPTH / float(self.spacing[1]))
        labels, _ = ndimage.label(self.hull[middle[0], behind])
        width = float(np.count_nonzero(labels == labels[middle[1]]) * self.spacing[2]) if labels[middle[1]] else 0.0
        if width > NOSE_WIDTH:
            raise VolumeError(
                f"no nose in the image: what lies foremost is {width:.0f} mm wide {NOSE_DEPTH:.0f} mm behind its front, "
                f"expected at most {NOSE_WIDTH:.0f} mm; take a scan that holds the nose"
            )
        return tip

    @cached_property
    def midline(self) -> FloatArray:
        """Plane n . index = d in mm, index times spacing: (n up, n back, n left, d), n towards the left.

        The plane about which the head in front of the ears, seen in soft and bone windows, is most like its mirror image.
        """
        hu = np.clip(self.coarse.hu, -400.0, 600.0) / 500.0
        hu = ndimage.gaussian_filter(np.where(self.hull_cells, hu, -0.8), 1.0)
        spacing = self.coarse.spacing
        tip = self.coarse.to_cell(self.tip) * spacing
        cells = np.argwhere(self.hull_cells)[::5] * spacing
        cells = cells[(cells[:, 1] < tip[1] + 130.0) & (np.abs(cells[:, 0] - tip[0]) < 90.0)]
        here = ndimage.map_coordinates(hu, (cells / spacing).T, order=1, mode="nearest")

        def unlike(values: FloatArray) -> float:
            normal, offset = _plane(values, tip)
            mirrored = cells - 2.0 * (cells @ normal - offset)[:, None] * normal
            there = ndimage.map_coordinates(hu, (mirrored / spacing).T, order=1, mode="constant", cval=-0.8)
            return float(np.mean(np.abs(here - there)))

        starts = [np.array([shift, 0.0, 0.0]) for shift in (-6.0, 0.0, 6.0)]
        best = min(starts, key=unlike)
        simplex = best + np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.08, 0.0], [0.0, 0.0, 0.08]])
        found = optimize.minimize(
            unlike, best, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 0.005, "maxiter": 90}
        )
        normal, offset = _plane(found.x, tip)
        # Cells and voxels have different origins: half a cell less half a voxel.
        shift = 0.5 * (spacing - self.spacing)
        return np.array([*normal, offset + float(normal @ shift)])

    def across(self, shape: tuple[int, ...], lower: IntArray | tuple[int, ...] = (0, 0, 0)) -> FloatArray:
        """Signed distance to the midline, mm, positive on the left, at the voxels of a box that starts at `lower`."""
        up, back, left = (
            (np.arange(n) + float(first)) * step * part
            for n, first, step, part in zip(shape, lower, self.spacing, self.midline[:3], strict=True)
        )
        return up[:, None, None] + back[None, :, None] + left[None, None, :] - self.midline[3]


def _plane(values: FloatArray, tip: FloatArray) -> tuple[FloatArray, float]:
    """Normal and offset of a plane by its distance from the tip and its two turns (roll, yaw) in radians."""
    shift, roll, yaw = values
    normal = np.array([np.sin(roll), np.sin(yaw), 1.0])
    normal /= np.linalg.norm(normal)
    return normal, float(normal @ tip + shift)
