"""The turnable scene of a rigid plan: nasal cavity as glass, structures in their colours, starts, instrument on its path."""

# Strategy: the script draws meshes and knows nothing of noses. Masks become light surfaces within a box around the way, so
# that no face is shown; shaver and endoscope are two solids of revolution in their own axes (x ahead, y towards the
# endoscope), which the script puts on the path's points with one turn for each straight segment.

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from markupsafe import Markup
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from reports.rigid_drawings import LABEL_COLORS, SHOWN_BEHIND_MM, place_in_the_way
from reports.still import Dots, Label, Solid, View, still_picture
from reports.turnable import rounded, turnable
from reports.wall import LightMesh, light_mesh
from segmentation.anatomy.nasal import NasalScene, inner_air
from segmentation.arrays import BoolArray, FloatArray
from segmentation.mesh import Surface
from segmentation.volume import Volume

BESIDE_MM = 18.0  # of the way and the starts: what lies farther is not drawn
CAVITY_FACES = 12_000
STRUCTURE_FACES = 3_000
SMOOTHING_MM = 0.8  # of the masks' steps, half a usual voxel; for drawing only
AROUND, RING_MM = 20, 3.0  # corners of a circle, and distance between circles along a shaft
SEEN = 20  # of so many corners of a structure one counts for how large the scene is drawn
SIGHT_RADIUS_MM = 0.2
SCOPE, SHAVER, SIGHT, FEASIBLE, REFUSED = "--run-4", "--ink-3", "--clearance", "--holds", "--ink-3"


@dataclass(frozen=True, eq=False)
class Picture:
    """The scene to stand still and to be turned."""

    still: Markup
    scene: Mapping[str, Any]


def rigid_scene(result: Mapping[str, Any], head: NasalScene, ramp: tuple[float, float] | None, start: int) -> Picture:
    """The scene of a page.

    Parameters
    ----------
    result : mapping
        The content of result.json.
    head : NasalScene
        As planned with, after shrinkage.
    ramp : (float, float) or None
        Clearance drawn as tight and as roomy, mm.
    start : int
        Sample of the path at which instrument and cursor stand first.
    """
    details, path = result["details"], result["path"]
    goal = np.array(details["goal_mm"], float)
    starts, feasible = np.array(details["entry"]["points_mm"], float), np.array(details["entry"]["feasible"], bool)
    points = np.empty((0, 3)) if path is None else np.array(path["points_mm"], float)
    extent = np.vstack([goal, starts, points])
    window = box_around(head.volume, extent)
    cavity = surface_of(inner_air(head), head.volume, window, faces=CAVITY_FACES)
    bodies = {
        name: made
        for name, mask in head.structures.items()
        if (made := surface_of(mask, head.volume, window, faces=STRUCTURE_FACES)) is not None
    }
    # What is fitted into the picture: the cavity, and places of all else, which belong to no face.
    around = cavity if cavity is not None else LightMesh(np.empty((0, 3)), np.empty((0, 3), np.int64), 0)
    beside = [body.vertices[::SEEN] for body in bodies.values()]
    glass = LightMesh(np.vstack([around.vertices, extent, *beside]), around.faces, around.planned)
    parts = None if path is None else instrument_parts(details["instrument"], float(path["s_mm"][-1]))
    poses = [] if path is None else poses_of(result)
    labels = labels_of(result, points, start)
    view, aside = views_of(str(details["side"]))
    words = "nasal cavity and the structures to keep clear of, entry voxels" + (
        "" if path is None else ", path to the lesion, endoscope and shaver"
    )
    solids = [Solid(mesh, LABEL_COLORS[name], dense=False) for name, mesh in bodies.items()]
    if parts is not None:
        along, up = next((along, up) for last, along, up in poses if start <= last)
        solids += [Solid(moved(mesh, points[start], along, up), STILL_COLORS[color], dense=True) for color, mesh in parts]
    dots = [Dots(starts[rows], name) for rows, name in ((~feasible, "rigid-closed"), (feasible, "rigid-open")) if rows.any()]
    still = still_picture(glass, points, (), labels, aside, f"In the head: {words}.", solids=solids, dots=dots)
    worst = details.get("worst")
    scene = turnable(glass, view, labels, start=start, ramp=ramp, words=words, aside=aside) | {
        "bodies": [{"mesh": mesh.packed(), "colour": LABEL_COLORS[name]} for name, mesh in bodies.items()],
        "dots": [
            {"points": LightMesh(starts[rows], np.empty((0, 3), np.int64), 0).packed(), "colour": color, "radius": radius}
            for rows, color, radius in ((~feasible, REFUSED, 0.3), (feasible, FEASIBLE, 0.4))
            if rows.any()
        ],
        "tool": None
        if parts is None
        else {
            "parts": [{"mesh": mesh.packed(), "colour": color} for color, mesh in parts],
            "poses": [{"last": last, "along": rounded(along), "up": rounded(up)} for last, along, up in poses],
        },
        "features": [] if worst is None else [{"kind": "clearance", "point": worst["place_mm"], "s": worst["s_mm"]}],
        "parts": nearest_stretches(result),
    }
    return Picture(still, scene)


