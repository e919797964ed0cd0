"""The Voronoi diagram of the wall inside the lumen, as a weighted graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import Delaunay

from segmentation.arrays import FloatArray, IntArray, frozen_array
from segmentation.errors import GeometryError
from segmentation.mesh import Surface
from tubeplan_viz.geometry import WallDistance

# Qhull slows down tenfold on the lattice-like points of marching cubes and merges the
# cospherical rings of a structured tube; a micrometre of jitter cures both and is a
# hundred times below the error asked of the centerline.
JITTER = 1e-3


@dataclass(frozen=True, eq=False)
class VoronoiGraph:
    """Voronoi vertices inside the lumen and the Voronoi edges between them.

    Attributes
    ----------
    nodes : (n, 3) float array, mm
    radii : (n,) float array, mm
        Distance to the nearest wall sample: the inscribed sphere up to the sampling.
    edges : (m, 2) int array
    lengths : (m,) float array, mm
    """

    nodes: FloatArray
    radii: FloatArray
    edges: IntArray
    lengths: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", frozen_array(self.nodes, (None, 3), "nodes"))
        object.__setattr__(self, "radii", frozen_array(self.radii, (len(self.nodes),), "radii"))
        object.__setattr__(self, "edges", frozen_array(self.edges, (None, 2), "edges", dtype=np.int64))
        object.__setattr__(self, "lengths", frozen_array(self.lengths, (len(self.edges),), "lengths"))

    def edge_costs(self, omega: float) -> FloatArray:
        """Integral of 1/R + omega along each edge (Dai 2024, eq. 1), R taken linear between the ends."""
        r0, r1 = self.radii[self.edges[:, 0]], self.radii[self.edges[:, 1]]
        return self.lengths * (mean_reciprocal(r0, r1) + omega)

    def matrix(self, weights: FloatArray) -> csr_matrix:
        """Symmetric sparse adjacency with the given edge weights."""
        i, j = self.edges.T
        n = len(self.nodes)
        return csr_matrix((np.concatenate([weights, weights]), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n, n))


def mean_reciprocal(r0: FloatArray, r1: FloatArray) -> FloatArray:
    """Mean of 1/R along a stretch on which R runs linearly from r0 to r1."""
    ratio = r1 / r0
    near = np.abs(ratio - 1.0) < 1e-6
    safe = np.where(near, 2.0, ratio)
    return np.where(near, 1.0 / r0, np.log(safe) / (r0 * (safe - 1.0)))


def wall_samples(surface: Surface, spacing: float) -> FloatArray:
    """Wall vertices, and more points on faces whose edges are longer than `spacing`, (k, 3) mm.

    Coarse meshes have faces longer than the tube is wide; their vertices alone do
    not describe the wall. Caps are left out: they are not wall (spec 1.8b), and
    their rim belongs to the wall anyway.
    """
    corners = surface.vertices[surface.wall_faces]  # (m, 3, 3)
    vertices = surface.vertices[np.unique(surface.wall_faces)]
    extra = []
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        corners = corners[edges.max(axis=1) > spacing]
        if not len(corners):
            break
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        extra.append(np.concatenate([ab, bc, ca]))
        corners = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    if not extra:
        return np.asarray(vertices)
    added = np.concatenate(extra)
    _, first = np.unique(np.round(added / 1e-4).astype(np.int64), axis=0, return_index=True)
    return np.concatenate([vertices, added[first]])


def voronoi_graph(surface: Surface, wall: WallDistance, *, points: FloatArray | None = None) -> VoronoiGraph:
    """Voronoi diagram of the wall's samples, cut down to the lumen.

    Parameters
    ----------
    surface : Surface
    wall : WallDistance
        Of the same surface; tells inside from outside.
    points : (k, 3) float array, mm, optional
        Wall samples; by default the vertices, refined where faces are long.

    Raises
    ------
    GeometryError
        If no Voronoi vertex lies inside: the wall is sampled too coarsely.

    Notes
    -----
    The Voronoi vertices are the circumcentres of the Delaunay tetrahedra. An edge
    stays when the inscribed spheres at its ends overlap: then the straight edge lies
    in their union and so in the lumen, however thin the tissue beside it.
    """
    if points is None:
        # Half the hydraulic radius of the whole: fine enough for necks narrower than the mean.
        radius = 3.0 * surface.volume_ml * 1000.0 / max(float(surface.face_areas.sum()), 1e-9)
        points = wall_samples(surface, max(0.6 * radius, 0.05))
    scale = float(np.ptp(surface.bounds, axis=0).max())
    rng = np.random.default_rng(0)
    jittered = points + rng.uniform(-JITTER, JITTER, points.shape) * min(1.0, scale / 50.0)
    delaunay = Delaunay(jittered, qhull_options="Qbb Qc Qz Q12")
    centers, radii = circumspheres(jittered, delaunay.simplices)
    low, high = surface.bounds
    candidate = np.flatnonzero(np.all((centers >= low) & (centers <= high), axis=1) & np.isfinite(radii) & (radii > 4 * JITTER))
    inside = candidate[wall.inside(centers[candidate])] if len(candidate) else candidate
    if len(inside) == 0:
        raise GeometryError(
            f"no inscribed sphere found among {len(points)} wall points; the mesh is too coarse, refine it and try again"
        )
    number = np.full(len(centers), -1)
    number[inside] = np.arange(len(inside))
    neighbors = delaunay.neighbors[inside]  # (n, 4)
    i = np.repeat(np.arange(len(inside)), 4)
    j = np.where(neighbors >= 0, number[neighbors], -1).ravel()
    keep = j > i
    i, j = i[keep], j[keep]
    nodes, radii = centers[inside], radii[inside]
    lengths = np.linalg.norm(nodes[i] - nodes[j], axis=1)
    overlap = lengths < 0.98 * (radii[i] + radii[j])
    return VoronoiGraph(nodes, radii, np.column_stack([i[overlap], j[overlap]]), np.maximum(lengths[overlap], 1e-9))


def circumspheres(points: FloatArray, simplices: IntArray) -> tuple[FloatArray, FloatArray]:
    """Centres (m, 3) and radii (m,) of the spheres through the four corners of each tetrahedron."""
    origin = points[simplices[:, 0]]
    a, b, c = (points[simplices[:, k]] - origin for k in (1, 2, 3))
    bc = np.cross(b, c)
    determinant = 2.0 * np.einsum("ij,ij->i", a, bc)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = (
            np.einsum("ij,ij->i", a, a)[:, None] * bc
            + np.einsum("ij,ij->i", b, b)[:, None] * np.cross(c, a)
            + np.einsum("ij,ij->i", c, c)[:, None] * np.cross(a, b)
        ) / determinant[:, None]
    return origin + offset, np.linalg.norm(offset, axis=1)
