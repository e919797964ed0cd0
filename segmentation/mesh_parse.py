"""Bytes of a mesh file to triangles, fail closed: STL, PLY, OBJ and GLB.

trimesh returns an empty mesh for truncated, huge-count and random files and drops
facets with NaN without a word, and misreads OBJ indices that count backwards, so STL and
OBJ are read here, and what trimesh reads of PLY and GLB is checked against what the file declares.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import SurfaceError

FORMATS = (".stl", ".ply", ".obj", ".glb")
# A wall needs some ten thousand faces; ten million are 500 MB of STL and no lumen.
MAX_FACES = 10_000_000
STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Vertices (n, 3) in the file's unit and faces (m, 3) of one named part."""

    name: str
    vertices: FloatArray
    faces: IntArray


@dataclass(frozen=True, eq=False)
class ParsedMesh:
    """What a mesh file holds.

    Attributes
    ----------
    format : str
        As shown to the reader, e.g. "binary STL".
    parts : tuple of MeshPart
        One for STL and PLY; the named parts of an OBJ or GLB scene.
    unit : {"mm", "m"}
        What the format says, or mm where it says nothing.
    comments : mapping of str to str
        Of a PLY that this program wrote.
    doubts : tuple of str
        What looks odd about the bytes, without the file's name.
    """

    format: str
    parts: tuple[MeshPart, ...]
    unit: str = "mm"
    comments: Mapping[str, str] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()


def parse_mesh(path: Path) -> ParsedMesh:
    """Read one mesh file.

    Raises
    ------
    SurfaceError
        If the file is missing, of another kind, cut short, empty or holds values that are not finite.
    """
    name, suffix = path.name, path.suffix.lower()
    if not path.is_file():
        raise SurfaceError(f"{name}: no such mesh file; give the path of an STL, PLY, OBJ or GLB file")
    if suffix not in FORMATS:
        raise SurfaceError(f"{name}: the ending {suffix or '(none)'} is no mesh format, expected one of {', '.join(FORMATS)}")
    data = path.read_bytes()
    if not data:
        raise SurfaceError(f"{name}: the file is empty, export the mesh again")
    if re.match(rb"\s*(<!doctype html|<html|<\?xml)", data[:200], re.IGNORECASE):
        raise SurfaceError(f"{name}: this is a web page or XML text, not a mesh; download the file itself again")
    parsed = {".stl": _parse_stl, ".ply": _parse_ply, ".obj": _parse_obj, ".glb": _parse_glb}[suffix](data, name)
    for part in parsed.parts:
        if not np.isfinite(part.vertices).all():
            bad = int((~np.isfinite(part.vertices).all(axis=1)).sum())
            raise SurfaceError(f"{name}: {bad} vertices have coordinates that are not numbers, export the mesh again")
        if len(part.faces) and (part.faces.min() < 0 or part.faces.max() >= len(part.vertices)):
            raise SurfaceError(
                f"{name}: faces name vertices that do not exist ({len(part.vertices)} are there), export the mesh again"
            )
    if not sum(len(part.faces) for part in parsed.parts):
        raise SurfaceError(f"{name}: the file holds no triangles; a mesh of the lumen's wall is needed")
    return parsed


def _parse_stl(data: bytes, name: str) -> ParsedMesh:
    # Strategy: the size decides. A binary STL is 84 + 50 n bytes whatever its header says, and many begin
    # with "solid"; only what fails that and reads as text is ASCII.
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        if count > MAX_FACES:
            raise SurfaceError(f"{name}: {count} triangles, expected at most {MAX_FACES}; reduce the mesh first")
        soup = np.frombuffer(data, STL_FACET, count, 84)["corners"].astype(np.float64).reshape(-1, 3)
        return ParsedMesh("binary STL", (_soup(name, soup),))
    if b"\0" not in data and re.search(
        rb"\bfacet\s+normal\b", data[: 1 << 16], re.IGNORECASE
    ):  # comments may come before "solid"
        return _parse_stl_text(data, name)
    if count < 0:
        raise SurfaceError(f"{name}: {len(data)} bytes are too few for an STL file (84 at least), export the mesh again")
    if len(data) < 84 + 50 * min(count, MAX_FACES) and count <= MAX_FACES:
        held = (len(data) - 84) // 50
        raise SurfaceError(
            f"{name}: the STL is cut short, {held} of {count} announced triangles are there; copy or export it again"
        )
    raise SurfaceError(
        f"{name}: no STL file: its header announces {count} triangles ({84 + 50 * count} bytes) and it has {len(data)} bytes; "
        "export the mesh again"
    )


def _parse_stl_text(data: bytes, name: str) -> ParsedMesh:
    text = data.decode("latin-1").lower()
    facets, closed = len(re.findall(r"\bfacet\s+normal\b", text)), len(re.findall(r"\bendfacet\b", text))
    numbers = re.findall(r"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", text)
    if facets != closed or len(numbers) != 3 * facets or "endsolid" not in text[-400:]:
        raise SurfaceError(
            f"{name}: the ASCII STL is cut short or damaged ({facets} facets begun, {closed} ended, {len(numbers)} vertices); "
            "export it again"
        )
    try:
        soup = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    except ValueError as fault:
        raise SurfaceError(f"{name}: a vertex of the ASCII STL is no number; export the mesh again") from fault
    return ParsedMesh("ASCII STL", (_soup(name, soup),))


def _soup(name: str, corners: FloatArray) -> MeshPart:
    return MeshPart(name, corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3))