STILL_COLORS = {SCOPE: "#2b8fa3", SHAVER: "#7d8790", SIGHT: "#d08a14"}  # of the light page; a picture has one set of colours


def views_of(side: str) -> tuple[View, View]:
    """From the front, and from the patient's side of the operation, a little in front and above: where the scene opens."""
    outwards = 1.0 if side == "left" else -1.0
    up = np.array([0.0, 0.0, 1.0])
    return View(unit(np.array([0.18 * outwards, -1.0, 0.1])), up), View(unit(np.array([outwards, -0.55, 0.22])), up)


def unit(vector: FloatArray) -> FloatArray:
    """A vector of length 1."""
    return np.asarray(vector / np.linalg.norm(vector))


def box_around(volume: Volume, points: FloatArray) -> tuple[slice, slice, slice]:
    """Index box of what lies within `BESIDE_MM` of the points' own box."""
    low, high = points.min(axis=0) - BESIDE_MM, points.max(axis=0) + BESIDE_MM
    corners = np.stack(np.meshgrid(*np.column_stack([low, high]), indexing="ij"), axis=-1).reshape(-1, 3)
    index = volume.to_index(corners)
    first = np.clip(np.floor(index.min(axis=0)).astype(int), 0, volume.voxels.shape)
    last = np.clip(np.ceil(index.max(axis=0)).astype(int) + 1, first, volume.voxels.shape)
    return tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))  # type: ignore[return-value]


def surface_of(mask: BoolArray, volume: Volume, window: tuple[slice, slice, slice], *, faces: int) -> LightMesh | None:
    """The surface of a mask within a box, open where the box cuts it; None where there is none."""
    # Within the array a layer beside the box ends what the image ends; the box itself leaves the surface open.
    field = gaussian_filter(mask[window].astype(np.float32), SMOOTHING_MM / volume.spacing)
    if min(field.shape) < 2 or not field.min() < 0.5 < field.max():
        return None
    vertices, triangles, *_ = marching_cubes(field, 0.5)
    points = volume.to_lps(vertices + [part.start for part in window])
    surface = Surface(points, triangles.astype(np.int64), np.full(len(triangles), -1), frame="LPS")
    return light_mesh(surface, faces=faces)


def instrument_parts(tool: Mapping[str, Any], run: float) -> tuple[tuple[str, LightMesh], ...]:
    """Shaver, endoscope and line of sight in the instrument's own axes, each with its colour; shafts are cut outside the nose."""
    shaver, scope = 0.5 * tool["shaver_diameter_mm"], 0.5 * tool["scope_diameter_mm"]
    back = -(SHOWN_BEHIND_MM + run)
    front = -float(tool["setback_mm"])
    ball = np.linspace(0.0, 0.5 * np.pi, 6)
    round_end = np.column_stack([-shaver + shaver * np.sin(ball), shaver * np.cos(ball)])
    angle = np.radians(tool["view_angle_deg"])
    sight = revolved(np.array([[0.0, 0.0], [0.0, SIGHT_RADIUS_MM], [tool_reach(tool), SIGHT_RADIUS_MM], [tool_reach(tool), 0.0]]))
    # The view leans from the endoscope's axis towards the shaver, which lies below it.
    turn = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    lens = np.array([front, tool["offset_mm"], 0.0])
    return (
        (SHAVER, revolved(np.vstack([shaft(back, -shaver, shaver), round_end]))),
        (SCOPE, shifted(revolved(np.vstack([shaft(back, front, scope), [front, 0.0]])), lens * [0.0, 1.0, 1.0])),
        (SIGHT, LightMesh(sight.vertices @ turn.T + lens, sight.faces, sight.planned)),
    )


