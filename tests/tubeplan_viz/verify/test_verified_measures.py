"""Measures are found again by the verifier's own means, and planted faults in them are refused."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from segmentation.mesh import Surface
from segmentation.synthetic import weibel_airway
from tubeplan_viz.bench.measures import measured
from tubeplan_viz.cases.inputs import InputCase
from tubeplan_viz.measures import Measure, StoneFacts, UrinarySettings, path_measures, rirs, russ, urinary_measures
from tubeplan_viz.pipeline import grow_tree, load_lumen
from tubeplan_viz.pipeline.measures import details_of, measured_airway
from tubeplan_viz.pipeline.parts import urinary_lumen
from tubeplan_viz.verify.hollow import Planes, filled
from tubeplan_viz.verify.measures import check_measures
from tubeplan_viz.verify.measures_urinary import check_urinary
from tubeplan_viz.verify.mesh_file import MeshFile, read_mesh
from tubeplan_viz.verify.pelvis import first_parting, pelvis_of, together
from tubeplan_viz.verify.profile import OwnProfile, measure
from tubeplan_viz.verify.run import _lumen, _path_of

Told = dict[str, Any]
KIDNEYS = Path(__file__).parents[4] / "shared" / "data" / "hubmap_ureter_female"


@pytest.fixture(scope="module")
def clean(made_runs: Path) -> tuple[Told, OwnProfile]:
    """A planned path without measures, and the verifier's samples of it."""
    result = json.loads((made_runs / "clean" / "result.json").read_text())
    return result, measure(_path_of(result), _lumen(result, read_mesh(made_runs / "clean" / "mesh.ply")))


def file_of(surface: Surface) -> MeshFile:
    return MeshFile(np.asarray(surface.vertices), np.asarray(surface.faces), ())


STONE = {"stone_volume_mm3": 60.0, "stone_diameter_mm": 6.0, "stone_hu_mean": 900.0, "stone_hu_max": 1200.0}


@pytest.fixture(scope="module")
def urinary(clean: tuple[Told, OwnProfile]) -> tuple[Told, MeshFile]:
    """The plain kidney with a stone in its lower calyx: ``details.measures`` and the mesh."""
    found = measured("plain", 1.0, noise=False)
    path, curvature_max = clean[0]["path"], clean[0]["metrics"]["curvature_max_per_mm"]
    whole = path_measures(
        np.array(path["s_mm"]), np.array(path["points_mm"]), np.array(path["curvature_per_mm"]), float(curvature_max)
    )
    stone = [Measure(key=key, of="stone 1", value=value) for key, value in STONE.items()]
    items = [*whole, *found.measures.measures, *stone]
    by = {(one.key, one.of): one.value for one in items}
    length = next(one.value for one in items if one.key == "infundibular_length_mm" and one.of.endswith(", lower"))
    facts = StoneFacts(
        burden=6.0,
        density=900.0,
        calyces=1,
        lower_pole=True,
        angle=by["infundibulopelvic_angle_coronal_deg", "lower infundibulum"],
        length=length,
        abnormal=False,
    )
    told = details_of(items, [score(facts).details() for score in (russ, rirs)], found.measures.drawing)
    return told, file_of(found.lumen.wall.surface)


@pytest.fixture(scope="module")
def airway() -> tuple[Told, MeshFile]:
    tree = grow_tree(weibel_airway(generations=2, voxel=1.0).surface)
    found, drawing, _ = measured_airway(tree, None)
    return details_of(list(found), [], drawing), file_of(tree.surface)


def faults(clean: tuple[Told, OwnProfile], told: Told, mesh: MeshFile) -> set[str]:
    result = copy.deepcopy(clean[0])
    result["details"]["measures"], result["frame"] = told, "LPS"
    return {check.name for check in check_measures(result, {}, mesh, clean[1]) if not check.ok}


def item(told: Told, key: str, of: str = "") -> Told:
    return next(one for one in told["items"] if one["key"] == key and one["of"].startswith(of))


def plant(key: str, change: Callable[[float], float], of: str = "") -> Callable[[Told], None]:
    def planted(told: Told) -> None:
        one = item(told, key, of)
        one["value"] = change(one["value"])

    return planted


def moved(kind: str, name: str, shift: tuple[float, float, float]) -> Callable[[Told], None]:
    def planted(told: Told) -> None:
        key = next(one for one in told["drawing"][kind] if one.startswith(name))
        told["drawing"][kind][key] = (np.array(told["drawing"][kind][key]) + shift).tolist()

    return planted


