"""Places on a result's path."""

from __future__ import annotations

from typing import Any

from tubeplan_viz.plan import Limits
from tubeplan_viz.recording.summary import case_text
from tubeplan_viz.result import kept_until, place_words, worst_at

S = [0.0, 1.0, 2.0, 3.0, 4.0]


def result(flags: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "status": "infeasible",
        "planner": {"name": "tube", "method": "optimal"},
        "metrics": {"clearance_min_mm": 1.0, "curvature_max_per_mm": 0.1},
        "path": {
            "s_mm": S,
            "points_mm": [[0.0, 0.0, s] for s in S],
            "clearance_mm": [3.0, 2.0, 1.6, 1.4, 1.2],
            "curvature_per_mm": [0.0, 0.1, 0.05, 0.0, 0.0],
        },
        "flagged_intervals": flags,
        "details": {
            "parts": [{"name": "ureter", "from_mm": 0.0, "to_mm": 2.5}, {"name": "pelvis", "from_mm": 2.5, "to_mm": 4.0}]
        },
    }


NARROW = {"kind": "clearance", "from_mm": 2.6, "to_mm": 4.0, "worst": 1.0, "worst_at_mm": 3.5}


def test_the_worst_place_is_the_gravest_flags_else_the_samples() -> None:
    less = {**NARROW, "from_mm": 1.5, "to_mm": 1.8, "worst": 1.1, "worst_at_mm": 1.7}
    assert worst_at(result([less, NARROW]), "clearance") == 3.5
    assert worst_at(result([NARROW]), "curvature") == 1.0
    assert worst_at(result([]), "clearance") == 4.0
    assert worst_at({"path": None, "flagged_intervals": []}, "clearance") is None


def test_both_limits_are_kept_up_to_the_sample_before_the_last_that_is_not_flagged() -> None:
    assert kept_until(result([NARROW])) == (1.0, [0.0, 0.0, 1.0])
    assert kept_until(result([])) is None
    assert kept_until(result([{**NARROW, "from_mm": 0.5}])) is None


def test_the_recordings_summary_says_where_the_case_is_worst() -> None:
    text = case_text("c", result([NARROW]), [], Limits(curvature_max=0.125, clearance_min=1.5))
    assert "1.00 mm, at 3.5 mm, pelvis" in text
    assert "0.1000 1/mm, at 1.0 mm, ureter" in text
    assert place_words({"details": {}}, 3.5) == "3.5 mm"
