"""Discrete curvature and the circle through three points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from segmentation.errors import GeometryError
from tubeplan_viz.geometry import circumcenter, menger_curvature

COORDINATE = st.floats(-50.0, 50.0, allow_nan=False)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE).map(np.array)
law = settings(deadline=None, max_examples=60, derandomize=True)


@law
@given(radius=st.floats(0.5, 500.0), seed=st.integers(0, 2**32 - 1))
def test_curvature_of_an_arc_is_its_reciprocal_radius_however_unevenly_sampled(radius: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.cumsum(rng.uniform(0.02, 0.4, 12))
    arc = radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    moved = Rotation.random(random_state=seed % 2**31).apply(arc) + rng.uniform(-20, 20, 3)
    # Chords of at least 1 % of the radius, 20 mm off the origin, leave twelve digits less four.
    np.testing.assert_allclose(menger_curvature(moved), 1.0 / radius, rtol=1e-7)


def test_collinear_vertices_have_no_curvature() -> None:
    line = np.outer([0.0, 1.0, 2.5, 7.0], [1.0, -2.0, 0.5])
    np.testing.assert_allclose(menger_curvature(line), 0.0, atol=1e-15)


def test_a_right_angle_has_the_curvature_of_its_thales_circle() -> None:
    # Legs 3 and 4: hypotenuse 5 is the diameter.
    assert menger_curvature([[3, 0, 0], [0, 0, 0], [0, 4, 0]]) == pytest.approx([0.4])


def test_curvature_of_a_helix_converges_to_that_of_the_curve() -> None:
    errors = []
    for count in (50, 100, 200):
        angle = np.linspace(0.0, 3.0, count)
        helix = np.column_stack([10.0 * np.cos(angle), 10.0 * np.sin(angle), 4.0 * angle])
        errors.append(np.abs(menger_curvature(helix) - 10.0 / 116.0).max())
    slope = np.polyfit(np.log([50, 100, 200]), np.log(errors), 1)[0]
    # The circle through three equally spaced points is right to second order.
    assert slope == pytest.approx(-2.0, abs=0.1)


def test_coinciding_vertices_are_refused_by_number() -> None:
    with pytest.raises(GeometryError, match="vertices 1 to 3 of the polyline coincide"):
        menger_curvature([[0, 0, 0], [1, 0, 0], [2, 1, 0], [2, 1, 0]])


def test_two_vertices_are_too_few() -> None:
    with pytest.raises(GeometryError, match="at least 3 vertices, found 2"):
        menger_curvature([[0, 0, 0], [1, 0, 0]])


@law
@given(a=POINT, b=POINT, c=POINT)
def test_the_circumcenter_is_as_far_from_all_three_and_in_their_plane(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    ba, bc = a - b, c - b
    lengths = np.linalg.norm(ba), np.linalg.norm(bc), np.linalg.norm(a - c)
    normal = np.cross(ba, bc)
    # Keep off slivers, whose centre is ill-conditioned.
    assume(min(lengths) > 0.1 and np.linalg.norm(normal) > 0.02 * lengths[0] * lengths[1])
    center = circumcenter(a, b, c)
    assert center is not None
    radii = [float(np.linalg.norm(center - p)) for p in (a, b, c)]
    assert radii == pytest.approx([radii[0]] * 3, rel=1e-6)
    assert abs((center - b) @ normal) < 1e-6 * radii[0] * np.linalg.norm(normal)
    assert 1.0 / radii[0] == pytest.approx(menger_curvature([a, b, c])[0], rel=1e-6)


def test_collinear_points_have_no_circumcenter() -> None:
    assert circumcenter([0, 0, 0], [1, 1, 1], [3, 3, 3]) is None
