"""The renal pelvis found again: from the stated middle lines and the voxels inside mesh.ply."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.hollow import Filled, lengths

SHARE = 0.85
LEADS_ON_MM = 10.0
NECK = 0.75
PARTED_MM = 0.02  # stated ways share their points up to where they part; lines of result.json have two digits


@dataclass(frozen=True, eq=False, kw_only=True)
class Pelvis:
    """What balls of `SHARE` of the largest reach before the ways' first necks.

    Attributes
    ----------
    arms : tuple of ((k, 3) float array in mm, float in mm)
        Centres of such balls and the radius of the largest; one for a bag.
    divided : float or None, mm
        Arc length at which the ways first part.
    """

    arms: tuple[tuple[FloatArray, float], ...]
    divided: float | None

    @property
    def center(self) -> FloatArray:
        """Mean of all centres, (3,) mm."""
        return np.asarray(np.concatenate([centers for centers, _ in self.arms]).mean(axis=0))

    @property
    def largest(self) -> float:
        """Radius of the largest ball, mm."""
        return max(radius for _, radius in self.arms)

    def outside(self, points: FloatArray) -> FloatArray:
        """Distance of points to what the balls reach, (n,) mm; negative in it."""
        return np.asarray(np.min([cKDTree(centers).query(points)[0] - SHARE * radius for centers, radius in self.arms], axis=0))


def pelvis_of(ways: Sequence[FloatArray], hollow: Filled) -> Pelvis:
    """The pelvis of ways that begin at the ureter's end, with an arm for each widest place that lies in no other."""
    divided = first_parting(ways)
    tops = sorted((widest(way, hollow, divided) for way in ways), key=lambda top: -top[1])
    found = Pelvis(arms=(hollow.wide(tops[0][0], SHARE),), divided=divided)
    for point, _ in tops[1:]:
        if found.outside(point[None])[0] > 0.0:
            found = Pelvis(arms=(*found.arms, hollow.wide(point, SHARE)), divided=divided)
    return found


def first_parting(ways: Sequence[FloatArray]) -> float | None:
    """Least arc length at which two ways part that both lead on, mm."""
    found = [
        (parting, min(float(lengths(one)[-1]), float(lengths(other)[-1])))
        for one, other in combinations(ways, 2)
        for parting in [together(one, other)]
    ]
    return min((parting for parting, whole in found if whole - parting >= LEADS_ON_MM), default=None)


def together(one: FloatArray, other: FloatArray) -> float:
    """Arc length up to which two ways from the same end go through the same points, mm."""
    count = min(len(one), len(other))
    apart = np.flatnonzero(np.linalg.norm(one[:count] - other[:count], axis=1) > PARTED_MM)
    return float(lengths(one)[max(int(apart[0]) - 1, 0) if len(apart) else count - 1])


def widest(way: FloatArray, hollow: Filled, divided: float | None) -> tuple[FloatArray, float]:
    """The deepest point of a way before it has, past the parting, become narrower than `NECK` of that; and its depth, mm."""
    best, deepest = way[0], -np.inf
    for point, depth, s in zip(way, hollow.at(hollow.depth, way), lengths(way), strict=True):
        if divided is not None and s > divided and depth < NECK * deepest:
            break
        if depth > deepest:
            best, deepest = point, float(depth)
    return best, deepest
