"""The random tree that the swarm is compared with: on target, clear of obstacles, honest where there is no way."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.needle.bodies import Sphere
from tubeplan_viz.needle.kinematics import Pose, push
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.path import NeedlePath
from tubeplan_viz.needle.rrt import plan_rrt
from tubeplan_viz.needle.spatial import NeedleSettings, SpatialProblem

WALL = Scene((Sphere(np.array([0.0, 2.0, 45.0]), 8.0), Sphere(np.array([0.0, -14.0, 45.0]), 6.0)))


def problem(scene: Scene = WALL, **asked: float) -> SpatialProblem:
    return SpatialProblem(Pose(np.zeros(3), np.eye(3)), np.array([0.0, 0.0, 100.0]), scene, NeedleSettings(**asked))  # type: ignore[arg-type]


def dense(path: NeedlePath) -> np.ndarray:
    assert path.pose is not None
    assert path.controls is not None
    arcs = push(path.pose, path.controls)
    return arcs.points(arcs.lengths[:, None] * np.linspace(0.0, 1.0, 801)).reshape(-1, 3)


@pytest.mark.parametrize("seed", range(3))
def test_the_tree_ends_on_the_target_past_obstacles_in_the_straight_way(seed: int) -> None:
    path = plan_rrt(problem(safety=2.0), rng=np.random.default_rng(seed))
    points = dense(path)
    assert path.nodes > 1  # the straight way is blocked: one pose does not see the target
    assert np.linalg.norm(points[-1] - [0.0, 0.0, 100.0]) < 1e-6
    assert WALL.distances(points).min() >= 2.0 - 1e-9
    assert path.controls is not None
    assert (path.controls.curvatures == 0.02).all()


def test_the_same_seed_grows_the_same_tree() -> None:
    first, second = (plan_rrt(problem(), rng=np.random.default_rng(4)) for _ in range(2))
    assert first.controls is not None
    assert second.controls is not None
    assert (first.controls.lengths == second.controls.lengths).all()
    assert first.nodes == second.nodes


def test_with_duty_cycle_the_tree_bends_fully_or_not_at_all_before_its_last_pieces() -> None:
    path = plan_rrt(problem(duty_cycle=True), rng=np.random.default_rng(1))
    assert path.controls is not None
    assert set(path.controls.curvatures[:-4].tolist()) <= {0.0, 0.02}


def test_a_cage_is_reported_as_no_path() -> None:
    cage = tuple(
        Sphere(np.array([18 * np.sin(b) * np.cos(a), 18 * np.sin(b) * np.sin(a), 100 + 18 * np.cos(b)]), 9.0)
        for b in (0.3, 0.9, 1.5, 2.1, 2.7)
        for a in np.arange(8) * np.pi / 4
    )
    path = plan_rrt(problem(Scene(cage)), rng=np.random.default_rng(0), time_budget=0.5)
    assert not path.feasible
    assert path.reason is not None
    assert "does not see the target" in path.reason
