"""The hollow inside a mesh by the verifier's own means: filled voxels, their depth, and cross-sections by rays in a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray

STEP_MM = 0.5
# The grid is put off the mesh's own by an odd share, so that no line runs along an edge.
OFF = np.array([0.377, 0.311, 0.423])
RAYS = 60


@dataclass(frozen=True, eq=False, kw_only=True)
class Filled:
    """The inside of a closed mesh on a grid.

    Attributes
    ----------
    depth : (nx, ny, nz) float array, mm
        Distance of each voxel's centre to the nearest outside, half a voxel taken off; 0 outside.
    origin : (3,) float array, mm
        Centre of the first voxel.
    """

    depth: FloatArray
    origin: FloatArray

    def at(self, values: FloatArray, points: FloatArray) -> FloatArray:
        """Values on the grid at points, (n,), linear between voxels."""
        return np.asarray(ndimage.map_coordinates(values, ((points - self.origin) / STEP_MM).T, order=1, mode="nearest"))

    def wide(self, near: FloatArray, share: float) -> tuple[FloatArray, float]:
        """Centres of balls of `share` of the largest one, joined with it around a place, (k, 3) mm; its radius, mm."""
        peak = np.clip(np.rint((near - self.origin) / STEP_MM).astype(int), 0, np.array(self.depth.shape) - 1)
        while True:
            deepest = float(self.depth[tuple(peak)])
            large = self.depth >= share * deepest
            index = np.argwhere(large)
            low = index.min(axis=0)
            box = tuple(slice(begin, end + 1) for begin, end in zip(low, index.max(axis=0), strict=True))
            labels, _ = ndimage.label(large[box])
            joined = low + np.argwhere(labels == labels[tuple(peak - low)])
            top = joined[self.depth[tuple(joined.T)].argmax()]
            if self.depth[tuple(top)] <= deepest:
                return self.origin + STEP_MM * joined, deepest
            peak = top


def filled(corners: FloatArray) -> Filled:
    """Fill a closed mesh, (m, 3, 3) mm, by the parity of the crossings of lines along x."""
    low = corners.min(axis=(0, 1)) - 2.0 * STEP_MM + STEP_MM * OFF
    shape = np.ceil((corners.max(axis=(0, 1)) - low) / STEP_MM).astype(int) + 3
    flips = np.zeros(tuple(shape), dtype=bool)
    scaled = (corners - low) / STEP_MM
    first = np.floor(scaled[:, :, 1:].min(axis=1)).astype(int) + 1
    span = np.floor(scaled[:, :, 1:].max(axis=1)).astype(int) - first + 1  # lines in y and z that may meet the face
    for rows in np.split(np.argsort(span.max(axis=1)), np.flatnonzero(np.diff(np.sort(span.max(axis=1)))) + 1):
        reach = span[rows].max(axis=0)
        for j, k in np.ndindex(max(int(reach[0]), 0), max(int(reach[1]), 0)):
            line = first[rows] + (j, k)
            met, x = crossings(scaled[rows], line.astype(float))
            sites = np.column_stack([np.ceil(x[met]).astype(int), line[met]])
            np.logical_xor.at(flips, tuple(sites.T), True)
    inside = np.logical_xor.accumulate(flips, axis=0)
    depth = np.maximum(ndimage.distance_transform_edt(inside) - 0.5, 0.0) * STEP_MM
    return Filled(depth=depth, origin=low)


def crossings(triangles: FloatArray, line: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether the i-th line along x, through (y, z), meets the i-th triangle, and at which x."""
    a, b, c = (triangles[:, k] for k in range(3))
    area = cross(b - a, c - a)
    share_b, share_c = cross(line_from(a, line), c - a), cross(b - a, line_from(a, line))
    whole = np.where(area != 0.0, area, 1.0)
    share_b, share_c = share_b / whole, share_c / whole
    met = (area != 0.0) & (share_b >= 0.0) & (share_c >= 0.0) & (share_b + share_c <= 1.0)
    x = a[:, 0] + np.where(met, share_b, 0.0) * (b - a)[:, 0] + np.where(met, share_c, 0.0) * (c - a)[:, 0]
    return met, np.asarray(x)