def _parse_ply(data: bytes, name: str) -> ParsedMesh:
    end = data.find(b"end_header")
    if data[:3] != b"ply" or end < 0:
        raise SurfaceError(f"{name}: no PLY file (it does not begin with 'ply' and end its header); export the mesh again")
    header = data[:end].decode("latin-1")
    declared = {kind: int(count) for kind, count in re.findall(r"^element\s+(\w+)\s+(\d+)", header, re.MULTILINE)}
    vertices, faces = declared.get("vertex", 0), declared.get("face", 0)
    if faces > MAX_FACES or vertices > MAX_FACES or 4 * (vertices + faces) > 20 * len(data):
        raise SurfaceError(
            f"{name}: the PLY header announces {vertices} vertices and {faces} faces, too many for its {len(data)} bytes; "
            "export it again"
        )
    mesh = _with_trimesh(data, "ply", name)
    part = MeshPart(name, np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64))
    if len(part.vertices) != vertices or len(part.faces) < faces:
        raise SurfaceError(
            f"{name}: the PLY is cut short, {len(part.vertices)} of {vertices} vertices and {len(part.faces)} of {faces} faces "
            "are there; copy or export it again"
        )
    words = [line.split(maxsplit=2) for line in header.splitlines() if line.startswith("comment ")]
    comments = {word[1]: word[2] if len(word) > 2 else "" for word in words if len(word) > 1 and word[1] != "cap"}
    text = re.search(r"^format\s+ascii", header, re.MULTILINE) is not None
    return ParsedMesh("PLY", (part,), comments=comments, doubts=_last_line(data) if text else ())


def _parse_obj(data: bytes, name: str) -> ParsedMesh:
    # Strategy: lines that begin with v and f, all of them, since trimesh counts negative indices from the end of the
    # file instead of from the face's own line, and leaves out what it does not understand. Groups in an OBJ share their
    # vertices and are mostly pieces of one wall: they are taken together.
    points: list[list[float]] = []
    corners: list[tuple[int, int, int]] = []
    text = data.decode("latin-1").replace("\\\r\n", "  ").replace("\\\n", " ")  # a backslash continues a line
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
        words = line.partition("#")[0].split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                x, y, z = words[1:4]
                points.append([float(x), float(y), float(z)])
                continue
            named = [int(word.partition("/")[0]) for word in words[1:]]
            places = [index - 1 if index > 0 else len(points) + index for index in named]
            first, second, *rest = places
            if 0 in named or not rest or min(places) < 0:
                raise ValueError
        except ValueError as fault:
            wanted = "three numbers" if words[0] == "v" else "three or more vertices, counted from 1 or backwards from -1"
            raise SurfaceError(
                f"{name}: line {number} of the OBJ reads {line.strip()[:60]!r}, expected {wanted} after {words[0]!r}; "
                "export the mesh again"
            ) from fault
        for third in rest:
            corners.append((first, second, third))
            second = third
    if not points or not corners:
        raise SurfaceError(f"{name}: no OBJ mesh (it holds no 'v' and 'f' lines); export the mesh again")
    part = MeshPart(name, np.array(points, dtype=np.float64), np.array(corners, dtype=np.int64))
    return ParsedMesh("OBJ", (part,), doubts=_last_line(data))


def _last_line(data: bytes) -> tuple[str, ...]:
    """A word about text that stops within a line: the number there may have lost digits, and lines after it may be missing."""
    if data.endswith((b"\n", b"\r")):
        return ()
    return ("its last line has no end, so that the file may have been cut there: look at its open ends",)


def _parse_glb(data: bytes, name: str) -> ParsedMesh:
    if data[:4] != b"glTF" or len(data) < 20:
        raise SurfaceError(f"{name}: no GLB file (it does not begin with 'glTF'); export the mesh again")
    length = int.from_bytes(data[8:12], "little")
    if length != len(data):
        raise SurfaceError(f"{name}: the GLB announces {length} bytes and has {len(data)}; copy or export it again")
    try:
        data[20 : 20 + int.from_bytes(data[12:16], "little")].decode("utf-8")
    except UnicodeDecodeError as fault:
        raise SurfaceError(
            f"{name}: the GLB's description of its parts is no UTF-8 text (byte {20 + fault.start}); copy or export it again"
        ) from None
    scene = _with_trimesh(data, "glb", name)
    parts = []
    for node in scene.graph.nodes_geometry:
        transform, geometry_name = scene.graph[node]
        geometry = scene.geometry[geometry_name]
        if isinstance(geometry, trimesh.Trimesh):
            vertices = np.asarray(geometry.vertices, dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3]
            parts.append(MeshPart(str(node), vertices, np.asarray(geometry.faces, dtype=np.int64)))
    return ParsedMesh("GLB", tuple(sorted(parts, key=lambda part: part.name)), unit="m")


def _with_trimesh(data: bytes, kind: str, name: str) -> trimesh.Trimesh | trimesh.Scene:
    try:
        if kind == "glb":
            return trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
        return trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False)
    # What trimesh's parsers raise on damaged files is not defined; these were seen on cut and altered ones.
    except (
        ValueError,
        KeyError,
        IndexError,
        TypeError,
        AttributeError,
        NotImplementedError,
        ImportError,  # of a part whose compression needs another library
        EOFError,
        OSError,
        MemoryError,
    ) as fault:
        raise SurfaceError(
            f"{name}: the {kind.upper()} file cannot be read ({type(fault).__name__}); export the mesh again"
        ) from fault
