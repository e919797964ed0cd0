"""Geometry behind the pictures: laws and closed forms."""

from __future__ import annotations

import base64
import io
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from reports.plates import HEIGHT, raster, stand
from reports.slices import LUNG, SOFT, cut, png, reduce_volume, windows_for
from reports.still import View, choose_view, still_picture
from reports.svg import nice_step
from reports.wall import light_mesh, rims, sideways_frames
from segmentation.mesh import Surface
from segmentation.volume import Volume


def straight_tube(radius: float, length: float = 40.0, sides: int = 96) -> Surface:
    z = np.linspace(0.0, length, 60)
    a = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack(np.broadcast_arrays(radius * np.cos(a), radius * np.sin(a), z[:, None]), axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(len(z) - 1), np.arange(sides), indexing="ij")
    p, q = i * sides + j, i * sides + (j + 1) % sides
    faces = np.concatenate([np.stack([p, q, q + sides], -1), np.stack([p, q + sides, p + sides], -1)]).reshape(-1, 3)
    return Surface(ring, faces, np.full(len(faces), -1), (), "mesh")


@pytest.mark.parametrize("offset", [0.0, 0.7])
def test_the_outline_across_a_tube_is_its_circle(offset: float) -> None:
    radius = 2.5
    points = np.stack([np.full(30, offset), np.zeros(30), np.linspace(0.0, 40.0, 30)], axis=1)
    tangent, normal, binormal = sideways_frames(points)
    found = rims(straight_tube(radius), points, tangent, normal, binormal, directions=36)
    a = 2 * np.pi * np.arange(36) / 36
    spots = points[:, None] + found[..., None] * (np.cos(a)[:, None] * normal[:, None] + np.sin(a)[:, None] * binormal[:, None])
    # A polygon of 96 sides lies inside its circle by at most r (1 - cos(pi / 96)).
    assert np.abs(np.hypot(spots[..., 0], spots[..., 1]) - radius).max() < radius * (1 - np.cos(np.pi / 96)) + 1e-6


def test_frames_are_orthonormal_and_do_not_turn_along_a_straight_line(make_review: Any) -> None:
    points = np.asarray(make_review(ct=False).result["path"]["points_mm"])
    frame = np.stack(sideways_frames(points), axis=1)
    assert np.abs(frame @ np.swapaxes(frame, 1, 2) - np.eye(3)).max() < 1e-9
    _, normal, _ = sideways_frames(np.outer(np.arange(9.0), [1.0, 2.0, 2.0]))
    assert np.abs(normal - normal[0]).max() < 1e-12


def test_a_png_reads_back_as_written() -> None:
    rng = np.random.default_rng(1)
    for shape, mode in (((7, 5), "L"), ((6, 9, 4), "RGBA")):
        picture = rng.integers(0, 256, shape, dtype=np.uint8)
        image = Image.open(io.BytesIO(base64.b64decode(png(picture).partition(",")[2])))
        assert image.mode == mode
        assert np.array_equal(np.asarray(image), picture)


def oblique_ramp() -> tuple[Volume, np.ndarray]:
    """A volume whose HU are linear in space, on tilted axes: linear interpolation must be exact."""
    turn = np.linalg.qr(np.array([[1.0, 0.2, 0.1], [-0.1, 1.0, 0.3], [0.2, -0.2, 1.0]]))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = turn @ np.diag([1.5, 0.9, 0.8])
    matrix[:3, 3] = [-40.0, -30.0, 20.0]
    index = np.stack(np.meshgrid(*(np.arange(n) for n in (60, 90, 100)), indexing="ij"), axis=-1)
    gradient = np.array([3.0, -2.0, 1.0])
    lps = index @ matrix[:3, :3].T + matrix[:3, 3]
    return Volume(np.round(lps @ gradient).astype(np.int16), matrix), gradient


def test_the_reduced_ct_has_the_hu_of_the_full_one_near_the_path() -> None:
    volume, gradient = oblique_ramp()
    middle = volume.to_lps((np.array(volume.voxels.shape) - 1) / 2)
    points = middle + np.linspace(-6, 6, 40)[:, None] * np.array([0.3, 0.8, 0.5])
    reduced = reduce_volume(volume, points, (LUNG, SOFT))
    near = np.argwhere(reduced.levels > 0)
    lps = reduced.low + near * reduced.step
    hu = reduced.hu0 + reduced.hu_step * reduced.levels[tuple(near.T)].astype(float)
    want = np.clip(lps @ gradient, -1350.0, 240.0)
    inside = np.linalg.norm(lps - middle, axis=1) < 15.0
    # Half a grey level, and half a HU from the rounding of the voxels.
    assert np.abs(hu - want)[inside].max() <= reduced.hu_step / 2 + 0.6
    assert inside.sum() > 1000


