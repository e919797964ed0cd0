"""Tubes with closed-form answers, and the mesh files and faults that tests need.

The models of the published comparison live in `tubeplan_viz.bench.models`; this adds what
only tests use: round ends, open ends, unlabelled copies and bytes of mesh files.
"""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from segmentation.mesh import Surface
from tubeplan_viz.bench.models import (
    Model,
    bent_cylinder_1,
    bent_cylinder_2,
    helix_tube,
    narrow_neck,
    straight_tube,
    torus_piece,
    variant_1,
    variant_2,
    with_noise,
    y_junction,
)

__all__ = [
    "Model",
    "bent_cylinder_1",
    "bent_cylinder_2",
    "box",
    "capsule",
    "helix_tube",
    "joined",
    "narrow_neck",
    "open_tube",
    "stl_bytes",
    "stl_text",
    "straight_tube",
    "torus_piece",
    "twice",
    "unlabelled",
    "variant_1",
    "variant_2",
    "with_noise",
    "y_junction",
]


def unlabelled(surface: Surface) -> Surface:
    """The same mesh with every face wall and no caps."""
    return Surface(surface.vertices, surface.faces, np.full(len(surface.faces), -1), (), surface.frame)


def twice(surface: Surface, shift: FloatArray) -> Surface:
    """A surface and the same beside it, moved by (3,) mm: two parts that nothing joins."""
    return Surface(
        np.concatenate([surface.vertices, surface.vertices + shift]),
        np.concatenate([surface.faces, surface.faces + len(surface.vertices)]),
        np.concatenate([surface.face_cap, surface.face_cap]),
        surface.caps,
        surface.frame,
    )


def open_tube(model: Model, *, ends: tuple[int, ...] = (0, 1)) -> tuple[FloatArray, IntArray]:
    """Vertices and faces of a model without the named caps."""
    faces = model.surface.faces[~np.isin(model.surface.face_cap, ends)]
    used = np.unique(faces)
    return model.surface.vertices[used], np.searchsorted(used, faces)


def capsule(length: float, radius: float, *, around: int = 48) -> Surface:
    """A cylinder along +z between z = 0 and `length` with a hemisphere at each end."""
    polar = np.linspace(0.0, 0.5 * np.pi, around // 4 + 1)
    rise = np.concatenate(
        [-radius * np.cos(polar), np.linspace(0.0, length, around)[1:-1], length + radius * np.cos(polar[::-1])]
    )
    wide = np.concatenate([radius * np.sin(polar), np.full(around - 2, radius), radius * np.sin(polar[::-1])])
    turn = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    rings = np.stack(
        [wide[1:-1, None] * np.cos(turn), wide[1:-1, None] * np.sin(turn), np.repeat(rise[1:-1, None], around, axis=1)], axis=-1
    )
    vertices = np.concatenate([rings.reshape(-1, 3), [[0.0, 0.0, rise[0]], [0.0, 0.0, rise[-1]]]])
    count = len(rings)
    j, k = np.arange(around), (np.arange(around) + 1) % around
    low = (np.arange(count - 1) * around)[:, None]
    a, b, c, d = ((low + j).ravel(), (low + k).ravel(), (low + around + k).ravel(), (low + around + j).ravel())
    bottom, top = count * around, count * around + 1
    faces = np.concatenate(
        [
            np.column_stack([a, b, c]),
            np.column_stack([a, c, d]),
            np.column_stack([k, j, np.full(around, bottom)]),
            np.column_stack([(count - 1) * around + j, (count - 1) * around + k, np.full(around, top)]),
        ]
    )
    return Surface(vertices, faces, np.full(len(faces), -1), (), "mesh")


def box(lower: tuple[float, float, float], upper: tuple[float, float, float]) -> tuple[FloatArray, IntArray]:
    """Vertices and outward faces of a box."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    vertices = np.asarray(lower) + corners * (np.asarray(upper) - np.asarray(lower))
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def joined(*meshes: tuple[FloatArray, IntArray]) -> tuple[FloatArray, IntArray]:
    """Several meshes as one list of vertices and faces."""
    shifts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    return np.concatenate([m[0] for m in meshes]), np.concatenate([m[1] + s for m, s in zip(meshes, shifts, strict=False)])


def stl_bytes(vertices: FloatArray, faces: IntArray, *, header: bytes = b"phantom") -> bytes:
    """A binary STL."""
    rows = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corners"] = vertices[faces]
    return header.ljust(80, b"\0") + len(faces).to_bytes(4, "little") + rows.tobytes()


def stl_text(vertices: FloatArray, faces: IntArray) -> str:
    """An ASCII STL with all digits."""
    lines = ["solid phantom"]
    for corners in vertices[faces]:
        lines += [
            "facet normal 0 0 0",
            "outer loop",
            *(f"vertex {x!r} {y!r} {z!r}" for x, y, z in corners.tolist()),
            "endloop",
            "endfacet",
        ]
    return "\n".join([*lines, "endsolid phantom", ""])
