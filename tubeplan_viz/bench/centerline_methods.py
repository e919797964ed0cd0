"""The ways to a centerline that are compared, each from a mesh file to lines in one call.

Run as a process of its own, ``python -P centerline_methods.py METHOD MESH ENDS OUT``, which imports
nothing but what a method needs, it goes the whole way twice and writes points, CPU seconds of both and the peak memory.
"""

from __future__ import annotations

import sys
import time
from importlib import import_module
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray
from segmentation.errors import TubeplanError
from segmentation.mesh import Surface
from segmentation.mesh_files import read_surface
from tubeplan_viz.centerline import CenterlineSettings, centerline_tree, trace_centerline, voronoi_graph
from tubeplan_viz.centerline.trace import least_cost_chains
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.memory import peak_memory

# Voxel of the peers that need an image of the lumen (notes on peers: 0.5 mm).
VOXEL = 0.5


def ours(mesh: Path, ends: FloatArray) -> FloatArray:
    """All lines of the tree from the first end to the others."""
    surface = read_surface(mesh).surface
    wall = WallDistance(surface)
    graph = voronoi_graph(surface, wall)
    if len(ends) == 2:
        line = trace_centerline(graph, wall, ends[0], ends[1])
        assert line is not None
        return np.asarray(line.points)
    tree = centerline_tree(graph, wall, ends[0], ends[1:])
    assert (tree.last_branch >= 0).all()
    return np.concatenate([branch.line.points for branch in tree.branches])


def delaunay(mesh: Path, ends: FloatArray) -> FloatArray:
    """Vertices of the full Voronoi diagram (scipy's Qhull) along the ways of least cost on 1/R, as they are."""
    surface = read_surface(mesh).surface
    return np.concatenate(delaunay_chains(surface, WallDistance(surface), ends))


def delaunay_chains(surface: Surface, wall: WallDistance, ends: FloatArray) -> list[FloatArray]:
    """The same for each way from the first end, (n, 3) mm without the ends themselves.

    Raises
    ------
    TubeplanError
        If no way leads to one of the ends.
    """
    graph = voronoi_graph(surface, wall, points=surface.vertices[np.unique(surface.wall_faces)])
    chains = least_cost_chains(graph, wall, ends[0], ends[1:], CenterlineSettings())
    found = [chain.points[1:-1] for chain in chains if chain is not None]
    if len(found) < len(chains):
        raise TubeplanError(f"the Voronoi diagram joins {len(found)} of {len(chains)} ends to the first, expected all")
    return found


def thinning(mesh: Path, ends: FloatArray) -> FloatArray:
    """Voxels of scikit-image's three-dimensional thinning along shortest ways between the ends."""
    skeletonize = import_module("skimage.morphology").skeletonize
    filled, lower = voxelized(read_surface(mesh).surface, VOXEL)
    sites = np.argwhere(skeletonize(filled))
    pairs = cKDTree(sites).query_pairs(1.8, output_type="ndarray")
    length = np.linalg.norm(sites[pairs[:, 0]] - sites[pairs[:, 1]], axis=1)
    graph = csr_matrix((length, (pairs[:, 0], pairs[:, 1])), shape=(len(sites),) * 2)
    points = lower + VOXEL * sites
    near = cKDTree(points).query(ends)[1]
    previous = dijkstra(graph, directed=False, indices=near[0], return_predecessors=True)[1]
    used = set()
    for node in near[1:]:
        while node >= 0 and node not in used:
            used.add(int(node))
            node = previous[node]
    return np.asarray(points[sorted(used)])


def kimimaro(mesh: Path, ends: FloatArray) -> FloatArray:
    """Vertices of kimimaro's skeleton (TEASAR) of the voxels, with its own search of tips."""
    filled, lower = voxelized(read_surface(mesh).surface, VOXEL)
    skeletons = import_module("kimimaro").skeletonize(
        filled.astype(np.uint32),
        # Its own penalty (exponent 4, made for neurons) cuts the bends of a tube by a third of its radius; 1 keeps to the middle.
        teasar_params={"scale": 1.5, "const": 2.0, "pdrf_exponent": 1},
        anisotropy=(VOXEL, VOXEL, VOXEL),
        dust_threshold=0,
        progress=False,
        parallel=1,
    )
    return np.asarray(lower + np.concatenate([skeleton.vertices for skeleton in skeletons.values()]))


def skeletor(mesh: Path, ends: FloatArray) -> FloatArray:
    """Vertices of skeletor's wavefront skeleton of the mesh."""
    surface = read_surface(mesh).surface
    made = import_module("skeletor").skeletonize.by_wavefront((surface.vertices, surface.faces), waves=1, progress=False)
    return np.asarray(made.vertices, dtype=float)


METHODS = {
    "tubeplan": ours,
    "scipy Delaunay": delaunay,
    "scikit-image thinning": thinning,
    "kimimaro": kimimaro,
    "skeletor": skeletor,
}
# Modules that a method needs beyond the project's own.
NEEDS = {"kimimaro": "kimimaro", "skeletor": "skeletor"}


def voxelized(surface: Surface, voxel: float) -> tuple[BoolArray, FloatArray]:
    """Voxels whose middles lie inside, by parity along columns of the last axis, and the first voxel's middle in mm."""
    # A shift by no round share keeps columns off the vertices.
    lower = surface.bounds[0] - voxel * np.array([1.137, 1.271, 1.0])
    count = np.ceil((surface.bounds[1] - lower) / voxel).astype(int) + 2
    corners = (surface.vertices[surface.faces] - lower) / voxel  # (m, 3, 3)
    flat = corners[:, :, :2]
    first = np.ceil(flat.min(axis=1)).astype(int)
    size = np.floor(flat.max(axis=1)).astype(int) - first + 1
    a, e1, e2 = flat[:, 0], flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
    crossed = np.zeros(count, dtype=np.int32)
    for i in range(int(size[:, 0].max())):
        for j in range(int(size[:, 1].max())):
            chosen = np.flatnonzero((size[:, 0] > i) & (size[:, 1] > j) & (area != 0.0))
            column = first[chosen] + np.array([i, j])
            offset = column - a[chosen]
            u = (offset[:, 0] * e2[chosen, 1] - offset[:, 1] * e2[chosen, 0]) / area[chosen]
            v = (e1[chosen, 0] * offset[:, 1] - e1[chosen, 1] * offset[:, 0]) / area[chosen]
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
            z = corners[chosen, :, 2]
            height = z[:, 0] + u * (z[:, 1] - z[:, 0]) + v * (z[:, 2] - z[:, 0])
            np.add.at(crossed, (column[hit, 0], column[hit, 1], np.ceil(height[hit]).astype(int)), 1)
    return np.cumsum(crossed, axis=2) % 2 == 1, lower


def main(method: str, mesh: str, ends: str, out: str) -> None:
    """Run a method twice and write what it found and took."""
    sites, seconds, points = np.load(ends), [], np.empty((0, 3))
    for _ in range(2):
        begun = time.process_time()
        points = METHODS[method](Path(mesh), sites)
        seconds.append(time.process_time() - begun)
    np.savez(out, points=points, cold=seconds[0], warm=seconds[1], peak=peak_memory())


if __name__ == "__main__":
    main(*sys.argv[1:])
