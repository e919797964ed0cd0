"""The verifier's own geometry against closed forms and against nothing it shares."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

import tubeplan_viz.verify
from segmentation.mesh import Surface
from segmentation.mesh_files import write_ply
from tubeplan_viz.verify.files import _tangent_and_torsion
from tubeplan_viz.verify.mesh_file import MeshFileError, read_mesh
from tubeplan_viz.verify.profile import measure
from tubeplan_viz.verify.spline import BezierPath
from tubeplan_viz.verify.wall import Lumen, Triangles, point_triangle_distance, winding_number

seeds = st.integers(0, 2**32 - 1)


def random_spline(seed: int, *, double_knot: bool = False) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 12))
    steps = rng.uniform(0.2, 1.0, count - 3)  # neighbouring features of a plan are not nearer than this to each other
    inner = np.cumsum(steps)[:-1] / steps.sum()
    if double_knot and len(inner) > 1:
        inner[1] = inner[0]
    return np.concatenate([[0.0] * 4, inner, [1.0] * 4]), rng.normal(scale=20.0, size=(count, 3)) + 100.0


@given(seeds, st.booleans())
@settings(max_examples=40, deadline=None)
def test_bezier_pieces_are_the_spline_with_its_derivatives(seed: int, double_knot: bool) -> None:
    knots, control = random_spline(seed, double_knot=double_knot)
    path = BezierPath.from_spline(3, knots, control)
    piece = np.repeat(np.arange(len(path.pieces)), 7)
    t = np.tile(np.linspace(0.02, 0.98, 7), len(path.pieces))
    u = path.breaks[piece] + t * np.diff(path.breaks)[piece]
    for order in range(4):
        expected = BSpline(knots, control, 3)(u, nu=order)
        # Coordinates near 100 mm, differenced three times over spans down to 1/40: 1e-14 * 6 * 40^3 of the largest.
        assert path.evaluate(piece, t, order) == pytest.approx(expected, rel=1e-7, abs=1e-7 * np.abs(expected).max())


def quarter_circle(radius: float) -> BezierPath:
    """Eight cubic pieces with the circle's points and tangents at their ends."""
    angle = np.linspace(0.0, np.pi / 2.0, 9)
    reach = 4.0 / 3.0 * np.tan(np.pi / 64.0)
    point = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    tangent = np.column_stack([-np.sin(angle), np.cos(angle), 0.0 * angle])
    pieces = np.stack([point[:-1], point[:-1] + reach * tangent[:-1], point[1:] - reach * tangent[1:], point[1:]], axis=1)
    return BezierPath(np.linspace(0.0, 1.0, 9), radius * pieces)


def test_circle_has_its_length_curvature_and_no_torsion() -> None:
    path = quarter_circle(20.0)
    samples = path.sample(0.04)
    # A cubic meets a 1/8 of a quarter circle to about 1e-9 of its radius, its curvature to about 1e-6.
    assert samples.s[-1] == pytest.approx(10.0 * np.pi, rel=1e-8)
    assert path.curvature(samples.piece, samples.t) == pytest.approx(0.05, rel=2e-5)
    torsion, rounding = path.torsion(samples.piece, samples.t)
    assert np.abs(torsion).max() <= 10.0 * rounding.max() + 1e-15
    assert np.diff(samples.s).max() <= 0.04


@pytest.mark.parametrize(("told", "holds"), [(1.0, True), (1.2, False), (0.8, False)])
def test_torsion_beside_an_inflection_may_be_that_of_a_place_half_a_millionth_of_a_mm_away(told: float, holds: bool) -> None:
    """(t, t^3, h t^2) bends with 6 t one way and 2 h the other: its torsion falls from -3 / h where t is as small as h."""
    hair = 1e-4
    power = np.array([[0.0, 0, 0], [1.0, 0, 0], [0.0, 0, hair], [0.0, 1, 0]])
    # Power basis to Bezier points of a cubic: b_k = sum over j of C(k, j) / C(3, j) a_j.
    bezier = np.array([[1, 0, 0, 0], [1, 1 / 3, 0, 0], [1, 2 / 3, 1 / 3, 0], [1, 1, 1, 1]]) @ power
    samples = BezierPath(np.array([0.0, 1.0]), bezier[None]).sample(0.01)
    s = np.array([0.0, 1e-5, 3e-5, 1e-4, 0.5])
    piece, t = samples.at_length(s)
    rows = np.zeros((len(s), 10))
    rows[:, 0] = s
    rows[:, 4:7] = samples.path.evaluate(piece, t, 1)
    rows[:, 4:7] /= np.linalg.norm(rows[:, 4:7], axis=1, keepdims=True)
    rows[:, 8] = told * samples.path.torsion(*samples.at_length(s + 5e-7))[0]
    assert np.abs(rows[:, 8]).max() > 1e4  # 1/mm, and 3 % less a millionth of a mm on
    checks = {check.name: check.ok for check in _tangent_and_torsion(rows, samples)}
    assert checks == {"path.csv: tangents": True, "path.csv: torsion": holds}


