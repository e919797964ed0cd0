"""The wall as a headlight shows it, by ray casting: Embree finds what each pixel sees, without a display or a graphics card."""

from __future__ import annotations

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from segmentation.arrays import BoolArray, FloatArray
from segmentation.mesh import Surface
from tubeplan_viz.endoluminal.camera import Camera

TISSUE = np.array([226.0, 150.0, 128.0])
OPENING = np.array([14.0, 9.0, 9.0])  # a cap: the lumen goes on where the data end
REACH_RADII = 5.0  # light falls to a half after so many radii of the lumen


class Interior:
    """The wall of one lumen, ready to be looked at from inside.

    Parameters
    ----------
    surface : Surface
    """

    def __init__(self, surface: Surface) -> None:
        self._scene = EmbreeScene()
        self._faces = surface.faces
        self._open = surface.face_cap >= 0
        self._normals = vertex_normals(surface)
        TriangleMesh(self._scene, surface.vertices[surface.faces].astype(np.float32))

    def distance(self, origin: FloatArray, directions: FloatArray) -> FloatArray:
        """How far one sees from a point in each direction, (n,) mm; inf where nothing is met."""
        seen = self._cast(origin, directions)
        return np.where(seen["primID"] < 0, np.inf, seen["tfar"].astype(float))

    def visible(self, origin: FloatArray, points: FloatArray) -> BoolArray:
        """Which points are seen from `origin` with no wall between, (n,)."""
        away = points - origin
        far = np.linalg.norm(away, axis=1)
        return np.asarray(self.distance(origin, away / np.maximum(far, 1e-9)[:, None]) >= far - 1e-3)

    def picture(self, camera: Camera, size: int, *, radius: float) -> FloatArray:
        """What a camera sees, (size, size, 3), 0 to 255.

        Shading is Lambert's law for a light at the camera, falling off with the distance.

        Parameters
        ----------
        camera : Camera
        size : int
            Pixels along a side.
        radius : float, mm
            The lumen's radius where the camera is; sets how deep the light reaches.
        """
        rays = camera.rays(size)
        seen = self._cast(camera.position, rays)
        face = seen["primID"]
        hit = face >= 0
        corners = self._faces[face[hit]]
        u, v = seen["u"][hit, None], seen["v"][hit, None]
        normal = (
            (1.0 - u - v) * self._normals[corners[:, 0]] + u * self._normals[corners[:, 1]] + v * self._normals[corners[:, 2]]
        )
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        facing = np.abs(np.einsum("ij,ij->i", normal, rays[hit]))
        reach = REACH_RADII * max(radius, 0.2)
        light = (0.22 + 0.78 * facing) / (1.0 + (seen["tfar"][hit] / reach) ** 2)
        # A wet wall shines where it faces the lamp.
        shine = 46.0 * facing**24 / (1.0 + (seen["tfar"][hit] / (0.6 * reach)) ** 2)
        colours = np.zeros((len(rays), 3))
        colours[hit] = light[:, None] * TISSUE + shine[:, None]
        colours[np.flatnonzero(hit)[self._open[face[hit]]]] = OPENING
        return np.clip(colours, 0.0, 255.0).reshape(size, size, 3)

    def _cast(self, origin: FloatArray, directions: FloatArray) -> dict[str, FloatArray]:
        begin = np.broadcast_to(np.asarray(origin, np.float32), directions.shape).copy()
        return dict(self._scene.run(begin, np.ascontiguousarray(directions, np.float32), query="INTERSECT", output=True))


def vertex_normals(surface: Surface) -> FloatArray:
    """Unit normals at the vertices, each face counted by its area, (n, 3)."""
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    weighted = np.cross(b - a, c - a)
    normals = np.zeros_like(surface.vertices)
    for k in range(3):
        np.add.at(normals, surface.faces[:, k], weighted)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))
