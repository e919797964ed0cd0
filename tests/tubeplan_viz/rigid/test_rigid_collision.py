"""Envelope and exact test on voxels, against closed forms and against dense points."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.volume import Volume
from tubeplan_viz.rigid import Bodies, CoupledInstrument, posed
from tubeplan_viz.rigid.collision import collide, rectangle_gap, structure_gaps
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.obstacles import Obstacles, build_obstacles

SPACING = np.array([1.5, 1.0, 1.0])


@pytest.fixture(scope="module")
def scene() -> Obstacles:
    """A slab and a column of voxels; the frame's axes are slice, row, column."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(SPACING)
    volume = Volume(np.zeros((40, 60, 60), np.int16), matrix)
    slab, column = np.zeros((40, 60, 60), bool), np.zeros((40, 60, 60), bool)
    slab[30:34] = True
    column[:, 20:24, 40:44] = True
    return build_obstacles(volume, {"slab": slab, "column": column})


def test_distances_are_to_the_faces_of_the_voxels(scene: Obstacles) -> None:
    # The slab begins at slice 30: its face lies at 30 * 1.5 - 0.75 = 44.25 mm. Axis along rows at 40 mm, radius 2.
    body = Bodies(np.array([[40.0, 5.0, 10.0]]), np.array([[40.0, 50.0, 10.0]]), np.array([2.0]), np.array([False]))
    gaps = structure_gaps(scene, body)
    assert gaps.distance[0, 0] == pytest.approx(2.25, abs=2e-3)  # distances settle within 1e-3 on either side
    # The column's face in the last axis lies at 40 - 0.5 = 39.5 mm, 29.5 mm from the axis.
    assert gaps.distance[0, 1] == pytest.approx(27.5, abs=2e-3)


def test_the_distance_to_a_stepped_surface_is_that_to_all_of_its_cells() -> None:
    volume = Volume(np.zeros((40, 40, 40), np.int16), np.eye(4))
    index = np.stack(np.meshgrid(*3 * [np.arange(40)], indexing="ij"), axis=-1)
    ball = np.linalg.norm(index - 20.0, axis=-1) < 9.3
    obstacles = build_obstacles(volume, {"ball": ball})
    rng = np.random.default_rng(3)
    # Axes that pass the ball's middle at 11 to 14 mm, in random directions: shafts 1.5 mm thick leave 0.2 to 4 mm.
    way = unit(rng.normal(size=(60, 3)))
    aside = unit(np.cross(way, rng.normal(size=(60, 3))))
    middle = 20.0 + rng.uniform(11.0, 14.0, (60, 1)) * aside
    bodies = Bodies(middle - 15.0 * way, middle + 12.0 * way, np.full(60, 1.5), np.zeros(60, dtype=bool))
    found = structure_gaps(obstacles, bodies).distance[:, 0]
    for k in range(60):
        one = bodies.take(np.full(len(obstacles.cells), k))
        centre = one.gap(obstacles.cells)
        # No point of a cell is farther from its centre than the cover: only these can hold the nearest place.
        near = np.flatnonzero(centre <= centre.min() + obstacles.cover)
        every, _ = rectangle_gap(one.take(near), obstacles.cells[near], obstacles.half[near])
        assert found[k] == pytest.approx(every.min(), abs=1.5e-3)  # both settle within 1e-3


def test_a_flat_end_stops_short_of_what_its_ball_would_touch(scene: Obstacles) -> None:
    # The front stands 0.3 mm before the slab, the axis along slices: a ball of radius 2 around it would be deep inside.
    body = Bodies(np.array([[5.0, 50.0, 10.0]]), np.array([[43.95, 50.0, 10.0]]), np.array([2.0]), np.array([False]))
    assert collide(scene, body).free.tolist() == [True]
    deeper = Bodies(body.tail, body.front + np.array([0.31, 0.0, 0.0]), body.radius, body.round_front)
    hits = collide(scene, deeper)
    assert scene.names[hits.label[0]] == "slab"


def test_a_body_wholly_inside_a_structure_is_a_hit(scene: Obstacles) -> None:
    body = Bodies(np.array([[47.0, 30.0, 30.0]]), np.array([[47.0, 33.0, 30.0]]), np.array([0.5]), np.array([True]))
    assert scene.names[collide(scene, body).label[0]] == "slab"


def test_the_envelope_never_passes_what_touches_and_hardly_refuses_too_early(scene: Obstacles) -> None:
    rng = np.random.default_rng(8)
    n = 3000
    tips = rng.uniform([5.0, 5.0, 5.0], [55.0, 55.0, 55.0], (n, 3))
    bodies = posed(CoupledInstrument(), tips, unit(rng.normal(size=(n, 3))), rng.uniform(-1.0, 1.0, n))
    envelope, exact = collide(scene, bodies, exact=False).free, collide(scene, bodies).free
    assert not np.any(envelope & ~exact)
    assert np.mean(exact & ~envelope) <= 0.02
    # An oracle of its own: points that fill the voxels, half a millimetre apart, faces included.
    share = np.linspace(-0.5, 0.5, 3)
    offsets = np.stack(np.meshgrid(share, share, share, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.vstack([np.argwhere(mask) for mask in scene.masks])
    points = ((index[:, None] + offsets) * SPACING).reshape(-1, 3)
    for k in rng.choice(2 * n, 40, replace=False):
        body = bodies.take(np.array([k]))
        least = body.take(np.zeros(len(points), int)).gap(points).min()
        # A point inside proves a hit; the nearest point is within 0.46 mm (half a gap's diagonal) of what touches.
        assert exact[k] == (least > 0.0) or (not exact[k] and least < 0.46)


def test_projections_bound_the_distance_from_both_sides() -> None:
    rng = np.random.default_rng(5)
    n = 200
    tail = rng.uniform(-10.0, 10.0, (n, 3))
    bodies = Bodies(tail, tail + 8.0 * unit(rng.normal(size=(n, 3))), np.full(n, 1.0), rng.random(n) < 0.5)
    centres, half = rng.uniform(-10.0, 10.0, (n, 3)), np.tile([0.15, 0.15, 0.0], (n, 1))
    upper, lower = rectangle_gap(bodies, centres, half)
    corners = np.stack(np.meshgrid(*3 * [np.linspace(-1.0, 1.0, 9)], indexing="ij"), axis=-1).reshape(-1, 3)
    dense = np.stack([bodies.gap(centres + corner * half) for corner in corners]).min(axis=0)
    assert np.all(lower <= upper + 1e-9)
    assert np.all(lower <= dense + 1e-9)
    # Dense points are 0.0375 mm apart, so the nearest is at most 0.0265 mm from the rectangle's nearest point.
    assert np.all(dense <= upper + 0.0275)
