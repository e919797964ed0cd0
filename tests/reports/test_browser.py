"""The page in headless Chromium: what a reader sees and does."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from reports import render_report, write_page

SPREAD = """(id) => {
  const canvas = document.getElementById(id);
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  const grey = data.filter((_, i) => i % 4 === 0);
  return grey.reduce((a, b) => Math.max(a, b), 0) - grey.reduce((a, b) => Math.min(a, b), 255);
}"""
BOXES = """[...document.querySelectorAll('#labels b')].filter((b) => !b.hidden).map((b) => {
  const box = b.getBoundingClientRect();
  return [box.left, box.top, box.right, box.bottom];
})"""


@pytest.fixture(scope="module")
def report(make_review: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("report") / "report.html"
    write_page(render_report(make_review()), target)
    return target


@pytest.fixture(scope="module")
def opened(browser: Any, report: Path) -> Iterator[tuple[Any, list[str], list[str]]]:
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    page = context.new_page()
    faults: list[str] = []
    requests: list[str] = []
    # Software GL remarks on its own speed; that is the browser's, not the page's.
    page.on("console", lambda message: faults.append(message.text) if "GL Driver Message" not in message.text else None)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(report.as_uri())
    settle(page)
    yield page, faults, requests
    context.close()


def settle(page: Any) -> None:
    for _ in range(400):
        if page.evaluate("globalThis.tubeplanReady === true"):
            page.wait_for_timeout(250)
            return
        page.wait_for_timeout(50)
    raise AssertionError("the page did not become ready in 20 s")


def drawn(page: Any) -> None:
    """Wait until what was asked for is on the screen."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done))))")


def test_no_error_and_no_outside_request(opened: Any, report: Path) -> None:
    _, faults, requests = opened
    assert faults == []
    assert [url for url in requests if not url.startswith("data:")] == [report.as_uri()]


def test_the_scene_waits_for_the_first_paint(opened: Any) -> None:
    page, _, _ = opened
    painted = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")
    started = page.evaluate("performance.getEntriesByName('tubeplan-start')[0].startTime")
    assert started >= painted > 0.0


def test_the_scene_is_not_blank_and_shows_the_flag(opened: Any) -> None:
    page, _, _ = opened
    assert page.evaluate("document.getElementById('scene').classList.contains('live')")
    picture = np.asarray(Image.open(io.BytesIO(page.locator("#scene canvas").screenshot())).convert("RGB")).astype(int)
    assert picture.reshape(-1, 3).std(axis=0).min() > 3.0
    orange = (np.abs(picture - [196, 116, 0]).sum(axis=2) < 40).sum()
    assert orange > 10


def test_hovering_a_chart_moves_the_marker_in_the_scene(opened: Any) -> None:
    page, _, _ = opened
    page.locator("#path").scroll_into_view_if_needed()
    box = page.locator("svg.for-wide[data-chart=clearance]").bounding_box()
    spots = []
    for share in (0.3, 0.6):
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        drawn(page)
        spots.append(page.evaluate("globalThis.tubeplanCursor()"))
        at = float(page.locator("#at").inner_text().split("\u00a0")[0])
        length = float(page.locator("#at-part").inner_text().removeprefix("of ").split("\u00a0")[0])
        assert at == pytest.approx(length * (share * 740 - 40) / (740 - 52), abs=1.0)
    assert np.hypot(*np.subtract(*spots)) > 30.0
    page.locator("#place").focus()
    page.keyboard.press("Home")
    drawn(page)
    assert page.locator("#at").inner_text().startswith("0.0")


def test_the_tightest_place_is_one_press_away(opened: Any) -> None:
    page, _, _ = opened
    page.get_by_role("button", name="Tightest", exact=True).click()
    drawn(page)
    assert page.locator("#at-clearance").locator("..").get_attribute("data-state") == "clearance"


def test_tiles_and_reformation_are_drawn(opened: Any) -> None:
    page, _, _ = opened
    for name in ("across", "axial", "coronal", "sagittal", "cpr"):
        spread = page.evaluate(SPREAD, name)
        assert spread > 60, name


def test_the_scene_fills_the_window_on_demand(opened: Any) -> None:
    page, _, _ = opened
    page.get_by_role("button", name="Larger").click()
    page.wait_for_timeout(300)
    assert page.locator("#stage").bounding_box()["width"] == pytest.approx(1440, abs=1)
    page.get_by_role("button", name="Smaller").click()
    page.wait_for_timeout(300)
    assert page.locator("#stage").bounding_box()["width"] < 720


def test_labels_in_the_scene_do_not_overlap(opened: Any) -> None:
    page, _, _ = opened
    for view in ("Front", "Side", "Top"):
        page.get_by_role("button", name=view, exact=True).click()
        drawn(page)
        boxes = page.evaluate(BOXES)
        assert len(boxes) >= 4
        for k, a in enumerate(boxes):
            for b in boxes[:k]:
                assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1], (view, a, b)


def test_a_phone_has_no_sideways_scroll(browser: Any, report: Path) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(report.as_uri())
    settle(page)
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert page.locator("svg.for-narrow[data-chart=clearance]").is_visible()
    assert not page.locator("svg.for-wide[data-chart=clearance]").is_visible()
    context.close()


