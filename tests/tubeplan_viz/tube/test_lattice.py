"""The search over place and direction: its chains keep what they say, and it leads past bends that a path is left with."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.bench.infeasible import clearance_at_bend
from tubeplan_viz.bench.models import Model, torus_piece
from tubeplan_viz.geometry import WallDistance, menger_curvature
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube.detour import find_detour, smooth_line
from tubeplan_viz.tube.lattice import ARC, ClearanceGrid, Stretch, way_through
from tubeplan_viz.tube.never_worse import past_sharp_places, standing
from tubeplan_viz.tube.passage import OptimalSettings, Passage, Proposal
from tubeplan_viz.tube.spline import spline_through

BEND, TUBE = 8.0, 2.5
VOXEL = 0.2


@pytest.fixture(scope="module")
def quarter() -> Model:
    return torus_piece(bend_radius=BEND, radius=TUBE)


@pytest.fixture(scope="module")
def wall(quarter: Model) -> WallDistance:
    return WallDistance(quarter.surface)


@pytest.fixture(scope="module")
def stretch(quarter: Model) -> Stretch:
    line = smooth_line(np.array(quarter.axis_points), BEND)
    return Stretch(line=line, free=True, leave=len(line) - 12)


def test_clearance_grid_is_exact_to_second_order(quarter: Model, wall: WallDistance) -> None:
    rng = np.random.default_rng(3)
    points = quarter.axis_points[rng.integers(20, len(quarter.axis_points) - 20, 400)] + rng.uniform(-1.0, 1.0, (400, 3))
    aside = np.linalg.norm(points[:, None] - quarter.axis_points, axis=2).min(axis=1)
    kept = (aside > 0.5) & (aside < 2.2)
    # A voxel's half diagonal squared over twice the distance to the axis, the least radius of the level sets, and the facets.
    error = np.abs(ClearanceGrid(wall, VOXEL)(points[kept]) - wall.clearance(points[kept]))
    assert np.all(error <= 0.75 * VOXEL**2 / 2.0 / (aside[kept] - 0.9 * VOXEL) + 0.06)


def test_a_chain_keeps_curvature_and_clearance_and_meets_the_line(wall: WallDistance, stretch: Stretch) -> None:
    chain = way_through(stretch, ClearanceGrid(wall, VOXEL), curvature=1.0 / BEND, clearance=1.5, scale=BEND)
    assert chain is not None
    assert np.array_equal(chain[0], stretch.line[0])
    step = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    arcs = int(np.argmax(np.abs(step / (ARC * BEND) - 1.0) > 0.01))
    assert arcs * ARC > 1.0
    # Chords of arcs that turn by ARC; what follows is the line, which the chain ran along for at least its own width before.
    assert np.allclose(step[:arcs], ARC * BEND, rtol=ARC**2 / 24.0)
    # Points of arcs of one curvature that turn about any side bend by no more than those arcs do.
    assert menger_curvature(chain[: arcs + 1]).max() <= 1.0 / BEND * (1.0 + 1e-6)
    # The level sets bend by the reciprocal of their distance from the axis, 1 mm: see the grid's own error above.
    assert wall.clearance(chain).min() >= 1.5 - 0.05
    assert np.array_equal(chain[-1], stretch.line[-1])


def test_no_chain_is_found_where_none_can_be(wall: WallDistance, stretch: Stretch) -> None:
    # The chain may end beside the goal, so that more room is left than the closed form says: ask for far more.
    assert clearance_at_bend(40.0, bend=BEND, radius=TUBE) < 0.6
    assert way_through(stretch, ClearanceGrid(wall, VOXEL), curvature=1.0 / 40.0, clearance=2.2, scale=BEND) is None


def wriggling(model: Model) -> Proposal:
    """A path in the lumen that bends far more sharply than the lumen."""
    points = np.array(model.axis_points[:: len(model.axis_points) // 12])
    points[1:-1:2, 2] += 1.2
    curve = spline_through(points)[0]
    return Proposal(curve=curve, phase="fit", least=0.0, mean=0.0, curvature=1.0)


def test_the_search_leads_from_a_wriggling_path_to_one_within_the_limit(quarter: Model, wall: WallDistance) -> None:
    limits = Limits(curvature_max=0.1, clearance_min=1.5)
    passage = Passage(wall=wall, line=np.array(quarter.axis_points), limits=limits)
    worse = wriggling(quarter)
    before = standing(worse.curve, passage)
    assert before.excess > 1.0
    *_, last = past_sharp_places(passage, OptimalSettings(), worse.curve, worse, before)
    after = standing(last.curve, passage)
    assert after.excess == 0.0
    # All of what a bend radius of 10 mm can have there, less the refinement's tolerance and the facets.
    assert after.clearance >= 0.98 * clearance_at_bend(10.0, bend=BEND, radius=TUBE)


def test_nothing_is_shown_where_the_search_finds_no_way() -> None:
    # Stiff as it is, a path misses the middle of this bend by far more than the tube is wide.
    assert clearance_at_bend(50.0, bend=BEND, radius=1.0) < -1.0
    narrow = torus_piece(bend_radius=BEND, radius=1.0)
    wall = WallDistance(narrow.surface)
    passage = Passage(wall=wall, line=np.array(narrow.axis_points), limits=Limits(curvature_max=0.01, clearance_min=0.5))
    worse = Proposal(curve=spline_through(narrow.axis_points[::20])[0], phase="fit", least=0.0, mean=0.0, curvature=0.125)
    assert find_detour(passage, OptimalSettings(), worse.curve) is None
    assert not list(past_sharp_places(passage, OptimalSettings(), worse.curve, worse, standing(worse.curve, passage)))
