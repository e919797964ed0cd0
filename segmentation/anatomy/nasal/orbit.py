"""What the orbits hold: eye, fat, muscles and nerve, between bone on four sides, in front of the brain.

Strategy: a voxel lies in an orbit if lines upwards, downwards, to the middle and to the side soon meet bone or a sinus.
A ball rolled through such soft tissue reaches all of an orbit and does not pass its fissures; of the spaces it reaches,
the orbit is the one with a likely volume. In front the eye looks out between the rims: there three walls are enough, near
what has four.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.anatomy.nasal import solids
from segmentation.anatomy.nasal.scene import SIDES
from segmentation.arrays import BoolArray, FloatArray, IntArray, VoxelArray

BALL = 2.5
"""Radius, mm: superior and inferior orbital fissure are narrower than twice that where they leave the orbit."""
BEFORE = 6.0
"""How far the eye is followed out from between the rims, mm."""
CORE = 6.0
"""Radius of a ball that fits into an orbit but into few other spaces between bones, mm."""
LOOK = 40.0
"""Farthest wall on either side, mm; an orbit is about 40 mm wide and 35 mm high."""
WALL_MIN = 120.0
"""Thin walls share their voxels with fat and air, HU."""
AIR_MAX = -300.0
VOLUME = (18.0, 38.0)
"""Content of one orbit, adults, ml."""
LATERAL = (14.0, 48.0)
"""How far from the plane of symmetry its middle may lie, mm."""


@dataclass(frozen=True, eq=False)
class Orbit:
    """The content of one orbit in a box of voxels.

    Attributes
    ----------
    mask : (up, back, left) bool array
    millilitres : float
    apex : (3,) int array
        Its rearmost part, [up, back, left].
    """

    mask: BoolArray
    millilitres: float
    apex: IntArray

    @property
    def confidence(self) -> float:
        """1 for a likely volume, less outside of it."""
        return min(1.0, self.millilitres / VOLUME[0], VOLUME[1] / max(self.millilitres, 1e-9))


def find_orbits(
    hu: VoxelArray,
    inside: BoolArray,
    brain: BoolArray | None,
    across: FloatArray,
    spacing: FloatArray,
    *,
    seeds: Mapping[str, FloatArray] | None = None,
) -> dict[str, Orbit]:
    """The orbits in a box about the face; a side without one is absent.

    Parameters
    ----------
    hu : (up, back, left) int16 array, HU
    inside : (up, back, left) bool array
        The head with its nostrils closed.
    brain : (up, back, left) bool array, optional
    across : (up, back, left) float array, mm
        Distance from the plane of symmetry, growing to the left.
    spacing : (3,) float array, mm
    seeds : mapping of side to (3,) float array, optional
        A place in the orbit, [up, back, left].
    """
    seeds = seeds or {}
    wall = hu >= WALL_MIN
    if brain is not None:
        wall |= brain
    stop = wall | ((hu <= AIR_MAX) & inside)
    reach = [int(LOOK / step) for step in spacing]
    walls = [_meets(stop, axis, way * reach[axis]) for axis in (0, 2) for way in (1, -1)]
    count = np.sum(walls, axis=0)
    room = solids.opened(inside & ~stop & (count == 4), BALL, spacing)
    wide = solids.opened(inside & ~stop & (count >= 3), BALL, spacing)
    depth = np.zeros(hu.shape)
    box = solids.box_of(room, 2.0, spacing) if room.any() else (slice(0),) * 3
    depth[box] = ndimage.distance_transform_edt(room[box], sampling=spacing)
    found = {}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        lateral = sign * across
        deep = (depth > CORE) & (lateral > LATERAL[0]) & (lateral < LATERAL[1])
        cores = [solids.near(deep, seeds[side], 2.0 * CORE, spacing)] if side in seeds else solids.parts(deep)[:4]
        best: Orbit | None = None
        for core in filter(np.any, cores):
            orbit = _orbit(room & (lateral > 5.0), wide & (lateral > 5.0), core, spacing)
            if best is None or orbit.confidence > best.confidence:
                best = orbit
        if best is not None:
            found[side] = best
    return found


def _meets(stop: BoolArray, axis: int, reach: int) -> BoolArray:
    """Voxels from which a line along the axis meets a wall within `reach` voxels, forwards or (negative) backwards."""
    flipped = np.flip(stop, axis) if reach < 0 else stop
    count = np.cumsum(flipped, axis=axis, dtype=np.int16)
    ahead = np.take(count, np.minimum(np.arange(stop.shape[axis]) + abs(reach), stop.shape[axis] - 1), axis=axis)
    meets = ahead > count
    return np.flip(meets, axis) if reach < 0 else meets


def _orbit(room: BoolArray, wide: BoolArray, core: BoolArray, spacing: FloatArray) -> Orbit:
    mask = solids.holding(room, np.argwhere(core)[0])
    mask |= solids.grown(mask, BEFORE, spacing) & wide
    mask = solids.largest(solids.opened(mask, BALL, spacing))
    rearmost = int(np.flatnonzero(mask.any(axis=(0, 2)))[-1])
    places = np.argwhere(mask[:, rearmost])
    middle = places[np.abs(places - places.mean(axis=0)).sum(axis=1).argmin()]
    return Orbit(mask, float(np.count_nonzero(mask) * spacing.prod() / 1000.0), np.array([middle[0], rearmost, middle[1]]))
