"""The optimal refinement against another path: which of two stands, and that the better one is taken."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.bench.models import straight_tube, torus_piece
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.plan import Limits, NoPathError
from tubeplan_viz.tube.never_worse import Standing, never_worse, standing, standing_of
from tubeplan_viz.tube.optimal import CLEARANCE_TOLERANCE, optimise
from tubeplan_viz.tube.passage import OptimalSettings, Passage
from tubeplan_viz.tube.spline import spline_through


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        (Standing(excess=0.0, clearance=1.1), Standing(excess=0.0, clearance=1.0)),
        (Standing(excess=0.0, clearance=0.5), Standing(excess=0.1, clearance=1.0)),
        (Standing(excess=2.0, clearance=0.1), Standing(excess=0.0, clearance=-0.1)),
    ],
    ids=["more room", "bends less", "stays in the lumen"],
)
def test_one_path_beats_another(better: Standing, worse: Standing) -> None:
    assert better.beats(worse)
    assert not worse.beats(better)


def test_the_proof_that_a_proposal_carries_is_that_of_its_curve() -> None:
    model = torus_piece(bend_radius=15.0, radius=2.5)
    passage = Passage(
        wall=WallDistance(model.surface), line=model.axis_points, limits=Limits(curvature_max=0.06, clearance_min=1.5)
    )
    first, *_, last = optimise(passage, OptimalSettings())
    assert first.clearance is None
    assert standing_of(first, passage) == standing(first.curve, passage)
    assert last.clearance is not None
    again, carried = standing(last.curve, passage), standing_of(last, passage)
    assert carried.excess == again.excess == 0.0
    # Two proofs of one curve, each within the tolerance below the truth.
    assert carried.clearance == pytest.approx(again.clearance, abs=CLEARANCE_TOLERANCE)
    assert carried.clearance <= passage.wall.clearance(last.curve(np.linspace(0.0, 1.0, 2001))).min()


def test_a_line_that_no_spline_follows_is_replaced_by_the_other_path() -> None:
    model = straight_tube()
    wall = WallDistance(model.surface)
    limits = Limits(curvature_max=0.1, clearance_min=2.0)
    # Half of the line lies outside the tube: no fit to it stays inside.
    strayed = np.array(model.axis_points)
    strayed[20:-20, 0] += 8.0
    axis = spline_through(np.array(model.axis_points[:: len(model.axis_points) // 6]))[0]
    passage = Passage(wall=wall, line=strayed, limits=limits)
    *_, last = never_worse(passage, OptimalSettings(), lambda: axis)
    assert not standing(axis, passage).beats(standing(last.curve, passage))
    with pytest.raises(NoPathError, match="no spline"):
        list(never_worse(passage, OptimalSettings(), lambda: spline_through(strayed[::40])[0]))
