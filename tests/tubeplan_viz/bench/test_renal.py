"""Renal rows: every breach is flagged, and the check that says so can fail."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tubeplan_viz.bench.models import narrow_neck
from tubeplan_viz.bench.renal import RENAL_LIMITS, RENAL_SETTINGS, case_rows, orifice_and_calyces, renal_rows, unflagged_length
from tubeplan_viz.centerline import Endpoint
from tubeplan_viz.tube import conclude, pose_problem, tube_steps


@pytest.fixture(scope="module")
def neck() -> tuple[Any, Any]:
    """A neck of 1 mm radius planned with the renal limits."""
    model = narrow_neck()
    problem = pose_problem(model.surface, model.start, model.goal, RENAL_LIMITS, RENAL_SETTINGS)
    return problem, conclude(problem, list(tube_steps(problem)))


def test_a_flagged_breach_is_not_counted_and_a_hidden_one_is(neck: tuple[Any, Any]) -> None:
    problem, plan = neck
    assert len(plan.flagged) == 1
    assert unflagged_length(plan, problem.wall) == 0.0
    flag = plan.flagged[0]
    assert unflagged_length(replace(plan, flagged=()), problem.wall) == pytest.approx(flag.end - flag.start, abs=0.02)
    # Half of the flag taken away: the other half is missed, but for what a flag may be off.
    half = replace(flag, end=0.5 * (flag.start + flag.end))
    missed = unflagged_length(replace(plan, flagged=(half,)), problem.wall)
    assert missed == pytest.approx(0.5 * (flag.end - flag.start) - 0.05, abs=0.02)


def test_the_columns_are_those_of_table_3(neck: tuple[Any, Any]) -> None:
    rows = {row.figure: row for row in case_rows("neck", neck[0])}
    # 40 mm in steps of at most 1 mm.
    assert rows["centerline points"].ours in (41, 42)
    assert rows["least clearance mm"].ours == pytest.approx(1.0, abs=0.01)
    assert rows["least clearance mm"].source == "Dai 2024, renal: 0.605 to 1.528"
    assert rows["mean distance to the centerline mm"].holds is True
    assert rows["flagged stretches"].ours == 1


def test_the_generated_urography_holds_its_targets() -> None:
    rows = renal_rows(quick=True, notify=lambda stage, done, total: None)
    assert {row.case for row in rows} == {"renal, generated, middle calyx"}
    held = [row for row in rows if row.holds is not None]
    assert len(held) == 2
    assert all(row.holds for row in held)


def test_the_orifice_is_lowest_and_the_calyces_are_spread_over_the_kidney() -> None:
    def tip(y: float) -> Endpoint:
        return Endpoint(label="E1", point=np.array([0.0, y, 0.0]), radius=1.0, branch_length=9.0, confidence=1.0)

    orifice, calyces = orifice_and_calyces(tuple(tip(y) for y in (250.0, 9.0, 100.0, 220.0, 270.0, 200.0)))
    assert orifice.point[1] == 9.0
    assert [c.point[1] for c in calyces] == [200.0, 250.0, 270.0]
