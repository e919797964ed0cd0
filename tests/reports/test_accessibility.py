"""Reports of tubes with a CT before axe-core; test_every_run.py does so with runs of every planner, most of them without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from reports import render_report, write_page


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[[Path], Any]]:
    """Opens a file in the light theme and waits for its scene."""
    context = browser.new_context(viewport={"width": 1440, "height": 900}, color_scheme="light", reduced_motion="reduce")

    def opened(file: Path) -> Any:
        page = context.new_page()
        page.goto(file.as_uri())
        for _ in range(400):  # wait_for_function would need eval, which the page's policy forbids
            if page.evaluate("!document.getElementById('tubeplan-scene') || globalThis.tubeplanReady === true"):
                break
            page.wait_for_timeout(50)
        page.wait_for_timeout(200)
        return page

    yield opened
    context.close()


# What a page that holds shows is on the page with flags too.
@pytest.mark.parametrize("state", [{}, {"infeasible": True}], ids=["flagged", "impossible"])
def test_reports_of_tubes_have_no_serious_fault(
    state: dict[str, Any], open_page: Any, hard_to_read: Any, make_review: Any, tmp_path: Path
) -> None:
    write_page(render_report(make_review(**state)), tmp_path / "report.html")
    assert hard_to_read(open_page(tmp_path / "report.html")) == []


def test_a_fault_would_be_found(open_page: Any, hard_to_read: Any, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    body = '<main><img src="data:,"><p style="color:#ccc">pale</p></main>'
    page.write_text(f'<!doctype html><html lang="en"><title>t</title>{body}')
    assert {fault.split(":")[0] for fault in hard_to_read(open_page(page))} >= {"image-alt", "color-contrast"}
