"""The one wall of a lumen among the components of a mesh, closed and outward, with the bodies that stand in the lumen."""

from __future__ import annotations

import igl
import numpy as np

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import SurfaceError
from segmentation.mesh import Cap, Surface
from segmentation.mesh_closing import boundary_loops, close_loops
from segmentation.mesh_repair import (
    choose_component,
    closed_and_oriented,
    edge_map,
    face_components,
    orient,
    signed_volume,
)

# A body inside the lumen that has more than this share of its wall's area may be the lumen's wall itself.
SHELL_SHARE = 0.2
# So many of a component's vertices are asked on which side of the wall they lie.
ASKED = 200


def lumen_wall(vertices: FloatArray, faces: IntArray, near: FloatArray | None, name: str) -> tuple[Surface, list[str]]:
    """The closed wall of one lumen, and what to know of it.

    Parameters
    ----------
    vertices, faces : (n, 3) float array, mm, and (m, 3) int array
        Without degenerate and repeated faces, and with two faces at most at each edge.
    near : (3,) float array, mm, or None
        The component that holds this point is kept, or the nearest; without it the largest.
    name : str
        Of the file, for messages.

    Returns
    -------
    Surface
        The wall; bodies that lie wholly inside it are wall too, their faces towards them.
    list of str
        What was left out, turned or closed, a sentence each.

    Raises
    ------
    SurfaceError
        If no closed two-sided wall can be made of it, or it is not clear which of two is meant.
    """
    count, label = face_components(faces, edge_map(faces))
    kept = choose_component(vertices, faces, label, near) if count > 1 else 0
    surface, notes = closed_wall(*_only(vertices, faces[label == kept]), name)
    if count == 1:
        return surface, notes
    others = [_only(vertices, faces[label == number]) for number in range(count) if number != kept]
    surface, told = _with_bodies(surface, others, near, name)
    return surface, [*told, *notes]


