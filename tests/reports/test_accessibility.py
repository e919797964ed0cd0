"""Reports of tubes in every state before axe-core; test_every_run.py does the same with runs of every planner."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe

from reports import render_report, write_page

STATES: dict[str, dict[str, Any]] = {
    "flagged": {},
    "holds": {"clearance_min": 0.5, "curvature_max": 0.5},
    "impossible": {"infeasible": True},
    "mesh": {"ct": False},
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


def test_a_fault_would_be_found(browser: Any, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    body = '<main><img src="data:,"><p style="color:#ccc">pale</p></main>'
    page.write_text(f'<!doctype html><html lang="en"><title>t</title>{body}')
    assert {fault.split(":")[0] for fault in faults(browser, page)} >= {"image-alt", "color-contrast"}
