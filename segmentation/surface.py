"""The closed wall of a grown lumen, smoothed, with its caps named and its deviation measured."""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import igl
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import SurfaceError
from segmentation.isosurface import Isosurface, isosurface, outward, signed_volume
from segmentation.mesh import Cap, Surface
from segmentation.region_growing import FACES, Region
from segmentation.surface_smoothing import edges, smoothed
from segmentation.volume import Volume

# The image's face cuts a tube lengthwise when the tube's axis near the cut is less than 30 degrees
# from the face's plane; the axis is that of the wall within this many lengths of the cut.
LENGTHWISE = np.sin(np.radians(30.0))
AXIS_REACH = 2.0

# Of the quadric edge collapse; its default of 7 is quicker and tears thin tubes more often.
AGGRESSIVENESS = 5


@dataclass(frozen=True, kw_only=True)
class SurfaceSettings:
    """How the surface is made.

    Attributes
    ----------
    smoothing_rounds : int
        Rounds of Taubin's filter; 0 leaves the marching cubes as they are.
    pass_band : float
        Taubin's k_PB, smaller is smoother.
    faces_max : int or None
        Reduce the mesh to about this many faces.
    """

    smoothing_rounds: int = 10
    pass_band: float = 0.1
    faces_max: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.smoothing_rounds <= 200 or not 0.0 < self.pass_band < 1.0:
            raise SurfaceError(
                f"smoothing_rounds is {self.smoothing_rounds} and pass_band {self.pass_band:g}, "
                "expected 0 to 200 and between 0 and 1"
            )
        if self.faces_max is not None and self.faces_max < 500:
            raise SurfaceError(f"faces_max is {self.faces_max}, expected at least 500")


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Distances between the final wall and the CT's isosurface, both ways, mm."""

    mean: float
    p95: float
    max: float


@dataclass(frozen=True, eq=False, kw_only=True)
class LumenSurface:
    """A lumen's wall and what the user should know about it."""

    surface: Surface
    deviation: Deviation
    notes: tuple[str, ...]


