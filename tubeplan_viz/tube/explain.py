"""Why no path was found: proof that none exists, or what little would have to give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.plan import Limits, NoPathError
from tubeplan_viz.tube.bend import BendBound, bend_bound
from tubeplan_viz.tube.bottleneck import Bottleneck, widest_way
from tubeplan_viz.tube.optimal import OptimalSettings, Passage
from tubeplan_viz.tube.relax import Relaxation, smallest_relaxation

# Distance of points along the best path, mm, as along a centerline.
LINE_SPACING = 0.25


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """Why the limits were not met.

    Attributes
    ----------
    impossible : bool
        Proved: no path keeps the clearance, whatever its bends or at least under the curvature limit.
    sentence : str
        With place, required and available value.
    details : mapping
        Keys ``bottleneck`` and ``relaxation`` of result.json.
    """

    impossible: bool
    sentence: str
    details: Mapping[str, Any] = field(default_factory=dict)


def explain(
    wall: WallDistance, centerline: Centerline, limits: Limits, settings: OptimalSettings, *, path: SplineCurve | None = None
) -> Explanation:
    """Prove that no path exists where it can be proved, and find the smallest relaxation.

    Parameters
    ----------
    wall : WallDistance
    centerline : Centerline
        From the start to the goal.
    limits : Limits
        That the best path found does not meet.
    settings : OptimalSettings
    path : SplineCurve, optional
        The best path found, if it keeps the curvature limit: what lies along it is looked at too.
    """
    start, goal = centerline.points[0], centerline.points[-1]
    way = widest_way(wall, start, goal, limit=limits.clearance_min)
    lines = [centerline.points]
    if path is not None:
        lines.append(path(path.uniform_parameters(LINE_SPACING)))
    relaxation = relaxation_along(lines, wall, limits, settings, ceiling=way.bound)
    narrow = way.bound < limits.clearance_min
    bend = None
    if not narrow:
        bend = bend_bound(
            wall,
            centerline,
            curvature=limits.curvature_max,
            ceiling=way.bound,
            limit=limits.clearance_min,
            known=relaxation.clearance or 0.0,
        )
    sharp = bend is not None and bend.bound <= limits.clearance_min
    if narrow:
        sentence = narrow_sentence(way, centerline, limits)
    elif bend is not None and sharp:
        sentence = bend_sentence(bend, centerline, relaxation, limits)
    else:
        sentence = open_sentence(way, bend, relaxation, limits)
    details = {
        "bottleneck": {
            "clearance_upper_bound_mm": way.bound,
            "point_mm": way.place,
            "end": way.end,
            "required_mm": limits.clearance_min,
            "bend": None if bend is None else bend_details(bend, limits),
            "proves_impossible": narrow or sharp,
        },
        "relaxation": relaxation.details(),
    }
    return Explanation(impossible=narrow or sharp, sentence=sentence, details=details)


def relaxation_along(
    lines: Sequence[FloatArray], wall: WallDistance, limits: Limits, settings: OptimalSettings, *, ceiling: float
) -> Relaxation:
    """The smallest relaxation from the first line that a path under the curvature limit is found from; else from the last one."""
    found = Relaxation(limits=limits, clearance=None, curvature=None, pareto=())
    for line in lines:
        try:
            found = smallest_relaxation(Passage(wall=wall, line=line, limits=limits), settings, ceiling=ceiling)
        except NoPathError:
            # No spline follows this line inside the lumen: it tells nothing.
            continue
        if found.clearance is not None:
            break
    return found


def bend_details(bend: BendBound, limits: Limits) -> dict[str, Any]:
    """The bound by the bends, for result.json, with the cross-sections that it rests on."""
    return {
        "clearance_upper_bound_mm": bend.bound,
        "curvature_max_per_mm": limits.curvature_max,
        "point_mm": bend.place,
        "proves_impossible": bend.bound <= limits.clearance_min,
        "sections": [
            {"point_mm": section.point, "normal": section.normal, "radius_mm": section.radius} for section in bend.sections
        ],
    }


def place_words(place: FloatArray, centerline: Centerline) -> str:
    """A place in mm and how far along the centerline it lies."""
    at = centerline.arc_length[int(np.argmin(np.linalg.norm(centerline.points - place, axis=1)))]
    # Adding zero makes a rounded negative zero a zero.
    x, y, z = np.round(place, 2) + 0.0
    return f"({x:.2f}, {y:.2f}, {z:.2f}) mm, {at:.1f} mm along the centerline"


def narrow_sentence(way: Bottleneck, centerline: Centerline, limits: Limits) -> str:
    """The proved bottleneck: where, required and available."""
    where = place_words(way.place, centerline)
    if way.end:
        where = f"{where.partition(' mm,')[0]} mm, the {way.end} itself"
    return (
        f"no path exists: every way from start to goal comes within {way.bound:.3f} mm of the wall, "
        f"at {where}; {limits.clearance_min:g} mm are required"
    )


def would_do(relaxation: Relaxation) -> str:
    """The single changes that let a path through, as the end of a sentence."""
    parts = []
    if relaxation.clearance is not None:
        parts.append(f"an instrument radius of {relaxation.clearance:.3f} mm")
    if relaxation.curvature is not None:
        parts.append(f"a bend radius of {1.0 / relaxation.curvature:.2f} mm ({relaxation.curvature:.4f} 1/mm)")
    return f"; {' or '.join(parts)} would do" if parts else ""


def bend_sentence(bend: BendBound, centerline: Centerline, relaxation: Relaxation, limits: Limits) -> str:
    """The proved bend: where, required and available."""
    if bend.bound == 0.0:
        return (
            f"no path exists at {limits.curvature_max:g} 1/mm: nothing that bends no more, however thin, passes the turns about "
            f"{place_words(bend.place, centerline)}; {limits.clearance_min:g} mm are required{would_do(relaxation)}"
        )
    return (
        f"no path exists at {limits.curvature_max:g} 1/mm: the bend at {place_words(bend.place, centerline)}, brings every such "
        f"path within {bend.bound:.3f} mm of the wall; {limits.clearance_min:g} mm are required{would_do(relaxation)}"
    )


def open_sentence(way: Bottleneck, bend: BendBound | None, relaxation: Relaxation, limits: Limits) -> str:
    """No proof: the lumen is wide enough somewhere, only no path was found under both limits."""
    least = way.bound if bend is None else bend.bound
    which = "the widest way lets" if bend is None else "the bends let"
    return (
        f"no path was found that keeps {limits.clearance_min:g} mm at {limits.curvature_max:g} 1/mm, and none is excluded "
        f"({which} at most {least:.3f} mm through){would_do(relaxation)}"
    )
