"""Where a decompression of the optic nerve goes: the medial wall of the optic canal, proposed or given.

Strategy: the canal begins at the apex of the orbit and runs backwards and towards the middle, past the side wall of the
sphenoid sinus (or of a posterior ethmoid cell). The proposal is the wall of such a sinus nearest to the middle of that way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from segmentation.anatomy.nasal.scene import SIDES, EntryRegion, NasalScene, Tissue
from segmentation.anatomy.nasal.upright import Upright
from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import CaseError

COURSE = np.array([0.2, 0.78, 0.6])
"""Direction of the canal from the orbit: upwards, backwards, towards the middle; it makes about 36 degrees with the sagittal
plane and rises a little (Rhoton, Neurosurgery 51 (2002) S335-S374)."""
MIDDLE = 8.0
"""From the apex of the orbit to the middle of the canal, mm; a canal is 8 to 12 mm long."""
NEAR = 8.0
"""How far from there the sinus wall is looked for, mm."""
BEHIND = 3.0
"""Thickness of tissue between the sinus and the proposal at most, mm."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Lesion:
    """Where the tip has to go.

    Attributes
    ----------
    side : str
        One of `SIDES`.
    center : (3,) float array, mm, LPS
        The goal: the given point, or the centroid of what was given or proposed.
    confidence : float
        0 to 1; 1 where the user gave it.
    origin : str
        "proposed", "point", "sphere" or "mask".
    note : str
        What a reader should know; empty where there is nothing to say.
    """

    side: str
    center: FloatArray
    confidence: float
    origin: str
    note: str = ""


def propose_lesion(scene: NasalScene, side: str) -> Lesion | None:
    """The medial wall of one optic canal; None without that side's orbit.

    Raises
    ------
    CaseError
        If the side is none.
    """
    _check_side(side)
    orbit = scene.structures.get(f"orbit_{side}")
    if orbit is None:
        return None
    upright = Upright(scene.volume)
    tissue = upright.turn(scene.tissue)
    apex = _apex(upright.turn(orbit))
    towards_middle = -1.0 if side == "left" else 1.0
    way = COURSE * [1.0, 1.0, towards_middle] / np.linalg.norm(COURSE)
    middle = apex + MIDDLE * way / upright.spacing
    wall, away = _sinus_wall(tissue, upright, middle, int(towards_middle))
    trust = scene.confidence.get(f"orbit_{side}", 0.0)
    if wall is None:
        inside = np.clip(np.rint(middle), 0, np.array(tissue.shape) - 1).astype(int)
        if tissue[tuple(inside)] == Tissue.AIR:
            return None
        note = f"no sinus wall within {NEAR:g} mm of where the canal should run"
        return Lesion(side=side, center=upright.to_lps(inside), confidence=0.2 * trust, origin="proposed", note=note)
    confidence = trust * float(np.clip(1.0 - away / (1.5 * NEAR), 0.0, 1.0))
    note = f"sinus wall {away:.1f} mm from where the canal should run"
    return Lesion(side=side, center=upright.to_lps(wall), confidence=confidence, origin="proposed", note=note)


def given_lesion(
    scene: NasalScene, side: str, *, point: ArrayLike | None = None, radius: float | None = None, mask: BoolArray | None = None
) -> Lesion:
    """A lesion that the user gives: a point, a sphere (point and radius) or a mask on the CT's grid.

    Raises
    ------
    CaseError
        If the side is none, nothing or too much is given, a mask does not fit, or the goal lies outside of the image or in air.
    """
    _check_side(side)
    if (point is None) == (mask is None):
        raise CaseError("the lesion is given neither or twice; give a point (with a radius for a sphere) or a mask")
    if mask is not None:
        mask = np.asarray(mask, dtype=bool)
        if mask.shape != scene.volume.voxels.shape:
            have, want = (" x ".join(map(str, shape)) for shape in (mask.shape, scene.volume.voxels.shape))
            raise CaseError(f"lesion: its mask has {have} voxels, the CT has {want}; save it on the grid of the CT")
        if not mask.any():
            raise CaseError("lesion: its mask holds no voxel; mark the region again")
        center, origin = scene.volume.to_lps(np.argwhere(mask).mean(axis=0)), "mask"
    else:
        center, origin = np.asarray(point, dtype=float), "point" if radius is None else "sphere"
        if center.shape != (3,) or not np.isfinite(center).all():
            raise CaseError("lesion: is no point; give x, y and z in LPS mm")
        if radius is not None and not 0.0 < radius <= 30.0:
            raise CaseError(f"lesion: has a radius of {radius:g} mm, expected 0 to 30 mm")
    require_tissue(scene, center, "lesion")
    return Lesion(side=side, center=center, confidence=1.0, origin=origin)


