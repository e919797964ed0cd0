"""Splines: derivatives, arc length, curvature and torsion, and the laws that they obey."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from segmentation.errors import GeometryError
from tubeplan_viz.geometry import SplineCurve

SEEDS = st.integers(0, 2**32 - 1)
law = settings(deadline=None, max_examples=30, derandomize=True)


def bezier(points: list[list[float]]) -> SplineCurve:
    return SplineCurve(3, np.repeat([0.0, 1.0], 4), np.array(points))


def through(points: np.ndarray, u: np.ndarray) -> SplineCurve:
    spline = make_interp_spline(u, points, k=3)
    return SplineCurve(3, spline.t, spline.c)


def helix(count: int, radius: float, pitch: float) -> SplineCurve:
    """Cubic interpolation of one turn of a helix; `pitch` is the rise per radian, mm."""
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    return through(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), pitch * angle]), angle / angle[-1])


def span_middles(curve: SplineCurve) -> np.ndarray:
    breaks = np.unique(curve.knots)
    return 0.5 * (breaks[1:] + breaks[:-1])


@pytest.mark.parametrize("derivative", [1, 2, 3])
def test_derivatives_agree_with_central_differences_to_second_order(
    derivative: int, random_spline: Callable[[np.random.Generator], SplineCurve]
) -> None:
    curve = random_spline(np.random.default_rng(derivative))
    u = span_middles(curve)
    steps = np.array([0.2, 0.1, 0.05]) * np.diff(np.unique(curve.knots)).min()
    exact = curve(u, derivative)
    errors = np.array(
        [np.abs((curve(u + h, derivative - 1) - curve(u - h, derivative - 1)) / (2.0 * h) - exact).max() for h in steps]
    )
    if derivative == 1:
        # The third derivative of a span is constant, so the error is exactly F''' h^2 / 6.
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(2.0, abs=1e-3)
    else:
        # F' is quadratic in a span and F'' linear: central differences are exact up to rounding.
        assert errors.max() < 1e-8 * np.abs(exact).max()


def test_arc_length_of_a_parabola_is_the_closed_form() -> None:
    # y = x^2 for x in [0, 1], 20 mm per unit, raised to degree 3.
    curve = bezier([[0, 0, 0], [20 / 3, 0, 0], [40 / 3, 20 / 3, 0], [20, 20, 0]])
    exact = 20.0 * (0.5 * np.sqrt(5.0) + 0.25 * np.arcsinh(2.0))
    # Five Gauss points on quarter spans of an analytic speed leave about 1e-9.
    assert curve.length == pytest.approx(exact, abs=1e-7)
    u = np.linspace(0.0, 1.0, 9)
    x = 2.0 * u
    partial = 20.0 * (0.5 * u * np.sqrt(1.0 + x**2) + 0.25 * np.arcsinh(x))
    np.testing.assert_allclose(curve.arc_length(u), partial, atol=1e-7)


def test_arc_length_of_a_semicubical_parabola_that_starts_at_rest() -> None:
    # (u^2, u^3): the speed u sqrt(4 + 9 u^2) vanishes at the start.
    curve = bezier([[0, 0, 0], [0, 0, 0], [1 / 3, 0, 0], [1, 1, 0]])
    assert curve.length == pytest.approx((13.0**1.5 - 8.0) / 27.0, abs=1e-8)


def test_parameter_is_the_inverse_of_arc_length(random_spline: Callable[[np.random.Generator], SplineCurve]) -> None:
    for seed in range(10):
        curve = random_spline(np.random.default_rng(seed))
        u = np.random.default_rng(seed + 100).uniform(0.0, 1.0, 50)
        s = np.linspace(0.0, curve.length, 50)
        # A micrometre is a thousandth of what any measurement here needs.
        np.testing.assert_allclose(curve.arc_length(curve.parameter(s)), s, atol=1e-6)
        np.testing.assert_allclose(curve(curve.parameter(curve.arc_length(u))), curve(u), atol=1e-6)


def test_uniform_parameters_are_evenly_spaced_in_arc_length(random_spline: Callable[[np.random.Generator], SplineCurve]) -> None:
    curve = random_spline(np.random.default_rng(5))
    u = curve.uniform_parameters(0.25)
    steps = np.diff(curve.arc_length(u))
    assert u[0] == 0.0
    assert u[-1] == 1.0
    assert steps.max() <= 0.25 + 1e-6
    assert np.ptp(steps) < 2e-6


def test_curvature_and_torsion_of_a_helix_converge_at_their_orders() -> None:
    radius, pitch = 12.0, 3.0
    square = radius**2 + pitch**2
    counts = np.array([32, 64, 128])
    curvature_error, torsion_error = [], []
    for count in counts:
        curve = helix(count, radius, pitch)
        u = span_middles(curve)[3:-3]
        curvature_error.append(np.abs(curve.curvature(u) - radius / square).max())
        torsion_error.append(np.abs(curve.torsion(u) - pitch / square).max())
    # Second derivatives of a cubic interpolant are of second order; its third derivative is constant on a span
    # and therefore of second order only in the middle of the span, where it is taken.
    for errors in (curvature_error, torsion_error):
        slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
        assert -2.3 < slope < -1.7
    assert curvature_error[-1] < 1e-4 * radius / square * 10
    assert torsion_error[-1] < 1e-3 * pitch / square * 10


def test_curvature_of_an_arc_is_its_reciprocal_radius_and_its_torsion_is_zero() -> None:
    angle = np.linspace(0.0, 0.5 * np.pi, 60)
    curve = through(15.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]), angle / angle[-1])
    u = np.linspace(0.0, 1.0, 500)
    # The interpolant of an arc by spans of 1.5 degrees is right to (h / 2)^2 / 3 of its curvature.
    np.testing.assert_allclose(curve.curvature(u), 1.0 / 15.0, rtol=1e-3)
    np.testing.assert_allclose(curve.torsion(u), 0.0, atol=1e-9)


def test_a_straight_line_has_no_curvature_and_no_torsion() -> None:
    line = bezier([[0, 0, 0], [1, 2, 3], [4, 8, 12], [5, 10, 15]])
    u = np.linspace(0.0, 1.0, 50)
    # Uneven speed along a line must not show as bending.
    assert line.curvature(u).max() < 1e-12
    assert np.all(line.torsion(u) == 0.0)
    np.testing.assert_allclose(line.tangent(u), np.tile(np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0), (50, 1)), atol=1e-12)


@law
@given(seed=SEEDS)
def test_rigid_motion_changes_no_measure(seed: int, random_spline: Callable[[np.random.Generator], SplineCurve]) -> None:
    rng = np.random.default_rng(seed)
    curve = random_spline(rng)
    turn, shift = Rotation.random(random_state=int(rng.integers(2**31))), rng.uniform(-100.0, 100.0, 3)
    moved = SplineCurve(3, curve.knots, turn.apply(np.array(curve.control_points)) + shift)
    u = np.linspace(0.0, 1.0, 80)
    scale = np.abs(curve.curvature(u)).max()
    np.testing.assert_allclose(moved(u), turn.apply(curve(u)) + shift, atol=1e-9)
    np.testing.assert_allclose(moved.arc_length(u), curve.arc_length(u), atol=1e-9)
    # 100 mm of shift costs two of the sixteen digits, the cubed speed some more.
    np.testing.assert_allclose(moved.curvature(u), curve.curvature(u), atol=1e-7 * scale)
    # Torsion divides by |F' x F''|^2 and is compared where the curve bends noticeably.
    bent = curve.curvature(u) > 1e-2 * scale
    np.testing.assert_allclose(moved.torsion(u)[bent], curve.torsion(u)[bent], rtol=1e-5, atol=1e-6)


@law
@given(seed=SEEDS, factor=st.floats(0.01, 100.0))
def test_scaling_by_k_divides_curvature_and_torsion_by_k(
    seed: int, factor: float, random_spline: Callable[[np.random.Generator], SplineCurve]
) -> None:
    curve = random_spline(np.random.default_rng(seed))
    scaled = SplineCurve(3, curve.knots, factor * curve.control_points)
    u = np.linspace(0.0, 1.0, 80)
    np.testing.assert_allclose(scaled.curvature(u) * factor, curve.curvature(u), rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(scaled.torsion(u) * factor, curve.torsion(u), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(scaled.arc_length(u), factor * curve.arc_length(u), rtol=1e-9)


@law
@given(seed=SEEDS, place=st.floats(0.01, 0.99))
def test_knot_insertion_keeps_the_curve(
    seed: int, place: float, random_spline: Callable[[np.random.Generator], SplineCurve]
) -> None:
    curve = random_spline(np.random.default_rng(seed))
    finer = BSpline(curve.knots, curve.control_points, 3).insert_knot(place)
    inserted = SplineCurve(3, finer.t, finer.c[: len(finer.t) - 4])
    assert len(inserted.control_points) == len(curve.control_points) + 1
    u = np.linspace(0.0, 1.0, 80)
    np.testing.assert_allclose(inserted(u), curve(u), atol=1e-10)
    assert inserted.length == pytest.approx(curve.length, abs=1e-6)


def test_decreasing_knots_are_refused() -> None:
    with pytest.raises(GeometryError, match="knots decrease"):
        SplineCurve(3, np.array([0, 0, 0, 0, 0.6, 0.4, 1, 1, 1, 1]), np.zeros((6, 3)))


def test_control_points_cannot_be_changed_from_outside() -> None:
    points = np.zeros((4, 3))
    curve = SplineCurve(3, np.repeat([0.0, 1.0], 4), points)
    points[0] = 7.0
    assert np.all(curve.control_points == 0.0)
    with pytest.raises(ValueError, match="read-only"):
        curve.control_points[0] = 1.0
