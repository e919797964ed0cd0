"""Bends in a row: a hook that no curve passes is proved to be one, nothing that a path keeps is excluded, and the facts hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from segmentation.arrays import FloatArray
from tubeplan_viz.bench.infeasible import sagitta
from tubeplan_viz.bench.models import torus_piece
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube import TubeProblem, TubeSettings, pose_problem
from tubeplan_viz.tube.bend import STEP, bend_bound, resampled
from tubeplan_viz.tube.bend_row import excluding_row, likely_chains, turning_places, turns
from tubeplan_viz.tube.cells import first_cells
from tubeplan_viz.tube.chain import Chain, ChainMaker
from tubeplan_viz.tube.explain import explain
from tubeplan_viz.tube.impassable import impassable
from tubeplan_viz.tube.optimal import OptimalSettings

HOOK, TUBE = 6.5, 1.5


@pytest.fixture(scope="module")
def hook() -> TubeProblem:
    """Half a turn of a tube: too wide for the ball of one bend."""
    model = torus_piece(bend_radius=HOOK, angle=np.pi, radius=TUBE)
    return pose_problem(model.surface, model.start, model.goal, Limits(curvature_max=0.125, clearance_min=0.3), TubeSettings())


def kept_in_the_hook(path_bend: float) -> float:
    """Clearance of the arc from end to end, mm: by Schur's theorem no such path comes nearer to the axis' middle."""
    return TUBE - (HOOK - sagitta(path_bend, HOOK))


def test_through_a_hook_no_curve_passes_that_misses_its_middle_by_more_than_the_tube(hook: TubeProblem) -> None:
    assert kept_in_the_hook(7.0) < 0.0
    found = bend_bound(hook.wall, hook.centerline, curvature=1.0 / 7.0, ceiling=TUBE, limit=0.0)
    assert found is not None
    assert found.bound == 0.0
    assert len(found.sections) >= 3
    # Three sections in one ball, which the whole hook does not fit in, leave some clearance.
    one = bend_bound(hook.wall, hook.centerline, curvature=1.0 / 7.0, ceiling=TUBE, limit=0.0, several=False)
    assert one is not None
    assert one.bound > 0.5


@pytest.mark.parametrize("path_bend", [6.52, 6.55])
def test_what_an_arc_keeps_in_a_hook_is_never_excluded(hook: TubeProblem, path_bend: float) -> None:
    curvature, clearance = 1.0 / path_bend, 0.97 * kept_in_the_hook(path_bend)
    assert clearance > 0.3
    way = resampled(hook.centerline, STEP / curvature)
    cells = first_cells(hook.wall, clearance, count=40_000)
    places = turning_places(way, curvature)
    assert len(places) > 10
    assert excluding_row(cells, way, places, curvature=curvature, clearance=clearance) is None


def test_the_sentence_of_a_hook_names_place_and_limits(hook: TubeProblem) -> None:
    found = explain(hook.wall, hook.centerline, hook.limits, OptimalSettings())
    assert found.impossible
    assert found.sentence.startswith("no path exists at 0.125 1/mm")
    assert "mm along the centerline" in found.sentence
    assert "0.3 mm are required" in found.sentence
    assert found.details["bottleneck"]["bend"]["proves_impossible"]


def test_no_path_that_there_is_is_ever_excluded_and_every_piece_of_it_is_as_short_as_claimed(
    kept_paths: Callable[[int, int, float], Iterator[Any]],
) -> None:
    chains = 0
    for kept in kept_paths(23, 6, 0.04):
        wall, way, clearance, curvature = kept.wall, kept.way, kept.clearance, kept.curvature
        maker = ChainMaker(first_cells(wall, clearance, count=20_000), way, clearance=clearance, curvature=curvature)
        places = [place for place in range(0, len(way.points), 3) if np.isfinite(maker.width(place))]
        curve = kept.path(np.linspace(0.0, 1.0, 6001))
        for at in likely_chains(way, places, curvature, clearance)[:10]:
            chain = maker.chain(at)
            if chain is None:
                continue
            chains += 1
            assert not impassable(wall, chain, curvature=curvature, clearance=clearance)
            assert_short_between(curve, chain, curvature)
    assert chains >= 12


def assert_short_between(curve: FloatArray, chain: Chain, curvature: float) -> None:
    """From the last crossing of each section before the next to that one the curve is no longer than the claimed ball allows."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    times: list[int] = []
    for k, station in reversed(list(enumerate(chain.stations))):
        if station.width == 0.0:
            found = np.array([0 if k == 0 else len(curve) - 1])
        else:
            height = (curve - station.origin) @ station.normal
            crossed = np.flatnonzero((height[:-1] <= 0.0) != (height[1:] <= 0.0))
            found = crossed[np.linalg.norm(curve[crossed] - station.origin, axis=1) <= station.radius + 0.05]
        earlier = found[found < times[0]] if times else found
        assert len(earlier)
        times.insert(0, int(earlier[-1] if times else earlier[0]))
    step = float(np.diff(length).max())
    for begin, end, radius in zip(times, times[1:], chain.radii, strict=False):
        assert length[end] - length[begin] <= 2.0 / curvature * np.arcsin(curvature * radius) + 2.0 * step


def test_turns_of_a_circle_are_what_a_path_of_its_curvature_may_have() -> None:
    angle = np.array([0.0, 0.4, 0.7, 1.3])
    points = 8.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    turn, allowed = turns(points, 1.0 / 8.0)
    assert turn == pytest.approx(allowed, rel=1e-12)
    # Each chord turns by half its arc at either end: the sum of the inner halves.
    assert turn == pytest.approx(0.5 * (0.4 + 0.3) + 0.5 * (0.3 + 0.6), rel=1e-12)


def test_along_a_straight_line_nothing_is_looked_at() -> None:
    points = np.column_stack([np.zeros(200), np.zeros(200), np.linspace(0.0, 160.0, 200)])
    assert turning_places(Centerline(points, np.full(200, 2.0)), 0.125) == []
