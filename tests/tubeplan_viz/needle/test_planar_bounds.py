"""The planar search's parts: paths that close on the target, derivatives, distances, and bounds that no path of a cell beats."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.needle.bodies import Capsule, Obstacle, Polygon, Sphere
from tubeplan_viz.needle.kinematics import Arcs, bend_from
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.planar_bodies import FlatScene
from tubeplan_viz.needle.planar_bounds import Cells, appraise, broken_limits
from tubeplan_viz.needle.planar_motion import Posed, along, contacts, motions, posed
from tubeplan_viz.needle.planar_shapes import FORMS, PlanarProblem, PlanarSettings, sides_of, turns_of

LONG_FORMS = [form for degree in (2, 3, 4) for form in FORMS[degree]]


def circle(y: float, z: float, radius: float) -> Sphere:
    return Sphere(np.array([0.0, y, z]), radius, "circle")


ROUND: tuple[Obstacle, ...] = (circle(0, 40, 10), circle(-40, 30, 15), circle(30, 50, 8))
CORNERED: tuple[Obstacle, ...] = (
    Polygon(np.array([[-30.0, 45], [6, 45], [6, 50], [-30, 50]])),
    Polygon(np.array([[10.0, 20], [30, 25], [18, 28], [25, 45]])),  # not convex
)


def task(bodies: tuple[Obstacle, ...] = (), entry: tuple[float, float] = (0.0, 0.0)) -> PlanarProblem:
    return PlanarProblem(np.array(entry), np.array([5.0, 90.0]), Scene(bodies), PlanarSettings(safety=1.0))


def some_paths(problem: PlanarProblem, form: str, count: int, rng: np.random.Generator) -> tuple[Posed, np.ndarray, np.ndarray]:
    """Paths that exist, with their sides and roots."""
    every = np.array(sides_of(form), dtype=float)
    sides, roots = every[rng.integers(len(every), size=count)], rng.choice([1.0, -1.0], count)
    paths = posed(problem, rng.uniform(1.0, 50.0, (count, len(form) - 1)), sides, roots)
    kept = np.flatnonzero((paths.room > 0.5) & (np.abs(paths.grazing) > 0.1) & (paths.lengths[:, -1] > 0.1))
    return paths.take(kept), sides[kept], roots[kept]


def in_space(problem: PlanarProblem, paths: Posed) -> Arcs:
    """The same paths by the needle's own kinematics."""
    count = len(paths.angle)
    zero, c, s = np.zeros(count), np.cos(paths.angle), np.sin(paths.angle)
    tangent, normal = np.column_stack([zero, -s, c]), np.column_stack([zero, -c, -s])
    entry = np.tile([0.0, *problem.entry], (count, 1))
    return bend_from(entry, tangent, normal, turns_of(np.sign(paths.curvatures)), paths.lengths, np.abs(paths.curvatures))


@pytest.mark.parametrize("form", LONG_FORMS)
def test_paths_end_at_the_target_by_the_needles_own_kinematics(form: str) -> None:
    problem = task(entry=(3.0, -2.0))
    paths, *_ = some_paths(problem, form, 60, np.random.default_rng(1))
    assert len(paths.angle) > 5
    assert np.abs(in_space(problem, paths).tips - [0.0, 5.0, 90.0]).max() < 1e-9


@pytest.mark.parametrize("form", ["LR", "RL", "RLR", "LRRL", "RRRR"])
def test_length_angle_and_clearance_change_as_their_derivatives_say(form: str) -> None:
    problem = task(ROUND)
    scene, step = FlatScene(problem), 1e-5
    paths, sides, roots = some_paths(problem, form, 200, np.random.default_rng(2))
    near = contacts(scene, paths)
    order = np.broadcast_to(np.repeat(np.arange(len(form)), len(scene)), near.gap.shape)
    slopes = along(motions(paths, near, order), near.normal)
    for i in range(len(form) - 1):
        moved = paths.lengths[:, :-1] + step * (np.arange(len(form) - 1) == i)
        back = paths.lengths[:, :-1] - step * (np.arange(len(form) - 1) == i)
        ahead, behind = posed(problem, moved, sides, roots), posed(problem, back, sides, roots)
        # Central differences of step h are off by h^2 times the third derivative, which the 10 % of grazing keep near 10 / mm^2.
        assert np.abs((ahead.lengths - behind.lengths)[:, -1] / (2 * step) - paths.lengthening[:, i]).max() < 1e-6
        assert np.abs((ahead.angle - behind.angle) / (2 * step) - paths.turning[:, i]).max() < 1e-6
        gaps = (contacts(scene, ahead).gap - contacts(scene, behind).gap) / (2 * step)
        # Where the nearest place passes from inside a piece to its end within the step, the two sides differ by O(h).
        assert np.abs(gaps - slopes[..., i]).max() < 1e-4


