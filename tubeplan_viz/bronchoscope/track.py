"""The tip's track over a plan as one smooth curve."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.bronchoscope.mover import Step
from tubeplan_viz.geometry import SplineCurve

KNOTS = 3.0  # mm between the spline's knots
LEAST_STEP = 0.5  # mm; places of the track nearer to each other are one
LAST_STEP = 2.5  # mm; the same about the end, where corrections on the spot are no way


def tip_track(steps: Sequence[Step]) -> FloatArray:
    """Some places of the tip from the start to the end, (n, 3) mm, about 0.5 to 1 mm apart."""
    every = np.concatenate([step.track for step in steps])
    kept = [every[0]]
    for place in every[1:-1]:
        if np.linalg.norm(place - kept[-1]) >= LEAST_STEP and np.linalg.norm(place - every[-1]) >= LAST_STEP:
            kept.append(place)
    return np.array([*kept, every[-1]])


def track_curve(steps: Sequence[Step]) -> tuple[SplineCurve, float]:
    """A cubic C2 spline along the tip's track and its greatest distance from any place of that, mm.

    Its ends are those of the track. A track without way has no curve: `tip_track` must have four places or more.
    """
    track = tip_track(steps)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track, axis=0), axis=1))])
    u = s / s[-1]
    pieces = max(min(int(s[-1] / KNOTS), len(track) // 3), 1)
    inner = np.interp(np.linspace(0.0, len(u) - 1.0, pieces + 1)[1:-1], np.arange(len(u)), u)
    knots = np.concatenate([np.zeros(4), inner, np.ones(4)])
    weights = np.ones(len(u))
    weights[[0, -1]] = 1e4
    spline = make_lsq_spline(u, track, knots, k=3, w=weights)
    control = np.array(spline.c)
    control[0], control[-1] = track[0], track[-1]
    curve = SplineCurve(degree=3, knots=knots, control_points=control)
    dense = curve(curve.uniform_parameters(0.05))
    return curve, float(cKDTree(dense).query(np.concatenate([step.track for step in steps]))[0].max())
