"""Errors of pose on the page: each figure is the result's, and the words name the first size that fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from reports import render_report
from reports.numbers import Source
from reports.tolerance import pose_errors

SIZES = (1.0, 2.0, 3.0, 4.0, 5.0)


def entry(shift: float, turn: float, probability: float) -> dict[str, Any]:
    return {
        "translation_mm": shift,
        "rotation_deg": turn,
        "samples": 200,
        "probability": probability,
        "probability_low": max(probability - 0.05, 0.0),
        "probability_high": min(probability + 0.05, 1.0),
        "weakest_mm": 7.5,
        "first_breach_mm": None if probability == 1.0 else 6.5,
        "s_mm": [0.0, 5.0, 10.0],
        "clear": [1.0, probability, 1.0],
    }


def presets(chances: tuple[float, ...]) -> dict[str, Any]:
    both = [entry(size, size, chance) for size, chance in zip(SIZES, chances, strict=True)]
    return {"presets": [*both, *(entry(size, 0.0, 0.9) for size in SIZES), *(entry(0.0, size, 1.0) for size in SIZES)]}


def source(told: dict[str, Any]) -> Source:
    return Source({"details": {"tolerance": told}})


def test_the_first_size_that_fails_is_named_with_where_it_fails() -> None:
    found = pose_errors(source(presets((1.0, 0.8, 0.5, 0.2, 0.1))))
    assert found is not None
    assert str(found.lead).startswith("Under an error of 2.0\u00a0mm and 2.0° the path stays clear with probability 0.800")
    assert "most often first at 6.5\u00a0mm" in str(found.lead)
    assert [[str(chance) for chance in row.chances] for row in found.rows][1] == ["0.800", "0.900", "1.000"]
    assert [str(row.first) for row in found.rows] == ["–", "6.5\u00a0mm", "6.5\u00a0mm", "6.5\u00a0mm", "6.5\u00a0mm"]
    assert "0.80 at 2" in found.by_size


def test_without_a_failure_nothing_is_said_to_fail() -> None:
    found = pose_errors(source(presets((1.0,) * 5)))
    assert found is not None
    assert "stayed clear in every draw" in str(found.lead)
    single = pose_errors(source(entry(2.0, 1.0, 0.75)))
    assert single is not None
    assert single.by_size == ""
    assert len(single.rows) == 1
    assert pose_errors(Source({"details": {}})) is None


@pytest.mark.parametrize("told", [presets((1.0, 0.8, 0.5, 0.2, 0.1)), entry(2.0, 1.0, 0.75)], ids=["presets", "one size"])
def test_every_figure_of_the_section_is_marked_with_its_key(make_review: Callable[..., Any], told: dict[str, Any]) -> None:
    review = make_review(ct=False)
    review = replace(review, result={**review.result, "details": {**review.result["details"], "tolerance": told}})
    page = render_report(review)
    section = page[page.index('id="tolerance"') :].partition("</section>")[0]
    place = "presets.1." if "presets" in told else ""
    assert f'data-key="details.tolerance.{place}probability">' in section
    assert f'data-key="details.tolerance.{place}weakest_mm">' in section
