"""Mesh files that are whole and yet odd: what a reader might take for another shape than the file says."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from segmentation.errors import SurfaceError
from segmentation.mesh_files import inspect_mesh, read_surface, write_ply
from segmentation.mesh_parse import parse_mesh
from tubeplan_viz.geometry import WallDistance


@pytest.fixture(scope="module")
def tube(phantoms: ModuleType) -> Any:
    """Along +y from 0 to 40 mm, radius 3 mm, with flat ends."""
    return phantoms.straight_tube().surface


def stl(path: Path, phantoms: ModuleType, *meshes: tuple[Any, Any]) -> Path:
    path.write_bytes(phantoms.stl_bytes(*phantoms.joined(*meshes)))
    return path


def test_obj_indices_count_back_from_their_own_line(tmp_path: Path) -> None:
    triangles = np.random.default_rng(0).random((4, 3, 3))
    path = tmp_path / "blocks.obj"
    path.write_text("".join("".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in one.tolist()) + "f -3 -2 -1\n" for one in triangles))
    part = parse_mesh(path).parts[0]
    np.testing.assert_array_equal(part.vertices[part.faces], triangles)


@pytest.mark.parametrize(
    ("line", "faces"),
    [
        ("f 1 2 3 4 # a comment", [[0, 1, 2], [0, 2, 3]]),
        ("f 1/7/9 2//4 3/1", [[0, 1, 2]]),
        ("  f 1 2 \\\n 3", [[0, 1, 2]]),
        ("g wall\nusemtl pink\nf 1 2 3\ng floor\nf 1 3 4", [[0, 1, 2], [0, 2, 3]]),
    ],
)
def test_an_obj_is_read_by_its_grammar(tmp_path: Path, line: str, faces: list[list[int]]) -> None:
    path = tmp_path / "sheet.obj"
    path.write_text(f"mtllib x.mtl\nv 0 0 0 1.0\nv 1 0 0\nvn 0 0 1\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\n{line}\n")
    assert parse_mesh(path).parts[0].faces.tolist() == faces


@pytest.mark.parametrize("line", ["f 0 1 2", "f 1 2", "f 1 2 -9", "f a b c", "v 1 2", "v 1,5 2,0 3,0", "f 1.5 2 3"])
def test_an_obj_line_that_makes_no_sense_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "sheet.obj"
    path.write_text(f"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n{line}\n")
    with pytest.raises(SurfaceError, match=f"line 5 of the OBJ reads '{line}', expected"):
        parse_mesh(path)


def test_text_that_stops_within_a_line_is_told(tmp_path: Path, phantoms: ModuleType) -> None:
    vertices, faces = phantoms.box((0, 0, 0), (10, 40, 10))
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in vertices) + "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1)
    path = tmp_path / "box.obj"
    path.write_text(text)
    assert read_surface(path).warnings == ()
    path.write_text(text[:-1])
    assert "its last line has no end" in read_surface(path).warnings[0]


def test_an_ascii_stl_may_begin_with_a_comment(tmp_path: Path, phantoms: ModuleType, tube: Any) -> None:
    path = tmp_path / "tube.stl"
    path.write_text("# exported for review\n" + phantoms.stl_text(tube.vertices, tube.faces))
    assert read_surface(path).facts["Mesh"].startswith("ASCII STL")


def test_a_body_inside_the_lumen_is_wall(tmp_path: Path, phantoms: ModuleType, tube: Any) -> None:
    stone = phantoms.box((0.0, 18.0, -0.5), (2.0, 20.0, 0.5))
    read = read_surface(stl(tmp_path / "stone.stl", phantoms, (tube.vertices, tube.faces), stone), near=[0.0, 5.0, 0.0])
    assert "a body inside the lumen counts as wall" in read.warnings[0]
    assert read.surface.volume_ml == pytest.approx(tube.volume_ml - 0.004, rel=1e-5)  # the box has 2 x 2 x 1 mm
    wall = WallDistance(read.surface)
    # Beside the box, 1 mm from its face at x = 0; within it; and far from it, where the tube's own wall is nearer.
    points = np.array([[-1.0, 19.0, 0.0], [1.0, 19.0, 0.0], [0.0, 5.0, 0.0]])
    np.testing.assert_allclose(wall.clearance(points)[:2], [1.0, -0.5], atol=1e-6)  # 32-bit coordinates below 64 mm
    assert wall.clearance(points)[2] == pytest.approx(3.0, abs=0.01)  # facets of 1.6 degrees


def test_which_of_two_nested_walls_is_meant_is_asked(tmp_path: Path, phantoms: ModuleType, tube: Any) -> None:
    outer = (tube.vertices - [0.0, 20.0, 0.0]) * [1.3, 1.05, 1.3] + [0.0, 20.0, 0.0]
    path = stl(tmp_path / "walls.stl", phantoms, (outer, tube.faces), (tube.vertices, tube.faces))
    with pytest.raises(SurfaceError, match=r"one wall lies inside another .* give the start as X,Y,Z in the lumen"):
        read_surface(path)
    assert read_surface(path, near=[0.0, 5.0, 0.0]).surface.volume_ml == pytest.approx(tube.volume_ml, rel=1e-5)
    # Between the two walls the lumen is what lies between them.
    between = read_surface(path, near=[3.5, 20.0, 0.0]).surface.volume_ml
    assert between == pytest.approx(tube.volume_ml * (1.05 * 1.3**2 - 1.0), rel=1e-5)


def test_what_crosses_the_wall_and_open_sheets_in_the_lumen_are_told(tmp_path: Path, phantoms: ModuleType, tube: Any) -> None:
    vertices, faces = phantoms.box((-1.0, 18.0, -0.5), (1.0, 20.0, 0.5))
    through = phantoms.box((0.0, 9.0, 0.0), (9.0, 11.0, 1.0))
    beside = phantoms.box((20.0, 0.0, 0.0), (21.0, 1.0, 1.0))
    sheet = (vertices, faces[:2])
    path = stl(tmp_path / "all.stl", phantoms, (tube.vertices, tube.faces), through, sheet, beside)
    told = "\n".join(read_surface(path, near=[0.0, 5.0, 0.0]).warnings)
    assert "1 further component(s) with 12 faces dropped" in told
    assert "a component that crosses the wall is left out, join it to the wall if it belongs to it: 12 faces" in told
    assert "a path may run through it: 2 faces around (-1.0, 19.0, 0.0)" in told


def test_coordinates_far_from_the_origin_are_told_or_refused(tmp_path: Path, phantoms: ModuleType, tube: Any) -> None:
    path = stl(tmp_path / "far.stl", phantoms, (tube.vertices + 9e5, tube.faces))
    # 2^19 < 900 000 < 2^20 and 24 binary digits: steps of 2^-4 mm.
    assert "32-bit numbers, which are 0.062 mm apart there" in read_surface(path).warnings[0]
    stl(path, phantoms, (tube.vertices + 9e3, tube.faces))
    assert read_surface(path).warnings == ()
    for shift in (2e6, 1e8):
        stl(path, phantoms, (tube.vertices + shift, tube.faces))
        with pytest.raises(SurfaceError, match="from the origin of its axes, expected at most 1e\\+06 mm"):
            read_surface(path)
        assert inspect_mesh(path)["faults"]


def test_a_ply_of_ours_that_was_changed_is_refused(tmp_path: Path, tube: Any) -> None:
    path = tmp_path / "mesh.ply"
    write_ply(tube, path)
    whole = path.read_bytes()
    begin = whole.index(b"end_header\n") + len(b"end_header\n") + 24 * len(tube.vertices)
    rows = np.frombuffer(whole, [("count", "u1"), ("corners", "<i4", 3)], offset=begin).copy()
    turned = rows.copy()
    turned["corners"] = rows["corners"][:, ::-1]
    torn = rows.copy()
    torn["corners"][100] = rows["corners"][99]
    far = np.array([5e4]).tobytes()  # the first coordinate of the first vertex
    first = whole.index(b"end_header\n") + len(b"end_header\n")
    for changed, words in (
        (whole[:begin] + turned.tobytes(), "its faces look inward"),
        (whole[:begin] + torn.tobytes(), "its wall is not closed"),
        (whole[:first] + far + whole[first + 8 :], "mm long"),
        # More faces than the end has are declared to be its cap: they would be no wall.
        (whole.replace(b"comment cap 224 C1", b"comment cap 999 C1"), "the faces of its cap C1 cover"),
        (whole.replace(b"comment cap 224 C1 0.0", b"comment cap 224 C1 x.0"), "no longer as tubeplan wrote them"),
        (whole.replace(b"comment cap 224 C1", b"comment cap 99999 C1"), "no longer as tubeplan wrote them"),
    ):
        assert changed != whole
        path.write_bytes(changed)
        with pytest.raises(SurfaceError, match=words):
            read_surface(path)


def test_a_part_is_asked_for_by_the_option_that_names_it(tmp_path: Path, phantoms: ModuleType, tube: Any) -> None:
    import trimesh

    scene = trimesh.Scene()
    for name in ("left", "right"):
        scene.add_geometry(trimesh.Trimesh(tube.vertices / 1000.0, tube.faces, process=False), node_name=name)
    scene.export(tmp_path / "scene.glb")
    with pytest.raises(SurfaceError, match=r"\(left, right\), expected one wall; name one with --part"):
        read_surface(tmp_path / "scene.glb")


def test_a_mesh_whose_faces_all_collapse_is_inspected(tmp_path: Path, phantoms: ModuleType) -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0], [0.0, 1e-9, 0.0], [30.0, 0.0, 0.0]])
    path = stl(tmp_path / "dust.stl", phantoms, (vertices, np.array([[0, 1, 2], [3, 3, 0]])))
    report = inspect_mesh(path)
    assert "degenerate" in report["faults"][0]
    assert report["parts"][0]["components"] == 0
