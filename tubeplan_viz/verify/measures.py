"""Clinical measures computed again from mesh.ply, the path and the middle lines of result.json.

# Strategy: the product measures by balls found with a distance query, and by edges in the CT. Here the hollow is filled
# with voxels, whose distance transform gives pelvis and lips, and cross-sections come from rays in a plane of the mesh.
# Mesh and CT differ by up to half a millimetre a side where organs lie side by side, and voxels are 0.5 mm: the limits
# are what that makes of each measure, and are stated in each check.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from tubeplan_viz.verify.hollow import Planes, filled
from tubeplan_viz.verify.measure_words import check_scores, check_stones
from tubeplan_viz.verify.measures_airway import check_airway
from tubeplan_viz.verify.measures_compared import Items, compared
from tubeplan_viz.verify.measures_urinary import check_urinary
from tubeplan_viz.verify.mesh_file import MeshFile
from tubeplan_viz.verify.profile import OwnProfile
from tubeplan_viz.verify.verification import Check

SHARE = 0.002  # of a path's own measures, which need no image


def check_measures(result: Mapping[str, Any], case: Mapping[str, Any] | None, mesh: MeshFile, own: OwnProfile) -> Iterator[Check]:
    """All checks of ``details.measures``; none for a run without it."""
    told = result["details"].get("measures")
    if not told:
        return
    items = {(item["key"], item["of"]): item["value"] for item in told["items"] if item["value"] is not None}
    yield from check_path_measures(items, result, own)
    if told["drawing"] is not None:
        lines = {name: np.array(line, float) for name, line in told["drawing"]["lines"].items()}
        points = {name: np.array(point, float) for name, point in told["drawing"]["points"].items()}
        corners = mesh.vertices[mesh.faces]
        if any(key == "generation" for key, _ in items):
            yield from check_airway(items, lines, Planes(corners))
        else:
            level = float(((case or {}).get("measures") or {}).get("ureter_level_mm", 40.0))
            yield from check_urinary(items, lines, points, filled(corners), Planes(corners), level, result["frame"])
    yield from check_stones(items)
    yield from check_scores(told, items)


def check_path_measures(items: Items, result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    """Tortuosity, bending and the sharpest place, from the spline's own samples."""
    samples = own.samples
    points, s = samples.points, samples.s
    straight = float(np.linalg.norm(points[-1] - points[0]))
    mine = {
        "tortuosity": float(s[-1]) / straight if straight > 0.0 else np.nan,
        "total_bending_deg": float(np.degrees(np.trapezoid(own.curvature, s))),
        "bend_radius_min_mm": 1.0 / own.curvature_peak if own.curvature_peak > 0.0 else np.nan,
    }
    for key, value in mine.items():
        if (key, "") in items:
            yield compared(
                key, [("", items[key, ""], value)], SHARE * abs(value) + 1e-3, "", "A measure of the path is that of its spline."
            )
    if ("bend_radius_min_at_mm", "") in items:
        there = float(np.interp(items["bend_radius_min_at_mm", ""], s, own.curvature))
        yield compared(
            "bend_radius_min_at_mm",
            [("", there, own.curvature_peak)],
            0.02 * own.curvature_peak,
            "1/mm",
            "The spline is as curved at the place of the least bend radius as anywhere.",
        )
