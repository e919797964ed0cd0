"""What the user brings to a scene: masks, seeds and boxes, checked against the CT."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from segmentation.anatomy.nasal.scene import SIDES, STRUCTURES
from segmentation.arrays import BoolArray, FloatArray
from segmentation.errors import CaseError
from segmentation.volume import Volume

ENTRIES = tuple(f"entry_{side}" for side in SIDES)


@dataclass(frozen=True, eq=False)
class Brought:
    """Checked corrections, each by the name of what it is for.

    Attributes
    ----------
    masks, boxes : mapping of name to (slices, rows, columns) bool array
    seeds : mapping of name to (3,) float array, mm, LPS
    """

    masks: Mapping[str, BoolArray]
    seeds: Mapping[str, FloatArray]
    boxes: Mapping[str, BoolArray]

    @classmethod
    def read(
        cls,
        volume: Volume,
        *,
        masks: Mapping[str, BoolArray] | None,
        seeds: Mapping[str, ArrayLike] | None,
        boxes: Mapping[str, ArrayLike] | None,
    ) -> Brought:
        """Check what is brought against the volume.

        Raises
        ------
        CaseError
            If a name is unknown, a mask has another shape or is empty, or a seed or box lies outside of the image.
        """
        for kind, names, known in (
            ("mask", masks or {}, STRUCTURES + ENTRIES),
            ("seed", seeds or {}, STRUCTURES),
            ("box", boxes or {}, STRUCTURES + ENTRIES),
        ):
            for name in names:
                if name not in known:
                    raise CaseError(f"{kind} {name!r} is for nothing that is known; choose one of {', '.join(known)}")
        return cls(
            {name: _mask(name, mask, volume) for name, mask in (masks or {}).items()},
            {name: _seed(name, seed, volume) for name, seed in (seeds or {}).items()},
            {name: _box(name, box, volume) for name, box in (boxes or {}).items()},
        )


def _mask(name: str, mask: BoolArray, volume: Volume) -> BoolArray:
    mask = np.asarray(mask, dtype=bool)
    if mask.shape != volume.voxels.shape:
        have, want = (" x ".join(map(str, shape)) for shape in (mask.shape, volume.voxels.shape))
        raise CaseError(f"mask {name}: has {have} voxels, the CT has {want}; save it on the grid of the CT")
    if not mask.any():
        raise CaseError(f"mask {name}: holds no voxel; leave it out or save it again")
    return mask


def _seed(name: str, seed: ArrayLike, volume: Volume) -> FloatArray:
    point = np.asarray(seed, dtype=float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise CaseError(f"seed {name}: is no point; give x, y and z in LPS mm")
    if not volume.contains(point):
        raise CaseError(
            f"seed {name}: ({', '.join(f'{v:.1f}' for v in point)}) mm lies outside of the image; give LPS coordinates"
        )
    return point


def _box(name: str, box: ArrayLike, volume: Volume) -> BoolArray:
    corners = np.asarray(box, dtype=float)
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise CaseError(f"box {name}: expected two opposite corners, x, y and z each, in LPS mm")
    low, high = corners.min(axis=0), corners.max(axis=0)
    corner = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    index = volume.to_index(corner)
    first = np.maximum(np.floor(index.min(axis=0)), 0).astype(int)
    last = np.minimum(np.ceil(index.max(axis=0)) + 1, volume.voxels.shape).astype(int)
    inside = np.zeros(volume.voxels.shape, dtype=bool)
    if np.all(first < last):
        part = tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
        places = volume.to_lps(np.stack(np.meshgrid(*(np.arange(s.start, s.stop) for s in part), indexing="ij"), axis=-1))
        inside[part] = np.all((places >= low) & (places <= high), axis=-1)
    if not inside.any():
        raise CaseError(f"box {name}: holds no voxel of the image; give opposite corners in LPS mm")
    return inside