def test_arc_length_is_inverted() -> None:
    samples = quarter_circle(20.0).sample(0.04)
    s = np.linspace(0.0, samples.s[-1], 301)
    piece, t = samples.at_length(s)
    angle = np.arctan2(*samples.path.evaluate(piece, t)[:, [1, 0]].T)
    assert 20.0 * angle == pytest.approx(s, abs=1e-6)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_curvature_peak_is_no_less_than_any_place(seed: int) -> None:
    knots, control = random_spline(seed)
    samples = BezierPath.from_spline(3, knots, control).sample(0.04)
    peak, where = samples.peak_curvature()
    rng = np.random.default_rng(seed)
    piece, t = rng.integers(0, len(samples.path.pieces), 4000), rng.uniform(size=4000)
    assert peak >= samples.path.curvature(piece, t).max() * (1.0 - 1e-6)
    there = samples.path.curvature(*samples.at_length(np.array([where])))[0]
    assert there == pytest.approx(peak, rel=1e-3)


TRIANGLE = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]])


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((1.0, 1.0, 2.0), 2.0),  # above the inside
        ((2.0, -3.0, 4.0), 5.0),  # beside the edge on x
        ((-3.0, -4.0, 12.0), 13.0),  # off the right-angled corner
        ((3.2, 2.4, 0.0), 1.44),  # off the long edge 3 x + 4 y = 12: (9.6 + 9.6 - 12) / 5
        ((7.0, 0.0, 4.0), 5.0),  # off the corner on x
        ((1.0, 1.0, 0.0), 0.0),
    ],
)
def test_point_triangle_distance_in_closed_form(point: tuple[float, float, float], distance: float) -> None:
    points = np.array([point])
    for order in ([0, 1, 2], [1, 2, 0], [2, 1, 0]):
        assert point_triangle_distance(points, TRIANGLE[None, order]) == pytest.approx(distance, abs=1e-12)


def test_triangle_without_area_is_a_segment_or_a_point() -> None:
    points = np.array([[1.0, 2.0, 0.0], [9.0, 0.0, 0.0]])
    line = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    assert point_triangle_distance(points, np.array([line, line])) == pytest.approx([2.0, 5.0])
    assert point_triangle_distance(points[1:], np.zeros((1, 3, 3))) == pytest.approx([9.0])


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_searched_distance_is_the_least_over_all_triangles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    small = rng.uniform(-10.0, 10.0, (300, 1, 3)) + rng.normal(scale=0.3, size=(300, 3, 3))
    needles = rng.uniform(-10.0, 10.0, (12, 1, 3)) + rng.normal(size=(12, 3, 1)) * rng.normal(scale=8.0, size=(12, 1, 3))
    needles[:6] += rng.normal(scale=1e-4, size=(6, 3, 3))
    triangles = np.concatenate([small, needles])
    points = np.concatenate([rng.uniform(-12.0, 12.0, (40, 3)), np.linspace(-9.0, 9.0, 60)[:, None] * [1.0, 0.5, -0.2]])
    every = np.array([point_triangle_distance(points, np.repeat(one[None], len(points), axis=0)) for one in triangles])
    assert Triangles(triangles).distance(points) == pytest.approx(every.min(axis=0), abs=1e-12)


def test_no_triangles_are_infinitely_far() -> None:
    assert np.isinf(Triangles(np.empty((0, 3, 3))).distance(np.zeros((2, 3)))).all()


def cube() -> np.ndarray:
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners[np.array([face for a, b, c, d in squares for face in ((a, b, c), (a, c, d))])]


def test_winding_number_is_one_inside_and_zero_outside() -> None:
    rng = np.random.default_rng(5)
    inside, outside = rng.uniform(0.01, 0.99, (50, 3)), rng.uniform(1.01, 3.0, (50, 3))
    assert winding_number(inside, cube()) == pytest.approx(1.0, abs=1e-12)
    assert winding_number(outside, cube()) == pytest.approx(0.0, abs=1e-12)


