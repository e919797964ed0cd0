"""The local solve: paths that cannot keep their distance are none, samples that miss are made up for, free entries stay free."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.needle.bodies import Capsule, Sphere
from tubeplan_viz.needle.kinematics import Pose, push
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.polish import polish, polish_clear
from tubeplan_viz.needle.spatial import NeedleSettings, SpatialProblem
from tubeplan_viz.needle.swarm import plan_spatial
from tubeplan_viz.needle.zigzag import best_starts

ORIGIN = Pose(np.zeros(3), np.eye(3))


def problem(scene: Scene, target: tuple[float, float, float] = (0.0, 0.0, 90.0), **asked: float) -> SpatialProblem:
    return SpatialProblem(ORIGIN, np.array(target), scene, NeedleSettings(safety=2.0, **asked))  # type: ignore[arg-type]


def test_a_target_within_the_safety_distance_has_no_polished_path() -> None:
    # Every path to it ends 1.5 mm from the sphere, whatever it does before.
    case = problem(Scene((Sphere(np.array([0.0, 6.5, 90.0]), 5.0),)))
    starts = best_starts(problem(Scene(())), 3)
    assert starts
    assert all(polish(case, start) is None for start in starts)
    # With half a millimetre less asked for there is one.
    fine = SpatialProblem(ORIGIN, case.target, case.scene, NeedleSettings(safety=1.4))
    assert any(polish(fine, start) is not None for start in starts)


def test_where_samples_miss_the_nearest_place_the_path_is_polished_again_with_more_distance() -> None:
    """Danger weighs nothing, so the path passes as near as it may; samples 3 mm apart let it come nearer than that."""
    rod = Capsule(np.array([[-3.0, 2.0, 47.0], [3.0, 2.0, 47.0]]), 3.0)
    case = problem(Scene((rod,), spacing=3.0), weight_danger=0.0)
    near: list[float] = []
    kept: list[float] = []
    for start in best_starts(case, 3):
        for made, told in ((polish(case, start), near), (polish_clear(case, start), kept)):
            if made is not None:
                told.append(float(case.scene.least_distance(case.arcs(made)).min()))
    assert min(near) < 2.0  # the samples alone do let it
    assert kept
    assert min(kept) >= 2.0


def test_a_tilt_in_the_corner_of_its_box_is_cut_to_the_cone() -> None:
    case = problem(Scene(()), cone=0.3)
    low, high = case.bounds
    x = 0.5 * (low + high)
    for tilt in ((0.3, 0.3), (-0.3, 0.3), (0.3, 0.0)):
        x[-2:] = tilt
        assert case.arcs(x).tangents[0, 2] == pytest.approx(np.cos(0.3), abs=1e-12)
    x[-2:] = (0.1, -0.2)
    assert case.arcs(x).tangents[0, 2] == pytest.approx(np.cos(np.hypot(0.1, 0.2)), abs=1e-12)


def test_the_front_holds_paths_that_keep_more_distance_than_they_must() -> None:
    scene = Scene((Sphere(np.array([0.0, 5.0, 40.0]), 5.0),))
    path = plan_spatial(problem(scene, (0.0, 0.0, 100.0)))
    assert path.controls is not None
    gaps = np.array([point.clearance for point in path.front])
    assert (gaps >= 2.0 - 1e-9).all()
    exact = [point for point in path.front if point.error == 0.0]
    # 8 mm of distance beyond the 2 that are asked for are among those polished for, and room there is.
    assert max(point.clearance for point in exact) > 9.0
    widest = max(exact, key=lambda point: point.clearance)
    assert widest.danger < min(path.danger, 2.0 / 9.0)
    arcs = push(widest.pose, widest.controls)
    assert scene.least_distance(arcs)[0] == pytest.approx(widest.clearance, abs=1e-9)
