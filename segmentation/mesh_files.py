"""Mesh files in and out: a wall that can be trusted, or one sentence that says why not."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from segmentation.errors import SurfaceError
from segmentation.mesh import Cap, Surface
from segmentation.mesh_parse import MeshPart, ParsedMesh, parse_mesh
from segmentation.mesh_repair import (
    clean_faces,
    closed_and_oriented,
    edge_map,
    face_components,
    merge_vertices,
    separate_sheets,
    signed_volume,
)
from segmentation.mesh_wall import lumen_wall

UNIT_MM: Mapping[str, float] = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
UNIT_NAMES: Mapping[str, str] = {"um": "micrometres", "mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches"}
# The longest side of a lumen's box: below, no instrument; above, larger than a person.
SMALLEST_MM, LARGEST_MM = 5.0, 2000.0
# Products of coordinates keep 16 digits: from here on, squares of a micrometre are lost beside squares of the place.
FARTHEST_MM = 1e6
# Steps of 32-bit coordinates from which on they are told: half of the last digit in which clearances are printed.
COARSE_MM = 0.005
# A cap's area may have been taken before its corners were merged or rounded: 7e-6 of it is the most seen. A face of wall is more.
CAP_ROUNDING = 1e-4
# The fill of an uneven open end may have this many times the area of its projection; more is wall that was called a cap.
UNEVEN_CAP = 4.0


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshInput:
    """A mesh file turned into a wall.

    Attributes
    ----------
    surface : Surface
        Closed, outward, in mm in the file's own axes (frame "mesh", or as recorded in a PLY of this program).
    facts : mapping of str to str
        Label and printed value, in reading order.
    warnings : tuple of str
        What was changed or looks odd, one sentence each.
    inputs : tuple of (name, sha256)
    """

    surface: Surface
    facts: Mapping[str, str]
    warnings: tuple[str, ...]
    inputs: tuple[tuple[str, str], ...]


def read_surface(
    path: str | Path, *, mesh_unit: str | None = None, near: ArrayLike | None = None, part: str | None = None
) -> MeshInput:
    """Read an STL, PLY, OBJ or GLB file as the closed wall of one lumen.

    Vertices within 1e-5 of the size are joined, degenerate and repeated faces dropped, one
    component kept, its faces turned outward, its open ends capped.

    Parameters
    ----------
    path : str or Path
    mesh_unit : {"um", "mm", "cm", "m", "in"}, optional
        The unit of the file. Without it GLB is taken as metres, as its standard says, all
        others as mm, and an absurd size is refused.
    near : (3,) array_like, mm, optional
        Keeps the component that holds this point, or else the nearest; without it the largest.
    part : str, optional
        Name of the part to take from a scene of several.

    Raises
    ------
    SurfaceError
        If the file is damaged, of doubtful unit, of several parts, or no closed two-sided wall can be made of it.
    """
    path = Path(path)
    name = path.name
    if mesh_unit is not None and mesh_unit not in UNIT_MM:
        raise SurfaceError(f"the mesh unit is {mesh_unit!r}, expected one of {', '.join(UNIT_MM)}")
    parsed = parse_mesh(path)
    inputs = ((name, hashlib.sha256(path.read_bytes()).hexdigest()),)
    if "tubeplan" in parsed.comments and mesh_unit in (None, "mm"):
        surface = read_ply(path)
        _check_unchanged(surface, name)
        return MeshInput(surface=surface, facts=_facts("PLY of tubeplan", "mm", surface), warnings=(), inputs=inputs)
    chosen = _choose_part(parsed, part, name)
    unit = mesh_unit or parsed.unit
    vertices, raw_faces = merge_vertices(chosen.vertices * UNIT_MM[unit], chosen.faces)
    size = float(np.ptp(vertices, axis=0).max())
    warnings = [f"{name}: {text}" for text in parsed.doubts]
    if not SMALLEST_MM <= size <= LARGEST_MM:
        doubt = f"{name}: taken as {UNIT_NAMES[unit]} the mesh is {size:.4g} mm long"
        if mesh_unit is None:
            raise SurfaceError(
                f"{doubt}, which no lumen is; {_likely_unit(size / UNIT_MM[unit])} with --mesh-unit (um, mm, cm, m, in)"
            )
        warnings.append(f"{doubt}, which is unusual for a lumen")
    warnings += _coarse_numbers(chosen, UNIT_MM[unit], name)
    if parsed.unit != "mm" and mesh_unit is None:
        warnings.append(
            f"{name}: {parsed.format} is in {UNIT_NAMES[unit]} by its standard; lengths were multiplied by {UNIT_MM[unit]:g}"
        )
    faces, degenerate, repeated = clean_faces(raw_faces)
    if not len(faces):
        raise SurfaceError(f"{name}: all {len(raw_faces)} faces are degenerate; export the mesh again")
    if degenerate or repeated:
        warnings.append(f"{name}: {degenerate} degenerate and {repeated} repeated faces were dropped")
    vertices, faces, touching = separate_sheets(vertices, faces, name)
    if touching:
        warnings.append(f"{name}: the wall touches itself along {touching} edge(s) and was cut apart there")
    point = None if near is None else np.asarray(near, dtype=float)
    surface, notes = lumen_wall(vertices, faces, point, name)
    facts = _facts(parsed.format, unit, surface)
    return MeshInput(surface=surface, facts=facts, warnings=(*warnings, *(f"{name}: {note}" for note in notes)), inputs=inputs)


def _coarse_numbers(part: MeshPart, mm: float, name: str) -> list[str]:
    """A word about coordinates so large that their last digit is no longer small against a clearance.

    Raises
    ------
    SurfaceError
        If the mesh lies so far out that distances cannot be computed from its coordinates.
    """
    far = float(np.abs(part.vertices).max())
    if far * mm > FARTHEST_MM:
        raise SurfaceError(
            f"{name}: lies {far * mm:.3g} mm from the origin of its axes, expected at most {FARTHEST_MM:g} mm, beyond which "
            "distances lose their digits; move the mesh towards the origin, and the points with it"
        )
    step = float(np.spacing(np.float32(far))) * mm
    if step < COARSE_MM or not np.array_equal(part.vertices.astype(np.float32), part.vertices):
        return []
    return [
        f"{name}: its coordinates reach {far * mm:.3g} mm in 32-bit numbers, which are {step:.2g} mm apart there: the wall is no "
        "truer than that; move the mesh towards the origin before it is exported"
    ]


def _check_unchanged(surface: Surface, name: str) -> None:
    """Hold a PLY that says it is of this program against what this program writes.

    Raises
    ------
    SurfaceError
        If another program has changed it: what it says of its caps would no longer be true.
    """
    size = float(np.ptp(surface.vertices, axis=0).max())
    fault = None
    if size > LARGEST_MM or float(np.abs(surface.vertices).max()) > FARTHEST_MM:
        fault = f"it is {size:.4g} mm long"
    elif not closed_and_oriented(surface.faces).all():
        fault = "its wall is not closed"
    elif signed_volume(surface.vertices, surface.faces) <= 0.0:
        fault = "its faces look inward"
    for index, cap in enumerate(surface.caps):
        corners = surface.vertices[surface.faces[surface.face_cap == index]]
        vectors = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # Of an open end that was filled, the area is that of its rim's projection, which is the length of the summed vectors.
        flat, whole = float(np.linalg.norm(vectors.sum(axis=0))), float(np.linalg.norm(vectors, axis=1).sum())
        is_own = np.isclose(flat if cap.origin == "open mesh" else whole, cap.area, rtol=CAP_ROUNDING, atol=1e-9)
        if fault is None and not (is_own and whole < UNEVEN_CAP * cap.area):
            fault = f"the faces of its cap {cap.label} cover {whole:.4g} mm^2 and not the {cap.area:.4g} mm^2 that it states"
    if fault is not None:
        raise SurfaceError(
            f"{name}: was changed since tubeplan wrote it ({fault}); write it again, "
            "or take out its line 'comment tubeplan' to have it read as any other mesh"
        )


def _choose_part(parsed: ParsedMesh, part: str | None, name: str) -> MeshPart:
    names = [p.name for p in parsed.parts]
    if part is not None:
        fitting = [p for p in parsed.parts if p.name == part]
        if not fitting:
            raise SurfaceError(f"{name}: no part is named {part!r}; its parts are {_listed(names)}")
        return fitting[0]
    if len(parsed.parts) > 1:
        raise SurfaceError(
            f"{name}: a scene of {len(names)} separate parts ({_listed(names)}), expected one wall; "
            "name one with --part, or fuse the parts to one closed mesh first"
        )
    return parsed.parts[0]


def _listed(names: list[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _likely_unit(size: float) -> str:
    """Name the units in which the longest side would be that of a lumen (20 mm to 1 m)."""
    likely = [unit for unit in ("m", "cm", "in", "mm", "um") if 20.0 <= size * UNIT_MM[unit] <= 1000.0]
    if not likely:
        return "no common unit makes it plausible: check the export and name the unit"
    words = " or ".join(f"{UNIT_NAMES[unit]} ({size * UNIT_MM[unit]:.0f} mm)" for unit in likely)
    return f"the file may be in {words}: name the unit"


def _facts(kind: str, unit: str, surface: Surface) -> dict[str, str]:
    lower, upper = surface.bounds
    return {
        "Mesh": f"{kind}, {len(surface.faces)} faces, {len(surface.vertices)} vertices",
        "Mesh unit": UNIT_NAMES[unit],
        "Box": " x ".join(f"{x:.1f}" for x in upper - lower) + " mm",
        "Volume": f"{surface.volume_ml:.2f} ml",
        "Open ends closed": ", ".join(f"{cap.label} {cap.area:.1f} mm²" for cap in surface.caps if cap.origin == "open mesh")
        or "none",
    }


def inspect_mesh(path: str | Path, *, mesh_unit: str | None = None) -> dict[str, Any]:
    """What is in a mesh file, as values that JSON can hold.

    Faults that `read_surface` would refuse are listed under ``faults``; only a file that
    cannot be parsed at all raises.
    """
    path = Path(path)
    parsed = parse_mesh(path)
    parts = []
    for part in parsed.parts:
        vertices, raw = merge_vertices(part.vertices, part.faces)
        faces, degenerate, repeated = clean_faces(raw)
        edges = edge_map(faces) if len(faces) else None
        parts.append(
            {
                "name": part.name,
                "faces": len(part.faces),
                "vertices": len(vertices),
                "components": 0 if edges is None else face_components(faces, edges)[0],
                "degenerate_faces": degenerate,
                "repeated_faces": repeated,
                "open_edges": 0 if edges is None else int((edges.count == 1).sum()),
                "crowded_edges": 0 if edges is None else int((edges.count > 2).sum()),
            }
        )
    points = np.concatenate([part.vertices for part in parsed.parts])
    unit = mesh_unit or parsed.unit
    bounds = np.array([points.min(axis=0), points.max(axis=0)]) * UNIT_MM[unit]
    report: dict[str, Any] = {
        "kind": "mesh",
        "name": path.name,
        "format": parsed.format,
        "unit": unit,
        "bounds_mm": bounds.tolist(),
        "size_mm": (bounds[1] - bounds[0]).tolist(),
        "faces": int(sum(len(part.faces) for part in parsed.parts)),
        "parts": parts,
        "open_ends": [],
        "volume_ml": None,
        "warnings": [],
        "faults": [],
    }
    try:
        mesh = read_surface(path, mesh_unit=mesh_unit)
    except SurfaceError as fault:
        report["faults"] = [str(fault)]
        return report
    report["warnings"] = list(mesh.warnings)
    report["volume_ml"] = mesh.surface.volume_ml
    report["open_ends"] = [
        {"label": cap.label, "origin": cap.origin, "center_mm": cap.center.tolist(), "area_mm2": cap.area}
        for cap in mesh.surface.caps
    ]
    return report


def write_ply(surface: Surface, path: str | Path) -> Surface:
    """Write binary little-endian PLY with double vertices, wall faces first and then the caps in their order.

    Returns
    -------
    Surface
        The same wall with its faces in the order of the file.
    """
    order = np.argsort(np.where(surface.face_cap < 0, -1, surface.face_cap), kind="stable")
    ordered = Surface(surface.vertices, surface.faces[order], surface.face_cap[order], surface.caps, surface.frame)
    lines = ["ply", "format binary_little_endian 1.0", "comment tubeplan", f"comment frame {surface.frame}", "comment unit mm"]
    for index, cap in enumerate(surface.caps):
        numbers = " ".join(repr(float(x)) for x in (*cap.center, *cap.normal, cap.area))
        lines.append(f"comment cap {int((ordered.face_cap == index).sum())} {cap.label} {numbers} {cap.origin}")
    lines += [f"element vertex {len(ordered.vertices)}", "property double x", "property double y", "property double z"]
    lines += [f"element face {len(ordered.faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = np.empty(len(ordered.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, ordered.faces
    Path(path).write_bytes("\n".join(lines).encode("ascii") + b"\n" + ordered.vertices.astype("<f8").tobytes() + rows.tobytes())
    return ordered


def read_ply(path: str | Path) -> Surface:
    """The surface that `write_ply` wrote, exactly.

    Raises
    ------
    SurfaceError
        If the file is not whole or is not as this program writes it.
    """
    path = Path(path)
    header, _, body = path.read_bytes().partition(b"end_header\n")
    text = header.decode("latin-1")
    counts = re.search(r"element vertex (\d+)\n.*element face (\d+)\n", text, re.DOTALL)
    frame = re.search(r"^comment frame (LPS|mesh)$", text, re.MULTILINE)
    if counts is None or frame is None or "\ncomment tubeplan\n" not in text:
        raise SurfaceError(f"{path.name}: not a PLY that tubeplan wrote; read it as a foreign mesh")
    n, m = int(counts[1]), int(counts[2])
    if len(body) != 24 * n + 13 * m:
        raise SurfaceError(
            f"{path.name}: {len(body)} bytes of data, expected {24 * n + 13 * m}; the file is cut short, write it again"
        )
    vertices = np.frombuffer(body, "<f8", 3 * n).reshape(-1, 3).astype(np.float64)
    rows = np.frombuffer(body, [("count", "u1"), ("corners", "<i4", 3)], m, 24 * n)
    faces = rows["corners"].astype(np.int64)
    caps, labels = [], []
    try:
        for line in re.findall(r"^comment cap (.*)$", text, re.MULTILINE):
            count, label, *rest = line.split(maxsplit=9)
            numbers = [float(x) for x in rest[:7]]
            caps.append(Cap(label, rest[7], np.array(numbers[:3]), np.array(numbers[3:6]), numbers[6]))
            labels.append(np.full(int(count), len(caps) - 1, dtype=np.int64))
        wall = m - sum(len(label) for label in labels)
        face_cap = np.concatenate([np.full(wall, -1, dtype=np.int64), *labels])
        return Surface(vertices, faces, face_cap, tuple(caps), frame[1])
    except (ValueError, IndexError) as fault:
        raise SurfaceError(
            f"{path.name}: its vertices or the lines of its caps are no longer as tubeplan wrote them ({fault}); write it again"
        ) from fault
