"""No path: proved where it can be, and the least that would have to give."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.bench.infeasible import clearance_at_bend
from tubeplan_viz.bench.models import Model, narrow_neck, straight_tube, torus_piece, y_junction
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.plan import Limits, Plan, PlanStatus
from tubeplan_viz.tube import OptimalSettings, TubeSettings, conclude, pose_problem, tube_steps
from tubeplan_viz.tube.bottleneck import widest_way
from tubeplan_viz.tube.explain import explain
from tubeplan_viz.tube.spline import spline_through
from tubeplan_viz.tube.triangulation import triangle_widths

NECK = 1.0


def planned(model: Model, curvature_max: float, clearance_min: float) -> Plan:
    limits = Limits(curvature_max=curvature_max, clearance_min=clearance_min)
    problem = pose_problem(model.surface, model.start, model.goal, limits, TubeSettings(method="optimal"))
    return conclude(problem, list(tube_steps(problem)))


@pytest.fixture(scope="module")
def stenosis() -> Model:
    return narrow_neck(neck=NECK)


@pytest.fixture(scope="module")
def sharp_bend() -> Model:
    """A quarter bend of 8 mm in a tube of radius 2.5 mm: a path bent by 10 mm must cut the corner."""
    return torus_piece(bend_radius=8.0, radius=2.5)


def test_stenosis_below_the_instrument_is_proved_impossible_with_place_and_both_values(stenosis: Model) -> None:
    plan = planned(stenosis, 0.1, 1.2)
    assert plan.status is PlanStatus.INFEASIBLE
    found = plan.details["bottleneck"]
    assert found["proves_impossible"]
    assert found["required_mm"] == 1.2
    # Tight: the neck's radius is 1 mm, and no proof may claim less than a path can have.
    axis_least = float(WallDistance(stenosis.surface).distance(stenosis.axis_points).min())
    assert axis_least <= found["clearance_upper_bound_mm"] <= 1.02 * NECK
    middle = stenosis.axis_points[len(stenosis.axis_points) // 2]
    assert np.linalg.norm(found["point_mm"] - middle) < 1.0
    assert plan.reason is not None
    assert "no path exists" in plan.reason
    assert "1.2 mm are required" in plan.reason
    relaxation = plan.details["relaxation"]
    # No bend radius helps against a neck.
    assert relaxation["curvature_per_mm"] is None
    assert relaxation["bend_radius_mm"] is None
    assert 0.98 * NECK <= relaxation["clearance_mm"] <= found["clearance_upper_bound_mm"]
    assert planned(stenosis, 0.1, relaxation["clearance_mm"]).certificate.holds
    assert not planned(stenosis, 0.1, 1.02 * relaxation["clearance_mm"]).certificate.holds


def test_bend_in_a_too_narrow_tube_is_proved_impossible_with_place_and_both_values(sharp_bend: Model) -> None:
    plan = planned(sharp_bend, 0.1, 2.0)
    assert plan.status is PlanStatus.INFEASIBLE
    assert plan.reason is not None
    assert "no path exists at 0.1 1/mm: the bend at" in plan.reason
    assert "2 mm are required" in plan.reason
    found = plan.details["bottleneck"]
    assert found["proves_impossible"]
    # The lumen itself is wide enough.
    assert found["clearance_upper_bound_mm"] > 2.0
    relaxation = plan.details["relaxation"]
    # No proof may claim less than a path keeps.
    assert relaxation["clearance_mm"] <= found["bend"]["clearance_upper_bound_mm"] <= 1.01 * clearance_at_bend(10.0)
    middle = sharp_bend.axis_points[len(sharp_bend.axis_points) // 2]
    assert np.linalg.norm(found["bend"]["point_mm"] - middle) < 1.5
    thinner, softer = relaxation["clearance_mm"], relaxation["curvature_per_mm"]
    assert relaxation["bend_radius_mm"] == pytest.approx(1.0 / softer)
    assert planned(sharp_bend, 0.1, thinner).certificate.holds
    assert not planned(sharp_bend, 0.1, 1.02 * thinner).certificate.holds
    assert planned(sharp_bend, softer, 2.0).certificate.holds
    assert not planned(sharp_bend, 0.98 * softer, 2.0).certificate.holds
    line = relaxation["pareto"]
    assert line[0] == {"clearance_mm": thinner, "curvature_per_mm": 0.1, "bend_radius_mm": 10.0}
    assert line[-1]["curvature_per_mm"] == softer
    assert np.all(np.diff([point["clearance_mm"] for point in line]) > 0)
    assert np.all(np.diff([point["curvature_per_mm"] for point in line]) > 0)
    # The smaller change in percent is named: 5 % of each limit is missing in the radius, a little less in the bend.
    changes = {
        "instrument radius": 100.0 * (thinner / 2.0 - 1.0),
        "bend radius": 100.0 * (relaxation["bend_radius_mm"] / 10.0 - 1.0),
    }
    assert relaxation["clearance_change_percent"] == pytest.approx(changes["instrument radius"])
    assert relaxation["bend_radius_change_percent"] == pytest.approx(changes["bend radius"])
    assert relaxation["smallest"] == max(changes, key=lambda name: changes[name])


def test_what_would_do_is_looked_for_along_the_best_path_where_no_spline_follows_the_centerline() -> None:
    model = straight_tube()
    wall = WallDistance(model.surface)
    strayed = np.array(model.axis_points)
    strayed[20:-20, 0] += 8.0
    centerline = Centerline(strayed, wall.distance(strayed))
    limits = Limits(curvature_max=0.1, clearance_min=1.5 * float(wall.distance(model.axis_points).max()))
    axis = spline_through(np.array(model.axis_points[:: len(model.axis_points) // 6]))[0]
    lost = explain(wall, centerline, limits, OptimalSettings())
    assert lost.details["relaxation"]["clearance_mm"] is None
    found = explain(wall, centerline, limits, OptimalSettings(), path=axis)
    # The axis itself keeps the most; what is named is a little less, so that planning again proves it.
    kept = float(wall.distance(model.axis_points[[0, -1]]).min())
    assert 0.98 * kept <= found.details["relaxation"]["clearance_mm"] <= kept


def test_a_start_too_near_to_the_wall_is_its_own_proof() -> None:
    model = straight_tube()
    wall = WallDistance(model.surface)
    start = np.array([2.5, 10.0, 0.0])
    way = widest_way(wall, start, model.goal, limit=1.0)
    assert way.end == "start"
    assert way.bound == pytest.approx(float(wall.distance(start)[0]))


@pytest.mark.parametrize("model", [straight_tube(20.0), torus_piece(), y_junction()], ids=lambda model: model.name)
def test_the_bound_is_never_below_what_the_axis_keeps(model: Model) -> None:
    wall = WallDistance(model.surface)
    way = widest_way(wall, model.start, model.goal)
    kept = float(wall.distance(model.axis_points).min())
    assert kept <= way.bound
    # The axis of a round tube is its widest way; where branches meet there is more room than on it.
    assert way.bound <= 1.02 * float(wall.distance(model.axis_points[[0, -1]]).min())


def test_width_of_a_triangle_is_the_largest_distance_from_all_corners_met_on_it() -> None:
    rng = np.random.default_rng(8)
    corners = rng.normal(size=(60, 3, 3))
    widths, places = triangle_widths(corners)
    shares = rng.dirichlet([1.0, 1.0, 1.0], 4000)
    for triangle, width, place in zip(corners, widths, places, strict=True):
        points = shares @ triangle
        met = np.linalg.norm(points[:, None] - triangle, axis=2).min(axis=1).max()
        assert met <= width + 1e-12
        assert np.linalg.norm(place - triangle, axis=1).min() == pytest.approx(width, abs=1e-9)
        # 4000 random points come near the extreme one.
        assert width - met < 0.05 * np.linalg.norm(triangle - triangle.mean(axis=0), axis=1).max()
