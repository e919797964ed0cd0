"""Meshes for other programs: binary STL, and a GLB scene of coloured parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from trimesh.visual.material import PBRMaterial

from segmentation.arrays import FloatArray, IntArray, frozen_array
from segmentation.mesh import Surface
from segmentation.mesh_parse import STL_FACET

STL_HEADER = b"tubeplan; mm; research use, not for clinical decisions"
# glTF wants metres, +y up and the front towards +z: left, superior, anterior.
LPS_TO_GLTF = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1000.0]]) / 1000.0


@dataclass(frozen=True, eq=False, kw_only=True)
class ScenePart:
    """One named, coloured mesh of a scene.

    Attributes
    ----------
    name : str
    vertices : (n, 3) float array, mm, LPS
    faces : (m, 3) int array
        Anticlockwise seen from outside.
    color : (4,) float tuple
        Red, green, blue and opacity, 0 to 1, linear.
    """

    name: str
    vertices: FloatArray
    faces: IntArray
    color: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen_array(self.vertices, (None, 3), "vertices"))
        object.__setattr__(self, "faces", frozen_array(self.faces, (None, 3), "faces", dtype=np.int64))


def stl_bytes(surface: Surface) -> bytes:
    """A surface, caps included, as binary STL in its own coordinates and mm; single precision."""
    facets = np.zeros(len(surface.faces), dtype=STL_FACET)
    facets["normal"] = surface.face_normals
    facets["corners"] = surface.vertices[surface.faces]
    return STL_HEADER.ljust(80, b" ") + np.uint32(len(facets)).tobytes() + facets.tobytes()


def glb_bytes(parts: Sequence[ScenePart]) -> bytes:
    """Parts as one binary glTF file [1]_: metres, +y superior, +z anterior, +x left.

    The vertices stay in mm and LPS; the node of each part turns and scales them, so that a
    reader finds the numbers of the run.

    References
    ----------
    .. [1] glTF 2.0, ISO/IEC 12113:2022, 3.4 (coordinate system and units).
    """
    scene = trimesh.Scene()
    for part in parts:
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        translucent = part.color[3] < 1.0
        mesh.visual = trimesh.visual.TextureVisuals(
            material=PBRMaterial(
                name=part.name,
                baseColorFactor=list(part.color),
                metallicFactor=0.0,
                roughnessFactor=0.8,
                alphaMode="BLEND" if translucent else "OPAQUE",
                doubleSided=translucent,
            )
        )
        scene.add_geometry(mesh, node_name=part.name, geom_name=part.name, transform=LPS_TO_GLTF)
    exported: bytes = scene.export(file_type="glb", include_normals=True)
    return exported
