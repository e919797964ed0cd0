"""A needle between the ribs of a real CT: bone as the obstacle, an honest plan that the verifier agrees with."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from segmentation.archive import unpack as unpack_archive
from segmentation.images import read_ct
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.verify import verify_run

ARCHIVE = Path(__file__).resolve().parents[4] / "shared" / "data" / "cmb_crc_chest_ct" / "dicom_original.tar.xz"
CASE = """
[input]
case_id = "chest-needle"
[planner]
name = "needle3d"
[needle3d]
frame = "LPS"
entry = [-188.0, 10.9, -139.0]
direction = [1.0, 0.0, 0.0]
target = [{target}, 10.9, -139.0]
kappa = 0.01
safety_mm = 1.5
entry_radius_mm = 12.0
cone_deg = 20.0
restarts = 2
rounds = 300
[[obstacles]]
kind = "mask"
file = "ct"
hu_min = 180
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not ARCHIVE.exists():
        pytest.skip("the shared CT data does not stand beside the repository")
    place = tmp_path_factory.mktemp("chest")
    unpack_archive(ARCHIVE, place / "all")
    next((place / "all").iterdir()).rename(place / "ct")
    return place


def test_a_path_between_the_ribs_keeps_its_distance_from_every_voxel_of_bone(folder: Path) -> None:
    (folder / "case.toml").write_text(CASE.format(target=-107.5), encoding="utf-8")
    # The page is looked at with the run through the skin.
    bare = ["--quiet", "--no-recording", "--no-report"]
    assert status_of(["run", str(folder / "case.toml"), "-o", str(folder / "run"), *bare]) == 0
    result = json.loads((folder / "run" / "result.json").read_text(encoding="utf-8"))
    volume = read_ct(folder / "ct").volume
    bone = volume.to_lps(np.argwhere(np.asarray(volume.voxels) >= 180))
    points = np.array(result["path"]["points_mm"])
    # Centres of voxels are half a diagonal from the farthest corner of their boxes.
    assert cKDTree(bone).query(points)[0].min() >= 1.5
    assert np.linalg.norm(points[-1] - [-107.5, 10.9, -139.0]) < 1e-3
    assert [check.name for check in verify_run(folder / "run").faults] == []


def command(folder: Path, name: str, *more: str) -> int:
    """The same lesion by the command line, its entry free on the skin."""
    places = ["--target=-107.5,10.9,-139", "--entry=-188,10.9,-139", "--direction", "1,0,0", "--skin", "--entry-radius", "12"]
    needle = ["--cone", "20", "--kappa", "0.01", "--restarts", "1", "--rounds", "150", "--quiet", "--no-recording"]
    image = ["--ct", str(folder / "ct"), "--hu-min", "180"]
    return status_of(["plan", "needle3d", *image, *places, *needle, *more, "-o", str(folder / name)])


def test_through_the_skin_of_the_chest_the_verifier_agrees(folder: Path) -> None:
    assert command(folder, "skin", "--safety", "1.5") == 0
    checks = {check.name: check for check in verify_run(folder / "skin").checks}
    assert checks["entry: on the skin"].ok
    assert [name for name, check in checks.items() if not check.ok] == []
    assert (folder / "skin" / "report.html").read_text(encoding="utf-8").count('<svg class="cut"') == 4


def test_a_needle_that_is_to_stay_farther_from_bone_than_the_ribs_are_apart_is_refused(folder: Path) -> None:
    """The gap between the ribs is about 10 mm wide: 6 mm to either side do not fit."""
    assert command(folder, "wide", "--safety", "6", "--no-report") == 4
    result = json.loads((folder / "wide" / "result.json").read_text(encoding="utf-8"))
    assert result["path"] is None
    assert "no path was found" in result["reason"]
    assert verify_run(folder / "wide").holds


def test_a_target_in_bone_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    volume = read_ct(folder / "ct").volume
    index = np.round(volume.to_index([-188.0, 10.9, -139.0])).astype(int)
    along = np.asarray(volume.voxels)[index[0], index[1], index[2] :]
    bone = volume.to_lps([*index[:2], index[2] + int(np.argmax(along >= 180))])
    (folder / "bone.toml").write_text(CASE.format(target=bone[0]), encoding="utf-8")
    assert status_of(["run", str(folder / "bone.toml"), "-o", str(folder / "bone"), "--quiet"]) == 2
    assert "from obstacle 1 (mask), expected at least safety_mm" in capsys.readouterr().err
    assert not (folder / "bone").exists()
