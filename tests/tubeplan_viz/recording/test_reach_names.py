"""Names of branches in the reach map's recording: none lies on another as the recording opens, and each stays by its tip."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.recording.blueprint import FIELD_OF_VIEW, Viewpoint, viewpoint
from tubeplan_viz.recording.matrix import margin_text
from tubeplan_viz.recording.names import FARTHER, FARTHEST, LETTER_SHARE, LINE_SHARE, stand_off
from tubeplan_viz.recording.reach import table


def on_screen(points: np.ndarray, eye: Viewpoint) -> tuple[np.ndarray, np.ndarray]:
    """Points across the line of sight as (n, 2) shares of the view's height, and how far each lies along it, mm."""
    ahead = eye.target - eye.position
    far = np.linalg.norm(ahead)
    right = np.cross(ahead, eye.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead) / far
    height = 2.0 * far * np.tan(0.5 * FIELD_OF_VIEW)
    return np.column_stack([points @ right, points @ up]) / height, points @ ahead / far


@pytest.mark.parametrize("seed", range(5))
def test_names_do_not_overlap_and_move_only_across_the_line_of_sight(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tips = rng.normal(size=(12, 3)) * [40.0, 15.0, 30.0]
    tips[6:] = tips[:6] + rng.normal(size=(6, 3))  # pairs of tips that lie side by side
    names = ["left upper division" if k % 2 else "lingula" for k in range(12)]
    eye = viewpoint(tips, "LPS", radius=8.0)
    spots = stand_off(tips, names, eye)
    flat, along = on_screen(spots, eye)
    np.testing.assert_allclose(along, on_screen(tips, eye)[1], atol=1e-9)
    assert np.linalg.norm(flat - on_screen(tips, eye)[0], axis=1).max() <= FARTHEST + FARTHER + 1e-9
    width = LETTER_SHARE * np.array([len(name) for name in names])
    for a in range(12):
        for b in range(a):
            across, down = np.abs(flat[a] - flat[b])
            assert across > 0.5 * (width[a] + width[b]) or down >= LINE_SHARE * (1.0 - 1e-9)


def test_the_table_names_what_is_not_reached_below_it() -> None:
    row = {"name": "trachea", "verdict": "reached", "reason": None, "depth_mm": 99.4, "length_mm": 99.4, "diameter_mm": 16.3}
    refused = row | {"name": "lingula", "verdict": "diameter", "reason": "no way is wider than 3.1 mm", "depth_mm": 0.0}
    text = table({"branches": [row, refused], "rule": "a rule"})
    above, below = text.split("## Not reached")
    assert "no way is wider" not in above
    assert "**lingula**: too narrow; no way is wider than 3.1 mm" in below
    assert "Not reached" not in table({"branches": [row], "rule": "a rule"})


def test_a_margin_that_does_not_fit_never_shows_as_none() -> None:
    assert [margin_text(value) for value in (-0.003, 0.6, -1e-9, 0.0)] == ["-0.003", "+0.60", "0.00", "0.00"]
