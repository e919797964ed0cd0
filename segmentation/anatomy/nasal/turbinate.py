"""The inferior turbinates: what hangs from the lateral wall into the lower half of each airway of the nose.

Strategy: the airway beside the septum is followed along the floor of the nose. In each coronal slice it reaches the lateral
wall below the turbinate, in the inferior meatus, which gives the wall. Tissue between septum and wall that air surrounds
from below, medially and above is the turbinate, up to the height at which it is thinnest: there the middle meatus parts
it from what lies above.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.anatomy.nasal import solids
from segmentation.anatomy.nasal.scene import SIDES
from segmentation.arrays import BoolArray, FloatArray, IntArray, VoxelArray

TISSUE_MIN = -300.0
"""Between mucosa and the air of narrow clefts, HU."""
MEATUS = 14.0
"""Height above the floor in which the airway is looked for, mm: the sinus opens into the nose above it."""
HALF_WIDTH_MAX = 22.0
"""Farthest lateral wall from the plane of symmetry, mm."""
HALF_WIDTH_MIN = 7.0
"""Nearest one; where the airway ends before it the wall is taken from the slices around, mm."""
REAR = 6.0
"""How far a turbinate reaches behind the septum's lower end, mm."""
TOP = (9.0, 26.0)
"""Between these heights above the floor a turbinate ends, mm."""
UNDER = 3.0
"""How far below the line through the lowest air the floor may lie, mm: a turbinate may rest on it."""
BEFORE = 4.0
"""How far the turbinate's head reaches before the bony aperture, mm."""
THIN = 1.5
"""Half the thickness of the mucosa of wall and floor, which is no turbinate, mm."""
BONE_MIN, LEAF = 250.0, 1.2
"""Bone, HU, and half the thickness beyond which it is no leaf, mm."""
VOLUME = (1.0, 12.0)
"""An inferior turbinate with its mucosa, ml."""
LENGTH = (30.0, 60.0)
"""Its length, mm."""


@dataclass(frozen=True, eq=False)
class Turbinate:
    """One inferior turbinate in a box of voxels.

    Attributes
    ----------
    mask : (up, back, left) bool array
    length : float, mm
    millilitres : float
    bordered : float
        Share of its surface that borders on air.
    """

    mask: BoolArray
    length: float
    millilitres: float
    bordered: float

    @property
    def confidence(self) -> float:
        """Share of the surface that is seen against air, less where length or volume are unlike a turbinate's."""
        return min(self.bordered / 0.6, 1.0) * _within(self.length, LENGTH) * _within(self.millilitres, VOLUME)


def _within(value: float, limits: tuple[float, float]) -> float:
    """1 inside the limits, falling with the ratio outside."""
    return min(1.0, value / limits[0], limits[1] / max(value, 1e-9))


def find_turbinates(
    hu: VoxelArray,
    inside: BoolArray,
    across: FloatArray,
    spacing: FloatArray,
    *,
    septum: BoolArray,
    choana: float,
    front: int,
    seeds: Mapping[str, FloatArray] | None = None,
) -> dict[str, Turbinate]:
    """The inferior turbinates in a box about the nose; a side without one is absent.

    Parameters
    ----------
    hu : (up, back, left) int16 array, HU
    inside : (up, back, left) bool array
        The head with its nostrils closed.
    across : (up, back, left) float array, mm
        Distance from the plane of symmetry, growing to the left.
    spacing : (3,) float array, mm
    septum : (up, back, left) bool array
    choana : float
        Index along back of the septum's lower rear end.
    front : int
        Index along back from where on the cavity is looked at: the rear edge of the nostrils.
    seeds : mapping of side to (3,) float array, optional
        A place in the turbinate, [up, back, left]; otherwise the largest body of tissue is taken.
    """
    rear = round(choana)
    if rear - front < LENGTH[0] / 2 / spacing[1]:
        return {}
    air = (hu <= TISSUE_MIN) & inside & (np.abs(across) <= HALF_WIDTH_MAX) & ~septum
    height = _height(air, across, spacing, front, rear)
    low = air & (height <= MEATUS)
    low[:, rear + 1 :] = False
    labels, count = ndimage.label(low)
    touched = np.bincount(labels[ndimage.binary_dilation(septum, iterations=2)], minlength=count + 1)
    touched[0] = 0
    airway = np.isin(labels, np.flatnonzero(touched * spacing.prod() > 50.0))
    # The turbinate's own bone is a thin leaf, that of wall and floor is not.
    solid = solids.opened(hu > BONE_MIN, LEAF, spacing)
    tissue = (hu > TISSUE_MIN) & ~septum & ~solid & (height > -UNDER)
    tissue[:, :front] = False
    tissue[:, rear + 1 + round(REAR / float(spacing[1])) :] = False
    palate = slice(rear + 1 - round(REAR / float(spacing[1])), None)  # soft there, where bone does not bound the floor
    tissue[:, palate] &= height[:, palate] > 1.0
    sides = {}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        lateral = sign * across
        wall = _wall(airway, lateral, spacing, front, rear)
        if wall is not None:
            part = tissue & (lateral <= wall[None, :, None] + 0.5 * spacing[2]) & _beside(septum, sign)
            part[:, : _aperture(hu, lateral, height, wall, spacing)] = False
            sides[side] = part
    if not sides:
        return {}
    both = np.any(list(sides.values()), axis=0)
    top = _meatus(both, height, spacing)
    bodies = {
        side: _body(part & (height <= top[None, :, None]), hu, spacing, None if seeds is None else seeds.get(side))
        for side, part in sides.items()
    }
    return {side: body for side, body in bodies.items() if body is not None}


