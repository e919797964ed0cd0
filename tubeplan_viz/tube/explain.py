"""Why no path was found: proof that none exists, or what little would have to give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube.bottleneck import Bottleneck, widest_way
from tubeplan_viz.tube.optimal import OptimalSettings, passage_of
from tubeplan_viz.tube.relax import Relaxation, smallest_relaxation


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """Why the limits were not met.

    Attributes
    ----------
    impossible : bool
        Proved: no path whatever its bends keeps the clearance.
    sentence : str
        With place, required and available value.
    details : mapping
        Keys ``bottleneck`` and ``relaxation`` of result.json.
    """

    impossible: bool
    sentence: str
    details: Mapping[str, Any] = field(default_factory=dict)


def explain(wall: WallDistance, centerline: Centerline, limits: Limits, settings: OptimalSettings) -> Explanation:
    """Prove that no path exists where it can be proved, and find the smallest relaxation.

    Parameters
    ----------
    wall : WallDistance
    centerline : Centerline
        From the start to the goal.
    limits : Limits
        That the best path found does not meet.
    settings : OptimalSettings
    """
    start, goal = centerline.points[0], centerline.points[-1]
    way = widest_way(wall, start, goal, limit=limits.clearance_min)
    relaxation = smallest_relaxation(passage_of(wall, centerline, limits), settings, ceiling=way.bound)
    impossible = way.bound < limits.clearance_min
    sentence = narrow_sentence(way, centerline, limits) if impossible else open_sentence(way, relaxation, limits)
    details = {
        "bottleneck": {
            "clearance_upper_bound_mm": way.bound,
            "point_mm": way.place,
            "end": way.end,
            "required_mm": limits.clearance_min,
            "proves_impossible": impossible,
        },
        "relaxation": relaxation.details(),
    }
    return Explanation(impossible=impossible, sentence=sentence, details=details)


def narrow_sentence(way: Bottleneck, centerline: Centerline, limits: Limits) -> str:
    """The proved bottleneck: where, required and available."""
    at = centerline.arc_length[int(np.argmin(np.linalg.norm(centerline.points - way.place, axis=1)))]
    where = f"the {way.end} itself" if way.end else f"{at:.1f} mm along the centerline"
    x, y, z = way.place
    return (
        f"no path exists: every way from start to goal comes within {way.bound:.3f} mm of the wall, "
        f"at ({x:.2f}, {y:.2f}, {z:.2f}) mm, {where}; {limits.clearance_min:g} mm are required"
    )


def open_sentence(way: Bottleneck, relaxation: Relaxation, limits: Limits) -> str:
    """No proof: the lumen is wide enough somewhere, only no path was found under both limits."""
    parts = []
    if relaxation.clearance is not None:
        parts.append(f"an instrument radius of {relaxation.clearance:.3f} mm")
    if relaxation.curvature is not None:
        parts.append(f"a bend radius of {1.0 / relaxation.curvature:.2f} mm ({relaxation.curvature:.4f} 1/mm)")
    would = f"; {' or '.join(parts)} would do" if parts else ""
    return (
        f"no path was found that keeps {limits.clearance_min:g} mm at {limits.curvature_max:g} 1/mm, and none is excluded "
        f"(the widest way lets at most {way.bound:.3f} mm through){would}"
    )
