"""The page of a cohort before a browser and axe-core: every figure the document's own, sorted and filtered, on a phone too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe

from reports import render_cohort, write_page
from reports.cohort_charts import histogram
from reports.svg import WIDTHS
from tubeplan_viz.cohort import CaseStatus, validate_cohort
from tubeplan_viz.cohort.summary import reasons_of
from tubeplan_viz.result.document import METRICS

ENDS = (
    ["ok"] * 20 + ["flagged"] * 6 + ["infeasible"] * 2 + ["bad_input", "died", "time_limit", "fault"]
)  # more rows than are shown at once
REASONS = {
    "flagged": "clearance falls to {value:.2f} mm at 19.8 mm where 1.5 mm are required",
    "infeasible": "no path keeps 1.5 mm from <the wall>",
    "bad_input": "ct.nii: slices 41 and 42 are 2.50 mm apart",
    "died": "its process ended: signal SIGSEGV",
    "time_limit": "not done within the time limit of 5 s",
    "fault": "a fault of the program, please report it: ValueError: x",
}


def cohort_of(ends: list[str]) -> dict[str, Any]:
    """A document as a cohort of generated numbers gives it."""
    rng = np.random.default_rng(11)
    cases = []
    for k, status in enumerate(ends):
        whole = status in ("ok", "flagged")
        margin = float(rng.uniform(0.01, 2.0)) * (1.0 if status == "ok" else -1.0)
        path = {name: float(rng.uniform(0.1, 90.0)) for name in METRICS} | {"clearance_min_mm": 1.5 + margin}
        cases.append(
            {
                "id": f"case-{k:02d}",
                "planner": ("tube", "needle3d")[k % 2],
                "method": ("optimal", "swarm")[k % 2],
                "rng_seed": k,
                "status": status,
                "reason": REASONS[status].format(value=1.5 + margin) if status in REASONS else None,
                "folder": f"case-{k:02d}" if whole or status == "infeasible" else None,
                "has_report": whole,
                "frame": "mesh" if whole else None,
                "margin_mm": path["clearance_min_mm"] - 1.5 if whole else None,
                "limits": {"curvature_max_per_mm": 0.125, "clearance_min_mm": 1.5},
                "metrics": path if whole else dict.fromkeys(METRICS),
                "certificate_holds": status == "ok" if whole else None,
                "flagged_intervals": int(status == "flagged"),
                "verification": {"holds": k != 3, "checks": 9, "failed": [] if k != 3 else [{"name": "x", "sentence": "y."}]}
                if whole
                else None,
                "inputs": [],
                "planning_s": 1.0 if whole else None,
                "wall_s": float(rng.gamma(3.0, 2.0)),
                "cpu_s": 1.0,
                "peak_memory_mb": float(rng.uniform(200, 900)),
            }
        )
    document: dict[str, Any] = {
        "schema_version": 1,
        "use": "research use, not for clinical decisions",
        "exit_status": 1,
        "counts": {status.value: ends.count(status.value) for status in CaseStatus},
        "reasons": reasons_of(cases),
        "cases": cases,
        "others": ["old"],
        "pass": {"done": len(cases), "kept": 0, "wall_s": 9.0, "cluster": False},
        "provenance": {
            "software": "tubeplan",
            "version": "0.1.0",
            "manifest": {"name": "m.toml", "sha256": "0" * 64},
            "rng_seed": 7,
            "created_utc": "2026-01-01T00:00:00Z",
            "platform": "Linux",
        },
    }
    validate_cohort(document)
    return document


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "index.html"
    write_page(render_cohort(cohort_of(ENDS)), path)
    return path


def test_reasons_that_differ_in_numbers_alone_stand_together() -> None:
    found = cohort_of(ENDS)["reasons"]
    assert [(row["status"], row["count"], row["same"]) for row in found][:2] == [("flagged", 6, False), ("infeasible", 2, True)]
    assert sum(row["count"] for row in found) == len(ENDS) - ENDS.count("ok")


def test_every_figure_is_the_documents_and_text_stays_text(page_file: Path, numbers_shown: Any) -> None:
    text = page_file.read_text(encoding="utf-8")
    page = numbers_shown.Page(text)
    document = json.loads(page.scripts["tubeplan-cohort"])
    assert document == cohort_of(ENDS)
    assert page.faults(document, {}) == []
    shown = {key for key, _, _ in page.found}
    assert {f"cases.{k}.margin_mm" for k, end in enumerate(ENDS) if end in ("ok", "flagged")} <= shown
    assert "<the wall>" not in text.split("<script")[0]
    assert 'href="case-00/report.html"' in text
    assert "case-26/report.html" not in text  # no path, and no report was asked for


def test_bins_of_a_histogram_count_each_case_once() -> None:
    values = [(-0.5, "flagged"), (0.0, "ok"), (0.049, "ok"), (0.05, "ok"), (0.3, "other")]
    drawing = str(histogram(values, "words", "mm", WIDTHS[0]))
    # Bins are 0.05 mm wide and hold their lower edge: [-0.5], [0, 0.049], [0.05], [0.3].
    assert drawing.count('class="pile ok"') == 2
    heights = [float(part.split('"')[0]) for part in drawing.split('height="')[1:]]
    assert sorted(heights) == pytest.approx([heights[0]] * 3 + [2.0 * heights[0]])


def rows_shown(page: Any) -> list[str]:
    return [str(text).strip() for text in page.locator("#case-table tbody tr:not([hidden]) th").all_inner_texts()]


def test_the_page_can_be_read_sorted_and_filtered(page_file: Path, browser: Any, lost_in_print: Any) -> None:
    context = browser.new_context(viewport={"width": 1440, "height": 900}, color_scheme="light", reduced_motion="reduce")
    page = context.new_page()
    told: list[str] = []
    page.on("console", lambda message: told.append(message.text))
    page.on("pageerror", lambda error: told.append(str(error)))
    page.goto(page_file.as_uri())
    assert "Research use, not for clinical decisions" in page.locator("header.bar").inner_text()
    assert page.locator("h1").inner_text() == "20 of 32 cases hold"
    assert serious(page) == []
    document = cohort_of(ENDS)
    order = [case["id"] for case in document["cases"]]
    assert rows_shown(page) == order
    with_margin = sorted((case["margin_mm"], case["id"]) for case in document["cases"] if case["margin_mm"] is not None)
    head = page.locator("#case-table thead button", has_text="Worst margin")
    head.click()
    assert rows_shown(page)[: len(with_margin)] == [name for _, name in with_margin]
    head.click()
    assert rows_shown(page)[: len(with_margin)] == [name for _, name in reversed(with_margin)]
    assert page.locator("#case-table th[aria-sort]").get_attribute("aria-sort") == "descending"
    head.click()
    assert rows_shown(page) == order
    page.locator("#find").fill("signal sigsegv")
    assert rows_shown(page) == [case["id"] for case in document["cases"] if case["status"] == "died"]
    assert page.locator("#shown").inner_text() == "1 of 32 cases are shown."
    page.locator("form.filter button[type=reset]").click()
    page.wait_for_timeout(50)
    page.locator("input[name=status][value=ok]").uncheck()
    page.locator("#planner").select_option("tube")
    wanted = [case["id"] for case in document["cases"] if case["status"] != "ok" and case["planner"] == "tube"]
    assert rows_shown(page) == wanted
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(100)
    assert serious(page, {"runOnly": ["color-contrast"]}) == []
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_timeout(100)
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert serious(page, {"runOnly": ["target-size", "scrollable-region-focusable", "color-contrast", "list"]}) == []
    assert lost_in_print(page) == []
    assert told == []
    context.close()


def serious(page: Any, rules: dict[str, Any] | None = None) -> list[str]:
    """Serious and critical faults that axe-core finds, as ``rule: element``."""
    found = Axe().run(page, options={"resultTypes": ["violations"], **(rules or {})}).response["violations"]
    return [f"{fault['id']}: {fault['nodes'][0]['target']}" for fault in found if fault["impact"] in ("serious", "critical")]
