"""The brain: the largest soft region inside the skull.

Strategy: a ball that does not fit through the foramen magnum's rim, a fissure or a hole of the skull is rolled through the
soft tissue; the largest space it reaches is the cranial cavity. Downwards it ends where its slices have become small: there
the spinal canal begins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.anatomy.nasal import solids
from segmentation.anatomy.nasal.landmarks import Landmarks
from segmentation.arrays import BoolArray, FloatArray
from segmentation.smoothing import block_mean

BALL = 8.0
"""Its radius, mm: defects of the skull up to 16 mm wide are closed."""
SMALLEST = 20e3
"""Least volume that the ball's centre reaches in a brain, mm^3."""
NECK = 0.08
"""Share of the largest slice below which the spinal canal begins."""
VOLUME = (900.0, 1800.0)
"""Brain with its fluid spaces, adults, ml."""
MATTER = (-60.0, 140.0)
"""Brain, fluid and vessels with noise, without voxels shared with air or bone, HU."""
BONE_SHARE = 0.25
"""Share of bone in a cell that stops the ball."""


@dataclass(frozen=True, eq=False)
class Brain:
    """The brain on the voxels [up, back, left].

    Attributes
    ----------
    mask : (up, back, left) bool array
    millilitres : float
    cut : bool
        Whether the image ends inside of it.
    enclosed : float
        Share of its surface that lies on bone or on the image's border.
    symmetry : float
        Smaller side over larger side.
    """

    mask: BoolArray
    millilitres: float
    cut: bool
    enclosed: float
    symmetry: float

    @property
    def confidence(self) -> float:
        """Enclosed share, less where the sides differ or an uncut brain has an unlikely volume."""
        size = 0.8 if self.cut else min(1.0, self.millilitres / VOLUME[0], VOLUME[1] / max(self.millilitres, 1.0))
        return min(self.enclosed / 0.85, 1.0) * min(self.symmetry / 0.9, 1.0) * size


def find_brain(head: Landmarks, *, seed: FloatArray | None = None) -> Brain | None:
    """The brain of a head; None where the scan holds no cranial cavity.

    Parameters
    ----------
    head : Landmarks
    seed : (3,) float array, optional
        A place in it, [up, back, left]; otherwise the largest space above the nose is taken.
    """
    spacing = head.coarse.spacing
    soft, bone = _cells(head)
    core = solids.shrunk(soft, BALL, spacing)
    # The ball starts above the palate: the neck may be wider than a cut brain.
    low = int(head.coarse.to_cell(head.tip)[0])
    if seed is not None:
        core = solids.near(core, head.coarse.to_cell(seed), BALL + 5.0, spacing)
    else:
        labels, count = ndimage.label(core)
        sizes = np.bincount(labels[low:].ravel(), minlength=count + 1)
        sizes[0] = 0
        core = labels == sizes.argmax() if sizes.any() else np.zeros_like(core)
    if np.count_nonzero(core) * spacing.prod() < SMALLEST:
        return None
    core = _above_neck(core)
    cells = solids.grown(core, BALL + float(spacing.max()), spacing) & soft
    cells[: max(int(np.flatnonzero(core.any(axis=(1, 2)))[0] - round(BALL / float(spacing[0]))), 0)] = False
    hu = head.upright.voxels
    mask = head.coarse.fine(cells, hu.shape) & (hu >= MATTER[0]) & (hu <= MATTER[1])
    # What is left of the cells beyond a thin roof of the sinuses is a sheet of a voxel or two.
    mask = solids.largest(ndimage.binary_opening(mask, border_value=0) | (mask & _edge(mask.shape)))
    surface = cells & ~ndimage.binary_erosion(cells, border_value=1)
    on_bone = solids.grown(bone, 2.0 * float(spacing.max()), spacing)
    volume = cells.sum(axis=(1, 2))
    across = _cell_distance(head, cells.shape)
    left = float(np.count_nonzero(cells & (across > 0.0)))
    right = float(np.count_nonzero(cells)) - left
    smaller, larger = sorted((left, right))
    return Brain(
        mask=mask,
        millilitres=float(np.count_nonzero(mask) * head.spacing.prod() / 1000.0),
        cut=bool(volume[-1] > 0.02 * volume.max() or cells[:, [0, -1]].any() or cells[:, :, [0, -1]].any()),
        enclosed=float((surface & on_bone).sum() / surface.sum()),
        symmetry=smaller / max(larger, 1.0),
    )


def _cells(head: Landmarks) -> tuple[BoolArray, BoolArray]:
    """Cells of soft tissue inside the head, and cells that bone stops."""
    hard = (head.upright.voxels >= head.bone_min).astype(np.int16)
    bone: BoolArray = block_mean(hard, head.coarse.factor) >= BONE_SHARE
    soft = ~bone & (head.coarse.hu > head.air_max) & head.hull_cells
    return soft, bone


def _edge(shape: tuple[int, ...]) -> BoolArray:
    """The outermost voxels, which an opening would take from a brain that the image cuts."""
    inner = np.ones(shape, dtype=bool)
    inner[1:-1, 1:-1, 1:-1] = False
    return inner


def _above_neck(core: BoolArray) -> BoolArray:
    """Without what lies below the first slice, downwards from the largest, that is small."""
    area = core.sum(axis=(1, 2))
    top = int(area.argmax())
    small = np.flatnonzero(area[:top] < NECK * area[top])
    kept = core.copy()
    if small.size:
        kept[: small[-1] + 1] = False
    return solids.largest(kept)


def _cell_distance(head: Landmarks, shape: tuple[int, ...]) -> FloatArray:
    """Signed distance of cell centres to the midline, mm."""
    fine = [head.coarse.to_fine(np.repeat(np.arange(n)[:, None], 3, axis=1))[:, axis] for axis, n in enumerate(shape)]
    up, back, left = (index * step * part for index, step, part in zip(fine, head.spacing, head.midline[:3], strict=True))
    return np.asarray(up[:, None, None] + back[None, :, None] + left[None, None, :] - head.midline[3])
