"""The curved reformation is geometrically right: a marker beside the path appears where arc length and angle say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reports import render_report, write_page
from reports.slices import SOFT, straightened
from reports.wall import sideways_frames
from segmentation.arrays import FloatArray
from segmentation.volume import Volume

BACKGROUND, MARKER = -100, 3000  # HU
RADIUS = 1.2  # of the marker, mm

CENTRE_OF_LIGHT = """(id) => {
  const canvas = document.getElementById(id);
  const { width, height } = canvas;
  const data = canvas.getContext('2d').getImageData(0, 0, width, height).data;
  let sum = 0, x = 0, y = 0;
  for (let r = 0; r < height; r++) for (let c = 0; c < width; c++) {
    const g = Math.max(0, data[4 * (r * width + c)] - 150);
    sum += g; x += g * (c + 0.5); y += g * (r + 0.5);
  }
  return [x / sum / width, y / sum / height, sum];
}"""


def with_marker(volume: Volume, place: FloatArray) -> Volume:
    """The volume's voxels all soft but for a bright ball with a soft rim."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in volume.voxels.shape), indexing="ij"), axis=-1)
    away = np.linalg.norm(volume.to_lps(index) - place, axis=-1)
    share = np.clip(RADIUS + 0.5 - away, 0.0, 1.0)
    return Volume((BACKGROUND + share * (MARKER - BACKGROUND)).astype(np.int16), volume.index_to_lps)


def marker_place(path: FloatArray, k: int, angle: float, distance: float) -> tuple[FloatArray, FloatArray]:
    """A place `distance` mm from sample k of the path in the direction that the page calls `angle`, and that direction."""
    _, normal, binormal = sideways_frames(path)
    across = np.cos(angle) * normal + np.sin(angle) * binormal
    return path[k] + distance * across[k], across


@pytest.mark.parametrize(("k", "degrees", "distance"), [(60, 0.0, 6.0), (200, 50.0, -5.0), (300, 120.0, 7.0)])
def test_a_marker_appears_within_one_pixel(make_review: Any, k: int, degrees: float, distance: float) -> None:
    review = make_review(film=False)
    path = np.asarray(review.result["path"]["points_mm"])
    place, across = marker_place(path, k, np.radians(degrees), distance)
    volume = with_marker(review.volume, place)
    rows, half = 90, 12.0
    picture = straightened(volume, path, across, half, SOFT, rows=rows).astype(float)
    light = np.maximum(picture - 200.0, 0.0)
    assert light.sum() > 0.0
    row = float((light.sum(axis=1) @ np.arange(rows)) / light.sum())
    middle = light[round(row)]  # the row through the marker: where the path bends the rows beside it are drawn shifted
    column = float((middle @ np.arange(len(path))) / middle.sum())
    assert column == pytest.approx(k, abs=1.0)


def test_a_marker_is_absent_from_the_plane_across(make_review: Any) -> None:
    review = make_review(film=False)
    path = np.asarray(review.result["path"]["points_mm"])
    place, _ = marker_place(path, 200, 0.0, 7.0)
    _, turned = marker_place(path, 200, np.radians(90.0), 7.0)
    picture = straightened(with_marker(review.volume, place), path, turned, 12.0, SOFT)
    assert np.ptp(picture) == 0


def test_the_page_draws_the_marker_where_it_is_at_every_turn(browser: Any, make_review: Any, tmp_path: Path) -> None:
    review = make_review()
    path = np.asarray(review.result["path"]["points_mm"])
    arc = np.asarray(review.result["path"]["s_mm"])
    k, degrees, distance = 120, 40.0, 4.0
    place, _ = marker_place(path, k, np.radians(degrees), distance)
    review = replace(review, volume=with_marker(review.volume, place))
    write_page(render_report(review), tmp_path / "report.html")
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    page = context.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    for _ in range(400):
        if page.evaluate("globalThis.tubeplanReady === true"):
            break
        page.wait_for_timeout(50)
    page.evaluate(
        "(v) => { const t = document.getElementById('turn'); t.value = v; t.dispatchEvent(new Event('input')); }", degrees
    )
    page.wait_for_timeout(300)
    x, y, light = page.evaluate(CENTRE_OF_LIGHT, "cpr")
    half = float(page.locator("#cpr-box").get_attribute("data-half"))
    length = float(arc[-1])
    assert light > 0
    # The page's CT is reduced to voxels of 0.8 to 1 mm: its marker may lie half a voxel off.
    assert x * length == pytest.approx(arc[k], abs=0.6)
    assert (1.0 - 2.0 * y) * half == pytest.approx(distance, abs=0.6)
    # Turned by a quarter the marker is out of the plane.
    page.evaluate(
        "(v) => { const t = document.getElementById('turn'); t.value = v; t.dispatchEvent(new Event('input')); }", degrees + 90
    )
    page.wait_for_timeout(300)
    assert page.evaluate(CENTRE_OF_LIGHT, "cpr")[2] < 0.02 * light
    context.close()
