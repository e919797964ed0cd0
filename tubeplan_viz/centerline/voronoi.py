"""The Voronoi diagram of the wall inside the lumen, as a weighted graph."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import Delaunay, cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray, frozen_array
from segmentation.errors import GeometryError
from segmentation.mesh import Surface
from tubeplan_viz.centerline.sampling import oriented_samples, thinned_samples
from tubeplan_viz.geometry import WallDistance

# Qhull slows down tenfold on the lattice-like points of marching cubes and merges the
# cospherical rings of a structured tube; a micrometre of jitter cures both and is a
# hundred times below the error asked of the centerline.
JITTER = 1e-3
# A sphere whose centre stands this steeply over the wall at all four samples lies on one side of it for certain.
CLEAR_COSINE = 0.3
# A sphere whose four samples lie this close together against its radius is a roughness of the wall, not its other side.
LEAST_SPREAD = 0.7


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


def voronoi_graph(surface: Surface, wall: WallDistance, *, points: FloatArray | None = None) -> VoronoiGraph:
    """Voronoi diagram of the wall's samples, cut down to the lumen.

    Parameters
    ----------
    surface : Surface
    wall : WallDistance
        Of the same surface; tells inside from outside.
    points : (k, 3) float array, mm, optional
        Wall samples, all of which are used; by default the vertices, refined where faces are
        long and thinned where the lumen is wide against them (see `thinned_samples`).

    Raises
    ------
    GeometryError
        If no Voronoi vertex lies inside: the wall is sampled too coarsely.

    Notes
    -----
    The Voronoi vertices are the circumcentres of the Delaunay tetrahedra. Their radii are
    distances to the nearest of all samples, thinned out or not. An edge stays when the
    inscribed spheres at its ends overlap: then the straight edge lies in their union and
    so in the lumen, however thin the tissue beside it.
    """
    if points is None:
        # Half the hydraulic radius of the whole: fine enough for necks narrower than the mean.
        radius = 3.0 * surface.volume_ml * 1000.0 / max(float(surface.face_areas.sum()), 1e-9)
        points, normals = oriented_samples(surface, max(0.6 * radius, 0.05))
        tree = cKDTree(points)
        edge = float(np.sqrt(surface.face_areas[surface.face_cap < 0].sum() / len(points)))
        chosen = thinned_samples(points, normals, tree, edge)
    else:
        normals, tree, chosen = np.zeros_like(points), cKDTree(points), np.arange(len(points))
    scale = float(np.ptp(surface.bounds, axis=0).max())
    rng = np.random.default_rng(0)
    sites = points[chosen]
    jittered = sites + rng.uniform(-JITTER, JITTER, sites.shape) * min(1.0, scale / 50.0)
    delaunay = Delaunay(jittered, qhull_options="Qbb Qc Qz Q12")
    centers, radii = circumspheres(jittered, delaunay.simplices)
    low, high = surface.bounds
    bounded = np.all((centers >= low) & (centers <= high), axis=1) & np.isfinite(radii) & (radii > 4 * JITTER)
    candidate = np.flatnonzero(bounded)
    candidate = candidate[spread(jittered, delaunay.simplices[candidate]) > LEAST_SPREAD * radii[candidate]]
    spheres = (centers[candidate], radii[candidate])
    inside = candidate[lies_inside(*spheres, sites, normals[chosen], delaunay.simplices[candidate], wall)]
    if len(inside) == 0:
        raise GeometryError(
            f"no inscribed sphere found among {len(points)} wall points; the mesh is too coarse, refine it and try again"
        )
    nodes, radii = centers[inside], radii[inside]
    if len(chosen) < len(points):
        radii = np.minimum(radii, tree.query(nodes, distance_upper_bound=float(radii.max()) * 1.01)[0])
    number = np.full(len(centers), -1)
    number[inside] = np.arange(len(inside))
    neighbors = delaunay.neighbors[inside]  # (n, 4)
    i = np.repeat(np.arange(len(inside)), 4)
    j = np.where(neighbors >= 0, number[neighbors], -1).ravel()
    keep = j > i
    i, j = i[keep], j[keep]
    lengths = np.linalg.norm(nodes[i] - nodes[j], axis=1)
    overlap = lengths < 0.98 * (radii[i] + radii[j])
    return VoronoiGraph(nodes, radii, np.column_stack([i[overlap], j[overlap]]), np.maximum(lengths[overlap], 1e-9))


def lies_inside(
    centers: FloatArray, radii: FloatArray, sites: FloatArray, normals: FloatArray, simplices: IntArray, wall: WallDistance
) -> BoolArray:
    """Whether each circumcentre lies in the lumen, (m,).

    The sphere around it is empty of samples. Where its four samples all say by their normals that it
    lies on their inner side, or all on their outer side, that is the answer, unless a cap is near,
    which has no samples. Only the others, most of them close to the wall against the spacing of
    the samples, need the winding number, which costs twenty times as much.

    Parameters
    ----------
    centers, radii : (m, 3) and (m,) float arrays, mm
        Of the spheres through four samples each.
    sites, normals : (n, 3) float arrays, mm and unit vectors out of the lumen
        The samples of the wall.
    simplices : (m, 4) int array
        The samples of each sphere.
    wall : WallDistance
    """
    inside, outside = np.ones(len(centers), dtype=bool), np.ones(len(centers), dtype=bool)
    for corner in simplices.T:
        cosine = np.einsum("ij,ij->i", centers - sites[corner], normals[corner]) / radii
        inside &= cosine < -CLEAR_COSINE
        outside &= cosine > CLEAR_COSINE
    doubtful = ~inside & ~outside
    if wall.surface.caps:
        sure = np.flatnonzero(inside)
        tree = cKDTree(centers[sure])
        for index, cap in enumerate(wall.surface.caps):
            corners = wall.surface.vertices[wall.surface.faces[wall.surface.face_cap == index]].reshape(-1, 3) - cap.center
            # A sphere that leans on the rim of a cap and is farther away has no clear cosine there.
            reach = float(np.linalg.norm(corners, axis=1).max()) * (1.0 + 1.0 / CLEAR_COSINE)
            near = sure[tree.query_ball_point(cap.center, reach)]
            doubtful[near[(centers[near] - cap.center) @ cap.normal > float((corners @ cap.normal).min()) - JITTER]] = True
    asked = np.flatnonzero(doubtful)
    if len(asked):
        inside[asked] = wall.inside(centers[asked])
    return inside


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


def spread(points: FloatArray, simplices: IntArray) -> FloatArray:
    """Longest edge of each tetrahedron, (m,) mm."""
    square = np.zeros(len(simplices))
    for a, b in combinations(range(4), 2):
        edge = points[simplices[:, a]] - points[simplices[:, b]]
        square = np.maximum(square, np.einsum("ij,ij->i", edge, edge))
    return np.sqrt(square)
