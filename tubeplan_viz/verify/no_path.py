"""A run's claim that no path passes a bend, held against samples of the cross-sections that it rests on."""

# Strategy: the claim names three or more cross-sections that a path meets in order, and says that of points of them with the
# clearance stated, one of each, some three neighbours lie on a circle smaller than the least bend radius. A circle's radius is
# all that is used of the argument: points on each disc, those of that clearance by the verifier's own distance, and the choice
# of them whose smallest circle is largest. One that is large enough refutes the claim; so does a path of the run itself.

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.profile import ON_SURFACE_MM, OwnProfile
from tubeplan_viz.verify.verification import Check
from tubeplan_viz.verify.wall import Lumen

# Points on a disc, along a spiral, and how many of those with the clearance are kept, spread over them.
SPIRAL = 4000
# Points of a spiral lie so many times the square root of the area of each apart at most.
GAP = 2.0
KEPT = 160
# The bound is closed to a few thousandths and the surface's file has single precision.
SLACK = 1e-3


def check_no_path(result: Mapping[str, Any], own: OwnProfile, lumen: Lumen) -> Iterator[Check]:
    """The bend of ``details.bottleneck.bend``, where the run states one."""
    bend = (result["details"].get("bottleneck") or {}).get("bend")
    if not bend:
        return
    bound, limit = float(bend["clearance_upper_bound_mm"]), float(bend["curvature_max_per_mm"])
    keeps = bool(own.curvature.max() <= limit and own.clearance.min() >= bound)
    yield Check(
        name="no path: the run's own path",
        ok=not keeps,
        found=f"{own.clearance.min():.3f} mm at {own.curvature.max():.4f} 1/mm",
        expected=f"less than {bound:.3f} mm, or more than {limit:g} 1/mm",
        text="The path shown does not keep what is said to be out of reach.",
    )
    rooms = [room(section, lumen, bound) for section in bend["sections"]]
    largest = max_circle(rooms)
    yield Check(
        name="no path: the bend",
        ok=largest <= (1.0 + SLACK) / limit,
        found=f"{largest:.3f} mm",
        expected=f"at most {1.0 / limit:.3f} mm",
        text="Largest circle through points of neighbouring cross-sections of the bend that have the clearance stated.",
    )


def room(section: Mapping[str, Any], lumen: Lumen, clearance: float) -> FloatArray:
    """Points of a cross-section with the clearance that hang together about its middle, (k, 3); an end stands for itself."""
    middle, normal = np.array(section["point_mm"], dtype=float), np.array(section["normal"], dtype=float)
    radius = float(section["radius_mm"])
    if radius == 0.0:
        return middle[None]
    side = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    side /= np.linalg.norm(side)
    k = np.arange(SPIRAL) + 0.5
    angle, out = np.pi * (1.0 + np.sqrt(5.0)) * k, radius * np.sqrt(k / SPIRAL)
    points = middle + (out * np.cos(angle))[:, None] * side + (out * np.sin(angle))[:, None] * np.cross(normal, side)
    # Neighbours in the file of samples are to be neighbours in space.
    points = points[np.lexsort((out, np.floor(angle % (2.0 * np.pi) * 8.0 / np.pi)))]
    points = points[lumen.clearance(points, on_surface=ON_SURFACE_MM)[0] >= clearance]
    if not len(points):
        return points
    pairs = cKDTree(points).query_pairs(GAP * radius * np.sqrt(np.pi / SPIRAL), output_type="ndarray")
    graph = csr_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    part = connected_components(graph, directed=False)[1]
    points = points[part == part[int(np.argmin(np.linalg.norm(points - middle, axis=1)))]]
    return np.asarray(points[np.linspace(0, len(points) - 1, min(KEPT, len(points))).astype(int)])


def max_circle(rooms: list[FloatArray]) -> float:
    """Radius of the smallest circle through three neighbouring points, mm, for one point of each set chosen to make it largest.

    Its arc passes the middle one by less than half a turn.
    """
    if not all(len(room) for room in rooms):
        return 0.0
    kept = np.full((len(rooms[0]), len(rooms[1])), np.inf)
    for one, two, three in zip(rooms, rooms[1:], rooms[2:], strict=False):
        largest = np.zeros((len(two), len(three)))
        for p, before in zip(one, kept, strict=True):
            a, b = two[:, None] - p, three[None] - two[:, None]
            across = np.linalg.norm(np.cross(a, b), axis=2)
            lengths = np.linalg.norm(a, axis=2) * np.linalg.norm(b, axis=2)
            radius = 0.5 * lengths * np.linalg.norm(three - p, axis=1) / np.maximum(across, 1e-12)
            forward = np.einsum("ijk,ijk->ij", np.broadcast_to(a, b.shape), b) > 0.0
            largest = np.maximum(largest, np.where(forward, np.minimum(radius, before[:, None]), 0.0))
        kept = largest
    return float(kept.max())