def test_clearance_changes_sign_where_the_path_leaves_and_comes_back() -> None:
    lumen = Lumen(Triangles(cube()), Triangles(np.empty((0, 3, 3))))
    points = np.column_stack([np.linspace(-0.5, 1.5, 401), np.full(401, 0.5), np.full(401, 0.5)])
    clearance, inside = lumen.clearance(points, on_surface=1e-6)
    x = points[:, 0]
    expected = np.where((x > 0) & (x < 1), np.minimum(np.minimum(x, 1 - x), 0.5), -np.maximum(-x, x - 1))
    assert clearance == pytest.approx(expected, abs=1e-9)
    assert inside.tolist() == ((x > -1e-6) & (x < 1 + 1e-6)).tolist()


@given(seeds)
@settings(max_examples=5, deadline=None)
def test_clearance_bound_holds_between_the_samples(seed: int) -> None:
    # A path past random obstacles: no place of it is nearer to them than the bound, nor the bound far below.
    rng = np.random.default_rng(seed)
    path = quarter_circle(20.0)
    obstacles = path.evaluate(np.arange(8), np.full(8, 0.3))[:, None] + rng.normal(scale=1.5, size=(8, 1, 3))
    shell = 400.0 * (cube() - 0.5)
    wall = np.concatenate([shell, obstacles + rng.normal(scale=0.05, size=(8, 3, 3))])
    own = measure(path, Lumen(Triangles(wall), Triangles(np.empty((0, 3, 3)))))
    piece, t = np.repeat(np.arange(8), 3000), np.tile(np.linspace(0.0, 1.0, 3000), 8)
    every = np.min(
        [point_triangle_distance(path.evaluate(piece, t), np.repeat(one[None], len(t), axis=0)) for one in wall], axis=0
    )
    assert own.clearance_least > 0.0
    assert own.clearance_bound <= every.min() + 1e-9
    assert own.clearance_bound >= own.clearance_least - 2e-4


def test_ends_of_broken_stretches_are_exact() -> None:
    # Along x the distance to the plane x = 0 is x itself: below 5 up to x = 5.
    knots, control = np.array([0.0, 0, 0, 0, 1, 1, 1, 1]), np.linspace([2.0, 0, 0], [11.0, 0, 0], 4)
    plane = np.array([[[0.0, -400, -400], [0, 400, -400], [0, 0, 800]]])
    far = 1000.0 * (cube() - 0.5)
    own = measure(BezierPath.from_spline(3, knots, control), Lumen(Triangles(np.concatenate([plane, far])), Triangles(plane[:0])))
    ((start, end),) = own.broken_clearance(5.0)
    assert (start, end) == pytest.approx((0.0, 3.0), abs=1e-6)
    assert own.broken_clearance(1.9) == []


def test_mesh_file_reads_what_the_product_writes(bent_tube: object, tmp_path: Path) -> None:
    surface: Surface = bent_tube.surface  # type: ignore[attr-defined]
    write_ply(surface, tmp_path / "mesh.ply")
    mesh = read_mesh(tmp_path / "mesh.ply")
    assert mesh.vertices.tolist() == surface.vertices.tolist()
    assert mesh.faces.tolist() == surface.faces.tolist()
    assert (mesh.comment("frame"), mesh.comment("unit"), mesh.open_edges) == ("mesh", "mm", 0)


HEADER = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
FACES = b"element face 4\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"solid nothing", "no PLY"),
        (HEADER + FACES, "bytes of data"),
        (HEADER + FACES + b"\0" * (4 * 12 + 4 * 13), "triangles"),
        (HEADER.replace(b"float x", b"half x") + FACES, "header line"),
        (HEADER.replace(b"little", b"middle") + FACES, "header line"),
        (HEADER.replace(b" z", b" w") + FACES, "vertex properties"),
        (HEADER + b"end_header\n", "expected vertex and face"),
        (HEADER + FACES.replace(b"element face 4", b"element face four"), "header line"),
    ],
)
def test_unreadable_mesh_files(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "mesh.ply").write_bytes(content)
    with pytest.raises(MeshFileError, match=words):
        read_mesh(tmp_path / "mesh.ply")


def test_verifier_shares_no_geometry_with_the_planners() -> None:
    readers = {"segmentation.images", "segmentation.mesh_files", "segmentation.volume_files"}  # obstacles from files
    readers |= {"segmentation.anatomy.nasal", "segmentation.label_file", "segmentation.volume"}  # labels, made again from the CT
    words = {"segmentation.errors", "segmentation.faults"}
    allowed = {"segmentation.arrays", "tubeplan_viz.result"} | words | readers
    folder = Path(tubeplan_viz.verify.__file__).parent
    own, foreign = set(), {"igl", "trimesh", "rerun"}
    for file in folder.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            own |= {name for name in names if name.split(".")[0] in {"segmentation", "tubeplan_viz", "reports"}}
            assert not foreign & {name.split(".")[0] for name in names}, file.name
    assert {name for name in own if not name.startswith("tubeplan_viz.verify")} <= allowed