def require_tissue(scene: NasalScene, point: FloatArray, name: str) -> None:
    """Refuse a goal outside of the image or in air.

    Raises
    ------
    CaseError
        With the distance to the nearest tissue.
    """
    words = ", ".join(f"{value:.1f}" for value in point)
    if not scene.volume.contains(point):
        raise CaseError(f"{name}: ({words}) mm lies outside of the image; give LPS coordinates of this CT")
    index = np.rint(scene.volume.to_index(point)).astype(int)
    if scene.tissue[tuple(index)] != Tissue.AIR:
        return
    reach = np.ceil(20.0 / scene.volume.spacing).astype(int)
    low = np.maximum(index - reach, 0)
    box = tuple(slice(int(a), int(b)) for a, b in zip(low, index + reach + 1, strict=True))
    places = np.argwhere(scene.tissue[box] != Tissue.AIR) + low
    away = np.linalg.norm((places - index) * scene.volume.spacing, axis=1)
    near = f"the nearest tissue is {away.min():.1f} mm away" if away.size else "there is no tissue within 20 mm"
    raise CaseError(f"{name}: ({words}) mm lies in air, {near}; put it into the bone or soft tissue to be removed")


def require_entry(scene: NasalScene, side: str) -> EntryRegion:
    """The entry region of one side.

    Raises
    ------
    CaseError
        If the side is none, or its nostril was not found.
    """
    _check_side(side)
    if side in scene.entries:
        return scene.entries[side]
    others = " and ".join(sorted(scene.entries)) or "none"
    raise CaseError(
        f"the {side} nostril was not found (found: {others}); give entry_{side} as a mask or a box, or plan the other side"
    )


def _check_side(side: str) -> None:
    if side not in SIDES:
        raise CaseError(f"side {side!r} is none; choose left or right")


def _apex(orbit: BoolArray) -> FloatArray:
    """Middle of the rearmost part of an orbit, [up, back, left]."""
    rearmost = int(np.flatnonzero(orbit.any(axis=(0, 2)))[-1])
    up, left = np.argwhere(orbit[:, rearmost]).mean(axis=0)
    return np.array([up, rearmost, left])


def _sinus_wall(tissue: np.ndarray, upright: Upright, middle: FloatArray, towards_middle: int) -> tuple[IntArray | None, float]:
    """Tissue voxel nearest to `middle` that has air towards the middle within `BEHIND` mm, and its distance in mm."""
    reach = np.ceil(NEAR / upright.spacing).astype(int)
    center = np.rint(middle).astype(int)
    low = np.maximum(center - reach, 0)
    high = np.minimum(center + reach + 1, tissue.shape)
    if np.any(low >= high):
        return None, np.inf
    steps = int(np.ceil(BEHIND / upright.spacing[2]))
    places = np.stack(np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    solid = places[tissue[tuple(places.T)] != Tissue.AIR]
    beside = np.zeros(len(solid), dtype=bool)
    for step in range(1, steps + 1):
        column = np.clip(solid[:, 2] + towards_middle * step, 0, tissue.shape[2] - 1)
        beside |= tissue[solid[:, 0], solid[:, 1], column] == Tissue.AIR
    away = np.linalg.norm((solid - middle) * upright.spacing, axis=1)
    near = beside & (away <= NEAR)
    if not near.any():
        return None, np.inf
    best = int(np.where(near, away, np.inf).argmin())
    return solid[best], float(away[best])