@pytest.mark.parametrize("bodies", [ROUND, CORNERED], ids=["circles", "polygons"])
def test_distances_are_those_of_the_scene_in_space(bodies: tuple[Obstacle, ...]) -> None:
    problem = task(bodies, entry=(2.0, 1.0))
    for form in ("LRL", "RLR"):
        paths, *_ = some_paths(problem, form, 150, np.random.default_rng(3))
        ours = contacts(FlatScene(problem), paths).gap.reshape(len(paths.angle), 3, -1)
        theirs = problem.scene.piece_distances(in_space(problem, paths))
        apart = theirs > 1e-9
        assert np.abs(ours - theirs)[apart].max() < 1e-9
        assert (ours[~apart] <= 1e-9).all()
        assert ((ours < -1e-9) == (theirs < -1e-9)).all()  # one that goes through is negative in both
        assert 0 < np.count_nonzero(~apart) < apart.size


@pytest.mark.parametrize("bodies", [ROUND, CORNERED], ids=["circles", "polygons"])
def test_no_path_of_a_cell_is_better_than_its_bounds(bodies: tuple[Obstacle, ...]) -> None:
    problem, rng = task(bodies), np.random.default_rng(4)
    scene, count, each = FlatScene(problem), 100, 12
    seen_paths = 0
    for form in ("RR", "LRL", "RRLR", "LRRL"):
        every, free = np.array(sides_of(form), dtype=float), len(form) - 1
        for half in (6.0, 2.0, 0.5):
            middles = 1.0 + half + rng.uniform(0.0, 50.0, (count, free))
            sides, roots = every[rng.integers(len(every), size=count)], rng.choice([1.0, -1.0], count)
            cells = Cells(middles, np.full(free, half), sides, roots)
            kept = appraise(problem, scene, cells, np.inf)
            least = {middle.tobytes(): low for middle, low in zip(kept.cells.middles, kept.least, strict=True)}
            low = np.array([least.get(middle.tobytes(), np.inf) for middle in middles])
            share = rng.uniform(-1.0, 1.0, (count, each, free))
            share[:, : each // 2] = np.sign(share[:, : each // 2])  # corners, where bounds are tight
            places = (middles[:, None] + half * share).reshape(-1, free)
            paths = posed(problem, places, np.repeat(sides, each, axis=0), np.repeat(roots, each))
            fine = (paths.room >= 0.0) & (broken_limits(problem.settings, paths) <= 0.0)
            fine &= contacts(scene, paths).gap.min(axis=1) >= problem.settings.safety
            # Paths over twice the target's distance are not looked for.
            fine &= paths.lengths.sum(axis=1) < 2.0 * problem.distance
            assert (paths.lengths.sum(axis=1)[fine] >= np.repeat(low, each)[fine] - 1e-9).all()
            seen_paths += np.count_nonzero(fine)
    assert seen_paths > 100


def test_bounds_close_on_the_middle_as_the_cell_shrinks() -> None:
    """What is between bound and middle falls to nothing with the cell: first order in its size."""
    problem = task()
    scene = FlatScene(problem)
    middle, sides = np.array([[20.0, 30.0]]), np.array([[1.0, 0.0, -1.0]])
    gaps = []
    for half in (1.0, 0.5, 0.25, 0.125):
        seen = appraise(problem, scene, Cells(middle, np.full(2, half), sides, np.ones(1)), np.inf)
        gaps.append(float((seen.lengths - seen.least)[0]))
    order = np.diff(np.log(gaps)).mean() / np.log(0.5)
    assert 0.9 < order < 1.5  # first order, from above by the second-order part


@pytest.mark.parametrize("body", [Capsule(np.array([[0.0, 20, 40], [0, 30, 50]]), 3.0), Sphere(np.array([4.0, 20, 40]), 3.0)])
def test_bodies_that_are_not_of_the_plane_are_refused(body: Obstacle) -> None:
    with pytest.raises(CaseError, match=r"obstacle 1 is a (capsule|sphere); needle2d expects circles and polygons"):
        FlatScene(task((body,)))


def test_a_turn_of_more_than_a_circle_is_refused() -> None:
    with pytest.raises(CaseError, match="turn_max is 400 degrees, expected more than 0 and at most 360"):
        PlanarSettings(turn_max=np.radians(400.0))
