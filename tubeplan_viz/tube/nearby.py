"""Wall around samples of a path: the faces that could be the nearest ones, each as a plane."""

# Strategy: the nearest faces of a sample are asked for anew whenever the path moves; those in directions
# across the path, which become nearest only after a long move, once it has moved by a share of its clearance.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.geometry import WallDistance, across

# Directions around the path in which wall is looked for, and how far out from it, as a
# share of the clearance: far enough that the nearest face lies in that direction.
DIRECTIONS = 12
PROBE = 0.7
NEAREST = 6
# Share of its clearance by which a sample may move before wall is looked for around it again.
MOVED = 0.1


@dataclass(frozen=True, eq=False)
class Nearby:
    """Faces of the wall around samples of the path.

    Attributes
    ----------
    faces : (m, k) int array
        The nearest `NEAREST` first, then those found around the sample.
    anchor : (m, 3) float array, mm
        Where each sample lay when wall was looked for around it.
    reach : (m,) float array, mm
        How far from there that serves.
    """

    faces: IntArray
    anchor: FloatArray
    reach: FloatArray

    def outgrown(self, points: FloatArray) -> BoolArray:
        """Which samples have moved too far from their anchors."""
        return np.asarray(np.linalg.norm(points - self.anchor, axis=1) > self.reach)


@dataclass(frozen=True, eq=False)
class WallRows:
    """Wall points around samples of the path and their distances.

    Attributes
    ----------
    sample : (r,) int array
        The sample that each row belongs to.
    normal : (r, 3) float array
        Unit vector from the wall point to the sample.
    distance : (r,) float array, mm
    clearance : (m,) float array, mm
        Least distance of each sample.
    nearby : Nearby
        What was found for each sample.
    """

    sample: IntArray
    normal: FloatArray
    distance: FloatArray
    clearance: FloatArray
    nearby: Nearby

    def telling(self, share: float) -> tuple[IntArray, FloatArray, FloatArray]:
        """Sample, normal and distance of the planes that can be the nearest one while no sample moves by more than `share`
        of its clearance.

        Plane i lies beyond plane j on the whole ball of radius r when its distance is the larger one by r |n_i - n_j|.
        """
        near = np.flatnonzero(self.distance <= self.clearance[self.sample] * (1.0 + 2.0 * share))
        near = near[np.lexsort((self.distance[near], self.sample[near]))]
        sample, normal, distance = self.sample[near], self.normal[near], self.distance[near]
        count = np.bincount(sample, minlength=len(self.clearance))
        place = np.arange(len(sample)) - (np.cumsum(count) - count)[sample]
        table = np.full((len(count), int(count.max())), np.inf)
        table[sample, place] = distance
        normals = np.zeros((*table.shape, 3))
        normals[sample, place] = normal
        beyond = np.zeros(len(sample), dtype=bool)
        # The planes of a sample stand in the order of their distances: one is hidden by nearer ones alone.
        for j in range(table.shape[1] - 1):
            later = np.flatnonzero((place > j) & ~beyond)
            apart = np.linalg.norm(normal[later] - normals[sample[later], j], axis=1)
            reach = share * self.clearance[sample[later]]
            beyond[later] = distance[later] - table[sample[later], j] >= reach * apart
        return sample[~beyond], normal[~beyond], distance[~beyond]

    def with_samples(self, others: WallRows, place: IntArray) -> WallRows:
        """The same with the samples of `others` put in before those at `place`, (k,) ascending, as `np.insert` would."""
        m, k = len(self.clearance), len(place)
        theirs = place + np.arange(k)
        ours = np.setdiff1d(np.arange(m + k), theirs)
        nearby = Nearby(
            np.insert(self.nearby.faces, place, others.nearby.faces, axis=0),
            np.insert(self.nearby.anchor, place, others.nearby.anchor, axis=0),
            np.insert(self.nearby.reach, place, others.nearby.reach),
        )
        return WallRows(
            np.concatenate([ours[self.sample], theirs[others.sample]]),
            np.concatenate([self.normal, others.normal]),
            np.concatenate([self.distance, others.distance]),
            np.insert(self.clearance, place, others.clearance),
            nearby,
        )


def wall_rows(
    points: FloatArray, tangents: FloatArray, wall: WallDistance, *, known: WallRows | None = None, more: IntArray | None = None
) -> WallRows:
    """The nearest faces of each point, those in `DIRECTIONS` directions across the path, and those found before.

    All are faces of the wall and their distances exact; that none nearer was missed is left
    to the certificate.

    Parameters
    ----------
    points, tangents : (m, 3) float array, mm
    wall : WallDistance
    known : WallRows, optional
        Of the same samples on a path near by: their faces count too, and where a sample has not
        moved far since wall was last looked for around it, they are not looked for again.
    more : (m, k) int array, optional
        Further faces to count for each sample.
    """
    triangles = wall.triangles
    near = triangles.likely_nearest(points, NEAREST)
    gap = np.linalg.norm(points[:, None] - _closest(wall, points, near), axis=2).min(axis=1)
    if known is None:
        around = faces_around(points, tangents, gap, wall)
        nearby = Nearby(np.concatenate([near, around], axis=1), points, MOVED * gap)
        found = nearby.faces
    else:
        before = known.nearby
        faces, anchor, reach = np.concatenate([near, before.faces[:, near.shape[1] :]], axis=1), before.anchor, before.reach
        far = np.flatnonzero(before.outgrown(points))
        if len(far):
            faces[far, near.shape[1] :] = faces_around(points[far], tangents[far], gap[far], wall)
            anchor, reach = anchor.copy(), reach.copy()
            anchor[far], reach[far] = points[far], MOVED * gap[far]
        nearby = Nearby(faces, anchor, reach)
        found = np.concatenate([faces, before.faces], axis=1)
    return rows_of(points, found if more is None else np.concatenate([found, more], axis=1), nearby, wall)


def rows_of(points: FloatArray, faces: IntArray, nearby: Nearby, wall: WallDistance) -> WallRows:
    """The rows of the given faces (m, k) of each point; a face that is named twice has one row."""
    faces = np.sort(faces, axis=1)
    fresh = np.ones(faces.shape, dtype=bool)
    fresh[:, 1:] = faces[:, 1:] != faces[:, :-1]
    sample, column = np.nonzero(fresh)
    foot = wall.triangles.closest(points[sample], faces[sample, column])
    away = points[sample] - foot
    distance = np.linalg.norm(away, axis=1)
    clearance = np.full(len(points), np.inf)
    np.minimum.at(clearance, sample, distance)
    return WallRows(sample.astype(np.int64), away / np.maximum(distance, 1e-12)[:, None], distance, clearance, nearby)


def faces_around(points: FloatArray, tangents: FloatArray, gap: FloatArray, wall: WallDistance) -> IntArray:
    """Faces near points a share of the clearance `gap` (m,) mm away, in directions across the path: (m, DIRECTIONS)."""
    side, up = across(tangents)
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    offset = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    probes = points[:, None] + PROBE * gap[:, None, None] * offset
    return wall.triangles.likely_nearest(probes.reshape(-1, 3)).reshape(len(points), DIRECTIONS)


def _closest(wall: WallDistance, points: FloatArray, faces: IntArray) -> FloatArray:
    count = faces.shape[1]
    return wall.triangles.closest(np.repeat(points, count, axis=0), faces.ravel()).reshape(len(points), count, 3)