def test_without_scripts_the_charts_and_the_picture_stand(browser: Any, report: Path) -> None:
    context = browser.new_context(viewport={"width": 1200, "height": 900}, java_script_enabled=False)
    page = context.new_page()
    page.goto(report.as_uri())
    assert page.locator("svg.still").is_visible()
    assert page.locator("svg.for-wide[data-chart=curvature]").is_visible()
    assert page.locator(".cpr-picture img").is_visible()
    assert not page.locator("#place").is_visible()
    context.close()


def test_five_questions_are_answered_in_at_most_two_actions(browser: Any, report: Path) -> None:
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    page = context.new_page()
    page.goto(report.as_uri())
    settle(page)
    # No action: the verdict, the tightest place with its depth, the sharpest bend and what would hold stand on the first screen.
    seen = page.locator("#verdict")
    words = seen.inner_text()
    for term in ("Flagged", "Worst margin", "Sharpest bend", "This path takes"):
        assert term in words
    keys = page.locator("#verdict dl.keys").bounding_box()
    assert keys["y"] + keys["height"] < 900
    margin = page.locator("#verdict dl.keys > div", has_text="Worst margin")
    depth = float(margin.locator("data[data-key$='_at_mm']").first.get_attribute("value"))
    # One action: the slice at the tightest place.
    page.get_by_role("button", name="Show clearance").first.click()
    page.wait_for_timeout(900)
    assert float(page.locator("#cap-across").inner_text().split("\u00a0")[0]) == pytest.approx(depth, abs=0.06)
    assert page.evaluate(SPREAD, "across") > 60
    # One action: the sharpest bend.
    page.get_by_role("button", name="Sharpest", exact=True).click()
    drawn(page)
    bend = page.locator("#verdict dl.keys > div", has_text="Sharpest bend")
    sharpest = float(bend.locator("data[data-key$='_at_mm']").first.get_attribute("value"))
    assert float(page.locator("#at").inner_text().split("\u00a0")[0]) == pytest.approx(sharpest, abs=0.06)
    context.close()


def test_one_cursor_moves_charts_slices_reformation_and_the_view_from_the_tip(opened: Any) -> None:
    page, _, _ = opened
    length = float(page.locator("#at-part").inner_text().removeprefix("of ").split("\u00a0")[0])
    shown = []
    for share in (25, 75):
        page.evaluate(
            "(v) => { const p = document.getElementById('place'); p.value = Math.round(v / 100 * p.max);"
            " p.dispatchEvent(new Event('input')); }",
            share,
        )
        drawn(page)
        at = float(page.locator("#at").inner_text().split("\u00a0")[0])
        assert at == pytest.approx(share / 100 * length, abs=0.3)
        assert float(page.locator("#cap-across").inner_text().split("\u00a0")[0]) == pytest.approx(at, abs=0.06)
        assert float(page.locator("#cap-tip").inner_text().split("\u00a0")[0]) == pytest.approx(at, abs=3.1)  # one every 6 mm
        assert float(page.locator("#cpr-cursor").evaluate("(e) => parseFloat(e.style.left)")) == pytest.approx(share, abs=0.3)
        move = page.locator("svg.for-wide[data-chart=clearance] .cursor").get_attribute("transform")
        shown.append((page.locator("#tip").get_attribute("src"), move, page.evaluate("globalThis.tubeplanCursor()")))
    for one, other in zip(*shown, strict=True):
        assert one != other


def test_the_keyboard_reaches_every_control_and_the_theme_switches(browser: Any, report: Path) -> None:
    context = browser.new_context(viewport={"width": 1440, "height": 900}, reduced_motion="reduce")
    page = context.new_page()
    page.goto(report.as_uri())
    settle(page)
    reached = set()
    for _ in range(80):
        page.keyboard.press("Tab")
        reached |= set(page.evaluate("(({ id, name, tagName }) => [id, name ?? '', tagName])(document.activeElement)"))
    assert {"theme", "place", "turn", "larger", "window", "overlay", "CANVAS", "SUMMARY"} <= reached
    before = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.get_by_label("Dark").check(force=True)
    page.wait_for_timeout(100)
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != before
    context.close()


SHEETS = """() => [...document.styleSheets].flatMap((sheet) => [...sheet.cssRules]).flatMap((rule) => [...(rule.cssRules || [])])
  .filter((rule) => rule instanceof CSSPageRule).map((rule) => rule.cssText).join(' ')"""


def test_print_shows_the_charts_whole_and_all_folds(browser: Any, report: Path, tmp_path: Path) -> None:
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    page = context.new_page()
    page.goto(report.as_uri())
    settle(page)
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.set_viewport_size({"width": 718, "height": 1000})  # A4 less its margins at 96 dpi
    assert page.evaluate("[...document.querySelectorAll('details')].every((fold) => fold.open)")
    for chart in page.locator("svg[data-chart]").all():
        if chart.is_visible():
            box = chart.bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= 718.5
    assert not page.locator("#place").is_visible()
    assert page.locator("svg.still").is_visible()
    # Each sheet bears the label, the case and its number.
    feet = page.evaluate(SHEETS)
    assert '@bottom-left { content: "Research use, not for clinical decisions"' in feet
    assert f'@bottom-center {{ content: "{page.title()}"' in feet
    assert 'content: counter(page) " of " counter(pages)' in feet
    context.close()