def _height(air: BoolArray, across: FloatArray, spacing: FloatArray, front: int, rear: int) -> FloatArray:
    """Height above the floor of the nose, mm: a straight line through the lowest air near the septum of each coronal slice."""
    places, lowest = [], []
    for back in range(front, rear + 1):
        rows = np.flatnonzero((air[:, back] & (np.abs(across[:, back]) < 10.0)).any(axis=1))
        if rows.size:
            places.append(float(back))
            lowest.append(float(rows[0]))
    middle = slice(len(places) // 6, len(places) - len(places) // 6)  # nostril sill and choana left out
    slope, start = np.polyfit(places[middle], lowest[middle], 1)
    floor = start + slope * np.arange(air.shape[1])
    return np.asarray((np.arange(air.shape[0])[:, None] - floor + 0.5)[:, :, None] * spacing[0])


def _wall(airway: BoolArray, lateral: FloatArray, spacing: FloatArray, front: int, rear: int) -> FloatArray | None:
    """Distance of the lateral wall from the plane of symmetry in each coronal slice, mm; None where too little of it is seen."""
    far = np.array([float(lateral[:, k][airway[:, k]].max(initial=0.0)) for k in range(airway.shape[1])])
    places = np.arange(len(far))
    known = np.flatnonzero((far >= HALF_WIDTH_MIN) & (places >= front) & (places <= rear))
    if known.size * spacing[1] < LENGTH[0] / 2:
        return None
    # The meatus is cut off here and there: the wall is where it reaches farthest within 4 mm.
    return np.asarray(ndimage.maximum_filter1d(np.interp(places, known, far[known]), 2 * int(4.0 / spacing[1]) + 1))


def _beside(septum: BoolArray, sign: float) -> BoolArray:
    """Voxels on one side of the septum; where a line does not meet it, of its nearest part."""
    columns = np.arange(septum.shape[2])
    met = septum.any(axis=2)
    edge = np.where(met, septum.shape[2] - 1 - septum[:, :, ::-1].argmax(axis=2) if sign > 0.0 else septum.argmax(axis=2), 0)
    nearest: IntArray = ndimage.distance_transform_edt(~met, return_distances=False, return_indices=True)
    side = edge[tuple(nearest)][:, :, None]
    return np.asarray(columns > side if sign > 0.0 else columns < side)


def _aperture(hu: VoxelArray, lateral: FloatArray, height: FloatArray, wall: FloatArray, spacing: FloatArray) -> int:
    """Index along back at which the nose begins to have bone beside it, less how far the turbinate reaches before it."""
    beside = (hu > BONE_MIN) & (lateral > wall[None, :, None] - 4.0) & (lateral < wall[None, :, None] + 8.0)
    level = (height > 3.0) & (height <= 12.0)
    share = (beside & level).any(axis=2).sum(axis=0) / np.maximum(level[:, :, 0].sum(axis=0), 1)
    bony = np.flatnonzero(share >= 0.6)
    return max(int(bony[0] - round(BEFORE / float(spacing[1]))), 0) if bony.size else lateral.shape[1]


def _meatus(tissue: BoolArray, height: FloatArray, spacing: FloatArray) -> FloatArray:
    """Height of the middle meatus above the floor in each coronal slice, mm: where the slices around hold least tissue."""
    levels = np.arange(TOP[0], TOP[1], spacing[0])
    area = np.array(
        [np.count_nonzero(tissue & (height > level) & (height <= level + spacing[0]), axis=(0, 2)) for level in levels],
        dtype=float,
    )
    area = ndimage.gaussian_filter(area, (1.5 / spacing[0], 4.0 / spacing[1]))
    return np.asarray(ndimage.gaussian_filter1d(levels[area.argmin(axis=0)] + 0.5 * spacing[0], 4.0 / spacing[1]))


def _body(tissue: BoolArray, hu: VoxelArray, spacing: FloatArray, seed: FloatArray | None) -> Turbinate | None:
    bodies = solids.opened(tissue, THIN, spacing)
    body = solids.largest(bodies) if seed is None else solids.near(bodies, seed, 5.0, spacing)
    if not body.any():
        return None
    for plane in range(body.shape[1]):  # the bone's leaf was left out where it is thick
        body[:, plane] = ndimage.binary_fill_holes(body[:, plane]) & (hu[:, plane] > TISSUE_MIN)
    there = np.flatnonzero(body.any(axis=(0, 2)))
    surface = body & ~ndimage.binary_erosion(body)
    bare = ndimage.binary_dilation(hu <= TISSUE_MIN) & surface
    return Turbinate(
        body,
        float((there[-1] - there[0] + 1) * spacing[1]),
        float(np.count_nonzero(body) * spacing.prod() / 1000.0),
        float(np.count_nonzero(bare) / np.count_nonzero(surface)),
    )
