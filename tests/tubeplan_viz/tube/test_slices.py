"""Slice clearance: closed forms, and pruning that changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tubeplan_viz.bench.models import Model
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.tube import TubeProblem
from tubeplan_viz.tube.slices import SliceClearance
from tubeplan_viz.tube.spline import spline_through

GRID = np.linspace(0.0, 1.0, 101)
# For slicing every sample with every triangle, which is slow.
COARSE = np.linspace(0.0, 1.0, 51)


def along_the_tube(offset: float) -> SplineCurve:
    y = np.linspace(2.0, 38.0, 7)
    return spline_through(np.column_stack([np.full(7, offset), y, 0.0 * y]))[0]


def contour_distance(point: np.ndarray, normal: np.ndarray, corners: np.ndarray) -> float:
    """Distance from `point` to where triangles (m, 3, 3) cross the plane through it; inf if none does."""
    side = (corners - point) @ normal
    crossing = (side < 0).any(axis=1) & (side >= 0).any(axis=1)
    if not crossing.any():
        return float("inf")
    here, there = corners[crossing], np.roll(corners[crossing], -1, axis=1)
    low, high = side[crossing], np.roll(side[crossing], -1, axis=1)
    changes = (low < 0) != (high < 0)  # two of the three edges of each
    share = np.divide(low, low - high, out=np.zeros_like(low), where=changes)
    cut = (here + share[..., None] * (there - here))[changes].reshape(-1, 2, 3)
    start, along = cut[:, 0], cut[:, 1] - cut[:, 0]
    square = np.maximum((along**2).sum(axis=1), 1e-300)
    t = np.clip(((point - start) * along).sum(axis=1) / square, 0.0, 1.0)
    return float(np.linalg.norm(start + t[:, None] * along - point, axis=1).min())


def every_slice(
    curve: SplineCurve, problem_surface: Any, wall: WallDistance, limit: float, pairs: int
) -> tuple[list[int], list[float]]:
    """Algorithm 1 word for word: every sample, every triangle of the wall."""
    points, corners = curve(COARSE), problem_surface.vertices[problem_surface.wall_faces]
    exact = wall.clearance(points)
    short, values = [], []
    for i, point in enumerate(points):
        least = np.inf
        for s in range(1, pairs + 1):
            normals = [point - points[max(i - s, 0)], points[min(i + s, len(points) - 1)] - point]
            least = min(least, float(np.mean([contour_distance(point, n, corners) for n in normals if np.any(n)])))
        if exact[i] <= 0:
            least = float(exact[i])
        if least < limit:
            short.append(i)
            values.append(least)
    return short, values


@pytest.mark.parametrize("offset", [0.0, 0.7, 1.8, 2.9])
def test_slice_clearance_in_a_straight_tube_is_its_radius_less_the_offset(offset: float, tube: Model) -> None:
    slices = SliceClearance(tube.surface, WallDistance(tube.surface), limit=3.2)
    short, values = slices.short_samples(along_the_tube(offset), GRID)
    assert short.tolist() == list(range(len(GRID)))
    # Facets of 0.44 mm on a radius of 3 mm lie up to 0.0081 mm inside the tube.
    assert values.max() <= 3.0 - offset + 1e-9
    assert values.min() >= 3.0 - offset - 0.0085


def test_only_samples_below_the_limit_are_given(tube: Model) -> None:
    slices = SliceClearance(tube.surface, WallDistance(tube.surface), limit=2.0)
    assert len(slices.short_samples(along_the_tube(0.9), GRID)[0]) == 0
    assert len(slices.short_samples(along_the_tube(1.1), GRID)[0]) == len(GRID)


def test_a_sample_outside_has_a_negative_clearance(tube: Model) -> None:
    slices = SliceClearance(tube.surface, WallDistance(tube.surface), limit=1.0)
    _, values = slices.short_samples(along_the_tube(3.5), GRID)
    np.testing.assert_allclose(values, -0.5, atol=0.01)


def test_caps_leave_no_contour(tube: Model) -> None:
    # Half a millimetre before the cap, aslant to it: the cap is nearer than the wall and does not count.
    wall = WallDistance(tube.surface)
    curve = spline_through(np.array([[-0.6, 37.5, 0.0], [-0.3, 38.5, 0.0], [0.0, 39.5, 0.0]]))[0]
    limit = 2.5
    open_ends = SliceClearance(tube.surface, wall, limit=limit).short_samples(curve, GRID)[1]
    closed = SliceClearance(tube.surface, WallDistance(tube.surface, closed_ends=True), limit=limit).short_samples(curve, GRID)[1]
    assert open_ends.min(initial=limit) > 2.3
    assert closed.min() < open_ends.min(initial=limit) - 0.3


@pytest.mark.parametrize(("limit", "pairs"), [(2.0, 1), (2.2, 2), (2.8, 3)])
def test_pruning_gives_the_same_answer_as_slicing_everything(limit: float, pairs: int, cylinder_1: TubeProblem) -> None:
    surface, wall = cylinder_1.surface, cylinder_1.wall
    pruned = SliceClearance(surface, wall, limit=limit, pairs=pairs)
    rng = np.random.default_rng(pairs)
    points = cylinder_1.centerline.points[::11]
    # The same object is asked again and again, as in the iteration: what it remembers must not mislead it.
    for size in (0.5, 0.9):
        curve = spline_through(points + rng.normal(0.0, size, points.shape))[0]
        short, values = pruned.short_samples(curve, COARSE)
        expected, clearances = every_slice(curve, surface, wall, limit, pairs)
        assert short.tolist() == expected
        np.testing.assert_allclose(values, clearances, atol=1e-12)
        assert len(expected) > 0


def test_a_slice_distance_is_never_below_the_exact_one(cylinder_1: TubeProblem) -> None:
    curve = spline_through(cylinder_1.centerline.points[::9])[0]
    slices = SliceClearance(cylinder_1.surface, cylinder_1.wall, limit=3.5)
    short, values = slices.short_samples(curve, GRID)
    exact = cylinder_1.wall.clearance(curve(GRID[short]))
    assert np.all(values >= exact - 1e-12)


def test_one_triangle_is_met_where_the_plane_cuts_it() -> None:
    # The plane z = 0 cuts the triangle along x = 2, y from -0.5 to 0.5.
    triangle = np.array([[[2.0, -1.0, -1.0], [2.0, 1.0, -1.0], [2.0, 0.0, 1.0]]])
    up = np.array([0.0, 0.0, 1.0])
    assert contour_distance(np.zeros(3), up, triangle) == pytest.approx(2.0)
    assert contour_distance(np.array([2.0, 3.5, 0.0]), up, triangle) == pytest.approx(3.0)
    assert contour_distance(np.array([0.0, 0.0, 5.0]), up, triangle) == float("inf")
