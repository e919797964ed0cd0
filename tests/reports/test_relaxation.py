"""What would have to give: the section of a run whose limits no path was found to keep."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from reports import render_report
from reports.derived import derived_values
from reports.numbers import Source
from reports.relaxation import relief

RELAXATION: dict[str, Any] = {
    "smallest": "bend radius",
    "clearance_mm": 1.893,
    "clearance_change_percent": -5.35,
    "curvature_per_mm": 0.105,
    "bend_radius_mm": 1.0 / 0.105,
    "bend_radius_change_percent": 100.0 * (0.1 / 0.105 - 1.0),
    "pareto": [
        {"clearance_mm": 1.893, "curvature_per_mm": 0.1, "bend_radius_mm": 10.0},
        {"clearance_mm": 2.0, "curvature_per_mm": 0.105, "bend_radius_mm": 1.0 / 0.105},
    ],
}
WAY = {"clearance_upper_bound_mm": 2.49, "point_mm": [0.0, 1.0, 2.0], "end": None, "required_mm": 2.0, "proves_impossible": False}


def source(relaxation: dict[str, Any], way: dict[str, Any]) -> Source:
    result = {
        "limits": {"curvature_max_per_mm": 0.1, "clearance_min_mm": 2.0},
        "details": {"relaxation": relaxation, "bottleneck": way},
    }
    return Source(result, derived_values(result))


def test_the_smaller_change_is_named_and_both_stand_with_what_was_asked_for() -> None:
    found = relief(source(RELAXATION, WAY))
    assert found is not None
    radius, bend = found.changes
    assert [str(radius.asked), str(radius.would_do), str(radius.change)] == [
        "2.000\u00a0mm",
        "1.893\u00a0mm",
        "\u22125.3\u00a0%",
    ]
    assert [str(bend.asked), str(bend.would_do), str(bend.change)] == ["10.00\u00a0mm", "9.52\u00a0mm", "\u22124.8\u00a0%"]
    assert (radius.smallest, bend.smallest) == (False, True)
    assert "none is excluded" in str(found.lead)
    assert str(found.lead).endswith("of the bend radius.")
    assert [str(row[0]) for row in found.line] == ["10.00", "9.52"]


def test_a_proof_by_a_bend_is_said_with_its_place_and_without_one_the_bend_is_named() -> None:
    bend = {"clearance_upper_bound_mm": 1.914, "point_mm": [-2.3, 5.6, 0.0], "proves_impossible": True}
    found = relief(source(RELAXATION, WAY | {"bend": bend, "proves_impossible": True}))
    assert found is not None
    lead = str(found.lead).replace("\u00a0", " ")
    assert lead.startswith("Proved: under the curvature limit no path past the bend keeps 1.914 mm, at (\u22122.3, 5.6, 0.0) mm")
    assert "2.000 mm are asked for" in lead
    open_bend = bend | {"clearance_upper_bound_mm": 2.2, "proves_impossible": False}
    found = relief(source(RELAXATION, WAY | {"bend": open_bend}))
    assert found is not None
    assert "the sharpest bend leaves less than 2.200 mm" in str(found.lead).replace("\u00a0", " ")


def test_a_proof_is_said_with_its_place_and_without_a_trade_there_is_no_chart() -> None:
    alone = copy.deepcopy(RELAXATION) | {"smallest": "instrument radius", "curvature_per_mm": None, "bend_radius_mm": None}
    alone |= {"bend_radius_change_percent": None, "pareto": RELAXATION["pareto"][:1]}
    found = relief(source(alone, WAY | {"proves_impossible": True, "clearance_upper_bound_mm": 1.9}))
    assert found is not None
    assert "Proved: whatever its bends, no path keeps more than 1.900\u00a0mm, at (0.0, 1.0, 2.0) mm" in str(found.lead)
    assert str(found.changes[1].would_do) == "none found"
    assert found.chart == ""
    assert "No bend radius helps" in str(found.line_words)


def test_nothing_found_to_do_is_said() -> None:
    nothing = dict.fromkeys(RELAXATION) | {"pareto": []}
    found = relief(source(nothing, WAY))
    assert found is not None
    assert "No single change was found to do" in str(found.lead)


@pytest.mark.parametrize("told", [True, False])
def test_the_page_has_the_section_where_the_run_has_a_relaxation(make_review: Callable[..., Any], told: bool) -> None:
    review = make_review(ct=False)
    if told:
        details = {**review.result["details"], "relaxation": RELAXATION, "bottleneck": WAY}
        review = replace(review, result={**review.result, "details": details})
    page = render_report(review)
    assert ("What would have to give" in page) is told
    assert ('data-key="details.relaxation.bend_radius_mm"' in page) is told
