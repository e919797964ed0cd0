"""The wall of a lumen as a closed triangle mesh with its end caps named."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from segmentation.arrays import FloatArray, IntArray, frozen_array
from segmentation.errors import SurfaceError


@dataclass(frozen=True, eq=False)
class Cap:
    """One end of the tube that is closed by a flat or filled face instead of wall.

    Attributes
    ----------
    label : str
        ``C1``, ``C2``, ... in order of falling area.
    origin : {"image border", "open mesh", "flat end"}
        Why it is there: the image cuts the tube, the file's mesh was open, or the
        mesh itself is closed by a flat disc.
    center : (3,) float array, mm
    normal : (3,) float array
        Unit vector out of the lumen.
    area : float, mm^2
    """

    label: str
    origin: str
    center: FloatArray
    normal: FloatArray
    area: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", frozen_array(self.center, (3,), "cap center"))
        object.__setattr__(self, "normal", frozen_array(self.normal, (3,), "cap normal"))


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed, outward-oriented triangle mesh around one lumen.

    Attributes
    ----------
    vertices : (n, 3) float array, mm
    faces : (m, 3) int array
        Anticlockwise seen from outside.
    face_cap : (m,) int array
        -1 for wall, otherwise the index into `caps`.
    caps : tuple of Cap
    frame : {"LPS", "mesh"}
        ``LPS`` when it came from a CT, ``mesh`` for the axes of a mesh file.
    """

    vertices: FloatArray
    faces: IntArray
    face_cap: IntArray
    caps: tuple[Cap, ...] = ()
    frame: str = "LPS"

    def __post_init__(self) -> None:
        vertices = frozen_array(self.vertices, (None, 3), "vertices")
        faces = frozen_array(self.faces, (None, 3), "faces", dtype=np.int64)
        face_cap = frozen_array(self.face_cap, (len(faces),), "face_cap", dtype=np.int64)
        if len(faces) < 4 or faces.min() < 0 or faces.max() >= len(vertices):
            raise SurfaceError(f"the mesh has {len(faces)} faces on {len(vertices)} vertices; it is no closed surface")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        object.__setattr__(self, "face_cap", face_cap)

    @cached_property
    def wall_faces(self) -> IntArray:
        """Faces that are wall, (k, 3): all but the caps."""
        return frozen_array(self.faces[self.face_cap < 0], (None, 3), "wall_faces", dtype=np.int64)

    @cached_property
    def face_normals(self) -> FloatArray:
        """Unit outward normals, (m, 3); zero for a face without area."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        return frozen_array(np.divide(cross, length, out=np.zeros_like(cross), where=length > 0), (None, 3), "normals")

    @cached_property
    def face_areas(self) -> FloatArray:
        """Areas in mm^2, (m,)."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return frozen_array(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1), (None,), "areas")

    @cached_property
    def volume_ml(self) -> float:
        """Enclosed volume in ml by the divergence theorem."""
        origin = self.vertices.mean(axis=0)
        a, b, c = (self.vertices[self.faces[:, k]] - origin for k in range(3))
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6000.0)

    @property
    def bounds(self) -> FloatArray:
        """(2, 3) lowest and highest corner, mm."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])