def shaft(back: float, front: float, radius: float) -> FloatArray:
    """Profile of a cylinder with a closed rear, in pieces short enough for triangles to be filled evenly, (k, 2)."""
    x = np.linspace(back, front, int(np.ceil((front - back) / RING_MM)) + 1)
    return np.vstack([[back, 0.0], np.column_stack([x, np.full(len(x), radius)])])


def tool_reach(tool: Mapping[str, Any]) -> float:
    """The working distance, from the endoscope's front centre to the shaver's tip, mm."""
    return float(np.hypot(tool["offset_mm"], tool["setback_mm"]))


def revolved(profile: FloatArray) -> LightMesh:
    """The solid between a profile (x, radius), from rear to front, and the x axis."""
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    rings = np.stack(
        [
            np.repeat(profile[:, :1], AROUND, axis=1),
            profile[:, 1:] * np.cos(angle)[None],
            profile[:, 1:] * np.sin(angle)[None],
        ],
        axis=-1,
    )  # (k, AROUND, 3)
    index = np.arange(rings.shape[0] * AROUND).reshape(-1, AROUND)
    a, b = index[:-1], index[1:]
    after = np.roll(index, -1, axis=1)
    c, d = after[:-1], after[1:]
    faces = np.concatenate([np.stack([a, c, b], axis=-1).reshape(-1, 3), np.stack([b, c, d], axis=-1).reshape(-1, 3)])
    return LightMesh(rings.reshape(-1, 3), faces, len(faces))


def shifted(mesh: LightMesh, by: FloatArray) -> LightMesh:
    """A mesh moved."""
    return LightMesh(mesh.vertices + by, mesh.faces, mesh.planned)


def moved(mesh: LightMesh, place: FloatArray, along: FloatArray, up: FloatArray) -> LightMesh:
    """A mesh of the instrument's own axes, in the head."""
    return LightMesh(mesh.vertices @ np.stack([along, up, np.cross(along, up)]) + place, mesh.faces, mesh.planned)


def poses_of(result: Mapping[str, Any]) -> list[tuple[int, FloatArray, FloatArray]]:
    """For every straight segment: its last sample of the path, its direction, and where the endoscope lies."""
    arc = np.array(result["path"]["s_mm"], float)
    ends = [float(feature["s_mm"]) for feature in result["feature_points"][1:]]
    nodes = result["details"]["nodes"]
    made = [
        (int(np.searchsorted(arc, end - 1e-6)), np.array(node["direction"], float), np.array(node["up"], float))
        for end, node in zip(ends, nodes, strict=True)
    ]
    return [*made[:-1], (len(arc) - 1, *made[-1][1:])]


def labels_of(result: Mapping[str, Any], points: FloatArray, start: int) -> list[Label]:
    """Lesion, start and the tightest place; without a path what stands in the way nearest to the lesion."""
    details = result["details"]
    labels = [Label(np.array(details["goal_mm"], float), "Lesion", "goal", 0)]
    if not len(points):
        found = place_in_the_way(details)
        return labels if found is None else [*labels, Label(found[1], f"{found[0]} in the way", "clearance", 1)]
    labels.append(Label(points[0], "Start", "start", 2))
    worst = details.get("worst")
    if worst is not None:
        told = f"{worst['distance_mm']:.2f} mm to the {worst['structure'].replace('_', ' ')}"
        labels.append(Label(np.array(worst["place_mm"], float), told, "clearance", 1))
    return labels


def nearest_stretches(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Stretches of the path by the structure that the instrument is nearest to, as the script's readout names them."""
    told, path = result["details"].get("structure_distances_mm") or {}, result["path"]
    if path is None or not told:
        return []
    names = list(told)
    values = np.array([[np.inf if v is None else v for v in told[name]] for name in names], float)
    nearest = values.argmin(axis=0)
    arc = path["s_mm"]
    cuts = np.concatenate([[0], np.flatnonzero(np.diff(nearest)) + 1, [len(nearest)]])
    return [
        {"name": f"nearest: {names[nearest[a]].replace('_', ' ')}", "from": arc[a], "to": arc[min(b, len(arc) - 1)]}
        for a, b in pairwise(cuts.tolist())
    ]