def points(score: int, part: int, by: int) -> Callable[[Told], None]:
    def planted(told: Told) -> None:
        told["scores"][score]["parts"][part]["points"] += by
        for key in ("low", "high", "total"):
            told["scores"][score][key] += by

    return planted


def total(told: Told) -> None:
    told["scores"][1]["total"] += 1


# What is planted, and the check that must name it. Sizes lie just beyond what each check allows.
PLANTED: dict[str, tuple[Callable[[Told], None], str]] = {
    "tortuosity": (plant("tortuosity", lambda value: value + 0.01), "measures: tortuosity"),
    "bending": (plant("total_bending_deg", lambda value: value * 1.01), "measures: total_bending_deg"),
    "bend radius": (plant("bend_radius_min_mm", lambda value: value * 1.01), "measures: bend_radius_min_mm"),
    "bend radius, where": (plant("bend_radius_min_at_mm", lambda value: 0.3 * value), "measures: bend_radius_min_at_mm"),
    "pelvis": (plant("pelvis_diameter_mm", lambda value: value + 2.0), "measures: pelvis_diameter_mm"),
    "angle": (
        plant("infundibulopelvic_angle_deg", lambda value: value - 4.5, "lower infundibulum"),
        "measures: angle of infundibula",
    ),
    "coronal angle": (
        plant("infundibulopelvic_angle_coronal_deg", lambda value: value + 4.5, "upper infundibulum"),
        "measures: coronal angle of infundibula",
    ),
    "length": (plant("infundibular_length_mm", lambda value: value + 1.6), "measures: length of infundibula"),
    "width": (plant("infundibular_width_mm", lambda value: value + 1.3), "measures: width of infundibula"),
    "calyx": (plant("calyx_diameter_mm", lambda value: value - 2.0), "measures: calyx diameters"),
    "ureter": (plant("ureter_diameter_mean_mm", lambda value: value + 1.3), "measures: ureter_diameter_mean_mm"),
    "ureter, least": (plant("ureter_diameter_min_mm", lambda value: value - 1.6), "measures: ureter_diameter_min_mm"),
    "a bottom in the air": (moved("points", "bottom of ", (4.0, 0.0, 0.0)), "measures: bottoms on the wall"),
    "a line in the air": (moved("lines", "way to ", (6.0, 0.0, 0.0)), "measures: middle lines"),
    "stone": (plant("stone_volume_mm3", lambda value: 3.0 * value), "measures: stone 1"),
    "stone's density": (plant("stone_hu_mean", lambda value: 2.0 * value), "measures: stone 1"),
    "points of RUSS": (points(0, 0, 1), "measures: parts of RUSS"),
    "points of R.I.R.S.": (points(1, 2, -1), "measures: parts of R.I.R.S."),
    "total of R.I.R.S.": (total, "measures: total of R.I.R.S."),
}


def test_true_measures_of_a_kidney_hold(clean: tuple[Told, OwnProfile], urinary: tuple[Told, MeshFile]) -> None:
    assert faults(clean, *urinary) == set()


# Faults that do not touch each other's checks are planted together: filling the mesh takes a second each time.
TOGETHER = [
    ("tortuosity", "bending", "angle", "width", "pelvis", "stone", "points of RUSS"),
    ("bend radius", "coronal angle", "length", "calyx", "ureter", "stone's density", "points of R.I.R.S."),
    ("bend radius, where", "ureter, least", "total of R.I.R.S."),
]


@pytest.mark.parametrize("names", TOGETHER)
def test_planted_faults_are_refused_by_their_checks_and_no_other(
    names: tuple[str, ...], clean: tuple[Told, OwnProfile], urinary: tuple[Told, MeshFile]
) -> None:
    told = copy.deepcopy(urinary[0])
    for name in names:
        PLANTED[name][0](told)
    assert faults(clean, told, urinary[1]) == {PLANTED[name][1] for name in names}


def test_places_in_the_air_are_refused(clean: tuple[Told, OwnProfile], urinary: tuple[Told, MeshFile]) -> None:
    told = copy.deepcopy(urinary[0])
    for name in ("a bottom in the air", "a line in the air"):
        PLANTED[name][0](told)
    assert {PLANTED[name][1] for name in ("a bottom in the air", "a line in the air")} <= faults(clean, told, urinary[1])
    assert {name for names in TOGETHER for name in names} == PLANTED.keys() - {"a bottom in the air", "a line in the air"}


