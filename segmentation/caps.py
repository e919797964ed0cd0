"""Flat ends of a closed tube: recognised and told apart from wall (end caps are not wall).

A cap is a flat disc that closes the tube where a path starts or ends. It is told
from other flat-looking patches by five properties, all measured against the patch's
own size: its faces lie within the tolerance of one plane, they do not bulge (a piece
of a ball or of a cylinder does), the patch is compact, the wall outside its rim turns
away by more than 40 degrees, and nothing of the tube lies beyond its plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import SurfaceError
from segmentation.mesh import Cap, Surface
from segmentation.mesh_repair import edge_map

# Facets of a rough disc may lean: 0.05 mm over a 0.2 mm facet is 14 degrees.
FACET_COSINE = 0.85
# 4 pi A / P^2 of a disc is 1, of a square 0.79, of a strip of 1 : 6 0.38.
LEAST_COMPACTNESS = 0.5
# The wall stands at 90 degrees around a cylinder's end; a cone of half angle 30 degrees at 60.
RIM_COSINE = 0.77
# A rim facet that leans towards the disc's normal by more than this beyond the wall's own lean below the rim is chamfer, not
# wall (facets of a smooth wall scatter by less than 0.1); one that faces more outward along the axis than sideways always is.
CHAMFER_LEAN, CHAMFER_COSINE = 0.15, 0.5
LEAST_RADIUS = 0.3
# A point may lie this far inside from the end that it means: on the disc, in discs' radii.
REACH_RADII, ON_DISC = 4.0, 1.0
SEARCH_RADIUS = 30.0
CANDIDATES = 80


@dataclass(frozen=True, eq=False)
class _Patch:
    """Faces of one flat disc with its plane: indices, centre, unit outward normal, area, and radius of the same area."""

    faces: IntArray
    center: FloatArray
    normal: FloatArray
    area: float
    radius: float


def mark_flat_ends(surface: Surface, points: ArrayLike, *, tolerance: float = 0.05) -> Surface:
    """Label the flat ends of a tube at which the given points lie or end.

    Parameters
    ----------
    surface : Surface
        Faces that are caps already stay so.
    points : (n, 3) array_like, mm
        Start and goal. An end is marked when the point lies within 1 mm of the disc, or
        when the disc closes the tube before it, within four of the disc's radii along its normal.
    tolerance : float, mm
        Greatest distance of a cap's vertices from its plane: within it the end counts as flat.

    Returns
    -------
    Surface
        The same vertices and faces, with caps of origin "flat end" added and all labelled
        C1, C2, ... by falling area. The given surface itself where nothing is found.

    Raises
    ------
    SurfaceError
        If `tolerance` is not positive.
    """
    if not tolerance > 0.0:
        raise SurfaceError(f"the tolerance of flat ends is {tolerance:g} mm, expected a positive length (0.05)")
    sites = np.asarray(points, dtype=float).reshape(-1, 3)
    finder = _Finder(surface, tolerance)
    face_cap, caps = surface.face_cap.copy(), list(surface.caps)
    for site in sites:
        patch = finder.end_at(site, face_cap < 0)
        if patch is None:
            continue
        face_cap[finder.with_chamfer(patch, face_cap < 0)] = len(caps)
        caps.append(Cap("new", "flat end", patch.center, patch.normal, patch.area))
    if len(caps) == len(surface.caps):
        return surface
    order = sorted(range(len(caps)), key=lambda i: -caps[i].area)
    rank = np.empty(len(caps) + 1, dtype=np.int64)
    rank[order], rank[-1] = np.arange(len(caps)), -1
    named = tuple(replace(caps[i], label=f"C{k + 1}") for k, i in enumerate(order))
    return Surface(surface.vertices, surface.faces, rank[face_cap], named, surface.frame)


class _Finder:
    """Searches one surface for flat ends; holds what every search needs."""

    def __init__(self, surface: Surface, tolerance: float) -> None:
        self.surface, self.tolerance = surface, tolerance
        self.corners = surface.vertices[surface.faces]  # (m, 3, 3)
        self.centers = self.corners.mean(axis=1)
        self.normals, self.areas = surface.face_normals, surface.face_areas
        self.tree = cKDTree(self.centers)
        self.edges = edge_map(surface.faces)
        order = np.argsort(self.edges.of_corner, kind="stable")
        order = order[self.edges.count[self.edges.of_corner[order]] == 2]
        self.pairs = np.column_stack([order[0::2] // 3, order[1::2] // 3])  # faces that share an edge

    def end_at(self, site: FloatArray, free: BoolArray) -> _Patch | None:
        """The flat end that `site` means: on the nearest faces first, then along the normals ahead."""
        near = np.asarray(self.tree.query_ball_point(site, SEARCH_RADIUS), dtype=np.int64)
        near = near[free[near] & (self.areas[near] > 0.0)]
        allowed, tried = np.zeros(len(free), dtype=bool), np.zeros(len(free), dtype=bool)
        allowed[near] = True
        near_centers, near_normals = self.centers[near], self.normals[near]
        for seed in self._seeds(site, near):
            if tried[seed]:
                continue
            faces = self._flat_patch(seed, near, near_centers, near_normals, allowed)
            tried[seed] = True
            tried[faces] = True
            patch = self._disc(faces) if len(faces) else None
            if patch is not None and self._means(site, patch):
                return patch
        return None

    def _seeds(self, site: FloatArray, near: IntArray) -> IntArray:
        """Faces to grow discs from, the nearest first: those around the site's foot points on the surface.

        The line along a disc's normal from a point that means it meets the disc, so the
        faces around the foot of that line look away from the point.
        """
        offset = self.centers[near] - site
        distance = np.linalg.norm(offset, axis=1)
        size = np.sqrt(self.areas[near])
        across = np.linalg.norm(offset - np.einsum("ij,ij->i", offset, self.normals[near])[:, None] * self.normals[near], axis=1)
        foot = near[across <= 0.25 * distance + 1.5 * size]
        order = foot[np.argsort(np.linalg.norm(self.centers[foot] - site, axis=1), kind="stable")]
        if len(order) > CANDIDATES:  # the nearest ones, and the others thinned out evenly: a disc has many faces
            half = CANDIDATES // 2
            order = np.concatenate([order[:half], order[np.linspace(half, len(order) - 1, half).astype(int)]])
        return np.asarray(order)

    def _flat_patch(
        self, seed: int, near: IntArray, near_centers: FloatArray, near_normals: FloatArray, allowed: BoolArray
    ) -> IntArray:
        """Connected faces around a seed within the tolerance of one plane, the plane refitted three times.

        A face within the tolerance has its centre there too, so the centres leave few faces whose corners are looked at.
        """
        reach = self.tree.query_ball_point(self.centers[seed], 3.0 * np.sqrt(self.areas[seed]) + 0.4)
        around = np.asarray(reach, dtype=np.int64)
        around = around[allowed[around]]
        around = around[self.normals[around] @ self.normals[seed] > FACET_COSINE]
        if len(around) == 0:
            return around
        normal = self.areas[around] @ self.normals[around]
        normal /= np.linalg.norm(normal)
        level = float(np.average(self.centers[around] @ normal, weights=self.areas[around]))
        faces = around
        for _ in range(3):
            close = np.abs(near_centers @ normal - level) <= 1.001 * self.tolerance
            likely = np.flatnonzero(close & (near_normals @ normal > FACET_COSINE))
            height = self.corners[near[likely]] @ normal - level
            flat = near[likely[np.abs(height).max(axis=1) <= self.tolerance]]
            faces = self._connected(flat, seed)
            if len(faces) < 3:
                return faces[:0]
            normal, level = self._fit(faces, normal)
        return faces

    def _connected(self, faces: IntArray, seed: int) -> IntArray:
        inside = np.zeros(len(self.areas), dtype=bool)
        inside[faces] = True
        if not inside[seed]:
            return faces[:0]
        place = np.empty(len(self.areas), dtype=np.int64)
        place[faces] = np.arange(len(faces))
        pairs = place[self.pairs[inside[self.pairs[:, 0]] & inside[self.pairs[:, 1]]]]
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(faces),) * 2)
        _, label = connected_components(graph, directed=False)
        return faces[label == label[place[seed]]]

    def _fit(self, faces: IntArray, toward: FloatArray) -> tuple[FloatArray, float]:
        """Area-weighted plane through the faces' vertices: unit normal on the side of `toward`, and its level."""
        sites, weights = self.corners[faces].reshape(-1, 3), np.repeat(self.areas[faces], 3)
        center = np.average(sites, axis=0, weights=weights)
        _, vectors = np.linalg.eigh(((sites - center).T * weights) @ (sites - center))
        normal = vectors[:, 0] * (1.0 if vectors[:, 0] @ toward > 0.0 else -1.0)
        return normal, float(center @ normal)

    def _disc(self, faces: IntArray) -> _Patch | None:
        """The patch as a tube's end, or None if it bulges, is no disc, has a soft rim or the tube goes on beyond."""
        areas, centers = self.areas[faces], self.centers[faces]
        area = float(areas.sum())
        radius = float(np.sqrt(area / np.pi))
        normal, level = self._fit(faces, areas @ self.normals[faces])
        center = np.average(centers, axis=0, weights=areas)
        if radius < LEAST_RADIUS:
            return None
        inside = np.zeros(len(self.areas), dtype=bool)
        inside[faces] = True
        rim = self.pairs[inside[self.pairs].sum(axis=1) == 1]
        rim_edges = self._shared_edges(inside)
        perimeter = float(
            np.linalg.norm(self.surface.vertices[rim_edges[:, 0]] - self.surface.vertices[rim_edges[:, 1]], axis=1).sum()
        )
        if len(rim) == 0 or 4.0 * np.pi * area < LEAST_COMPACTNESS * perimeter**2:
            return None
        if self._sag(faces, center, normal, radius) > 0.5 * self.tolerance:
            return None
        if not self._sharp(center, normal, level, radius, inside):
            return None
        close = self.tree.query_ball_point(center, 1.5 * radius)
        beyond = self.corners[close] @ normal - level
        if float(beyond.max()) > 2.0 * self.tolerance:
            return None
        return _Patch(faces, center, normal, area, radius)

    def _shared_edges(self, inside: BoolArray) -> IntArray:
        """Vertex pairs of the edges between the faces inside and the others."""
        count = np.bincount(self.edges.of_corner, weights=np.repeat(inside, 3), minlength=len(self.edges.ends))
        return self.edges.ends[(count > 0) & (count < self.edges.count)]

    def _sag(self, faces: IntArray, center: FloatArray, normal: FloatArray, radius: float) -> float:
        """By how much the best quadratic through the patch leaves its plane over one radius, mm."""
        corners = self.corners[faces] - center
        middles = 0.5 * (corners + np.roll(corners, 1, axis=1))  # with the centroids: exact for quadratics on each face
        sites = np.concatenate([middles.reshape(-1, 3), corners.mean(axis=1)])
        weights = np.sqrt(np.concatenate([np.repeat(self.areas[faces], 3), self.areas[faces]]))
        u = np.linalg.svd(normal[None])[2][1:]  # two directions across the normal
        x, y = sites @ u[0], sites @ u[1]
        terms = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
        c = np.linalg.lstsq(terms * weights[:, None], (sites @ normal) * weights, rcond=None)[0]
        bend = np.linalg.eigvalsh(np.array([[c[3], 0.5 * c[4]], [0.5 * c[4], c[5]]]))
        return float(np.abs(bend).max() * radius**2)

    def _sharp(self, center: FloatArray, normal: FloatArray, level: float, radius: float, inside: BoolArray) -> bool:
        """Whether the wall just outside the rim stands across the disc, all around.

        Looked at between 0.15 and 0.7 radii below the plane, past the chamfer of one voxel
        that marching cubes leave, in twelve sectors.
        """
        near = np.asarray(self.tree.query_ball_point(center, 2.0 * radius + 1.0), dtype=np.int64)
        near = near[~inside[near]]
        depth = level - self.centers[near] @ normal
        deepest = level - (self.corners[near] @ normal).min(axis=1)
        offset = self.centers[near] - center
        across = offset - np.outer(offset @ normal, normal)
        chosen = (deepest > 0.15 * radius) & (depth < max(0.7 * radius, 0.6)) & (np.linalg.norm(across, axis=1) < 1.8 * radius)
        near, across = near[chosen], across[chosen]
        if len(near) == 0:
            return False
        u = np.linalg.svd(normal[None])[2][1:]
        sector = np.floor((np.arctan2(across @ u[1], across @ u[0]) / (2.0 * np.pi) + 0.5) * 12.0).astype(int) % 12
        weight = np.bincount(sector, weights=self.areas[near], minlength=12)
        lean = np.bincount(sector, weights=self.areas[near] * (self.normals[near] @ normal), minlength=12)
        filled = weight > 0.0
        return bool(filled.sum() >= 3 and np.all(lean[filled] < RIM_COSINE * weight[filled]))

    def _means(self, site: FloatArray, patch: _Patch) -> bool:
        """Whether the point lies on the disc or, inside, before it."""
        offset = site - patch.center
        height = float(offset @ patch.normal)
        across = float(np.linalg.norm(offset - height * patch.normal))
        rim = max(float(np.linalg.norm(self.corners[patch.faces].reshape(-1, 3) - patch.center, axis=1).max()), patch.radius)
        on_disc = abs(height) <= ON_DISC and across <= rim + ON_DISC
        before = -REACH_RADII * patch.radius <= height <= ON_DISC and across <= rim
        return bool(on_disc or before)

    def with_chamfer(self, patch: _Patch, free: BoolArray) -> IntArray:
        """The patch with the slivers of its rim: facets between disc and wall, within one facet's size of the plane."""
        edge = float(np.median(np.linalg.norm(self.corners[patch.faces] - np.roll(self.corners[patch.faces], 1, axis=1), axis=2)))
        width = min(1.5 * edge, 0.5 * patch.radius)
        level = float(patch.center @ patch.normal)
        rim = float(np.linalg.norm(self.corners[patch.faces].reshape(-1, 3) - patch.center, axis=1).max())
        near = np.asarray(self.tree.query_ball_point(patch.center, rim + 3.0 * width), dtype=np.int64)
        near = near[free[near]]
        depth = level - self.corners[near] @ patch.normal
        wall = near[(depth.min(axis=1) > width) & (depth.max(axis=1) < 3.0 * width)]
        areas = self.areas[wall]
        lean = float(areas @ (self.normals[wall] @ patch.normal) / areas.sum()) if len(wall) else CHAMFER_COSINE
        shallow = (depth.max(axis=1) <= width) & (
            np.linalg.norm(self.corners[near] - patch.center, axis=2).max(axis=1) <= rim + width
        )
        leaning = self.normals[near] @ patch.normal > min(lean + CHAMFER_LEAN, CHAMFER_COSINE)
        pool = np.union1d(patch.faces, near[shallow & leaning])
        whole = self._connected(pool, int(patch.faces[0]))
        # Slivers without a direction of their own, all of whose vertices belong to the cap by now.
        on_cap = np.zeros(len(self.surface.vertices), dtype=bool)
        on_cap[self.surface.faces[whole]] = True
        sliver = near[shallow & on_cap[self.surface.faces[near]].all(axis=1)]
        return np.union1d(whole, sliver)
