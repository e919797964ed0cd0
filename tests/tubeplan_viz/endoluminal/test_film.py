"""What a camera in a lumen sees: geometry in closed form, and the film on a real airway's shape."""

from __future__ import annotations

import io

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from segmentation.errors import CaseError
from tubeplan_viz.bench.models import Model, straight_tube
from tubeplan_viz.endoluminal import Camera, FilmSettings, Interior, make_film, path_cameras
from tubeplan_viz.plan import FlaggedInterval, FlagKind


@pytest.fixture(scope="module")
def tube() -> Model:
    return straight_tube()


def axis_of(model: Model) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.asarray(model.arc_length), np.asarray(model.axis_points)


def camera_in(model: Model) -> Camera:
    _, points = axis_of(model)
    return path_cameras(points)[len(points) // 2]


def test_a_ray_through_a_pixel_projects_onto_it(tube: Model) -> None:
    camera = camera_in(tube)
    size = 7
    rays = camera.rays(size)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)
    seen = camera.project(camera.position + 13.0 * rays)
    row, column = np.divmod(np.arange(size * size), size)
    np.testing.assert_allclose(seen[:, 0] * size - 0.5, column, atol=1e-9)
    np.testing.assert_allclose(seen[:, 1] * size - 0.5, row, atol=1e-9)
    assert (seen[:, 2] > 0).all()


def test_the_field_of_view_is_that_of_the_camera(tube: Model) -> None:
    camera = camera_in(tube)
    edge = camera.forward + np.tan(0.5 * camera.field_of_view) * camera.right
    np.testing.assert_allclose(camera.project(camera.position + edge)[0, :2], [1.0, 0.5], atol=1e-12)


def test_cameras_look_along_the_path_and_keep_their_top(tube: Model) -> None:
    _, points = axis_of(tube)
    cameras = path_cameras(points)
    along = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    for camera in cameras:
        np.testing.assert_allclose(camera.forward, along, atol=1e-9)
        np.testing.assert_allclose(camera.up, cameras[0].up, atol=1e-9)  # a straight line turns no frame
        np.testing.assert_allclose(np.cross(camera.forward, camera.up), camera.right, atol=1e-12)


def test_distances_in_a_straight_tube_are_those_of_a_cylinder(tube: Model) -> None:
    camera = camera_in(tube)
    radius = float(np.median(tube.radius))
    away = np.deg2rad([30.0, 60.0, 90.0])
    rays = np.cos(away)[:, None] * camera.forward + np.sin(away)[:, None] * camera.up
    seen = Interior(tube.surface).distance(camera.position, rays)
    # A ray at an angle meets the wall of radius r at r / sin(angle); the mesh's chords lie up to 0.5 % inside.
    np.testing.assert_allclose(seen, radius / np.sin(away), rtol=0.005)


def test_a_place_behind_the_wall_is_not_visible(tube: Model) -> None:
    camera = camera_in(tube)
    radius = float(np.median(tube.radius))
    inside, outside = camera.position + 0.9 * radius * camera.up, camera.position + 1.1 * radius * camera.up
    assert Interior(tube.surface).visible(camera.position, np.array([inside, outside])).tolist() == [True, False]


def test_the_wall_is_lit_and_gets_darker_with_depth(tube: Model) -> None:
    camera = camera_in(tube)
    picture = Interior(tube.surface).picture(camera, 65, radius=float(np.median(tube.radius)))
    assert picture.shape == (65, 65, 3)
    grey = picture.mean(axis=2)
    row = grey[32, 32:]
    assert row[-1] > row[len(row) // 2] > row[len(row) // 8]  # from the middle, far down the tube, to the near wall
    # A straight tube looks the same from its axis however the picture is turned.
    np.testing.assert_allclose(grey, np.rot90(grey), atol=12.0)


def test_the_film_covers_the_path_and_its_flags_are_drawn(tube: Model) -> None:
    arc, points = axis_of(tube)
    clearance = np.full(len(arc), float(np.median(tube.radius)))
    flag = FlaggedInterval(kind=FlagKind.CLEARANCE, start=0.0, end=float(arc[-1]), worst=0.1, worst_at=1.0)
    settings = FilmSettings(size=128, step=5.0, quality=95)
    told: list[tuple[int, int]] = []
    # From a little off the axis, so that the way ahead is not one point.
    off = points + 0.4 * np.array([camera_in(tube).up]) * np.sin(arc / 6.0)[:, None]
    film = make_film(tube.surface, arc, off, clearance, (flag,), settings, progress=lambda k, n: told.append((k, n)))
    plain = make_film(tube.surface, arc, off, clearance, (), settings)
    assert film.stills[0].arc_length == 0.0
    assert film.stills[-1].arc_length == pytest.approx(arc[-1])
    assert told[-1] == (len(film.stills), len(film.stills))
    assert film.nearest(film.stills[2].arc_length + 0.4 * film.step) == 2
    k = 1
    with_flag, without = (np.asarray(Image.open(io.BytesIO(f.stills[k].jpeg)), float) for f in (film, plain))
    assert with_flag.shape == (128, 128, 3)
    changed = np.abs(with_flag - without).max(axis=2) > 40.0
    assert changed.any()
    red_over_blue = with_flag[..., 0] - with_flag[..., 2] - (without[..., 0] - without[..., 2])
    assert red_over_blue[changed].mean() > 40.0  # orange in place of blue


def test_settings_that_make_no_picture_are_refused() -> None:
    with pytest.raises(CaseError, match="expected 16 to 2048 pixels"):
        FilmSettings(size=4)