def _only(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """The vertices that the faces use, and the faces on them."""
    used, named = np.unique(faces, return_inverse=True)
    return vertices[used], named.reshape(-1, 3).astype(np.int64)


def _with_bodies(
    surface: Surface, others: list[tuple[FloatArray, IntArray]], near: FloatArray | None, name: str
) -> tuple[Surface, list[str]]:
    """The wall with the bodies that lie inside the lumen; what lies elsewhere is left out and said.

    Raises
    ------
    SurfaceError
        If a large shell lies in the other and no point says which of them is the lumen's wall.
    """
    outside = f"the part kept is {'the largest' if near is None else 'the one at ({:.1f}, {:.1f}, {:.1f})'.format(*near)}"
    shares = _shares_inside(surface, [points for points, _ in others])
    dropped = [len(faces) for (_, faces), share in zip(others, shares, strict=True) if share == 0.0]
    notes, bodies = [], list[Surface]()
    for (points, faces), share in sorted(zip(others, shares, strict=True), key=lambda pair: -len(pair[0][1])):
        if share == 0.0:
            continue
        size, place = float(np.ptp(points, axis=0).max()), ", ".join(f"{x:.1f}" for x in points.mean(axis=0))
        what = f"{len(faces)} faces around ({place}), {size:.1f} mm long"
        if share < 1.0:
            notes.append(f"a component that crosses the wall is left out, join it to the wall if it belongs to it: {what}")
            continue
        if any(_shares_inside(body, [points])[0] > 0.0 for body in bodies):
            dropped.append(len(faces))  # within a body that is wall: no path comes there
            continue
        try:
            body = closed_wall(points, faces, name)[0]
        except SurfaceError:
            notes.append(f"an open sheet inside the lumen is left out, so that a path may run through it: {what}")
            continue
        if near is None and body.face_areas.sum() > SHELL_SHARE * surface.face_areas.sum():
            raise SurfaceError(
                f"{name}: one wall lies inside another ({what}), and either may bound the lumen; "
                "give the start as X,Y,Z in the lumen, or take the other wall out of the mesh"
            )
        bodies.append(body)
        notes.append(f"a body inside the lumen counts as wall, take it out of the mesh if it is noise: {what}")
    if dropped:
        notes.insert(0, f"{len(dropped)} further component(s) with {sum(dropped)} faces dropped; {outside}")
    if not bodies:
        return surface, notes
    starts = np.cumsum([len(surface.vertices), *(len(body.vertices) for body in bodies)])
    inner = [body.faces[:, ::-1] + start for body, start in zip(bodies, starts, strict=False)]
    points = np.concatenate([surface.vertices, *(body.vertices for body in bodies)])
    face_cap = np.concatenate([surface.face_cap, np.full(sum(map(len, inner)), -1, dtype=np.int64)])
    return Surface(points, np.concatenate([surface.faces, *inner]), face_cap, surface.caps, surface.frame), notes


def _shares_inside(surface: Surface, components: list[FloatArray]) -> FloatArray:
    """Share of each component's vertices, of `ASKED` at most, that lie inside the closed surface."""
    low, high = surface.bounds
    asked = [points[:: max(1, len(points) // ASKED)] for points in components]
    owner = np.repeat(np.arange(len(asked)), [len(points) for points in asked])
    every = np.concatenate(asked)
    inside = np.all((every > low) & (every < high), axis=1)
    inside[inside] = igl.fast_winding_number(surface.vertices, surface.faces, every[inside]) > 0.5
    return np.asarray(np.bincount(owner, weights=inside) / np.bincount(owner))


def closed_wall(vertices: FloatArray, faces: IntArray, name: str) -> tuple[Surface, list[str]]:
    """One component made one-sensed, closed by caps where it is open, and turned outward; and what was done.

    Raises
    ------
    SurfaceError
        If it has no inside, or touches itself.
    """
    edges = edge_map(faces)
    faces, turned = orient(vertices, faces, edges, name)
    notes = [f"{turned} faces looked the other way and were turned"] if turned else []
    face_cap: IntArray = np.full(len(faces), -1, dtype=np.int64)
    caps: tuple[Cap, ...] = ()
    if (edges.count == 1).any():
        # Fills follow the faces' sense, so the whole is turned outward before the caps' normals are taken.
        loops = boundary_loops(faces, edges)
        closing = close_loops(vertices, faces, loops, name)
        if signed_volume(closing.vertices, closing.faces) < 0.0:
            faces = faces[:, ::-1]
            closing = close_loops(vertices, faces, [loop[::-1] for loop in loops], name)
        vertices, faces, face_cap, caps = closing.vertices, closing.faces, closing.face_cap, closing.caps
        notes += closing.notes
        if caps:
            named = ", ".join(f"{cap.label} ({cap.area:.1f} mm^2)" for cap in caps)
            notes.append(
                f"{len(caps)} open {'end was' if len(caps) == 1 else 'ends were'} closed by caps, which are not wall: {named}"
            )
    volume = signed_volume(vertices, faces)
    if volume < 0.0:
        faces, volume = faces[:, ::-1], -volume
    corners = vertices[faces]
    area = 0.5 * float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum())
    if volume < 1e-4 * area**1.5:
        raise SurfaceError(
            f"{name}: the mesh encloses {volume:.3g} mm^3 within {area:.3g} mm^2 of faces; "
            "it is a sheet, no tube: give a closed wall"
        )
    if not closed_and_oriented(faces).all():
        raise SurfaceError(f"{name}: the mesh touches itself and cannot be closed two-sidedly; repair it in a mesh editor")
    handles = 1 - (len(np.unique(faces)) - len(faces) // 2) // 2
    if handles:
        notes.append(f"the wall has {handles} handle(s), by a loop or an inner and an outer wall; a tube or tree has none")
    return Surface(vertices, faces, face_cap, caps, "mesh"), notes
