"""Rows of the best path on anatomy, and the name under which they are asked for."""

from __future__ import annotations

import pytest

from tubeplan_viz.bench.anatomies import anatomies
from tubeplan_viz.bench.optimal_anatomies import way_rows
from tubeplan_viz.cli.app import status_of


def test_a_way_through_the_generated_urography_is_within_one_percent_of_what_its_lumen_leaves() -> None:
    (anatomy,) = anatomies(("generated urography",))
    label = anatomy.goals[0][0]
    clearance, beside, seconds = way_rows(anatomy, label)
    assert clearance.holds
    assert clearance.reference is not None
    assert clearance.ours <= clearance.reference + 1e-9
    assert beside.holds is not False
    assert seconds.ours > 0.0


def test_a_benchmark_without_methods_refuses_the_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(["bench", "centerline", "--method", "optimal"]) == 2
    assert "has no --method optimal" in capsys.readouterr().err
    assert status_of(["bench", "paper", "--method", "magic"]) == 2
    assert "expected optimal or feature_iteration" in capsys.readouterr().err
