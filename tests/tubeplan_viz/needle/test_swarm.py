"""Needles in space: the target met to rounding, distances kept on dense samples, the front, and reproducibility."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.needle.bodies import Capsule, Sphere
from tubeplan_viz.needle.front import undominated
from tubeplan_viz.needle.kinematics import Controls, Pose, push
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.path import NeedlePath
from tubeplan_viz.needle.spatial import NeedleSettings, SpatialProblem
from tubeplan_viz.needle.swarm import SwarmSettings, plan_printed, plan_spatial, weights

ORIGIN = Pose(np.zeros(3), np.eye(3))


def ball(x: float, y: float, z: float, radius: float) -> Sphere:
    return Sphere(np.array([x, y, z]), radius)


SCENE = Scene((ball(0, 5, 40, 5), ball(15, -12, 60, 7), ball(-14, 10, 65, 7)))


def problem(target: tuple[float, float, float], scene: Scene = SCENE, **asked: float) -> SpatialProblem:
    return SpatialProblem(ORIGIN, np.array(target), scene, NeedleSettings(safety=2.0, **asked))  # type: ignore[arg-type]


def dense(pose: Pose | None, controls: Controls | None) -> np.ndarray:
    assert pose is not None
    assert controls is not None
    arcs = push(pose, controls)
    return arcs.points(arcs.lengths[:, None] * np.linspace(0.0, 1.0, 3001)).reshape(-1, 3)


@pytest.mark.parametrize("target", [(0.0, 0.0, 100.0), (-15.0, 15.0, 100.0), (15.0, 0.0, 100.0)])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_target_is_met_and_every_distance_kept(target: tuple[float, float, float], seed: int) -> None:
    case = problem(target)
    path = plan_spatial(case, rng=np.random.default_rng(seed), front=False)
    points = dense(path.pose, path.controls)
    assert np.linalg.norm(points[-1] - target) < 1e-6
    assert (points[0] == 0.0).all()
    assert SCENE.distances(points).min() >= 2.0
    assert path.controls is not None
    assert (path.controls.curvatures == 0.02).all()
    if target == (0.0, 0.0, 100.0):
        assert path.length <= 102.03  # printed


def test_a_duty_cycle_reaches_a_free_target_along_the_straight_line() -> None:
    path = plan_spatial(problem((0.0, 0.0, 100.0), Scene(()), duty_cycle=True), front=False)
    # The straight way is 100 mm; 2e-4 of it is where the polish stops.
    assert path.length == pytest.approx(100.0, abs=0.05)
    assert path.controls is not None
    assert path.controls.curvatures.max() <= 0.02


def test_a_free_entry_and_cone_stay_within_their_limits() -> None:
    wall = Scene((ball(0, 0, 40, 12),))
    case = problem((0.0, 0.0, 100.0), wall, entry_radius=8.0, cone=0.3)
    path = plan_spatial(case, front=False)
    assert path.pose is not None
    assert np.linalg.norm(path.pose.position) <= 8.0 + 1e-9
    assert path.pose.position[2] == pytest.approx(0.0, abs=1e-12)
    assert np.arccos(path.pose.tangent[2]) <= 0.3 + 1e-9
    assert wall.distances(dense(path.pose, path.controls)).min() >= 2.0


def test_capsules_are_kept_away_from_between_the_samples_too() -> None:
    rib = Capsule(np.array([[-40.0, 6, 40], [40, 4, 45]]), 4.0)
    path = plan_spatial(problem((0.0, 0.0, 90.0), Scene((rib,))), front=False)
    assert rib.distance(dense(path.pose, path.controls)).min() >= 2.0


def test_the_same_seed_gives_the_same_plan() -> None:
    first, second = (plan_spatial(problem((0.0, 15.0, 100.0)), rng=np.random.default_rng(5), front=False) for _ in range(2))
    assert first.controls is not None
    assert second.controls is not None
    assert (first.controls.lengths == second.controls.lengths).all()
    assert (first.controls.turns == second.controls.turns).all()


def test_no_path_of_the_front_is_beaten_by_another() -> None:
    path = plan_spatial(problem((0.0, 0.0, 100.0)))
    goals = np.array([(p.error, p.length, p.danger) for p in path.front])
    assert len(goals) >= 3
    for k, row in enumerate(goals):
        others = np.delete(goals, k, axis=0)
        assert not ((others <= row).all(axis=1) & (others < row).any(axis=1)).any()
    for point in path.front:
        points = dense(point.pose, point.controls)
        assert np.linalg.norm(points[-1] - [0.0, 0.0, 100.0]) == pytest.approx(point.error, abs=1e-6)
        assert SCENE.distances(points).min() >= 2.0 - 1e-9


def test_undominated_rows_by_hand() -> None:
    goals = np.array([[1.0, 1, 1], [2, 2, 2], [0, 3, 3], [1, 1, 1], [3, 0, 3]])
    assert sorted(undominated(goals).tolist()) == [0, 2, 4]


def test_the_printed_swarm_ends_within_its_tolerance_or_says_that_it_failed() -> None:
    settings = SwarmSettings()
    case = problem((0.0, 0.0, 100.0))
    path = plan_printed(case, settings, rng=np.random.default_rng(0))
    assert path.feasible
    assert path.error < 0.1
    assert SCENE.distances(dense(path.pose, path.controls)).min() >= 2.0
    short = plan_printed(case, SwarmSettings(rounds=2), rng=np.random.default_rng(0))
    assert not short.feasible
    assert short.reason is not None
    assert "no path was found" in short.reason


def test_the_weights_move_from_length_to_accuracy() -> None:
    far, near = weights(140.0, 100.0), weights(100.0, 100.0)
    assert near[0] > far[0]
    assert near[1] < far[1]


def test_a_closed_cage_has_no_path_and_says_so() -> None:
    cage = tuple(
        ball(18 * np.sin(b) * np.cos(a), 18 * np.sin(b) * np.sin(a), 80 + 18 * np.cos(b), 9.0)
        for b in (0.3, 0.9, 1.5, 2.1, 2.7)
        for a in np.arange(8) * np.pi / 4
    )
    found: NeedlePath = plan_spatial(problem((0.0, 0.0, 80.0), Scene(cage)), SwarmSettings(restarts=1, rounds=60))
    assert not found.feasible
    assert found.reason is not None
    assert "no path was found" in found.reason


def test_places_and_settings_that_cannot_be_are_refused() -> None:
    with pytest.raises(CaseError, match=r"the target \(0, 5, 40\) mm is -5\.00 mm from obstacle 1"):
        problem((0.0, 5.0, 40.0)).check_places()
    with pytest.raises(CaseError, match="the needle's target is where its tip is"):
        problem((0.0, 0.0, 0.0))
    with pytest.raises(CaseError, match="pieces is 1, expected 2 to 12"):
        NeedleSettings(pieces=1)


def test_with_duty_cycle_a_free_target_ahead_is_reached_straight() -> None:
    free = SpatialProblem(Pose(np.zeros(3), np.eye(3)), np.array([0.0, 0.0, 100.0]), Scene(()), NeedleSettings(duty_cycle=True))
    path = plan_spatial(free, front=False)
    always = plan_spatial(problem((0.0, 0.0, 100.0), Scene(())), front=False)
    assert path.length == pytest.approx(100.0, abs=1e-3)  # the polish stops at a relative gain of 1e-4 of its scale
    assert always.length > 100.3  # a needle that always bends cannot
    assert path.error < 1e-6
