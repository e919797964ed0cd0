"""Verdicts that a later search takes over: they are those that it would find itself."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.arrays import BoolArray
from segmentation.volume import Volume
from tubeplan_viz.rigid import CoupledInstrument, Judge, posed, swept
from tubeplan_viz.rigid.collision import collide, to_frame
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.obstacles import Obstacles, build_obstacles
from tubeplan_viz.rigid.tangents import _first_free
from tubeplan_viz.rigid.verdicts import Verdicts, keys_of

TOOL = CoupledInstrument()
SHAPE = (60, 80, 60)


def blocks(thick: int) -> Obstacles:
    """A wall that is `thick` voxels, which mucosa may shrink, and a fixed block beside it; voxels of 1 mm, LPS axes."""
    volume = Volume(np.zeros(SHAPE, np.int16), np.eye(4)[[2, 1, 0, 3]])
    wall, block = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    wall[20:40, 30:50, 20 : 20 + thick] = True
    block[20:40, 30:50, 45:50] = True
    return build_obstacles(volume, {"wall": wall, "block": block})


def pushes(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random pushes past wall and block: starts, ends, rolls."""
    rng = np.random.default_rng(11)
    start = np.column_stack([rng.uniform(15.0, 50.0, count), np.full(count, 0.0), rng.uniform(22.0, 38.0, count)])
    end = start + np.column_stack([rng.uniform(-6.0, 6.0, count), np.full(count, 60.0), rng.uniform(-3.0, 3.0, count)])
    return start, end, rng.uniform(-0.2, 0.2, count)


def test_a_search_among_less_tissue_takes_over_what_stands_and_finds_what_it_would_find_alone() -> None:
    more, less = blocks(8), blocks(5)
    start, end, roll = pushes(400)
    before = Verdicts(more)
    first, _ = Judge(more, TOOL, start, verdicts=before).push(start, end, roll)
    judge = Judge(less, TOOL, start, verdicts=before.among(less))
    label, place = judge.push(start, end, roll)
    alone, _ = Judge(less, TOOL, start).push(start, end, roll)
    assert np.array_equal(label < 0, alone < 0)
    # Some were opened by what is gone, some are stopped by what is left.
    assert ((first >= 0) & (label < 0)).any()
    assert judge.evaluations < np.count_nonzero(first == 0) < judge.tests == 400
    # What is told to stop an instrument is of the obstacles as they are now.
    hit = label >= 0
    away, _ = less.tree.query(less.frame.to_frame(place[hit]))
    assert away == pytest.approx(np.zeros(len(away)), abs=1e-6)


def test_verdicts_among_the_same_obstacles_leave_nothing_to_evaluate() -> None:
    obstacles = blocks(6)
    start, end, roll = pushes(150)
    before = Verdicts(obstacles)
    first, _ = Judge(obstacles, TOOL, start, verdicts=before).push(start, end, roll)
    judge = Judge(obstacles, TOOL, start, verdicts=before.among(obstacles))
    again, _ = judge.push(start[::-1], end[::-1], roll[::-1])
    assert np.array_equal(again[::-1], first)
    assert judge.evaluations == 0


def test_keys_tell_instruments_apart_by_a_hundredth_of_a_millimetre_and_a_tenth_of_a_degree() -> None:
    tip = np.array([[30.0, 60.0, 30.0]])
    way = unit(np.array([[0.1, 1.0, 0.05]]))
    turned = unit(way + np.array([[0.0, 0.0, np.radians(0.1)]]))
    some = [posed(TOOL, tip, way, 0.0), posed(TOOL, tip + np.array([0.01, 0.0, 0.0]), way, 0.0), posed(TOOL, tip, turned, 0.0)]
    some += [posed(TOOL, tip, way, np.radians(0.1)), posed(TOOL, tip, way, 0.0, run=0.01), some[0].grown(0.01)]
    keys = {keys_of(bodies).tobytes() for bodies in some}
    assert len(keys) == len(some)
    assert np.array_equal(keys_of(posed(TOOL, tip, way, 0.0)), keys_of(some[0]))


def test_an_endoscope_beside_a_shaver_that_is_stopped_need_not_be_looked_at() -> None:
    obstacles = blocks(6)
    start, end, roll = pushes(200)
    bodies = to_frame(swept(TOOL, start, end, roll), obstacles.frame)
    full = collide(obstacles, bodies, exact=False).label.reshape(-1, 2)
    short = collide(obstacles, bodies, exact=False, pairs=True).label.reshape(-1, 2)
    assert np.array_equal(short[:, 0], full[:, 0])
    free = full[:, 0] < 0
    assert 0 < free.sum() < len(free)
    assert np.array_equal(short[free, 1], full[free, 1])


def first_free_by_scanning(angle: np.ndarray, spread: np.ndarray) -> float | None:
    """The least angle from 0 up outside all intervals, tried at every end of one."""
    covered: BoolArray
    for theta in np.sort(np.concatenate([[0.0], angle + spread])):
        covered = (angle - spread <= theta) & (theta < angle + spread)
        if theta >= 0.0 and not covered.any():
            return float(theta)
    return None


@pytest.mark.parametrize("seed", range(30))
def test_the_first_free_angle_is_the_least_that_no_interval_covers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, spread = rng.uniform(-0.5, 1.2, 12), rng.uniform(0.01, 0.3, 12)
    found, expected = _first_free(angle, spread), first_free_by_scanning(angle, spread)
    if expected is None or expected <= 0.0 or expected >= 0.5 * np.pi:
        assert found is None
    else:
        assert found is not None
        assert found[0] == pytest.approx(expected, abs=2e-6)
        assert angle[found[1]] + spread[found[1]] == pytest.approx(expected, abs=1e-12)


def test_obstacles_without_a_structure_are_those_built_without_it_and_what_is_the_same_is_taken_over() -> None:
    volume = Volume(np.zeros(SHAPE, np.int16), np.eye(4)[[2, 1, 0, 3]])
    some = blocks(6)
    masks = dict(zip(some.names, some.masks, strict=True))
    cut, built = some.without(["wall"]), build_obstacles(volume, {"block": masks["block"]})
    assert cut.names == built.names == ("block",)
    for name in ("cells", "half", "label"):
        assert np.array_equal(getattr(cut, name), getattr(built, name))
    assert np.array_equal(cut.field.values, built.field.values)
    assert cut.cover == built.cover
    thinner = masks["wall"].copy()
    thinner[:, :, 24:] = False
    like = build_obstacles(volume, {"wall": thinner, "block": masks["block"]}, like=some)
    fresh = build_obstacles(volume, {"wall": thinner, "block": masks["block"]})
    assert like.trees[1] is some.trees[1]
    assert like.trees[0] is not some.trees[0]
    assert np.array_equal(like.cells, fresh.cells)
    assert np.array_equal(like.field.values, fresh.field.values)
