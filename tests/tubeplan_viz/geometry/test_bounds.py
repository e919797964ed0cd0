"""Bounds between the samples: never violated, and tight."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from segmentation.errors import GeometryError
from segmentation.mesh import Surface
from tubeplan_viz.geometry import SplineCurve, WallDistance, clearance_lower_bound, curvature_upper_bound

SplineMaker = Callable[[np.random.Generator], SplineCurve]


def near_cusp(delta: float) -> SplineCurve:
    """A cubic that nearly stops at u = 1/2: at delta = 0 it turns back in a cusp there."""
    return SplineCurve(3, np.repeat([0.0, 1.0], 4), 10.0 * np.array([[0, 0, 0], [1 + delta, 1, 0], [-delta, 1, 0], [1, 0, 0]]))


def test_curvature_bound_holds_at_dense_samples_of_random_splines_and_is_within_one_percent(random_spline: SplineMaker) -> None:
    u = np.linspace(0.0, 1.0, 20_001)
    for seed in range(100):
        curve = random_spline(np.random.default_rng(seed))
        bound = curvature_upper_bound(curve)
        truth = float(curve.curvature(u).max())
        assert bound.bound >= truth
        assert bound.sampled <= bound.bound <= 1.01 * max(truth, bound.sampled)
        assert curve.curvature([bound.at])[0] == pytest.approx(bound.sampled, rel=1e-12)


def test_curvature_bound_of_a_coarse_tolerance_still_holds(random_spline: SplineMaker) -> None:
    curve = random_spline(np.random.default_rng(7))
    truth = float(curve.curvature(np.linspace(0.0, 1.0, 20_001)).max())
    fine, coarse = curvature_upper_bound(curve, tolerance=1e-4), curvature_upper_bound(curve, tolerance=0.2)
    assert truth <= fine.bound <= coarse.bound
    assert fine.bound <= max(truth, fine.sampled) * 1.0002


@pytest.mark.parametrize("delta", [1e-2, 1e-3, 1e-4])
def test_curvature_bound_sees_a_near_cusp_that_samples_miss(delta: float) -> None:
    curve = near_cusp(delta)
    found = minimize_scalar(
        lambda u: -curve.curvature([u])[0], bounds=(0.5 - 5 * delta, 0.5 + 5 * delta), method="bounded", options={"xatol": 1e-14}
    )
    peak = max(-float(found.fun), float(curve.curvature([0.5])[0]))
    # 40 samples, as even a fine plot would have, land beside the peak.
    sampled = float(curve.curvature(np.linspace(0.0, 1.0, 40)).max())
    bound = curvature_upper_bound(curve)
    assert sampled < 0.5 * peak
    assert peak <= bound.bound * (1.0 + 1e-9)
    assert bound.bound <= 1.01 * peak


def test_curvature_bound_of_a_cusp_is_infinite() -> None:
    assert curvature_upper_bound(near_cusp(0.0)).bound == float("inf")


def test_curvature_bound_of_a_straight_line_is_nothing() -> None:
    line = SplineCurve(3, np.repeat([0.0, 1.0], 4), np.outer([0.0, 1.0, 5.0, 6.0], [1.0, 2.0, 3.0]))
    assert curvature_upper_bound(line).bound < 1e-8


def test_bounds_are_for_cubics_only() -> None:
    line = SplineCurve(1, np.array([0.0, 0.0, 1.0, 1.0]), np.array([[0.0, 0, 0], [1, 0, 0]]))
    with pytest.raises(GeometryError, match="degree 1, expected 3"):
        curvature_upper_bound(line)


def test_clearance_bound_holds_at_dense_samples_in_a_bent_tube_and_is_within_ten_micrometres(bent_tube: Any) -> None:
    wall = WallDistance(bent_tube.surface)
    rng = np.random.default_rng(11)
    u = np.linspace(0.0, 1.0, 20_001)
    for _ in range(6):
        control = np.array(bent_tube.curve.control_points)
        # The two points at either end keep the path from passing the caps.
        control[2:-2] += rng.normal(0.0, 0.6, control[2:-2].shape)
        curve = SplineCurve(3, bent_tube.curve.knots, control)
        bound = clearance_lower_bound(curve, wall)
        truth = float(wall.clearance(curve(u)).min())
        # Dense samples are 2.5 micrometres apart and so at most that above the truth.
        assert bound.bound <= truth
        assert bound.bound >= truth - 0.01 - 0.0025
        assert bound.sampled >= bound.bound


def test_clearance_bound_holds_where_a_path_swings_out_through_a_cap_between_samples(bent_tube: Any) -> None:
    # A parabola of curvature 2/mm tops the cap's plane by 16 micrometres, over 8 micrometres of its length.
    # The wall stays 3 mm away throughout: only the cap, which is no wall, is passed.
    wall = WallDistance(bent_tube.surface)
    cap = bent_tube.surface.caps[0]
    across = np.cross(cap.normal, [0.0, 0.0, 1.0])
    x = np.linspace(-0.4637, 0.5, 4)
    top, curvature = 1.6e-5, 2.0
    # Control values of a quadratic raised to degree 3: its blossom at (a, a, b) and so on.
    a, b = x[0], x[-1]
    squares = np.array([a * a, (a * a + 2 * a * b) / 3.0, (b * b + 2 * a * b) / 3.0, b * b])
    control = cap.center + np.outer(x, across) + np.outer(top - 0.5 * curvature * squares, cap.normal)
    curve = SplineCurve(3, np.repeat([0.0, 1.0], 4), control)
    apex = -a / (b - a)
    truth = float(wall.clearance(curve([apex]))[0])
    assert truth < -2.0
    assert clearance_lower_bound(curve, wall).bound <= truth


def test_clearance_bound_of_a_path_from_cap_to_cap_is_not_spoilt_by_its_ends(bent_tube: Any) -> None:
    wall = WallDistance(bent_tube.surface)
    truth = float(wall.clearance(bent_tube.curve(np.linspace(0.0, 1.0, 20_001))).min())
    assert truth - 0.0125 <= clearance_lower_bound(bent_tube.curve, wall).bound <= truth


def test_clearance_bound_of_a_straight_path_in_a_box_is_the_closed_form(box: Surface) -> None:
    # From (-2, 0, -3) to (2, 1, 3): nearest to y = 3 and z = 5 at the end, both 2 mm.
    line = SplineCurve(3, np.repeat([0.0, 1.0], 4), np.linspace([-2.0, 0.0, -3.0], [2.0, 1.0, 3.0], 4))
    bound = clearance_lower_bound(line, WallDistance(box))
    assert 1.99 - 1e-9 <= bound.bound <= 2.0 + 1e-12


def test_clearance_bound_is_negative_when_the_curve_leaves_the_lumen_between_samples(box: Surface) -> None:
    # An excursion of 0.05 mm through y = 3 that lasts 2 % of the path.
    points = np.array([[x, 0.0, 0.0] for x in np.linspace(-3.5, 3.5, 15)])
    spline = SplineCurve(3, np.concatenate([np.zeros(4), np.arange(1, 12) / 12.0, np.ones(4)]), points)
    control = np.array(spline.control_points)
    # Lift the middle control point until the top lies at 3.05.
    lift = 3.05 / float((SplineCurve(3, spline.knots, control + np.eye(15)[7][:, None] * [0, 1, 0]))([0.5])[0, 1])
    control[7, 1] = lift
    bound = clearance_lower_bound(SplineCurve(3, spline.knots, control), WallDistance(box))
    # The lumen is 4 mm wide in x, so y rules: the truth is -0.05.
    assert -0.06 - 1e-9 <= bound.bound <= -0.05 + 1e-9


def test_clearance_bound_decides_a_limit_that_is_nearly_met(box: Surface) -> None:
    line = SplineCurve(3, np.repeat([0.0, 1.0], 4), np.linspace([-1.0, 0.0, -2.0], [1.0, 0.0, 2.0], 4))
    # The clearance is exactly 3 mm everywhere; a limit 5 micrometres below must be proved, one above refuted.
    wall = WallDistance(box)
    assert clearance_lower_bound(line, wall, limit=2.995).bound >= 2.995
    assert clearance_lower_bound(line, wall, limit=3.001).bound < 3.001
