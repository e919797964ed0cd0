"""tubeplan bench centerline: the Voronoi centerline against exact axes."""

from __future__ import annotations

import time
from typing import get_args

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.bench.models import Meshing, Model, bent_cylinder_1
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.centerline import trace_centerline, voronoi_graph
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.pipeline import Notify

# Measured on a 2-core machine on 20 000 faces: VMTK 1.5.2, raw line.
VMTK_SECONDS = 3.0
VMTK_ERROR = 0.006
# Away from the ends, where the line leaves the axis for the picked point.
END_LENGTH = 5.0


def centerline(*, quick: bool, notify: Notify) -> list[Row]:
    """Error of line and radius on cylinder 1, for each way of meshing it."""
    kinds = get_args(Meshing)
    rows: list[Row] = []
    for kind in kinds[:2] if quick else kinds:
        notify(kind, 0, 0)
        rows += centerline_rows(f"cylinder 1, {kind.replace('_', ' ')}", bent_cylinder_1(meshing=kind))
    return rows


def centerline_rows(case: str, model: Model) -> list[Row]:
    """Rows of one mesh."""
    begun = time.perf_counter()
    wall = WallDistance(model.surface)
    line = trace_centerline(voronoi_graph(model.surface, wall), wall, model.start, model.goal)
    seconds = time.perf_counter() - begun
    assert line is not None
    s = line.arc_length
    interior = (s > END_LENGTH) & (s < s[-1] - END_LENGTH)
    gap, clearance = off_axis(line.points[interior], model)
    radius_error = np.abs(line.radii[interior] - clearance)
    inside = wall.inside(line.points)
    return [
        Row(
            case=case,
            figure="interior error mm, mean",
            ours=float(gap.mean()),
            reference=VMTK_ERROR,
            source="VMTK 1.5.2, raw",
            target="under 0.02",
            holds=bool(gap.mean() < 0.02),
        ),
        Row(case=case, figure="interior error mm, largest", ours=float(gap.max())),
        Row(
            case=case,
            figure="radius error mm, mean",
            ours=float(radius_error.mean()),
            target="under 0.02",
            holds=bool(radius_error.mean() < 0.02),
        ),
        Row(case=case, figure="points inside %", ours=100.0 * float(inside.mean()), target="100", holds=bool(inside.all())),
        Row(case=case, figure="time s", ours=seconds, reference=VMTK_SECONDS, source="VMTK 1.5.2, 2 cores"),
    ]


def off_axis(points: FloatArray, model: Model) -> tuple[FloatArray, FloatArray]:
    """Distance of (n, 3) points to the exact axis, and the axis' own clearance at the foot: both (n,) mm."""
    nearest = cKDTree(model.axis_points).query(points)[1]
    gap, clearance = np.full(len(points), np.inf), np.empty(len(points))
    for first in (nearest - 1, nearest):
        # The axis points are 0.1 mm apart; the nearest lies on one of the two pieces beside it.
        i = np.clip(first, 0, len(model.axis_points) - 2)
        a, piece = model.axis_points[i], model.axis_points[i + 1] - model.axis_points[i]
        share = np.clip(np.einsum("ij,ij->i", points - a, piece) / np.einsum("ij,ij->i", piece, piece), 0.0, 1.0)
        found = np.linalg.norm(a + share[:, None] * piece - points, axis=1)
        there = (1.0 - share) * model.clearance[i] + share * model.clearance[i + 1]
        gap, clearance = np.where(found < gap, found, gap), np.where(found < gap, there, clearance)
    return gap, clearance
