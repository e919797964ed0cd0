"""Free directions, ways onto them, and the local search around the best paths: in scenes whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.volume import Volume
from tubeplan_viz.rigid import CoupledInstrument, Judge, RigidPath, Weights
from tubeplan_viz.rigid.free_directions import FINEST_MM, PITCHES, free_directions
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.obstacles import build_obstacles
from tubeplan_viz.rigid.polish import polish
from tubeplan_viz.rigid.search_state import SearchSettings, State
from tubeplan_viz.rigid.shared_nodes import alternating, refine, share, spread
from tubeplan_viz.rigid.ways import LEAST_LEG_MM, Ways

TOOL = CoupledInstrument()
GOAL = np.array([40.0, 90.0, 40.0])
SETTINGS = SearchSettings(rolls=1, nodes=1)


def scene(*, wall: bool = True, gap: tuple[float, float] = (36.0, 44.0)) -> Judge:
    """A wall across y = 60 mm, 4 mm thick, with a slit between two x; starts on a square at y = 10."""
    volume = Volume(np.zeros((80, 100, 80), np.int16), np.eye(4)[[2, 1, 0, 3]])
    mask = np.zeros((80, 100, 80), bool)
    if wall:
        mask[:, 58:62] = True
        mask[:, 58:62, int(gap[0]) : int(gap[1])] = False
    x, z = np.meshgrid(np.arange(25.0, 56.0, 3.0), np.arange(31.0, 47.0, 3.0))
    starts = np.column_stack([x.ravel(), np.full(x.size, 10.0), z.ravel()])
    return Judge(build_obstacles(volume, {"wall": mask}), TOOL, starts)


def state_of(judge: Judge) -> State:
    n = len(judge.mouth)
    return State(judge.mouth, GOAL, judge, [], np.zeros(n, bool), np.zeros((n, len(judge.obstacles.names)), np.int64))


def test_all_directions_are_free_without_obstacles_and_all_starts_are_among_them() -> None:
    judge = scene(wall=False)
    fan = free_directions(judge, judge.mouth, GOAL, 0.0, known=np.empty((0, 3)))
    # The grid of 1 mm, at 80 mm: every start has a direction within half a cell's diagonal, and what that is as an angle.
    ways = unit(judge.mouth - GOAL)
    nearest = np.linalg.norm(ways[:, None] - fan[None], axis=2).min(axis=1)
    assert nearest.max() <= np.sqrt(0.5) * PITCHES[0] * FINEST_MM / 80.0 + 1e-6


def test_free_directions_are_those_that_pass_the_slit() -> None:
    judge = scene()
    fan = free_directions(judge, judge.mouth, GOAL, 0.0, known=np.empty((0, 3)))
    assert len(fan)
    # The slit's faces lie at x = 35.5 and 43.5, its ends at y = 57.5 and 61.5. The endoscope, 2 mm in radius, needs that much
    # room at both ends, but for the slant (its radius grows by 1 / cos) and the envelope's cover of up to 0.21 mm.
    for y in (57.5, 61.5):
        x = GOAL[0] + (y - GOAL[1]) * fan[:, 0] / fan[:, 1]
        assert x.min() >= 37.5 - 1e-6
        assert x.max() <= 41.5 + 1e-6
    across = GOAL[0] + (57.5 - GOAL[1]) * fan[:, 0] / fan[:, 1]
    # Every place between is used: the grid's cells are at most 0.41 mm apart there, and 0.25 mm goes to slant and cover.
    assert across.min() <= 37.5 + 0.7
    assert across.max() >= 41.5 - 0.7


def test_a_closed_wall_leaves_no_direction() -> None:
    judge = scene(gap=(0.0, 0.0))
    assert len(free_directions(judge, judge.mouth, GOAL, 0.0, known=np.empty((0, 3)))) == 0


def test_a_way_is_entered_at_the_angle_it_names() -> None:
    direction, turn = unit(np.array([0.1, -1.0, 0.2])), np.radians(22.0)
    ways = Ways(GOAL)
    which = ways.add(np.tile(direction, (2, 1)), np.array([turn, np.radians(4.0)]), 0.0)
    starts = np.array([[30.0, 10.0, 35.0], [50.0, 12.0, 44.0]])
    first, second = ways.seen_from(which[[0, 0]], starts)
    assert second == pytest.approx(np.tile(GOAL, (2, 1)))
    for node, start in zip(first, starts, strict=True):
        assert unit(node - GOAL) == pytest.approx(direction, abs=1e-12)
        assert np.arccos(unit(node - start) @ unit(GOAL - node)) == pytest.approx(turn, abs=1e-9)
        assert np.linalg.norm(node - GOAL) >= LEAST_LEG_MM
    # Far aside a gentle turn would lie beyond the goal.
    assert np.isnan(ways.seen_from(which[1:], np.array([[70.0, 10.0, 40.0]]))[0]).all()


def test_ways_that_hardly_differ_have_one_key_and_tails_keep_their_nodes() -> None:
    direction = unit(np.array([0.1, -1.0, 0.2]))
    ways = Ways(GOAL)
    first = ways.add(direction[None], np.radians([22.0]), 0.0)
    tail = (np.array([30.0, 40.0, 41.0]), np.array([34.0, 60.0, 41.0]), GOAL)
    bent = ways.add_tail(direction, 0.0, tail)
    # 1e-5 is far below the thousandth of a unit vector and the degree that tell ways apart; 3 degrees are above.
    again = ways.add(np.tile(direction + 1e-5, (2, 1)), np.radians([22.1, 25.0]), 0.0)
    keys = ways.keys(np.concatenate([first, bent, again]))
    assert keys[0] == keys[2]
    assert len({keys[0], keys[1], keys[3]}) == 3
    node, following = ways.seen_from(bent, np.array([[30.0, 10.0, 35.0]]))
    assert node[0] == pytest.approx(tail[0])
    assert following[0] == pytest.approx(tail[1])
    assert [place.tolist() for place in ways.after(int(bent[0]))] == [tail[1].tolist(), GOAL.tolist()]
    assert [place.tolist() for place in ways.after(int(first[0]))] == [GOAL.tolist()]


def test_shared_ways_solve_starts_whose_straight_push_is_blocked_and_all_are_free() -> None:
    judge = scene()
    state = state_of(judge)
    label, _ = judge.push(state.starts, np.broadcast_to(GOAL, state.starts.shape), np.zeros(len(state.starts)))
    for row in np.flatnonzero(label < 0):
        state.solve(int(row), (state.starts[row], GOAL), 0.0)
    straight = int(state.solved.sum())
    assert 0 < straight < len(state.starts)
    fans = {0.0: free_directions(judge, state.starts, GOAL, 0.0, known=np.empty((0, 3)))}
    share(state, fans, lambda: None)
    refine(state, fans, SETTINGS, lambda: None)
    assert state.solved.sum() > straight
    assert len({path.start for path in state.paths}) == len(state.paths) == state.solved.sum()
    exact = Judge(judge.obstacles, TOOL, judge.mouth, exact=True)
    for path in state.paths:
        assert path.nodes[0] == pytest.approx(state.starts[path.start])
        label, _ = exact.push(path.nodes[:-1], path.nodes[1:], np.zeros(len(path.nodes) - 1))
        assert (label < 0).all()


def test_without_directions_nothing_is_offered() -> None:
    judge = scene()
    state = state_of(judge)
    share(state, {0.0: np.empty((0, 3))}, lambda: None)
    refine(state, {0.0: np.empty((0, 3))}, SETTINGS, lambda: None)
    assert not state.solved.any()
    assert judge.tests == 0


def test_a_spread_holds_one_row_of_every_cube_and_alternating_numbers_are_all_there() -> None:
    points = np.random.default_rng(2).uniform(0.0, 30.0, (300, 3))
    rows = np.arange(10, 300)
    some = spread(points, rows)
    assert set(some) <= set(rows.tolist())
    cubes = {tuple(cube) for cube in np.floor(points[rows] / 3.0).astype(int).tolist()}
    assert len(some) == len(cubes)
    assert sorted(alternating(97).tolist()) == list(range(97))


def test_polishing_shortens_a_detour_to_the_nearest_start_with_a_straight_way() -> None:
    judge = scene(wall=False)
    starts = judge.mouth
    row = int(np.argmax(np.linalg.norm(starts - GOAL, axis=1)))
    bent = RigidPath(np.array([starts[row], [30.0, 50.0, 40.0], GOAL]), 0.0, row)

    def measure(paths: object) -> np.ndarray:
        assert isinstance(paths, list | tuple)
        return np.array([[1.0, 1.0, 1.0, 1.0, path.length, 0.0] for path in paths])

    better, goals = polish(judge, starts, (bent,), measure([bent]), Weights(), measure)
    shortest = np.linalg.norm(starts - GOAL, axis=1).min()
    assert goals[:, 4].min() == pytest.approx(min(path.length for path in better))
    # In the open the straight push from the nearest start is the shortest of all paths.
    assert goals[:, 4].min() == pytest.approx(shortest, rel=1e-9)


def test_polishing_never_trades_a_free_path_for_a_blocked_one() -> None:
    judge = scene()
    starts = judge.mouth
    label, _ = judge.push(starts, np.broadcast_to(GOAL, starts.shape), np.zeros(len(starts)))
    row = int(np.flatnonzero(label < 0)[0])
    path = RigidPath(np.array([starts[row], GOAL]), 0.0, row)

    def measure(paths: object) -> np.ndarray:
        assert isinstance(paths, list | tuple)
        return np.array([[-p.nodes[0, 0], 1.0, 1.0, 1.0, p.length, p.nodes[0, 2]] for p in paths])

    better, goals = polish(judge, starts, (path,), measure([path]), Weights(), measure)
    assert len(better) == len(goals) > 0
    for found in better:
        label, _ = judge.push(found.nodes[:-1], found.nodes[1:], np.zeros(len(found.nodes) - 1))
        assert (label < 0).all()
