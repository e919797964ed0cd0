"""Smoothing of a triangle mesh that keeps its volume and its flat ends."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.isosurface import signed_volume


def edges(faces: IntArray) -> IntArray:
    """Every edge of every face as it is walked, (3 m, 2)."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def averaging(faces: IntArray, count: int, *, listens: BoolArray | None = None) -> csr_matrix:
    """Matrix that gives each vertex the mean of its neighbours, (count, count).

    `listens`, if given, is a mask over `edges`: an edge counts for its first vertex only where it is true.
    """
    pairs = edges(faces)
    if listens is not None:
        pairs = pairs[listens]
    # In a closed mesh each edge is walked once in each direction.
    matrix = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    total = np.asarray(matrix.sum(axis=1)).ravel()
    return csr_matrix(diags(np.divide(1.0, total, out=np.zeros(count), where=total > 0)) @ matrix)


def smoothed(
    vertices: FloatArray,
    faces: IntArray,
    *,
    vertex_plane: IntArray,
    planes: FloatArray,
    cap_face: BoolArray,
    rounds: int,
    pass_band: float,
    shrink: float = 0.5,
) -> FloatArray:
    """Taubin's low-pass filter [1]_ with flat caps kept flat.

    Each round moves every vertex towards the mean of its neighbours and then a
    little further back, which passes all but the short waves; a last even step gives
    back the volume that this took. A vertex on the rim of
    a cap slides in the cap's plane and listens to the wall alone; the inside of a cap is
    spread evenly afterwards.

    Parameters
    ----------
    vertices : (n, 3) float array, mm
    faces : (m, 3) int array
        Closed and consistently oriented.
    vertex_plane : (n,) int array
        Bits of the planes on which a vertex must stay.
    planes : (k, 3) float array
        Unit normals.
    cap_face : (m,) bool array
    rounds : int
    pass_band : float
        Taubin's k_PB: waves of lower frequency keep their height.
    shrink : float
        Taubin's lambda.

    References
    ----------
    .. [1] Taubin, G. (1995). A signal processing approach to fair surface design. SIGGRAPH, 351-358.
    """
    if rounds == 0:
        return vertices
    count = len(vertices)
    wall_vertex = np.zeros(count, dtype=bool)
    wall_vertex[faces[~cap_face]] = True
    pairs = edges(faces)
    mean = averaging(faces, count, listens=wall_vertex[pairs[:, 0]] & wall_vertex[pairs[:, 1]])
    grow = 1.0 / (pass_band - 1.0 / shrink)
    points = vertices.copy()
    free = wall_vertex[:, None]
    for _ in range(rounds):
        for weight in (shrink, grow):
            step = np.where(free, weight * (mean @ points - points), 0.0)
            points += _in_planes(step, vertex_plane, planes)
    points += _in_planes(
        _restoring(signed_volume(vertices, faces) - signed_volume(points, faces), points, faces[~cap_face], free),
        vertex_plane,
        planes,
    )
    if cap_face.any():
        inner = ~wall_vertex[:, None]
        every = averaging(faces, count)
        for _ in range(20):
            points = np.where(inner, _in_planes(every @ points - points, vertex_plane, planes) + points, points)
    return points


def _restoring(missing: float, points: FloatArray, wall: IntArray, free: BoolArray) -> FloatArray:
    """The even step along the wall's normals that adds `missing` mm^3."""
    a, b, c = (points[wall[:, k]] for k in range(3))
    normal = 0.5 * np.cross(b - a, c - a)
    offset = missing / float(np.linalg.norm(normal, axis=1).sum())
    at_vertex = np.zeros_like(points)
    for corner in range(3):
        np.add.at(at_vertex, wall[:, corner], normal)
    length = np.linalg.norm(at_vertex, axis=1, keepdims=True)
    return np.where(free & (length > 0), offset * at_vertex / np.where(length > 0, length, 1.0), 0.0)


def _in_planes(step: FloatArray, vertex_plane: IntArray, planes: FloatArray) -> FloatArray:
    """The steps without the part that would leave a vertex's planes."""
    for number, normal in enumerate(planes):
        held = (vertex_plane >> number) & 1 > 0
        if held.any():
            step[held] -= np.outer(step[held] @ normal, normal)
    return step
