"""Every figure that the page prints is the result's, and says so in a form that can be checked."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from reports import DERIVED, derived_values, render_report
from reports.numbers import Figure, Source, printed
from tubeplan_viz.result import digits_apart
from tubeplan_viz.verify.page import derived as verified

CASES = {
    "flagged": {},
    "holds": {"curvature_max": 0.25, "clearance_min": 0.8},
    "infeasible": {"infeasible": True},
    "mesh": {"ct": False},
    "many flags": {"clearance_min": 1.95},
}


@pytest.mark.parametrize("case", CASES)
def test_every_marked_figure_is_the_results_and_printed_as_it_rounds(make_review: Any, numbers_shown: Any, case: str) -> None:
    review = make_review(**CASES[case])
    page = numbers_shown.Page(render_report(review))
    assert len(page.found) > 60
    assert page.faults(review.result, derived_values(review.result)) == []
    keys = {key for key, _, _ in page.found}
    assert {"metrics.clearance_min_mm", "metrics.length_mm", "derived:margin_mm", "derived:bend_radius_mm"} <= keys
    assert json.loads(page.scripts["tubeplan-result"]) == review.result


def test_every_derived_figure_is_documented_and_follows_its_formula(make_review: Any) -> None:
    result = make_review().result
    result["details"]["bottleneck"] = {"clearance_upper_bound_mm": 0.9}
    values = derived_values(result)
    assert {".".join("N" if part.isdigit() else part for part in key.split(".")) for key in values} == set(DERIVED)
    metrics, limits, path, flags = result["metrics"], result["limits"], result["path"], result["flagged_intervals"]
    assert values["derived:margin_mm"] == metrics["clearance_min_mm"] - limits["clearance_min_mm"]
    assert values["derived:bend_radius_mm"] * metrics["curvature_max_per_mm"] == pytest.approx(1.0)
    assert values["derived:clearance_min_at_mm"] == path["s_mm"][int(np.argmin(path["clearance_mm"]))]
    assert values["derived:flagged_clearance_mm"] == sum(f["to_mm"] - f["from_mm"] for f in flags if f["kind"] == "clearance")
    assert values["derived:path_diameter_mm"] == 2.0 * metrics["clearance_min_mm"]
    assert values["derived:narrow_by_mm"] == limits["clearance_min_mm"] - 0.9
    assert values["derived:kept_until_mm"] == [s for s in path["s_mm"] if s < min(f["from_mm"] for f in flags)][-2]
    # The verifier has formulas of its own, for every one of them: a page with a figure that it cannot check is refused.
    told = {key: verified(result, key) for key in values}
    assert told == {key: (True, pytest.approx(value, rel=1e-12)) for key, value in values.items()}
    sharp = next(k for k, flag in enumerate(flags) if flag["kind"] == "curvature")
    assert values[f"derived:flag.{sharp}.radius_mm"] * flags[sharp]["worst"] == pytest.approx(1.0)


def test_minus_is_a_minus_sign_and_zero_has_none() -> None:
    assert printed(-0.147, 2) == "\u22120.15"
    assert printed(-0.001, 2) == "0.00"
    assert printed(0.05, 2, signed=True) == "+0.05"


def test_a_limit_missed_by_little_is_printed_with_the_digits_that_show_it() -> None:
    assert printed(1.1996, digits_apart(1.1996, 1.2, 2)) == "1.1996"
    assert digits_apart(1.2, 1.2, 2) == 2


def test_a_figure_escapes_nothing_it_does_not_have_and_keeps_the_exact_number() -> None:
    figure = Figure("metrics.length_mm", 124.86088812011234, 1, "mm")
    assert figure.__html__() == '<data class="v" value="124.86088812011234" data-key="metrics.length_mm">124.9</data>\u00a0mm'
    assert Source({"metrics": {"a": True, "b": None}}).figure("metrics.a", 1) is None
    with pytest.raises(KeyError, match="metrics\\.b"):
        Source({"metrics": {"b": None}}).need("metrics.b", 1)