def line_from(corner: FloatArray, line: FloatArray) -> FloatArray:
    """Vectors from corners to lines, with any x, (n, 3)."""
    return np.column_stack([np.zeros(len(line)), line - corner[:, 1:]])


def cross(one: FloatArray, other: FloatArray) -> FloatArray:
    """Cross product of vectors seen along x, (n,)."""
    return np.asarray(one[:, 1] * other[:, 2] - one[:, 2] * other[:, 1])


class Planes:
    """Cross-sections of a mesh, (m, 3, 3) mm: how far the wall is from a place in every direction of a plane."""

    def __init__(self, corners: FloatArray) -> None:
        self._corners = corners
        centers = corners.mean(axis=1)
        self._size = float(np.linalg.norm(corners - centers[:, None], axis=2).max())
        self._tree = cKDTree(centers)

    def radii(self, point: FloatArray, normal: FloatArray, reach: float = 30.0) -> FloatArray | None:
        """Distance to the first wall on `RAYS` rays, (RAYS,) mm; None where one of them meets none."""
        faces = self._corners[self._tree.query_ball_point(point, reach + self._size)] - point
        first, second = np.linalg.svd(normal[None])[2][1:]
        height = faces @ (normal / np.linalg.norm(normal))
        cut = (height.min(axis=1) < 0.0) & (height.max(axis=1) >= 0.0)
        ends: tuple[list[FloatArray], list[FloatArray]] = ([], [])
        for face, rise in zip(faces[cut], height[cut], strict=True):
            places = [
                face[i] + rise[i] / (rise[i] - rise[j]) * (face[j] - face[i])
                for i, j in ((0, 1), (1, 2), (2, 0))
                if (rise[i] >= 0.0) != (rise[j] >= 0.0)
            ]
            for k in range(2):
                ends[k].append(places[k])
        if not ends[0]:
            return None
        begin, end = (np.column_stack([np.array(side) @ first, np.array(side) @ second]) for side in ends)
        turn = 2.0 * np.pi * np.arange(RAYS) / RAYS
        ray = np.column_stack([np.cos(turn), np.sin(turn)])
        along = end - begin
        with np.errstate(divide="ignore", invalid="ignore"):
            below = ray[:, :1] * along[:, 1] - ray[:, 1:] * along[:, 0]
            away = (begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]) / below
            share = (begin[:, 0] * ray[:, 1:] - begin[:, 1] * ray[:, :1]) / below
        found = np.where((share >= -1e-9) & (share <= 1.0 + 1e-9) & (away > 0.0), away, np.inf).min(axis=1)
        return found if np.isfinite(found).all() else None

    def diameters(self, line: FloatArray, places: FloatArray) -> FloatArray:
        """Diameters of the circles of the sections' areas at arc lengths of a line, (k,) mm; places without one left out."""
        found = []
        for s in places:
            radii = self.radii(at(line, s), at(line, s + 1.5) - at(line, s - 1.5))
            if radii is not None:
                found.append(float(np.sqrt((radii * np.roll(radii, 1)).sum() * np.sin(2.0 * np.pi / RAYS) * 2.0 / np.pi)))
        return np.array(found)

    def chords(self, line: FloatArray, places: FloatArray) -> FloatArray:
        """Median chords through a line's places, (k,) mm."""
        found = []
        for s in places:
            radii = self.radii(at(line, s), at(line, s + 1.5) - at(line, s - 1.5))
            if radii is not None:
                found.append(float(np.median(radii[: RAYS // 2] + radii[RAYS // 2 :])))
        return np.array(found)


def lengths(line: FloatArray) -> FloatArray:
    """Arc length at the vertices of a polyline, (n,) mm."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def at(line: FloatArray, s: float) -> FloatArray:
    """Point of a polyline at an arc length, (3,) mm; beyond an end, the end."""
    along = lengths(line)
    return np.array([np.interp(s, along, line[:, k]) for k in range(3)])