def test_true_measures_of_an_airway_hold_and_faults_are_refused(
    clean: tuple[Told, OwnProfile], airway: tuple[Told, MeshFile]
) -> None:
    assert faults(clean, *airway) == set()
    for change, check in (
        (plant("generation", lambda value: value + 1.0, "branch 2"), "measures: airway generations"),
        (plant("branch_length_mm", lambda value: value + 0.5, "branch 1"), "measures: airway lengths"),
        (plant("branch_diameter_mm", lambda value: value + 1.5, "branch 2"), "measures: airway diameters"),
        (plant("branch_angle_deg", lambda value: value + 14.0, "branch 1"), "measures: airway angles"),
        (plant("trachea_diameter_mm", lambda value: value - 1.5), "measures: airway diameters"),
    ):
        told = copy.deepcopy(airway[0])
        change(told)
        assert faults(clean, told, airway[1]) == {check}


def test_a_run_without_measures_has_nothing_to_check(clean: tuple[Told, OwnProfile], airway: tuple[Told, MeshFile]) -> None:
    assert list(check_measures(clean[0], {}, airway[1], clean[1])) == []


def test_a_filled_ball_has_its_volume_and_its_depth(phantoms: Any) -> None:
    surface = phantoms.capsule(12.0, 5.0, around=96)
    corners = surface.vertices[surface.faces]
    hollow = filled(corners)
    volume = np.pi * 25.0 * 12.0 + 4.0 / 3.0 * np.pi * 125.0
    # Voxels of 0.5 mm; those cut by the wall are in or out by halves, and 96 facets take 0.1 %.
    assert (hollow.depth > 0.0).sum() * 0.5**3 == pytest.approx(volume, rel=0.02)
    found = pelvis_of([np.column_stack([np.zeros(13), np.zeros(13), np.arange(13.0)])], hollow)
    assert found.largest == pytest.approx(5.0, abs=0.5)  # a voxel
    assert found.divided is None
    np.testing.assert_allclose(found.center, [0.0, 0.0, 6.0], atol=0.2)
    # What such balls reach is the capsule itself: its end lies at z = 17, half a voxel's depth either way.
    ends = np.array([[0.0, 0.0, 15.5], [0.0, 0.0, 18.5]])
    np.testing.assert_allclose(found.outside(ends), [-1.5, 1.5], atol=0.5)
    line = np.column_stack([np.zeros(13), np.zeros(13), np.arange(13.0)])
    planes = Planes(corners)
    np.testing.assert_allclose(planes.diameters(line, np.array([3.0, 6.0])), 10.0, atol=0.02)  # 96 facets: 0.01 mm
    np.testing.assert_allclose(planes.chords(line, np.array([6.0])), 10.0, atol=0.02)


def test_ways_that_share_their_points_part_where_they_differ() -> None:
    stem = np.column_stack([np.zeros(31), np.zeros(31), np.arange(31.0)])
    onward = [
        30.0 * np.array([0.0, 0.0, 1.0]) + np.arange(1.0, 21.0)[:, None] * np.array([side, 0.0, 1.0]) for side in (-1.0, 1.0)
    ]
    left, right = (np.vstack([stem, arm]) for arm in onward)
    assert together(left, right) == 30.0
    assert together(left, left) == pytest.approx(30.0 + 20.0 * np.sqrt(2.0))
    # A bulge that leaves the ureter after 10 mm does not lead on.
    bulge = np.vstack([stem[:11], stem[10] + np.arange(1.0, 5.0)[:, None] * np.array([1.0, 0.0, 0.0])])
    assert first_parting([left, right, bulge]) == 30.0
    assert first_parting([left, bulge]) is None


@pytest.mark.skipif(not KIDNEYS.exists(), reason="the shared data folder is not beside the repository")
@pytest.mark.parametrize("side", ["L", "R"])
def test_a_pelvis_in_arms_is_found_again(side: str) -> None:
    tree = grow_tree(load_lumen(InputCase(mesh=KIDNEYS / f"fused_F_{side}_mm.stl")).surface)
    found = urinary_measures(urinary_lumen(tree, None), UrinarySettings())
    items = {(one.key, one.of): one.value for one in found.measures if one.value is not None}
    lines, points = dict(found.drawing.lines), dict(found.drawing.points)
    corners = tree.surface.vertices[tree.surface.faces]
    checks = list(check_urinary(items, lines, points, filled(corners), Planes(corners), 40.0, "mesh"))
    assert [check.text for check in checks if not check.ok] == []
    assert {"measures: pelvis_diameter_mm", "measures: length of infundibula"} <= {check.name for check in checks}
