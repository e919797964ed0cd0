"""Controls mended under way: what is left of a path, planned for the needle as it bends, and when it is given up."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.needle.bodies import Capsule, Sphere
from tubeplan_viz.needle.events import Event, moved
from tubeplan_viz.needle.insertion import InsertionSettings, insert
from tubeplan_viz.needle.kinematics import Controls, Pose, push
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.replan import bent, first_part, misses, padded, renewed
from tubeplan_viz.needle.spatial import NeedleSettings, SpatialProblem
from tubeplan_viz.needle.swarm import plan_spatial

ORIGIN, KAPPA, NOTHING = Pose(np.zeros(3), np.eye(3)), 0.02, Scene(())


def problem(target: tuple[float, float, float], scene: Scene = NOTHING) -> SpatialProblem:
    return SpatialProblem(ORIGIN, np.array(target), scene, NeedleSettings(kappa=KAPPA))


@pytest.fixture(scope="module")
def aside() -> tuple[SpatialProblem, Controls]:
    """A target aside of the straight way, and a path to it."""
    case = problem((-20.0, 20.0, 100.0))
    path = plan_spatial(case, front=False)
    assert path.controls is not None
    return case, path.controls


@pytest.fixture(scope="module")
def ahead() -> tuple[SpatialProblem, Controls]:
    """A target straight ahead, and a path to it."""
    case = problem((0.0, 0.0, 100.0))
    path = plan_spatial(case, front=False)
    assert path.controls is not None
    return case, path.controls


@pytest.mark.parametrize("ratio", [0.9, 1.1])
def test_what_is_mended_for_another_bend_is_told_in_controls_of_the_model(
    aside: tuple[SpatialProblem, Controls], ratio: float
) -> None:
    case, controls = aside
    here = push(ORIGIN, bent(first_part(controls, 20.0), ratio)).end_pose()
    rest = controls.after(20.0)
    assert misses(case, here, rest, ratio) > 1.0
    made = renewed(case, here, rest, ratio, changed=False)
    assert made is not None
    # A needle that always bends is ordered to bend as modelled; pushed as it truly bends, it ends on the target.
    assert made.curvatures == pytest.approx(np.full(len(made), KAPPA))
    assert misses(case, here, made, ratio) < 1e-6


@pytest.mark.parametrize("pieces", [1, 2, 4])
def test_pieces_split_in_two_are_the_same_path(pieces: int) -> None:
    rng = np.random.default_rng(pieces)
    rest = Controls(rng.uniform(-3.0, 3.0, pieces), rng.uniform(10.0, 30.0, pieces), np.full(pieces, KAPPA))
    case = problem((0.0, 0.0, 70.0))
    x = padded(case, rest)
    assert len(x) == 2 * case.settings.pieces
    assert case.arcs(x).tips == pytest.approx(push(ORIGIN, rest).tips, abs=1e-9)


@pytest.mark.parametrize("at", [30.0, 50.0])
def test_a_bend_that_changes_under_way_is_learnt_from_what_comes_after_it(
    aside: tuple[SpatialProblem, Controls], at: float
) -> None:
    """Measured without noise, one push tells the new bend; tips from before would hold it to a compromise, 0.2 mm off."""
    case, controls = aside
    made = insert(case, ORIGIN, controls, (Event(at=at, kappa=1.1 * KAPPA),))
    assert made.withdrawn is None
    assert len(made.replans) == 1
    assert made.error < 1e-6


def test_noise_alone_does_not_make_the_needle_bend_otherwise(aside: tuple[SpatialProblem, Controls]) -> None:
    """One tip measured with 4 mm of noise tells the bend to a multiple of itself; tissues differ by 5 %, and that is believed."""
    case, controls = aside
    settings = InsertionSettings(noise=4.0, tolerance=2.0)
    for seed in range(6):
        made = insert(case, ORIGIN, controls, (), settings, rng=np.random.default_rng(seed))
        assert made.withdrawn is None
        # The bend is not misjudged by more than would miss the target by the tolerance.
        assert made.error < 2.0


@pytest.mark.parametrize(("left", "away"), [(30.0, 20.0), (20.0, 10.0)])
def test_a_target_that_moves_out_of_reach_far_from_it_makes_the_needle_withdraw(
    ahead: tuple[SpatialProblem, Controls], left: float, away: float
) -> None:
    case, controls = ahead
    made = insert(case, ORIGIN, controls, (Event(at=controls.length - left, target=np.array([away, 0.0, 100.0])),))
    assert made.withdrawn is not None
    assert "the target has moved, and no path from there was found: withdraw the needle" in made.withdrawn
    assert made.length == pytest.approx(controls.length - left, abs=1e-9)


@pytest.mark.parametrize(("left", "away"), [(10.0, 1.5), (6.0, 1.0)])
def test_a_target_that_moves_a_little_near_the_end_is_missed_by_that(
    ahead: tuple[SpatialProblem, Controls], left: float, away: float
) -> None:
    """Nothing bends aside by 1.5 mm on 10 mm, since 2 * 1.5 / (1.5^2 + 10^2) is more than kappa: the plan goes to its end."""
    case, controls = ahead
    assert 2.0 * away / (away**2 + left**2) > KAPPA
    made = insert(case, ORIGIN, controls, (Event(at=controls.length - left, target=np.array([away, 0.0, 100.0])),))
    assert made.withdrawn is None
    assert not any(step.found for step in made.replans)
    assert made.length == pytest.approx(controls.length, abs=1e-9)
    assert made.error == pytest.approx(away, abs=1e-6)


def test_the_clearance_of_an_insertion_is_to_where_an_obstacle_stood_when_the_tip_passed() -> None:
    near, far = np.array([0.0, 9.0, 25.0]), np.array([60.0, 60.0, 25.0])
    case = problem((0.0, 0.0, 100.0), Scene((Sphere(near, 4.0),)))
    path = plan_spatial(case, front=False)
    assert path.controls is not None
    made = insert(case, ORIGIN, path.controls, (Event(at=60.0, obstacle=0, place=far),))
    early = push(ORIGIN, first_part(made.pushed, 60.0))
    points = early.points(early.lengths[:, None] * np.linspace(0.0, 1.0, 4001)).reshape(-1, 3)
    stood = float(np.linalg.norm(points - near, axis=1).min()) - 4.0
    # A sphere's distance is a closed form; samples 0.01 mm apart are off by 0.005^2 / 2 over the distance.
    assert made.clearances[0] == pytest.approx(stood, abs=1e-4)
    assert stood < 10.0


def test_a_rod_that_moves_goes_as_a_whole() -> None:
    rod = Capsule(np.array([[-20.0, 8.0, 40.0], [20.0, 8.0, 42.0]]), 3.0)
    (gone,) = moved(Scene((rod,)), 0, np.array([-20.0, -2.0, 45.0])).obstacles
    assert isinstance(gone, Capsule)
    assert gone.points == pytest.approx(rod.points + np.array([0.0, -10.0, 5.0]))
    assert gone.radius == 3.0