def lumen_surface(volume: Volume, region: Region, settings: SurfaceSettings) -> LumenSurface:
    """Closed surface of a region in LPS.

    Parameters
    ----------
    volume : Volume
    region : Region
        As grown from `volume`.
    settings : SurfaceSettings

    Raises
    ------
    SurfaceError
        If no closed surface arises.
    """
    raw = isosurface(volume, region)
    notes = []
    if raw.filled_ml > 0:
        notes.append(f"voids of {raw.filled_ml:.3g} ml inside the lumen were filled")
    if region.wall_limits is not None:
        low, high = np.percentile(region.wall_limits[region.mask], [5, 95])
        notes.append(
            f"the wall lies at half maximum between the lumen and the tissue behind it (mostly {low:.0f} to {high:.0f} HU), "
            f"not at the {region.hu_min:.0f} HU that the region was grown with"
        )
    vertices, faces, vertex_plane, dropped = _around_seed(raw, volume.to_lps(region.seed))
    if dropped > 0.01 * volume.voxel_ml * 1000.0:
        notes.append(f"{dropped / 1000.0:.3g} ml that touch the lumen at voxel corners only were left out")
    cap_face = _cap_faces(faces, vertex_plane)
    if not _is_closed(faces):
        raise SurfaceError(
            "the surface is not closed: an edge does not have exactly two faces; grow again with smoothing or another limit"
        )
    points = smoothed(
        vertices,
        faces,
        vertex_plane=vertex_plane,
        planes=raw.planes,
        cap_face=cap_face,
        rounds=settings.smoothing_rounds,
        pass_band=settings.pass_band,
    )
    iso_vertices, iso_wall = vertices, faces[~cap_face]
    if settings.faces_max is not None and len(faces) > settings.faces_max:
        points, faces, vertex_plane = _reduced(points, faces, vertex_plane, raw.planes, settings.faces_max)
        if len(faces) == len(cap_face):
            notes.append(f"the mesh keeps its {len(faces)} faces: reduced to {settings.faces_max} it would not stay closed")
        cap_face = _cap_faces(faces, vertex_plane)
    face_cap, caps = _name_caps(points, faces, vertex_plane, raw.planes, notes)
    surface = Surface(vertices=points, faces=faces, face_cap=face_cap, caps=caps, frame="LPS")
    tunnels = (2 - (len(points) - len(edges(faces)) // 2 + len(faces))) // 2
    if tunnels:
        notes.append(
            f"the wall has {tunnels} tunnel{'s' if tunnels > 1 else ''} "
            f"(Euler number {2 - 2 * tunnels}): a path may run round it on either side"
        )
    return LumenSurface(
        surface=surface, deviation=_deviation(points, surface.wall_faces, iso_vertices, iso_wall), notes=tuple(notes)
    )


def _around_seed(raw: Isosurface, seed: FloatArray) -> tuple[FloatArray, IntArray, IntArray, float]:
    """The one component around the seed, and the volume in mm^3 of the other solid ones."""
    count = len(raw.vertices)
    pairs = edges(raw.faces)
    graph = coo_matrix((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    parts, label = connected_components(graph, directed=False)
    vertices, faces, vertex_plane, dropped = raw.vertices, raw.faces, raw.vertex_plane, 0.0
    if parts > 1:
        volumes = np.array([signed_volume(vertices, faces[label[faces[:, 0]] == part]) for part in range(parts)])
        around = [
            part
            for part in np.flatnonzero(volumes > 0)
            if igl.winding_number(vertices, faces[label[faces[:, 0]] == part], np.atleast_2d(seed))[0] > 0.5
        ]
        if not around:
            raise SurfaceError("no closed surface lies around the seed; grow again with other limits")
        chosen = min(around, key=lambda part: volumes[part])
        dropped = float(sum(volumes[part] for part in np.flatnonzero(volumes > 0) if part != chosen))
        faces = faces[label[faces[:, 0]] == chosen]
    used, faces = np.unique(faces, return_inverse=True)
    faces = outward(vertices[used], faces.reshape(-1, 3).astype(np.int64))
    return vertices[used], faces, vertex_plane[used], dropped


def _is_closed(faces: IntArray) -> bool:
    """Whether every edge is walked once in each direction: closed, edge-manifold and consistently oriented."""
    pairs = edges(faces)
    count = int(pairs.max()) + 1
    forth = np.sort(pairs[:, 0] * count + pairs[:, 1])
    back = np.sort(pairs[:, 1] * count + pairs[:, 0])
    return bool(np.all(forth[1:] != forth[:-1]) and np.array_equal(forth, back))


def _cap_faces(faces: IntArray, vertex_plane: IntArray) -> BoolArray:
    """Faces with all corners on one face of the image."""
    return np.asarray((vertex_plane[faces[:, 0]] & vertex_plane[faces[:, 1]] & vertex_plane[faces[:, 2]]) > 0)


def _name_caps(
    points: FloatArray, faces: IntArray, vertex_plane: IntArray, planes: FloatArray, notes: list[str]
) -> tuple[IntArray, tuple[Cap, ...]]:
    """Connected flat patches on the image's faces as caps C1, C2, ... by falling area; adds a note on each."""
    shared = vertex_plane[faces[:, 0]] & vertex_plane[faces[:, 1]] & vertex_plane[faces[:, 2]]
    found = []
    for plane in range(len(planes)):
        members = np.flatnonzero((shared >> plane) & 1)
        if len(members) == 0:
            continue
        pairs = edges(faces[members])
        graph = coo_matrix((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
        label = connected_components(graph, directed=False)[1][faces[members, 0]]
        for part in np.unique(label):
            patch = members[label == part]
            areas = _areas(points, faces[patch])
            found.append((float(areas.sum()), plane, patch, np.average(points[faces[patch]].mean(axis=1), axis=0, weights=areas)))
    face_cap = np.full(len(faces), -1, dtype=np.int64)
    caps = []
    for number, (area, plane, patch, center) in enumerate(sorted(found, key=lambda item: -item[0])):
        face_cap[patch] = number
        label_text = f"C{number + 1}"
        caps.append(Cap(label=label_text, origin="image border", center=center, normal=planes[plane], area=area))
        name = [name for pair in FACES for name in pair][plane]
        long, along = _lie(points, faces, patch, center)
        if abs(float(along @ planes[plane])) < LENGTHWISE:
            notes.append(
                f"{label_text}: the image border ({name}) cuts the lumen lengthwise over {long:.0f} mm ({area:.0f} mm²); "
                "the wall beyond it is not in the image and the clearance towards it is unknown"
            )
        else:
            notes.append(
                f"{label_text}: the image border ({name}) cuts the lumen across ({area:.0f} mm²); closed there by a flat cap"
            )
    return face_cap, tuple(caps)


def _lie(points: FloatArray, faces: IntArray, patch: IntArray, center: FloatArray) -> tuple[float, FloatArray]:
    """Longest extent of a cap in mm, and the unit axis of the tube around it."""
    rim = points[np.unique(faces[patch])]
    _, _, axes = np.linalg.svd(rim - rim.mean(axis=0), full_matrices=False)
    long = float(np.ptp(rim @ axes[0]))
    near = points[np.linalg.norm(points - center, axis=1) <= AXIS_REACH * long]
    _, _, axes = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)
    return long, axes[0]


def _reduced(
    points: FloatArray, faces: IntArray, vertex_plane: IntArray, planes: FloatArray, faces_max: int
) -> tuple[FloatArray, IntArray, IntArray]:
    """The mesh with about `faces_max` faces by edge collapse, still closed and with flat caps; unchanged if that fails."""
    center = points.mean(axis=0)
    share = 1.0 - faces_max / len(faces)
    small, few = fast_simplification.simplify(
        (points - center).astype(np.float32), faces.astype(np.int32), share, agg=AGGRESSIVENESS
    )
    small, few = small.astype(np.float64) + center, few.astype(np.int64)
    used, few = np.unique(few, return_inverse=True)
    small, few = small[used], few.reshape(-1, 3).astype(np.int64)
    held = np.zeros(len(small), dtype=np.int64)
    edge = float(np.sqrt(_areas(points, faces).mean()))
    for number, normal in enumerate(planes):
        before = (vertex_plane >> number) & 1 > 0
        if before.any():
            away = (small - points[before].mean(axis=0)) @ normal
            # The collapse puts a rim vertex a little off the plane; the next ring of the wall is an edge away.
            near = np.abs(away) < 0.25 * edge
            small[near] -= np.outer(away[near], normal)
            held[near] |= 1 << number
    return (small, few, held) if _is_closed(few) else (points, faces, vertex_plane)


def _areas(points: FloatArray, faces: IntArray) -> FloatArray:
    """Area of each face, mm^2."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _deviation(points: FloatArray, wall: IntArray, iso_vertices: FloatArray, iso_wall: IntArray) -> Deviation:
    """Two-sided distances between the walls: vertices and face centres of each to the triangles of the other."""
    distances = []
    for (v, f), (w, g) in (((points, wall), (iso_vertices, iso_wall)), ((iso_vertices, iso_wall), (points, wall))):
        sample = np.concatenate([v[np.unique(f)], v[f].mean(axis=1)])
        square = igl.point_mesh_squared_distance(sample, w, g)[0]
        distances.append(np.sqrt(np.maximum(square, 0.0)))
    every = np.concatenate(distances)
    return Deviation(mean=float(every.mean()), p95=float(np.percentile(every, 95)), max=float(every.max()))
