"""How a command tells the outcome of a plan in lines."""

from __future__ import annotations

from typing import Any

import pytest

from tubeplan_viz.cli.show import outcome_lines

PARTS = [{"name": "ureter", "from_mm": 0.0, "to_mm": 60.0}, {"name": "renal pelvis", "from_mm": 60.0, "to_mm": 80.0}]


def result(**over: Any) -> dict[str, Any]:
    """A plan of 80 mm whose samples are tightest at 70 mm and sharpest at 20 mm."""
    made = {
        "status": "ok",
        "reason": None,
        "limits": {"clearance_min_mm": 1.2, "curvature_max_per_mm": 0.125},
        "metrics": {"length_mm": 80.0, "clearance_min_mm": 1.5, "curvature_max_per_mm": 0.1, "tip_error_mm": None},
        "path": {
            "s_mm": [0.0, 20.0, 70.0, 80.0],
            "clearance_mm": [2.0, 1.8, 1.5, 1.9],
            "curvature_per_mm": [0.0, 0.1, 0.02, 0.0],
        },
        "flagged_intervals": [],
        "details": {"parts": PARTS, "warnings": ["the image border cuts the lumen"]},
    }
    return made | over


def test_figures_stand_with_limit_place_and_part() -> None:
    lines = outcome_lines(result())
    assert lines == [
        "holds: both limits are kept and proved over the whole path",
        "path 80.0 mm, through ureter, renal pelvis",
        "least clearance 1.50 mm at 70.0 mm, renal pelvis; 1.2 mm asked for",
        "largest curvature 0.1000 1/mm at 20.0 mm, ureter; 0.125 1/mm allowed",
        "note: the image border cuts the lumen",
    ]


def test_a_flag_between_the_samples_is_the_place_that_is_told() -> None:
    flags = [
        {"kind": "clearance", "from_mm": 50.0, "to_mm": 58.0, "worst": 1.0, "worst_at_mm": 57.0},
        {"kind": "clearance", "from_mm": 69.0, "to_mm": 71.0, "worst": 1.1, "worst_at_mm": 70.0},
    ]
    metrics = {"length_mm": 80.0, "clearance_min_mm": 1.0, "curvature_max_per_mm": 0.1, "tip_error_mm": None}
    lines = outcome_lines(result(status="flagged", reason="too near", flagged_intervals=flags, metrics=metrics))
    assert lines[0] == "flagged: too near"
    assert "least clearance 1.00 mm at 57.0 mm, ureter; 1.2 mm asked for" in lines
    assert "  clearance from 69.0 to 71.0 mm, worst 1.1 mm at 70.0 mm, renal pelvis" in lines


@pytest.mark.parametrize(
    ("clearance", "bend", "said"),
    [
        (0.9, None, "would do: instrument radius 0.900 mm (-25.0 %)"),
        (0.9, 6.0, "would do: instrument radius 0.900 mm (-25.0 %) or bend radius 6.000 mm (-25.0 %)"),
        (None, None, "no single change of a limit was found that would do"),
    ],
)
def test_where_nothing_holds_the_smallest_changes_are_told(clearance: float | None, bend: float | None, said: str) -> None:
    told = {
        "clearance_mm": clearance,
        "clearance_change_percent": None if clearance is None else -25.0,
        "bend_radius_mm": bend,
        "bend_radius_change_percent": None if bend is None else -25.0,
    }
    lines = outcome_lines(result(status="infeasible", reason="no path exists", details={"relaxation": told}))
    assert lines[0] == "infeasible: no path exists"
    assert said in lines


def test_where_nothing_holds_the_last_place_that_does_is_told_as_a_goal() -> None:
    path = {"s_mm": [0.0, 1.0, 2.0, 3.0, 4.0], "points_mm": [[0.0, 0.0, z] for z in (0.0, 1.0, 2.0, 3.0, 4.0)]}
    flags = [{"kind": "clearance", "from_mm": 3.5, "to_mm": 4.0, "worst": 1.0, "worst_at_mm": 4.0}]
    lines = outcome_lines(result(status="infeasible", reason="no path exists", path=path, flagged_intervals=flags))
    assert "both limits are kept up to 2.0 mm, ureter: a goal at 0.00,0.00,2.00 is reached" in lines
    flags[0]["from_mm"] = 0.5
    lines = outcome_lines(result(status="infeasible", reason="no path exists", path=path, flagged_intervals=flags))
    assert not [line for line in lines if "is reached" in line]


def test_a_planner_without_clearance_or_parts_tells_what_it_has() -> None:
    metrics = {"length_mm": 80.0, "clearance_min_mm": None, "curvature_max_per_mm": 0.1, "tip_error_mm": 0.012}
    limits = {"clearance_min_mm": None, "curvature_max_per_mm": None}
    lines = outcome_lines(result(metrics=metrics, limits=limits, path=None, details={}))
    assert lines == [
        "holds: the path is free and proved over the whole path",
        "path 80.0 mm",
        "largest curvature 0.1000 1/mm",
        "tip error 0.012 mm",
    ]
