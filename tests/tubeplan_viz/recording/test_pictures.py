"""Geometry behind the pictures, and the pictures themselves in the real viewer."""

from __future__ import annotations

import ctypes.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from segmentation.volume import Volume
from tubeplan_viz.geometry import moving_frames
from tubeplan_viz.recording.anatomy import CONTRAST_WINDOW, grey
from tubeplan_viz.recording.blueprint import FIELD_OF_VIEW, viewpoint
from tubeplan_viz.recording.slices import AXES, PIXEL_MM, Slicer

TOOL = Path(__file__).parents[4] / "shared" / "tools" / "rrd_screenshot.py"


def helix(turns: float, rise: float) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi * turns, 400)
    return np.column_stack([12.0 * np.cos(angle), 12.0 * np.sin(angle), rise * angle])


@given(rise=st.floats(0.5, 6.0), turns=st.floats(0.2, 2.0))
def test_moving_frames_are_rotations_whose_third_axis_is_the_tangent(rise: float, turns: float) -> None:
    points = helix(turns, rise)
    frames = moving_frames(points)
    np.testing.assert_allclose(frames.transpose(0, 2, 1) @ frames, np.broadcast_to(np.eye(3), frames.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-12)
    forward = points[2:] - points[:-2]
    np.testing.assert_allclose(frames[1:-1, :, 2], forward / np.linalg.norm(forward, axis=1, keepdims=True), atol=1e-12)


def test_moving_frames_do_not_turn_about_the_tangent() -> None:
    # On a helix of radius r and rise c an angle, the frame lags the Frenet frame by its torsion times the arc
    # length: c / sqrt(r^2 + c^2) an angle (Wang 2008). Double reflection is of fourth order in the step.
    rise, points = 3.0, helix(1.5, 3.0)
    frames = moving_frames(points)
    tangents = frames[:, :, 2]
    frenet = -points * [1.0, 1.0, 0.0] / 12.0
    across = np.cross(tangents, frenet)
    turn = np.unwrap(np.arctan2(np.einsum("ij,ij->i", frames[:, :, 0], across), np.einsum("ij,ij->i", frames[:, :, 0], frenet)))
    angle = np.linspace(0.0, 3.0 * np.pi, 400)[1:-1]
    lag = turn[1:-1] - turn[1]
    np.testing.assert_allclose(lag, -rise / np.hypot(12.0, rise) * (angle - angle[0]), atol=1e-4)


@given(seed=st.integers(0, 50), frame=st.sampled_from(["LPS", "mesh"]))
def test_the_eye_sees_the_whole_path_with_a_usable_up(seed: int, frame: str) -> None:
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(size=(40, 3)), axis=0) * rng.uniform(0.2, 5.0)
    eye = viewpoint(points, frame, radius=3.0)
    look = eye.target - eye.position
    to_points = points - eye.position
    cosine = to_points @ look / np.linalg.norm(look) / np.linalg.norm(to_points, axis=1)
    assert np.degrees(np.arccos(cosine)).max() < 0.5 * np.degrees(FIELD_OF_VIEW) + 2.0
    assert abs(eye.up @ look) / np.linalg.norm(look) < 0.9


def test_a_plane_through_an_oblique_ct_shows_the_field_where_it_is(imaged: Any) -> None:
    volume: Volume = imaged[0]
    slicer = Slicer(volume, imaged[1])
    center = slicer.home + np.array([1.0, -2.0, 0.5])
    middle = volume.to_lps((np.array(volume.voxels.shape) - 1) / 2.0)
    middle_pixel = slicer.pixels // 2
    shown = np.arange(middle_pixel - 8, middle_pixel + 8)
    for plane, (right, down) in AXES.items():
        picture, _ = slicer.cut(plane, center)
        # Pixel i covers i to i + 1, and the middle of the picture is `center`.
        offset = (shown + 0.5 - 0.5 * slicer.pixels) * PIXEL_MM
        points = center + offset[:, None, None] * down + offset[None, :, None] * right
        field = (points - middle) @ np.array([2.0, 1.0, -1.0])
        # HU are rounded to whole numbers and grey values too: two grey steps at most.
        difference = picture[np.ix_(shown, shown)].astype(int) - grey(field, CONTRAST_WINDOW).astype(int)
        assert np.abs(difference).max() <= 2
        flat = slicer.to_pixels(plane, center, points.reshape(-1, 3)).reshape(*points.shape[:2], 2)
        np.testing.assert_allclose(flat[0, :, 0], shown + 0.5, atol=1e-9)
        np.testing.assert_allclose(flat[:, 0, 1], shown + 0.5, atol=1e-9)


def test_the_outline_in_a_plane_is_the_lumens(imaged: Any, run: Any) -> None:
    slicer = Slicer(*imaged)
    center = run.centerline.points[len(run.centerline.points) // 2]
    for plane, (right, down) in AXES.items():
        _, outline = slicer.cut(plane, center)
        assert outline
        for line in outline:
            flat = (line - 0.5 * slicer.pixels) * PIXEL_MM
            points = center + flat[:, :1] * right + flat[:, 1:] * down
            near = np.linalg.norm(points[:, None] - run.centerline.points[None], axis=2).min(axis=1)
            # The mask's staircase of 1 mm voxels about a tube of radius 3 mm.
            assert np.abs(near - 3.0).max() < 1.0


def screenshot(recording: Path, picture: Path, *options: str) -> dict[str, Any]:
    """What the viewer says of a recording; the picture is written beside."""
    if not TOOL.is_file():
        pytest.skip("the folder ../shared with the picture tool is not here")
    if ctypes.util.find_library("vulkan") is None:
        pytest.skip("no Vulkan loader: install mesa-vulkan-drivers and libvulkan1")
    command = [sys.executable, str(TOOL), str(recording), str(picture), "--size", "1200x800", *options]
    shown = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    if shown.returncode == 3:
        pytest.skip(shown.stderr.strip().splitlines()[-1])
    assert shown.returncode == 0, shown.stderr
    state: dict[str, Any] = json.loads(shown.stdout)
    return state


def test_the_viewer_opens_at_the_last_iteration_and_no_view_complains(recorded_file: Path, tmp_path: Path) -> None:
    state = screenshot(recorded_file, tmp_path / "last.png")
    assert state["cursor"] == ["iteration", 3]
    assert [view["reports"] for view in state["views"] if view["reports"]] == []
    names = " ".join(view["name"] for view in state["views"])
    for part in (
        "3D",
        "Clearance",
        "Curvature",
        "Convergence",
        "CT, axial",
        "CT, coronal",
        "CT, sagittal",
        "From the tip",
        "straightened",
        "Decisions",
        "Summary",
    ):
        assert part in names


def test_the_walk_shows_without_a_ct_and_no_view_complains(light_file: Path, tmp_path: Path) -> None:
    state = screenshot(light_file, tmp_path / "walk.png", "--timeline", "arc_length", "--at", "200")
    assert [view["reports"] for view in state["views"] if view["reports"]] == []
    assert not [view["name"] for view in state["views"] if view["name"].startswith("CT")]
