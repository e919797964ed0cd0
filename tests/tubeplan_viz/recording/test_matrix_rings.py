"""The cross-sections of a bend that keeps an instrument out, as the recording of a matrix draws them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tubeplan_viz.recording.matrix import section_rings


def section(point: list[float], normal: list[float], radius: float) -> dict[str, Any]:
    return {"point_mm": point, "normal": normal, "radius_mm": radius}


def test_rims_lie_on_their_planes_at_their_radius_and_ends_have_none() -> None:
    tilted = [0.6, 0.0, 0.8]
    sections = [
        section([1.0, 2.0, 3.0], [0.0, 0.0, 1.0], 2.5),
        section([4.0, 2.0, 6.0], tilted, 1.5),
        section([9.0] * 3, tilted, 0.0),
    ]
    document = {"bends": [[], [{"sections": []}, {"sections": sections}], [{"sections": sections[:1]}]]}
    rings = section_rings(document, [{"bend": None}, {"bend": 1}, {"bend": None}])
    assert len(rings) == 2
    for ring, drawn in zip(rings, sections[:2], strict=True):
        arms = ring - np.array(drawn["point_mm"])
        assert np.allclose(np.linalg.norm(arms, axis=1), drawn["radius_mm"])
        assert np.allclose(arms @ np.array(drawn["normal"]), 0.0)
        # Closed, and all the way round: the points' mean is the middle.
        assert np.allclose(ring[0], ring[-1])
        assert np.allclose(arms[:-1].mean(axis=0), 0.0)
