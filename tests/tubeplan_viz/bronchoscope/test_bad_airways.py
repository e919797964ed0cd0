"""Bad input of the bronchoscope robot, through the command line: one sentence each, the right exit status, and no folder left."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import SimpleITK as sitk

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from segmentation.mesh_files import write_ply
from tubeplan_viz.cases.bronchoscope import make_bronchoscope_case
from tubeplan_viz.cli.app import status_of

GOAL = "E2"


@pytest.fixture(scope="module")
def tube(phantoms: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> tuple[Surface, Path]:
    """A straight trachea of 18 mm along +y, small enough that each command takes a second."""
    surface = phantoms.straight_tube(length=80.0, radius=9.0).surface
    file = tmp_path_factory.mktemp("tube") / "tube.ply"
    write_ply(surface, file)
    return surface, file


def refused(capsys: pytest.CaptureFixture[str], tmp_path: Path, *options: str) -> tuple[int, str]:
    """Exit status and what was said of a plan that must not leave a folder."""
    folder = tmp_path / "run"
    status = status_of(["plan", "bronchoscope", "-q", "-o", str(folder), "--method", "kinematic", *options])
    said = capsys.readouterr().err.strip()
    assert not folder.exists()
    assert len(said.splitlines()) == 1, said
    return status, said


def spelled(point: FloatArray) -> str:
    return ",".join(f"{value:.2f}" for value in point)


def test_a_target_outside_the_airway_gets_the_nearest_reachable_place(
    tube: tuple[Surface, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outside = np.array([30.0, 50.0, 0.0])
    status, said = refused(capsys, tmp_path, "--mesh", str(tube[1]), "--goal", spelled(outside))
    assert status == 2
    # The trachea is 18 mm wide, so a place 30 mm beside its middle lies 21 mm outside; its middle is 30 mm away.
    # The mesh lies inside its circle by up to 0.1 mm.
    assert "lies 21." in said
    assert "30.0 mm away" in said or "29.9 mm away" in said
    assert "in trachea" in said


def test_an_entrance_narrower_than_the_robot_is_named_with_both_widths(
    tube: tuple[Surface, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, said = refused(capsys, tmp_path, "--mesh", str(tube[1]), "--goal", GOAL, "--diameter", "19")
    assert status == 2
    assert "the robot of 19 mm does not fit straight into the airway at E1, which is at most 1" in said


def test_a_target_in_another_part_of_a_broken_mesh_is_told_with_the_part_left_out(
    tube: tuple[Surface, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # A smaller copy beside the airway is the other part.
    whole = tube[0]
    vertices = np.vstack([whole.vertices, 0.5 * whole.vertices + [200.0, 0.0, 0.0]])
    faces = np.vstack([whole.faces, whole.faces + len(whole.vertices)])
    goal = "200,20,0"
    # Of a foreign file the larger part is kept and the other one left out.
    foreign = tmp_path / "broken.obj"
    foreign.write_text(
        "".join("v {} {} {}\n".format(*place) for place in vertices)
        + "".join("f {} {} {}\n".format(*corners) for corners in faces + 1)
    )
    status, said = refused(capsys, tmp_path, "--mesh", str(foreign), "--goal", goal)
    assert status == 2
    assert "outside the airway; the nearest reachable place is" in said
    assert "1 further component(s)" in said
    # A mesh that tubeplan wrote is taken as it is: both parts are lumen, and nothing joins them.
    own = tmp_path / "broken.ply"
    write_ply(Surface(vertices, faces, np.full(len(faces), -1), (), "mesh"), own)
    status, said = refused(capsys, tmp_path, "--mesh", str(own), "--goal", goal)
    assert status == 2
    assert "nothing joins with the airway at E1: the nearest reachable place is" in said


def test_a_gap_in_the_airway_of_a_ct_ends_it_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # A straight trachea of 14 mm, along z; 6 mm of it are filled with mucus.
    z, y, x = np.meshgrid(np.arange(110), np.arange(48), np.arange(48), indexing="ij")
    air = (np.hypot(x - 24.0, y - 24.0) < 7.0) & (z > 4) & (z < 105) & ~((z > 40) & (z < 47))
    image = sitk.GetImageFromArray(np.where(air, -1000, 20).astype(np.int16))
    image.SetSpacing((1.0, 1.0, 1.0))
    file = tmp_path / "ct.nii.gz"
    sitk.WriteImage(image, str(file))
    status, said = refused(
        capsys, tmp_path, "--ct", str(file), "--seed-point", "24,24,80", "--hu-max", "-500", "--goal", "24,24,20"
    )
    assert status == 2
    assert "outside the airway; the nearest reachable place is" in said
    # The gap begins at 47: nothing beyond it is offered.
    assert float(said.split("reachable place is ")[1].split(" in ")[0].split(",")[2]) > 47.0


def test_without_mujoco_kinematics_plan_and_dynamics_say_what_to_install(
    tube: tuple[Surface, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "mujoco"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mujoco", None)  # so that neither find_spec nor import finds it
    table = {"input": {"mesh": str(tube[1])}, "planner": {"goal": GOAL}}
    assert make_bronchoscope_case(table).method == "kinematic"
    status, said = refused(capsys, tmp_path, "--mesh", str(tube[1]), "--goal", GOAL, "--method", "dynamic")
    assert status == 2
    assert 'pip install "tubeplan[dynamics]"' in said
    free = ["plan", "bronchoscope", "-q", "-o", str(tmp_path / "free"), "--no-report", "--no-recording"]
    assert status_of([*free, "--mesh", str(tube[1]), "--goal", GOAL]) == 0
