"""The mucosa after adrenaline: septum and inferior turbinate of one side drawn back towards their bone.

Strategy: on each line across the nose the mucosa's edge may retreat to the first bone or cartilage behind it, for the
turbinate also to the air behind it, less a thin layer that stays [1]_. Where a line shows neither, it lines up with the
lines around it in the same slice: axial for the septum, coronal for the turbinate. The retreat is found once, from the CT;
`amount` is the share of it that is taken, so that more shrinkage takes away all that less does.

References
----------
.. [1] Multi-constraint path planning (Chinese patent text, 2021), paragraphs 85 and 86; its simulation reached
   4.06 mm at the septum and 8.13 mm at the turbinate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from segmentation.anatomy.nasal.scene import SIDES, NasalScene, Tissue
from segmentation.anatomy.nasal.upright import Upright
from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import CaseError

HARD_MIN = 130.0
"""Cartilage and thin bone that share voxels with mucosa begin here, HU; mucosa without contrast has 30 to 70."""
LAYER = 1.0
"""Mucosa that stays on the bone, mm."""
SEPTUM_MOST, TURBINATE_MOST = 4.06, 8.13
"""Greatest displacement, mm: what the source's simulation reached and found realistic."""
EVEN = 5.0
"""Over this distance neighbouring lines give way alike, mm."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Shrinkage:
    """A scene after shrinkage.

    Attributes
    ----------
    scene : NasalScene
    side : str
    amount : float
        0 (none) to 1 (all).
    septum_mm, turbinate_mm : float
        Greatest displacement of the edge; 0 where the structure is absent.
    removed_ml : float
        Tissue that became air.
    """

    scene: NasalScene
    side: str
    amount: float
    septum_mm: float
    turbinate_mm: float
    removed_ml: float


def shrink(scene: NasalScene, amount: float, side: str) -> Shrinkage:
    """Shrink the mucosa of one side.

    Parameters
    ----------
    scene : NasalScene
    amount : float
        0 to 1.
    side : str
        One of `SIDES`.

    Raises
    ------
    CaseError
        If the amount or the side is none.
    """
    if side not in SIDES:
        raise CaseError(f"mucosa of side {side!r} cannot be shrunk; choose left or right")
    if not 0.0 <= amount <= 1.0:
        raise CaseError(f"a shrinkage of {amount:g} was given, expected 0 to 1 (0 to 100 %)")
    upright = Upright(scene.volume)
    tissue = upright.turn(scene.tissue)
    removed: BoolArray = np.zeros(tissue.shape, dtype=bool)
    reached = {"septum": 0.0, f"turbinate_{side}": 0.0}
    # Septum: its edge on this side retreats across the midline; turbinate: its inner edge retreats outwards.
    outwards = 1 if side == "left" else -1
    for name, way, slices, most in (("septum", -outwards, 1, SEPTUM_MOST), (f"turbinate_{side}", outwards, 0, TURBINATE_MOST)):
        if name in scene.structures:
            mask = upright.turn(scene.structures[name])
            gone, reached[name] = _retreat(
                mask, upright, tissue, amount, way=way, along=slices, to_air=name != "septum", most=most
            )
            removed |= gone
    out = upright.restore(removed)
    return Shrinkage(
        scene=replace(
            scene,
            tissue=np.where(out, np.uint8(Tissue.AIR), scene.tissue),
            structures={name: mask & ~out if name in reached else mask for name, mask in scene.structures.items()},
        ),
        side=side,
        amount=amount,
        septum_mm=reached["septum"],
        turbinate_mm=reached[f"turbinate_{side}"],
        removed_ml=float(np.count_nonzero(out)) * scene.volume.voxel_ml,
    )


def _retreat(
    mask: BoolArray, upright: Upright, tissue: np.ndarray, amount: float, *, way: int, along: int, to_air: bool, most: float
) -> tuple[BoolArray, float]:
    """Voxels that a structure loses, and the greatest displacement of its edge, mm.

    Parameters
    ----------
    mask, tissue : (up, back, left) arrays
    upright : Upright
    amount : float
    way : int
        Direction along the last axis in which the edge retreats.
    along : int
        Axis of the lines' grid (up, back) along which a line without bone lines up with others.
    to_air : bool
        Whether the edge may retreat to air behind the structure too.
    most : float, mm
        Greatest displacement at full shrinkage.
    """
    box = _box(mask)
    turned = (slice(None), slice(None), slice(None, None, way))
    body = mask[box][turned]
    hard = (upright.voxels[box][turned] >= HARD_MIN) & body
    air = (tissue[box] == Tissue.AIR)[turned]
    step = float(upright.spacing[2])
    places = np.arange(body.shape[2])
    there: BoolArray = np.asarray(body.any(axis=2))
    edge = np.where(there, body.argmax(axis=2), 0)
    ends = (places > edge[:, :, None]) & ~body
    end = np.where(ends.any(axis=2), ends.argmax(axis=2), body.shape[2])
    bone = np.where(hard.any(axis=2), hard.argmax(axis=2), body.shape[2])
    meets_bone = there & (bone < end)
    behind = np.take_along_axis(air, np.minimum(end, body.shape[2] - 1)[:, :, None], axis=2)[:, :, 0] & (end < body.shape[2])
    seen = meets_bone | (there & behind & np.bool_(to_air))
    stop = _lined_up(np.where(meets_bone, bone, end).astype(float), seen, there, along)
    depth = np.where(there, (stop - edge) * step - LAYER, 0.0)
    # Lines give way together: single ones that miss the bone would leave furrows.
    size = 2 * np.round(0.5 * EVEN / upright.spacing[:2]).astype(int) + 1
    depth = ndimage.median_filter(depth, size=tuple(size.tolist()), mode="nearest")
    # A line gives way before its bone, without any to the air behind, or else (septum) to its middle.
    own = np.where(seen, (np.minimum(bone, end) - edge) * step - LAYER, 0.5 * (end - edge) * step)
    depth = np.where(there, np.clip(depth, 0.0, np.clip(own, 0.0, most)), 0.0)
    middle = (places - edge[:, :, None] + 0.5) * step
    gone = body & (middle >= 0.0) & (middle <= amount * depth[:, :, None]) & (places < np.minimum(bone, end)[:, :, None])
    gone &= (tissue[box] == Tissue.SOFT)[turned]
    out = np.zeros_like(mask)
    out[box] = gone[turned]
    moved = np.where(gone.any(axis=2), amount * depth, 0.0)
    return out, float(moved.max(initial=0.0))


def _lined_up(stop: FloatArray, seen: BoolArray, there: BoolArray, along: int) -> FloatArray:
    """Where lines without bone stop: between the nearest seen ones of their slice, or of all slices where it has none."""
    filled = stop.copy()
    if not seen.any():
        return np.where(there, 0.0, filled)
    nearest: IntArray = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    filled = np.where(seen, stop, stop[tuple(nearest)])
    for number in range(stop.shape[1 - along]):
        line = (number, slice(None)) if along == 1 else (slice(None), number)
        known = np.flatnonzero(seen[line])
        if known.size >= 2:
            filled[line] = np.interp(np.arange(stop.shape[along]), known, stop[line][known])
    return filled


def _box(mask: BoolArray) -> tuple[slice, slice, slice]:
    """Index box of a mask with one voxel around it."""
    sides = []
    for axis in range(3):
        there = np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis)))
        sides.append(slice(max(int(there[0]) - 1, 0), min(int(there[-1]) + 2, mask.shape[axis])))
    return sides[0], sides[1], sides[2]
