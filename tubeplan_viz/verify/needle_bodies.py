"""What a needle keeps away from, built again from case.toml: distances by the plainest means there are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from segmentation.images import read_ct
from segmentation.mesh_files import read_surface
from segmentation.volume_files import read_volume_file
from tubeplan_viz.verify.wall import Lumen, Triangles

Distance = Callable[[FloatArray], FloatArray]
EVERY = 10  # of the places along a path is asked of a mesh
TISSUE_HU = -300.0
OUTSIDE_MM = 3.0


def place(values: Any) -> FloatArray:
    """A place of the case in space: (y, z) is (0, y, z)."""
    return np.array(values if len(values) == 3 else [0.0, *values], dtype=float)


def located(name: str, folder: Path) -> Path:
    """A file of case.toml, which is relative to the run folder."""
    file = Path(name)
    return file if file.is_absolute() else folder.resolve() / file


def distance_to(row: Mapping[str, Any], folder: Path, spacing: float) -> Distance:
    """The distance, mm, of (k, 3) points along a path to one obstacle of the case file, negative inside.

    `spacing` is that of the points, mm: a mesh is asked for every tenth of them, and the way between is taken off.
    """
    kind = row["kind"]
    if kind in ("sphere", "circle"):
        return lambda points: np.asarray(np.linalg.norm(points - place(row["center"]), axis=1) - row["radius_mm"])
    if kind == "capsule":
        line = np.array(row["points"], float)
        return lambda points: along_lines(points, line, closed=False) - row["radius_mm"]
    if kind == "polygon":
        corners = np.array(row["points"], float)
        return lambda points: (
            along_lines(points[:, 1:], corners, closed=True) * np.where(wound(points[:, 1:], corners), -1.0, 1.0)
        )
    if kind == "mesh":
        surface = read_surface(located(row["file"], folder)).surface
        lumen = Lumen(Triangles(surface.vertices[surface.faces]), Triangles(np.zeros((0, 3, 3))))

        def to_mesh(points: FloatArray) -> FloatArray:
            gap, inside = lumen.clearance(points[::EVERY], on_surface=0.0)
            near = np.where(inside, -np.abs(gap), np.abs(gap)) - 0.5 * EVERY * spacing
            return np.asarray(np.repeat(near, EVERY)[: len(points)])

        return to_mesh
    return to_voxels(row, located(row["file"], folder))


def along_lines(points: FloatArray, corners: FloatArray, *, closed: bool) -> FloatArray:
    """Distance of points to a polyline."""
    best = np.full(len(points), np.inf)
    pairs = zip(corners if closed else corners[:-1], np.roll(corners, -1, axis=0) if closed else corners[1:], strict=True)
    for a, b in pairs:
        share = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-300), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return best


def wound(points: FloatArray, corners: FloatArray) -> Any:
    """Whether a polygon goes round points: its corners' directions turn by a whole number of turns that is not 0."""
    way = np.arctan2(corners[:, 1] - points[:, 1:2], corners[:, 0] - points[:, 0:1])
    turns = np.mod(np.diff(way, axis=1, append=way[:, :1]) + np.pi, 2.0 * np.pi) - np.pi
    return np.abs(turns.sum(axis=1)) > np.pi


def to_voxels(row: Mapping[str, Any], file: Path) -> Distance:
    """Distance to the boxes of the obstacle's voxels: the nearest of all whose centre could be it."""
    if "hu_min" in row:
        volume = read_ct(file, series=row.get("series")).volume
        hu, matrix = np.asarray(volume.voxels), volume.index_to_lps
        voxels = (hu >= row["hu_min"]) & (hu <= row.get("hu_max", np.inf))
    else:
        labels = read_volume_file(file)
        voxels, matrix = np.asarray(labels.voxels) > 0, labels.index_to_lps
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    inverse = np.linalg.inv(matrix)
    if "seed_point" in row:
        seed = np.round(inverse[:3, :3] @ np.array(row["seed_point"], float) + inverse[:3, 3]).astype(int)
        grown = np.zeros_like(voxels)
        grown[tuple(seed)] = True
        voxels = ndimage.binary_propagation(grown, structure=np.ones((3, 3, 3)), mask=voxels)
    centers = np.argwhere(voxels) * spacing
    tree = cKDTree(centers)
    diagonal = float(np.linalg.norm(spacing))

    def distance(points: FloatArray) -> FloatArray:
        here = (points @ inverse[:3, :3].T + inverse[:3, 3]) * spacing
        nearest = tree.query(here)[0]
        found = np.maximum(nearest - 0.5 * diagonal, 0.0)
        # Where that bound is not enough to tell, the boxes themselves.
        for k in np.flatnonzero(found < 3.0 * diagonal):
            near = centers[tree.query_ball_point(here[k], nearest[k] + diagonal)]
            found[k] = np.linalg.norm(np.maximum(np.abs(near - here[k]) - 0.5 * spacing, 0.0), axis=1).min()
        return np.asarray(found)

    return distance


def at_skin(file: Path, series: str | None, entry: FloatArray, direction: FloatArray) -> tuple[bool, str]:
    """Whether air and tissue meet at an entry: tissue within a voxel of it, air before it; and what was found."""
    volume = read_ct(file, series=series).volume
    hu, matrix = np.asarray(volume.voxels), np.asarray(volume.index_to_lps)
    inverse = np.linalg.inv(matrix)
    diagonal = float(np.linalg.norm(np.linalg.norm(matrix[:3, :3], axis=0)))
    way = direction / np.linalg.norm(direction)

    def values(places: FloatArray) -> FloatArray:
        index = np.round(places @ inverse[:3, :3].T + inverse[:3, 3]).astype(int)
        held = np.clip(index, 0, np.array(hu.shape) - 1)
        inside = (held == index).all(axis=1)
        return np.where(inside, hu[tuple(held.T)], -1024.0)

    inward = values(entry + np.arange(0.0, diagonal + 0.1, 0.1)[:, None] * way)
    outward = values(entry - np.arange(diagonal, diagonal + OUTSIDE_MM, 0.1)[:, None] * way)
    found = f"up to {inward.max():.0f} HU within {diagonal:.1f} mm behind it, up to {outward.max():.0f} HU before it"
    return bool(inward.max() >= TISSUE_HU and outward.max() < TISSUE_HU), found
