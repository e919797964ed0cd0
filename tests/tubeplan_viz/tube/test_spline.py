"""The interpolating spline: through its points, C2, with Bessel's end tangents."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tubeplan_viz.tube.spline import bessel_tangent, spline_through

law = settings(deadline=None, max_examples=40, derandomize=True)


def wandering(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0.0, 1.5, (int(rng.integers(3, 20)), 3)) + np.array([4.0, 0.0, 0.0]), axis=0)


@law
@given(seed=st.integers(0, 2**32 - 1))
def test_the_spline_passes_through_its_points_at_their_chord_parameters(seed: int) -> None:
    points = wandering(seed)
    curve, u = spline_through(points)
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(u, np.concatenate([[0.0], np.cumsum(chords)]) / chords.sum(), atol=1e-12)
    np.testing.assert_allclose(curve(u), points, atol=1e-9)
    assert u[-1] == 1.0


@law
@given(seed=st.integers(0, 2**32 - 1))
def test_the_spline_has_two_continuous_derivatives_at_its_knots(seed: int) -> None:
    points = wandering(seed)
    curve, u = spline_through(points)
    assert len(np.unique(curve.knots)) == len(points)
    inner = u[1:-1]
    h = 1e-9
    for derivative in (1, 2):
        jump = curve(inner + h, derivative) - curve(inner - h, derivative)
        size = np.abs(curve(u, derivative)).max()
        # Across 2e-9 a continuous derivative changes by its slope; a jump would be of the size of the derivative.
        assert np.abs(jump).max(initial=0.0) < 1e-4 * max(size, 1.0)


@law
@given(seed=st.integers(0, 2**32 - 1))
def test_end_tangents_are_bessels(seed: int) -> None:
    points = wandering(seed)
    curve, u = spline_through(points)
    np.testing.assert_allclose(curve([0.0], 1)[0], bessel_tangent(u[:3], points[:3]), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(curve([1.0], 1)[0], bessel_tangent(u[:-4:-1], points[:-4:-1]), rtol=1e-7, atol=1e-7)


def test_bessels_tangent_is_exact_on_a_parabola_however_unevenly_sampled() -> None:
    rng = np.random.default_rng(2)
    a, b, c = rng.normal(size=(3, 3))
    u = np.array([0.13, 0.2, 0.71])
    points = a + np.outer(u, b) + np.outer(u**2, c)
    np.testing.assert_allclose(bessel_tangent(u, points), b + 2.0 * 0.13 * c, atol=1e-12)
    # The far end: the same three points backwards.
    np.testing.assert_allclose(bessel_tangent(u[::-1], points[::-1]), b + 2.0 * 0.71 * c, atol=1e-12)


def test_points_on_a_line_give_a_line_at_constant_speed() -> None:
    direction = np.array([1.0, 2.0, -2.0]) / 3.0
    curve, _ = spline_through(np.outer([0.0, 1.0, 5.0, 6.0, 11.0], direction))
    u = np.linspace(0.0, 1.0, 30)
    np.testing.assert_allclose(curve(u, 1), np.tile(11.0 * direction, (30, 1)), atol=1e-9)


def test_points_on_an_arc_give_its_curvature_to_second_order() -> None:
    errors = []
    for count in (8, 16, 32):
        angle = np.linspace(0.0, 0.5 * np.pi, count)
        curve, u = spline_through(20.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]))
        inner = np.linspace(u[2], u[-3], 200)
        errors.append(np.abs(curve.curvature(inner) - 0.05).max())
    slope = np.polyfit(np.log([7, 15, 31]), np.log(errors), 1)[0]
    assert slope == pytest.approx(-2.0, abs=0.3)
