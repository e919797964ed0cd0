"""Distances of needle paths to obstacles: closed forms, dense sampling and bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from segmentation.errors import CaseError
from segmentation.mesh import Surface
from segmentation.volume import Volume
from tubeplan_viz.needle.arc_distance import STRAIGHT, arc_distance
from tubeplan_viz.needle.bodies import Capsule, MaskObstacle, MeshObstacle, Polygon, Sphere
from tubeplan_viz.needle.kinematics import Arcs, Controls, Pose, bend, planar_pose, push
from tubeplan_viz.needle.obstacles import Scene, danger

ORIGIN = Pose(np.zeros(3), np.eye(3))


def sampled(arcs: Arcs, center: np.ndarray, count: int = 20001) -> float:
    places = arcs.lengths[:, None] * np.linspace(0.0, 1.0, count)
    return float(np.linalg.norm(arcs.points(places) - center, axis=-1).min())


def printed(arcs: Arcs, center: np.ndarray) -> float:
    """Huo et al. (2015), eq. 13, for one arc, distance to the centre."""
    start, end = center - arcs.starts[0], center - arcs.ends[0]
    if start @ arcs.tangents[0] > 0 and end @ arcs.end_tangents[0] < 0:
        radius = 1.0 / arcs.curvatures[0]
        off = center - (arcs.starts[0] + radius * arcs.normals[0])
        across = np.cross(arcs.tangents[0], arcs.normals[0])
        size = np.linalg.norm(off)
        phi = np.arcsin(min(abs(off @ across) / size, 1.0))
        return float(np.sqrt(size**2 + radius**2 - 2.0 * radius * size * np.cos(phi)))
    return float(min(np.linalg.norm(start), np.linalg.norm(end)))


point = st.tuples(*[st.floats(-80.0, 80.0)] * 3)


@given(point, st.floats(0.0, 0.05), st.floats(0.05, 0.99), st.floats(0.0, 6.28))
@example((0.0, 2.0, 79.0), 0.0, 0.77, 0.0)
@settings(max_examples=80, deadline=None)
def test_distance_to_an_arc_is_that_of_dense_samples_up_to_a_full_turn(
    center: tuple[float, float, float], curvature: float, share: float, turn: float
) -> None:
    length = share * min(2.0 * np.pi / max(curvature, 1e-9), 150.0)
    arcs = push(ORIGIN, Controls(np.array([turn]), np.array([length]), np.array([curvature])))
    found = float(arc_distance(arcs, np.array([center]))[0, 0])
    dense = sampled(arcs, np.array(center))
    step = length / 20000
    # A sample lies within half a step of the nearest place; a straight piece is taken as one that bends by STRAIGHT.
    assert found <= dense + 1e-9 + 0.5 * STRAIGHT * length**2
    assert dense <= np.hypot(found, step) + step * 1e-2


@given(point, st.floats(0.02, 0.49))
@settings(max_examples=80, deadline=None)
def test_the_printed_formula_holds_under_half_a_turn(center: tuple[float, float, float], share: float) -> None:
    kappa = 0.02
    arcs = push(ORIGIN, Controls(np.zeros(1), np.array([share * 2.0 * np.pi / kappa]), np.array([kappa])))
    ours = float(arc_distance(arcs, np.array([center]))[0, 0])
    # The printed arcsine loses half the digits near the axis of the circle.
    assert printed(arcs, np.array(center)) == pytest.approx(ours, abs=1e-5)


def test_the_printed_formula_fails_beyond_half_a_turn() -> None:
    kappa = 0.02
    arcs = push(ORIGIN, Controls(np.zeros(1), np.array([0.75 * 2.0 * np.pi / kappa]), np.array([kappa])))
    # On the arc's own far side: ahead of the start's tangent no more, the middle of the arc is the nearest.
    center = arcs.points(np.array([[0.625 * 2.0 * np.pi / kappa]]))[0, 0] * 1.02
    ours = float(arc_distance(arcs, center[None])[0, 0])
    # samples 0.006 mm from the nearest place, which is 1.7 mm away
    assert ours == pytest.approx(sampled(arcs, center), abs=1e-5)
    assert printed(arcs, center) > ours + 10.0


def test_a_line_is_the_limit_of_an_arc() -> None:
    centers = np.random.default_rng(1).uniform(-50, 120, (200, 3))
    straight, nearly = (
        arc_distance(push(ORIGIN, Controls(np.zeros(1), np.array([90.0]), np.array([k]))), centers) for k in (0.0, 1e-11)
    )
    # At a curvature of 1e-11 the arc leaves the line by 4e-8 mm.
    assert np.abs(straight - nearly).max() < 1e-7
    foot = np.clip(centers[:, 2], 0.0, 90.0)
    expected = np.linalg.norm(centers - np.column_stack([0 * foot, 0 * foot, foot]), axis=1)
    assert np.allclose(straight[0], expected, atol=1e-9)


def test_capsule_and_polygon_distances_by_hand() -> None:
    bar = Capsule(np.array([[0.0, 0, 0], [0, 0, 10]]), 2.0)
    assert np.allclose(bar.distance(np.array([[5.0, 0, 5], [0, 0, 14], [1, 0, 5]])), [3.0, 2.0, -1.0])
    square = Polygon(np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]]))
    points = np.array([[9.0, 2, 2], [0, 7, 8], [0, -1, 2], [0, 2, 3.5]])
    assert np.allclose(square.distance(points), [-2.0, 5.0, 1.0, -0.5])
    notch = Polygon(np.array([[0.0, 0], [10, 0], [10, 10], [5, 2], [0, 10]]))
    assert notch.distance(np.array([[0.0, 5, 4]]))[0] > 0  # in the notch, outside
    assert notch.distance(np.array([[0.0, 1, 4]]))[0] < 0


@pytest.mark.parametrize("curvature", [0.0, 0.02, 0.08])
def test_distance_of_planar_pieces_to_a_polygon_is_that_of_dense_samples(curvature: float) -> None:
    rng = np.random.default_rng(11)
    body = Polygon(np.array([[8.0, 20], [20, 22], [30, 40], [18, 33], [6, 38]]))
    met = 0
    for _ in range(60):
        pose = planar_pose(rng.uniform(-30, 40, 2), float(rng.uniform(-3, 3)))
        turn = rng.choice([0.0, np.pi])
        arcs = push(pose, Controls(np.array([turn]), np.array([rng.uniform(2, 70)]), np.array([curvature])))
        dense = body.distance(arcs.points(arcs.lengths[:, None] * np.linspace(0, 1, 20001))).min()
        found = body.arc_gaps(arcs)[0]
        if dense <= 0.0:
            met += 1
            assert dense - 1e-9 <= found < 0.0  # some depth of the way through, not the greatest
        else:
            assert found == pytest.approx(dense, abs=2e-3)  # half of 70 mm / 20000
    assert 5 < met < 50


def box(half: float) -> Surface:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return Surface(corners, faces, np.full(len(faces), -1), frame="mesh")


def test_a_mesh_is_as_far_as_its_triangles() -> None:
    cube = MeshObstacle(box(3.0))
    points = np.array([[[7.0, 0, 0], [6, 7, 0]], [[0, 0, 0], [0, 2, 0]]])
    assert np.allclose(cube.distance(points), [[4.0, 5.0], [-3.0, -1.0]], atol=1e-9)


def ball_mask(radius: float) -> Volume:
    spacing = np.array([1.0, 0.7, 0.7])
    shape = (31, 45, 45)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1) * spacing
    middle = (np.array(shape) - 1) / 2 * spacing
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(spacing)
    return Volume((np.linalg.norm(index - middle, axis=-1) <= radius).astype(np.int16), matrix)


@pytest.mark.parametrize("fine", [True, False], ids=["half grid", "voxel grid"])
def test_a_mask_is_never_nearer_than_it_says_nor_farther_than_its_bound(fine: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    mask = ball_mask(8.0)
    if not fine:
        monkeypatch.setattr("tubeplan_viz.needle.bodies.FINE_VOXELS", 0)
    body = MaskObstacle(mask)
    # Half a diagonal of half the spacing, and a whole one of the spacing.
    assert body.bound == pytest.approx(np.linalg.norm([1.0, 0.7, 0.7]) * (0.25 if fine else 1.0))
    centers = mask.to_lps(np.argwhere(np.asarray(mask.voxels) > 0))
    half = np.asarray(mask.spacing) / 2
    points = np.random.default_rng(2).uniform([-8, -8, -8], [38, 40, 40], (1200, 3))
    away = np.maximum(np.abs(points[:, None] - centers) - half, 0.0)
    exact = np.linalg.norm(away, axis=2).min(axis=1)  # to the voxels' boxes
    outside = exact > 0
    # Within, the field's depth; without, the boxes' own distance to rounding.
    assert np.abs(body.exact(points)[outside] - exact[outside]).max() < 1e-9
    assert (body.exact(points)[~outside] <= 0.0).all()
    said = body.distance(points)
    assert (said[outside] <= exact[outside] + 1e-5).all()
    inner = outside & (points >= 0).all(axis=1) & (points <= mask.to_lps(np.array(mask.voxels.shape) - 1.0)).all(axis=1)
    assert np.count_nonzero(inner) > 100
    # Interpolation is off to either side by no more than the bound, which is taken off besides.
    assert (said[inner] >= exact[inner] - 2.0 * body.bound - 1e-5).all()


def test_a_path_past_a_mask_is_told_the_distance_of_the_boxes_not_of_the_field() -> None:
    body = MaskObstacle(ball_mask(8.0))
    top = max(float(place[2]) for place in body.volume.to_lps(np.argwhere(np.asarray(body.volume.voxels) > 0)))
    # A straight way across the ball's top, 3 mm from the upper faces of its highest voxels.
    spacing = float(abs(body.volume.index_to_lps[2]).max())
    height = top + 0.5 * spacing + 3.0
    across = Pose(np.array([-20.0, 15.0, height]), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    way = push(across, Controls(np.zeros(1), np.array([70.0]), np.zeros(1)))
    # The bisection stops a thousandth short.
    assert Scene((body,)).least_distance(way)[0] == pytest.approx(3.0, abs=2e-3)


def test_the_least_distance_bounds_a_path_between_the_samples() -> None:
    rng = np.random.default_rng(5)
    bodies = (
        Sphere(np.array([4.0, 6.0, 40.0]), 3.0),
        Capsule(np.array([[-20.0, 8, 30], [20, 9, 55]]), 2.0),
        MeshObstacle(box(2.5)),
    )
    scene = Scene(bodies, spacing=3.0)
    for _ in range(6):
        controls = Controls(rng.uniform(-3, 3, 3), rng.uniform(10, 40, 3), np.full(3, 0.02))
        arcs = push(Pose(np.array([0.0, 0.0, 6.0]), np.eye(3)), controls)
        bound = scene.least_distance(arcs)
        places = arcs.lengths[:, None] * np.linspace(0.0, 1.0, 4001)
        dense = np.array([body.distance(arcs.points(places)).min() for body in bodies])
        assert (bound <= dense + 1e-9).all()
        # 1 micrometre of bisection, and 40 mm / 4000 between the dense samples
        assert (bound >= dense - 0.012).all()


@pytest.mark.parametrize("place", [17.3, 31.7])
def test_the_bound_of_a_line_past_a_rod_is_never_more_than_the_distance_and_less_by_the_tolerance_at_most(place: float) -> None:
    # The rod crosses the way 5 mm beside it, where no halving of 40 mm falls: the nearest sample is a little too far.
    rod = Capsule(np.array([[-20.0, 5.0, place], [20.0, 5.0, place]]), 1.0)
    way = push(ORIGIN, Controls(np.zeros(1), np.array([40.0]), np.zeros(1)))
    for tolerance in (1e-3, 0.1):
        told = float(Scene((rod,)).least_distance(way, tolerance=tolerance)[0])
        assert 4.0 - tolerance - 1e-12 <= told < 4.0


def test_distances_of_a_population_are_those_of_its_paths() -> None:
    rng = np.random.default_rng(7)
    scene = Scene((Sphere(np.array([0.0, 5.0, 40.0]), 4.0), Sphere(np.array([9.0, -5.0, 60.0]), 6.0)))
    turns, lengths = rng.uniform(-3, 3, (9, 3)), rng.uniform(10, 40, (9, 3))
    found = scene.piece_distances(bend(ORIGIN, turns, lengths, np.full((9, 3), 0.02))).min(axis=1)
    for k in range(9):
        assert np.allclose(found[k], scene.least_distance(push(ORIGIN, Controls(turns[k], lengths[k], np.full(3, 0.02)))))


def test_danger_grows_as_printed_and_is_infinite_within_the_safety_distance() -> None:
    assert danger(np.array([4.0, 8.0]), 2.0) == pytest.approx(0.75)
    assert np.isinf(danger(np.array([1.99, 80.0]), 2.0))


def test_obstacles_that_are_none_are_refused() -> None:
    with pytest.raises(CaseError, match="radius_mm -1, expected more than 0"):
        Sphere(np.zeros(3), -1.0)
    with pytest.raises(CaseError, match="two or more"):
        Capsule(np.zeros((1, 3)), 1.0)
    with pytest.raises(CaseError, match="no area"):
        Polygon(np.array([[0.0, 0], [1, 1], [2, 2]]))
    with pytest.raises(CaseError, match="no voxel above 0"):
        MaskObstacle(Volume(np.zeros((4, 4, 4), np.int16), np.eye(4)))
