"""A needle's obstacles with their safety shells as things of the recording's scene."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import rerun as rr

from segmentation.arrays import FloatArray
from tubeplan_viz.needle.bodies import Capsule, MeshObstacle, Obstacle, Polygon, Sphere, body_distance
from tubeplan_viz.needle.shape import level_surface

BODY, SHELL = (205, 110, 95), (205, 110, 95, 45)
BESIDE_MM = 30.0  # of an obstacle from a file is shown beside entry and target


def shapes(body: Obstacle, safety: float, ends: FloatArray) -> list[tuple[str, Any]]:
    """An obstacle and its safety shell, each with the end of its entity's name.

    Parameters
    ----------
    body : Obstacle
    safety : float, mm
    ends : (2, 3) float array, mm
        Entry and target: of a label volume or mesh the part beside them is shown.
    """
    made = _shapes(body, safety, ends)
    return made if safety > 0.0 else made[:1]


def _shapes(body: Obstacle, safety: float, ends: FloatArray) -> list[tuple[str, Any]]:
    if isinstance(body, Sphere):
        made = []
        for suffix, size, color in (("", body.radius, (*BODY, 255)), ("/shell", body.radius + safety, SHELL)):
            half = [(1e-3 if body.kind == "circle" else size, size, size)]
            made.append((suffix, rr.Ellipsoids3D(centers=[body.center], half_sizes=half, colors=[color], fill_mode="solid")))
        return made
    if isinstance(body, Polygon):
        ring = np.column_stack([np.zeros(len(body.corners) + 1), np.vstack([body.corners, body.corners[:1]])])
        return [
            ("", rr.LineStrips3D([ring], colors=BODY, radii=rr.Radius.ui_points(2.0))),
            ("/shell", rr.LineStrips3D([ring], colors=[SHELL], radii=safety)),
        ]
    place, beside = (body.points, body.radius + safety + 3.0) if isinstance(body, Capsule) else (ends, BESIDE_MM)
    distance = partial(body_distance, body)
    if isinstance(body, MeshObstacle):
        whole = (body.surface.vertices, body.surface.faces)
    else:
        whole = level_surface(distance, place, beside=beside)
    around = level_surface(distance, place, beside=beside, level=safety)
    return [
        (suffix, rr.Mesh3D(vertex_positions=vertices, triangle_indices=faces, albedo_factor=color))
        for suffix, (vertices, faces), color in (("", whole, (*BODY, 210)), ("/shell", around, SHELL))
        if len(faces)
    ]
