"""The truth that infeasible cases are held against."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.bench.infeasible import BEND, TUBE, bend_at_clearance, clearance_at_bend


@pytest.mark.parametrize("path_bend", [8.0, 9.5, 13.0, 40.0])
def test_clearance_at_a_bend_is_that_of_the_arc_through_both_ends(path_bend: float) -> None:
    # Quarter bend about the origin from (8, 0) to (0, 8); the arc through both has its centre on the diagonal beyond.
    half = BEND * np.sqrt(0.5)
    centre = (half - np.sqrt(path_bend**2 - half**2)) * np.sqrt(0.5)
    turn = np.arcsin(half / path_bend)
    angle = np.pi / 4.0 + np.linspace(-turn, turn, 2001)
    arc = centre + path_bend * np.column_stack([np.cos(angle), np.sin(angle)])
    assert arc[[0, -1]] == pytest.approx(np.array([[BEND, 0.0], [0.0, BEND]]), abs=1e-9)
    least = TUBE - np.abs(np.linalg.norm(arc, axis=1) - BEND).max()
    assert clearance_at_bend(path_bend) == pytest.approx(least, abs=1e-6)


def test_bend_at_clearance_is_the_inverse() -> None:
    for bend in (8.5, 10.0, 20.0):
        assert bend_at_clearance(clearance_at_bend(bend)) == pytest.approx(bend)
