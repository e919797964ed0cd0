"""The verifier's samples of a bend: a true claim stands, one that goes too far is refuted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tubeplan_viz.bench.infeasible import clearance_at_bend
from tubeplan_viz.bench.models import Model, torus_piece
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube import TubeSettings, pose_problem
from tubeplan_viz.tube.bend import bend_bound
from tubeplan_viz.tube.explain import bend_details
from tubeplan_viz.tube.spline import spline_through
from tubeplan_viz.verify.no_path import check_no_path, max_circle
from tubeplan_viz.verify.profile import OwnProfile, measure
from tubeplan_viz.verify.spline import BezierPath
from tubeplan_viz.verify.wall import Lumen, Triangles

PATH_BEND = 10.0


@pytest.fixture(scope="module")
def quarter() -> Model:
    return torus_piece(bend_radius=8.0, radius=2.5)


@pytest.fixture(scope="module")
def claim(quarter: Model) -> dict[str, Any]:
    limits = Limits(curvature_max=1.0 / PATH_BEND, clearance_min=2.0)
    problem = pose_problem(quarter.surface, quarter.start, quarter.goal, limits, TubeSettings())
    found = bend_bound(problem.wall, problem.centerline, curvature=limits.curvature_max, ceiling=2.5, limit=2.0)
    assert found is not None
    return {"details": {"bottleneck": {"bend": bend_details(found, limits)}}}


@pytest.fixture(scope="module")
def lumen(quarter: Model) -> Lumen:
    corners = quarter.surface.vertices[quarter.surface.faces]
    cap = quarter.surface.face_cap >= 0
    return Lumen(Triangles(corners[~cap]), Triangles(corners[cap]))


@pytest.fixture(scope="module")
def shown(quarter: Model, lumen: Lumen) -> OwnProfile:
    """The axis: bent by 8 mm, in the middle of the lumen."""
    curve = spline_through(quarter.axis_points[:: len(quarter.axis_points) // 8])[0]
    return measure(BezierPath.from_spline(3, curve.knots, curve.control_points), lumen)


def held(claim: dict[str, Any], shown: OwnProfile, lumen: Lumen) -> dict[str, bool]:
    return {check.name: check.ok for check in check_no_path(claim, shown, lumen)}


def changed(claim: dict[str, Any], **keys: float) -> dict[str, Any]:
    return {"details": {"bottleneck": {"bend": claim["details"]["bottleneck"]["bend"] | keys}}}


def test_a_proved_bend_is_confirmed(claim: dict[str, Any], shown: OwnProfile, lumen: Lumen) -> None:
    assert held(claim, shown, lumen) == {"no path: the run's own path": True, "no path: the bend": True}


def test_a_claim_two_percent_below_the_truth_is_refuted(claim: dict[str, Any], shown: OwnProfile, lumen: Lumen) -> None:
    forged = changed(claim, clearance_upper_bound_mm=0.98 * clearance_at_bend(PATH_BEND))
    assert not held(forged, shown, lumen)["no path: the bend"]


def test_a_claim_that_the_path_shown_disproves_is_refuted(claim: dict[str, Any], shown: OwnProfile, lumen: Lumen) -> None:
    forged = changed(claim, curvature_max_per_mm=1.0 / 7.5)
    assert not held(forged, shown, lumen)["no path: the run's own path"]


def test_a_run_without_such_a_claim_is_not_checked_for_it(shown: OwnProfile, lumen: Lumen) -> None:
    for details in ({}, {"bottleneck": {"bend": None}}):
        assert not held({"details": details}, shown, lumen)


@pytest.fixture(scope="module")
def hook() -> Model:
    """Half a turn of 6.5 mm: an arc of 6.69 mm from end to end keeps 0.1 mm in it, one of 7 mm would leave it."""
    return torus_piece(bend_radius=6.5, angle=np.pi, radius=1.5)


def test_several_sections_of_a_hook_are_confirmed_and_refuted_where_an_arc_passes(hook: Model) -> None:
    limits = Limits(curvature_max=1.0 / 7.0, clearance_min=0.3)
    problem = pose_problem(hook.surface, hook.start, hook.goal, limits, TubeSettings())
    found = bend_bound(problem.wall, problem.centerline, curvature=limits.curvature_max, ceiling=1.5, limit=0.0)
    assert found is not None
    claim = {"details": {"bottleneck": {"bend": bend_details(found, limits)}}}
    corners, cap = hook.surface.vertices[hook.surface.faces], hook.surface.face_cap >= 0
    lumen = Lumen(Triangles(corners[~cap]), Triangles(corners[cap]))
    curve = spline_through(hook.axis_points[:: len(hook.axis_points) // 16])[0]
    axis = measure(BezierPath.from_spline(3, curve.knots, curve.control_points), lumen)
    assert held(claim, axis, lumen) == {"no path: the run's own path": True, "no path: the bend": True}
    # An arc of 6.69 mm keeps 0.1 mm: its circle is 3 % larger than is said to be possible.
    forged = changed(claim, clearance_upper_bound_mm=0.1, curvature_max_per_mm=1.0 / 6.51)
    assert not held(forged, axis, lumen)["no path: the bend"]


def test_of_sections_in_a_row_the_sharpest_three_count() -> None:
    angle = np.array([0.0, 0.4, 0.9, 1.3])
    turned = 7.0 * np.column_stack([np.cos(angle) - 1.0, np.sin(angle), 0.0 * angle])
    on_one = [turned[k : k + 1] for k in range(4)]
    assert max_circle(on_one) == pytest.approx(7.0)
    # A straight piece before an arc is no sharper than the arc; with two points to choose from the better one is taken.
    aside = turned[1] + np.array([-0.5, 0.0, 0.0])
    assert max_circle([turned[:1], np.array([aside]), *on_one[2:]]) < 7.0
    assert max_circle([turned[:1], np.array([aside, turned[1]]), *on_one[2:]]) == pytest.approx(7.0)


def test_largest_circle_of_points_on_circles_is_the_larger_one() -> None:
    angle = np.array([0.0, 0.4, 0.9])
    small, large = (radius * np.column_stack([np.cos(angle) - 1.0, np.sin(angle), 0.0 * angle]) for radius in (3.0, 7.0))
    assert max_circle([large[:1], large[1:2], large[2:]]) == pytest.approx(7.0)
    # The first point is common to both.
    rooms = [large[:1], np.array([small[1], large[1]]), np.array([small[2], large[2]])]
    assert max_circle(rooms) >= 7.0
    # Behind a turn of more than a right angle a piece of so small a ball cannot lie.
    back = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.1, 0.0]])
    assert max_circle([back[:1], back[1:2], back[2:]]) == 0.0
