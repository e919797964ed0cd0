"""Random splines and simple closed surfaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from segmentation.mesh import Surface
from tubeplan_viz.geometry import SplineCurve

SplineMaker = Callable[[np.random.Generator], SplineCurve]


@pytest.fixture(scope="session")
def random_spline() -> SplineMaker:
    """Makes clamped cubics of 6 to 14 control points, 3 to 8 mm apart, with uneven knots, that wander forward."""

    def make(rng: np.random.Generator) -> SplineCurve:
        count = int(rng.integers(6, 15))
        steps = rng.normal(0.0, 2.5, (count, 3)) + np.array([5.0, 0.0, 0.0])
        inner = np.sort(rng.uniform(0.05, 0.95, count - 4))
        knots = np.concatenate([np.zeros(4), inner, np.ones(4)])
        return SplineCurve(3, knots, np.cumsum(steps, axis=0))

    return make


@pytest.fixture(scope="session")
def box() -> Surface:
    """A closed box of 8 x 6 x 10 mm around the origin, two triangles a side."""
    corners = np.array([[x, y, z] for x in (-4.0, 4.0) for y in (-3.0, 3.0) for z in (-5.0, 5.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))])
    surface = Surface(corners, faces, np.full(12, -1), (), "mesh")
    assert surface.volume_ml == pytest.approx(0.48)
    return surface
