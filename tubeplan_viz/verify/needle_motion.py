"""A needle's controls integrated as a rate model, by other means than the planner's closed forms.

# Strategy: the pose is integrated with the body twist of Webster's unicycle model by a Runge-Kutta method of order 8.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from segmentation.arrays import FloatArray

STEP_MM = 0.02


def integrated(
    entry: Mapping[str, Any], controls: Sequence[Mapping[str, float]], *, step: float = STEP_MM
) -> tuple[FloatArray, FloatArray]:
    """Arc lengths (n,), mm, and tips (n, 3), mm, of controls from an entry (`entry_mm`, `entry_frame`), `step` apart or less."""
    position, frame = np.array(entry["entry_mm"], float), np.array(entry["entry_frame"], float)
    s, points, done = [0.0], [position], 0.0
    for control in controls:
        c, si = np.cos(control["turn_rad"]), np.sin(control["turn_rad"])
        frame = frame @ np.array([[c, -si, 0.0], [si, c, 0.0], [0.0, 0.0, 1.0]])
        length, k = control["length_mm"], control["curvature_per_mm"]
        spin = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -k], [0.0, k, 0.0]])

        def rate(_: float, state: FloatArray, spin: FloatArray = spin) -> FloatArray:
            turned = state[3:].reshape(3, 3)
            return np.concatenate([turned[:, 2], (turned @ spin).ravel()])

        places = np.linspace(0.0, length, max(int(np.ceil(length / step)), 1) + 1)
        start = np.concatenate([position, frame.ravel()])
        path = solve_ivp(rate, (0.0, max(length, 1e-12)), start, method="DOP853", rtol=1e-12, atol=1e-13, t_eval=places).y
        s.extend(done + places[1:])
        points.extend(path[:3, 1:].T)
        position, frame, done = path[:3, -1], path[3:, -1].reshape(3, 3), done + length
    return np.array(s), np.array(points)
