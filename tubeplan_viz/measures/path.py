"""Measures of the path itself, from the numbers that result.json holds."""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.measures.measure import Measure, lacking


def path_measures(
    s: FloatArray, points: FloatArray, curvature: FloatArray, curvature_max: float, *, sharpest_at: float | None = None
) -> list[Measure]:
    """Tortuosity, total bending angle, least bend radius and where it is.

    Parameters
    ----------
    s : (n,) float array, mm
    points : (n, 3) float array, mm
    curvature : (n,) float array, 1/mm
    curvature_max : float, 1/mm
        Largest curvature between the samples too.
    sharpest_at : float, optional, mm
        Where it is; by default at the sample that is bent most.
    """
    straight = float(np.linalg.norm(points[-1] - points[0]))
    made = [Measure(key="total_bending_deg", value=float(np.degrees(np.trapezoid(curvature, s))))]
    if straight > 0.0:
        made.insert(0, Measure(key="tortuosity", value=float(s[-1]) / straight))
    else:
        made[:0] = lacking("the path ends where it starts", "tortuosity")
    if curvature_max > 0.0:
        made.append(Measure(key="bend_radius_min_mm", value=1.0 / curvature_max))
        at = float(s[int(curvature.argmax())]) if sharpest_at is None else sharpest_at
        made.append(Measure(key="bend_radius_min_at_mm", value=at))
    else:
        made += lacking("the path is straight", "bend_radius_min_mm", "bend_radius_min_at_mm")
    return made
