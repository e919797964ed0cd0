"""Places that no path of a needle reaches: closed forms, and random paths that never come there."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.needle.kinematics import Pose, bend, insertion_pose
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.reach import unreachable
from tubeplan_viz.needle.spatial import NeedleSettings, SpatialProblem
from tubeplan_viz.needle.swarm import plan_spatial

KAPPA = 0.02  # bends with 50 mm; half a circle is 157 mm, and five pieces of 1.5 times the distance stay below it up to 20.9 mm


def problem(target: tuple[float, float, float], pose: Pose | None = None, **asked: float) -> SpatialProblem:
    settings = NeedleSettings(kappa=KAPPA, **asked)  # type: ignore[arg-type]
    return SpatialProblem(pose or Pose(np.zeros(3), np.eye(3)), np.array(target), Scene(()), settings)


def beside(ahead: float, radius: float, turn: float) -> tuple[float, float, float]:
    """The place `ahead` mm along the tip's direction on an arc of a radius, in a plane turned about that direction."""
    aside = radius - np.sqrt(radius**2 - ahead**2)
    return (float(aside * np.cos(turn)), float(aside * np.sin(turn)), ahead)


@pytest.mark.parametrize("turn", [0.0, 2.0, -1.1])
@pytest.mark.parametrize("ahead", [4.0, 10.0, 18.0])
def test_the_needles_own_arc_is_the_border(ahead: float, turn: float) -> None:
    assert unreachable(problem(beside(ahead, 50.0, turn))) is None
    assert unreachable(problem(beside(ahead, 50.1, turn))) is None
    told = unreachable(problem(beside(ahead, 49.9, turn)))
    assert told is not None
    assert f"{ahead:.1f} mm ahead of the tip" in told
    assert "a radius of 49.9 mm; the needle bends with 50.0 mm" in told


def test_a_place_behind_the_tip_is_out_of_reach_however_far_aside() -> None:
    told = unreachable(problem((0.0, 19.0, -0.5)))
    assert told == "no path exists: the target lies 0.5 mm behind the tip, 19.0 mm aside"


def test_nothing_is_certain_of_paths_that_may_turn_round_or_begin_elsewhere() -> None:
    # 7.5 times 21 mm is longer than half a circle.
    assert unreachable(problem((0.0, 20.0, 5.0))) is not None
    assert unreachable(problem((0.0, 20.6, 5.0))) is None
    assert unreachable(problem((0.0, 10.0, 5.0), entry_radius=2.0)) is None
    assert unreachable(problem((0.0, 10.0, 5.0), cone=0.2)) is None


def test_no_path_up_to_half_a_circle_ends_where_none_is_said_to() -> None:
    """Random pieces, bent fully or less, from a pose askew: their tips lie outside all arcs of more than kappa."""
    rng, count = np.random.default_rng(5), 40_000
    pose = insertion_pose([3.0, -7.0, 11.0], [0.3, -0.5, 0.8])
    turns = rng.uniform(-np.pi, np.pi, (count, 5))
    # Half of them turn by half a turn each time or not at all: those stay in a plane and come nearest to the border.
    turns[::2] = np.pi * rng.integers(0, 2, (count // 2, 5))
    lengths = rng.dirichlet(np.full(5, 0.5), count) * rng.uniform(1.0, np.pi / KAPPA, count)[:, None]
    curvatures = KAPPA * np.where(rng.random((count, 5)) < 0.7, 1.0, rng.random((count, 5)))
    way = bend(pose, turns, lengths, curvatures).tips - pose.position
    ahead = way @ pose.tangent
    aside = np.linalg.norm(way - ahead[:, None] * pose.tangent, axis=1)
    needed = 2.0 * aside / np.square(way).sum(axis=1)
    assert ahead.min() > -1e-9
    # 1e-9: rounding of tips up to 157 mm away.
    assert needed.max() <= KAPPA * (1.0 + 1e-9)
    assert needed.max() > 0.999 * KAPPA  # the border is met, so nothing narrower would hold


def test_the_planner_says_so_without_a_search() -> None:
    found = plan_spatial(problem((0.0, 9.0, 12.0)))
    assert not found.feasible
    assert found.reason is not None
    # 2 * 9 / (81 + 144) = 1 / 12.5
    assert "bends with a radius of 12.5 mm" in found.reason
    assert found.swarms == 0
    assert found.rounds == ()
