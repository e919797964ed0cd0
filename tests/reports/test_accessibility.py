"""Every kind of page and verdict before axe-core: no serious or critical fault, in both themes and on a phone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe

from reports import render_report, write_page
from tubeplan_viz.pipeline import RunOptions
from tubeplan_viz.planners import make_case, run_case

STATES: dict[str, dict[str, Any]] = {
    "flagged": {},
    "holds": {"clearance_min": 0.5, "curvature_max": 0.5},
    "impossible": {"infeasible": True},
    "mesh": {"ct": False},
}
NEEDLES: dict[str, dict[str, Any]] = {
    "needle2d": {
        "planner": {"name": "needle2d"},
        "needle2d": {"target": [0, 90], "degree_max": 2},
        "obstacles": [{"kind": "circle", "center": [0, 40], "radius_mm": 10}],
    },
    "needle3d": {
        "planner": {"name": "needle3d"},
        "needle3d": {"target": [0, 0, 100], "safety_mm": 1.0},
        "obstacles": [{"kind": "sphere", "center": [0, 5, 40], "radius_mm": 5}],
    },
}


def faults(browser: Any, page_file: Path, *, width: int = 1440, theme: str = "light") -> list[str]:
    """Serious and critical faults as ``rule: element``."""
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=theme, reduced_motion="reduce")
    page = context.new_page()
    page.goto(page_file.as_uri())
    for _ in range(400):  # wait_for_function would need eval, which the page's policy forbids
        if page.evaluate("!document.getElementById('tubeplan-scene') || globalThis.tubeplanReady === true"):
            break
        page.wait_for_timeout(50)
    page.wait_for_timeout(200)
    found = Axe().run(page, options={"resultTypes": ["violations"]}).response["violations"]
    context.close()
    return [
        f"{fault['id']}: {node['target']} {node['failureSummary'][:160]}"
        for fault in found
        if fault["impact"] in ("serious", "critical")
        for node in fault["nodes"][:3]
    ]


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_reports_of_tubes_have_no_serious_fault(browser: Any, make_review: Any, tmp_path: Path, state: str, theme: str) -> None:
    write_page(render_report(make_review(**STATES[state])), tmp_path / "report.html")
    assert faults(browser, tmp_path / "report.html", theme=theme) == []


def test_a_report_on_a_phone_has_no_serious_fault(browser: Any, make_review: Any, tmp_path: Path) -> None:
    write_page(render_report(make_review()), tmp_path / "report.html")
    assert faults(browser, tmp_path / "report.html", width=390) == []


@pytest.mark.parametrize("planner", NEEDLES)
def test_reports_of_needles_have_no_serious_fault(browser: Any, tmp_path: Path, planner: str) -> None:
    run_case(make_case(NEEDLES[planner]), tmp_path / "run", RunOptions(recording=False))
    for theme in ("light", "dark"):
        assert faults(browser, tmp_path / "run" / "report.html", theme=theme) == []


def test_a_fault_would_be_found(browser: Any, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    body = '<main><img src="data:,"><p style="color:#ccc">pale</p></main>'
    page.write_text(f'<!doctype html><html lang="en"><title>t</title>{body}')
    assert {fault.split(":")[0] for fault in faults(browser, page)} >= {"image-alt", "color-contrast"}
