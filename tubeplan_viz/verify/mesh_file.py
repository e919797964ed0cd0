"""A reader of mesh.ply made for checking: every claim of the header is tested against the bytes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import TubeplanError

SCALARS = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
HEADER_LIMIT = 1 << 16


class MeshFileError(TubeplanError):
    """A mesh.ply that cannot be read."""


@dataclass(frozen=True, eq=False)
class MeshFile:
    """Content of a binary PLY file of triangles.

    Attributes
    ----------
    vertices : (n, 3) float array
    faces : (m, 3) int array
    comments : tuple of str
    """

    vertices: FloatArray
    faces: IntArray
    comments: tuple[str, ...]

    def comment(self, word: str) -> str | None:
        """What follows `word` in the first comment line that begins with it."""
        found = (line[len(word) :].strip() for line in self.comments if line.split(" ")[0] == word)
        return next(found, None)

    @cached_property
    def open_edges(self) -> int:
        """Edges that are not shared by exactly two faces of opposite direction; 0 for a closed oriented surface."""
        edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        count = len(self.vertices)
        forward, counts = np.unique(edges[:, 0] * count + edges[:, 1], return_counts=True)
        backward = np.unique(edges[:, 1] * count + edges[:, 0])
        return int((counts > 1).sum() + len(np.setxor1d(forward, backward)))


def read_mesh(path: Path) -> MeshFile:
    """Read a binary PLY file whose faces are triangles.

    Raises
    ------
    MeshFileError
        If the file is missing, is no such PLY, is shorter or longer than its header
        says, or names vertices that do not exist.
    """
    try:
        raw = path.read_bytes()
    except OSError as fault:
        raise MeshFileError(f"{path.name} cannot be read ({(fault.strerror or 'unknown reason').lower()})") from fault
    head, mark, body = raw[:HEADER_LIMIT].partition(b"end_header\n")
    if not raw.startswith(b"ply\n") or not mark:
        raise MeshFileError(f"{path.name} is no PLY file, expected one that begins with 'ply'")
    body = raw[len(head) + len(mark) :]
    order, comments, elements = _header(head.decode("latin-1").splitlines(), path.name)
    if [name for name, _, _ in elements] != ["vertex", "face"]:
        raise MeshFileError(
            f"{path.name} holds {', '.join(name for name, _, _ in elements) or 'nothing'}, expected vertex and face"
        )
    (_, vertex_count, vertex_fields), (_, face_count, face_fields) = elements
    vertex_type = np.dtype([(name, order + kind) for name, kind, length in vertex_fields if length is None])
    if any(length is not None for _, _, length in vertex_fields) or not {"x", "y", "z"} <= set(vertex_type.names or ()):
        raise MeshFileError(f"{path.name} has the vertex properties {', '.join(f[0] for f in vertex_fields)}, expected x, y, z")
    lists = [(name, kind, length) for name, kind, length in face_fields if length is not None]
    if len(lists) != 1 or lists[0][0] not in ("vertex_indices", "vertex_index"):
        raise MeshFileError(f"{path.name} has no list of vertex indices for its faces, expected one")
    face_type = np.dtype(
        [
            field
            for name, kind, length in face_fields
            for field in (
                [(name, order + kind)] if length is None else [("corners", order + length), ("indices", order + kind, 3)]
            )
        ]
    )
    expected = vertex_count * vertex_type.itemsize + face_count * face_type.itemsize
    if len(body) != expected:
        raise MeshFileError(
            f"{path.name} has {len(body)} bytes of data, expected {expected} for its triangles; it is cut or not of triangles"
        )
    points = np.frombuffer(body, vertex_type, vertex_count)
    rows = np.frombuffer(body, face_type, face_count, offset=vertex_count * vertex_type.itemsize)
    vertices = np.column_stack([points[axis].astype(float) for axis in "xyz"])
    faces = rows["indices"].astype(np.int64).reshape(-1, 3)
    if face_count < 4 or (rows["corners"] != 3).any() or faces.min() < 0 or faces.max() >= vertex_count:
        raise MeshFileError(
            f"{path.name} has faces that are no triangles on its {vertex_count} vertices, expected triangles only"
        )
    if not np.isfinite(vertices).all():
        raise MeshFileError(f"{path.name} has vertices that are not finite, expected numbers")
    return MeshFile(vertices, faces, comments)


Field = tuple[str, str, str | None]


def _header(lines: list[str], name: str) -> tuple[str, tuple[str, ...], list[tuple[str, int, list[Field]]]]:
    order, comments = "", []
    elements: list[tuple[str, int, list[Field]]] = []
    for line in lines[1:]:
        words = line.split()
        try:
            match words:
                case ["format", kind, "1.0"] if kind in ORDERS:
                    order = ORDERS[kind]
                case ["comment", *text]:
                    comments.append(" ".join(text))
                case ["element", element, count]:
                    elements.append((element, int(count), []))
                case ["property", "list", length, kind, field]:
                    elements[-1][2].append((field, SCALARS[kind], SCALARS[length]))
                case ["property", kind, field]:
                    elements[-1][2].append((field, SCALARS[kind], None))
                case ["obj_info", *_] | []:
                    continue
                case _:
                    raise MeshFileError(f"{name} has the header line {line[:60]!r}, expected binary PLY 1.0")
        except (KeyError, IndexError, ValueError) as fault:
            raise MeshFileError(f"{name} has the header line {line[:60]!r}, expected binary PLY 1.0") from fault
    if not order:
        raise MeshFileError(f"{name} names no binary format, expected binary PLY 1.0")
    return order, tuple(comments), elements
