"""A surface seen from inside the lumen: where its vertices face, and how it bulges."""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface

BULGE_REACH_MM, BULGE_LEAST, BULGE_MAX = 2.5, 12, 0.5


class OutwardWall:
    """Vertices of a surface with their unit outward normals: means of the faces' weighted by area."""

    def __init__(self, surface: Surface) -> None:
        weighted = surface.face_normals * surface.face_areas[:, None]
        total = np.zeros_like(surface.vertices)
        for corner in range(3):
            np.add.at(total, surface.faces[:, corner], weighted)
        self.points = surface.vertices
        self.normals = np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12))

    def bulge(self, point: FloatArray, heading: FloatArray) -> float:
        """Mean curvature of the surface ahead, 1/mm: positive where the lumen ends in a dome, negative before a papilla.

        That of the best paraboloid through the vertices around; 0 where there are too few.
        """
        around = np.linalg.norm(self.points - point, axis=1) <= BULGE_REACH_MM
        rows = self.points[around & (self.normals @ heading > 0.0)] - point
        if len(rows) < BULGE_LEAST:
            return 0.0
        height = rows @ heading
        plane = np.linalg.svd(heading[None])[2][1:]
        beside = rows @ plane.T
        terms = np.column_stack([np.ones(len(rows)), beside, (beside**2).sum(axis=1)])
        return float(np.clip(-2.0 * np.linalg.lstsq(terms, height, rcond=None)[0][3], -BULGE_MAX, BULGE_MAX))