def test_a_cut_through_a_ramp_is_the_ramp() -> None:
    volume, gradient = oblique_ramp()
    middle = volume.to_lps((np.array(volume.voxels.shape) - 1) / 2)
    right, down = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
    grey = cut(volume, middle, right, down, SOFT, pixels=20, field=10.0).astype(float)
    at = ((np.arange(20) + 0.5) / 20 - 0.5) * 10.0
    hu = (middle + at[:, None, None] * down + at[None, :, None] * right) @ gradient
    want = np.clip((hu - (SOFT.centre - SOFT.width / 2)) / SOFT.width * 255.0, 0, 255)
    assert np.abs(grey - want).max() <= 1.5  # truncation to whole grey values and HU


def test_windows_follow_the_anatomy_and_otherwise_the_lumen() -> None:
    assert windows_for("airway", 300.0)[0].name == "lung"
    assert windows_for("urinary", 300.0)[0].name == "urography"
    assert windows_for("vessel", 300.0)[0].name == "vessel"
    assert windows_for("unheard of", 320.0)[0].name == "contrast"
    assert windows_for(None, -900.0)[0].name == "lung"


def test_the_light_mesh_keeps_the_shape(make_review: Any) -> None:
    surface = make_review(ct=False).surface
    light = light_mesh(surface, faces=6000)
    assert len(light.faces) < 7000
    assert light.planned == len(surface.faces)
    assert np.abs(np.ptp(light.vertices, axis=0) - np.ptp(surface.vertices, axis=0)).max() < 0.2


def test_the_still_shows_the_outline_where_the_tube_is() -> None:
    tube = straight_tube(4.0)
    view = View(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    markup = str(still_picture(light_mesh(tube), np.empty((0, 3)), [], [], view, "a tube"))
    data = markup.split('href="data:image/png;base64,')[1].split('"')[0]
    alpha = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))[..., 3].astype(float)
    row = alpha[alpha.shape[0] // 2]
    seen = np.flatnonzero(row > 0)
    width = (seen[-1] - seen[0]) / alpha.shape[0] * 470  # drawing units
    assert width == pytest.approx(8.0 * (470 - 60) / 40.0, rel=0.04)  # 8 mm at 410 units for 40 mm
    assert row[seen[0] + 2] > 2.5 * row[(seen[0] + seen[-1]) // 2]  # dense at the edge, clear in the middle


def test_a_mesh_is_seen_face_on() -> None:
    rng = np.random.default_rng(0)
    flat = rng.normal(size=(500, 3)) * [60.0, 30.0, 2.0]
    view = choose_view(flat, "mesh")
    assert abs(view.toward[2]) > 0.99
    assert abs(view.up[0]) > 0.99
    assert choose_view(flat, "LPS").toward[1] < -0.9


@given(st.lists(st.tuples(st.floats(20.0, 320.0), st.floats(20.0, 400.0), st.floats(30.0, 150.0)), min_size=1, max_size=8))
def test_labels_never_overlap_nor_cover_their_own_place(wanted: list[tuple[float, float, float]]) -> None:
    spots, widths = np.array([spot[:2] for spot in wanted]), [spot[2] for spot in wanted]
    corners = stand(spots, widths, np.zeros((470, 340)), bottom=406.0)
    plates = [(*corner, width) for corner, width in zip(corners, widths, strict=True) if np.isfinite(corner).all()]
    assert np.isfinite(corners[0]).all()
    for (x, y, width), (other_x, other_y, other_width) in combinations(plates, 2):
        assert x >= other_x + other_width or other_x >= x + width or abs(y - other_y) >= HEIGHT
    for (x, y), (left, top), width in zip(spots, corners, widths, strict=True):
        assert not (left < x < left + width and top < y < top + HEIGHT)
    assert all(x >= 0.0 and y >= 0.0 and x + width <= 340.0 and y + HEIGHT <= 406.0 for x, y, width in plates)


def test_a_label_stands_beside_the_path_and_not_over_it() -> None:
    across = np.array([[20.0, 200.0], [320.0, 200.0]])
    drawn = raster((470, 340), np.empty((0, 2)), [across])
    spot = np.array([[170.0, 200.0]])
    left, top = stand(spot, [100.0], drawn, bottom=406.0)[0]
    assert top + HEIGHT < 199.0 or top > 201.0
    assert abs(top + 0.5 * HEIGHT - 200.0) < 3.0 * HEIGHT
    assert left - 30.0 < 170.0 < left + 130.0


@given(st.floats(1e-4, 1e5), st.integers(2, 12))
def test_a_grid_has_at_most_the_asked_number_of_parts_and_not_a_third_of_it(span: float, count: int) -> None:
    step = nice_step(span, count)
    assert span / step <= count * (1 + 1e-6)
    assert span / step > count / 2.6
