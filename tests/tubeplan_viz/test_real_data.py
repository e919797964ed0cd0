"""Real images and meshes through the command line: grown, planned, flagged honestly, refused where there is no tube."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import igl
import numpy as np
import pytest
from scipy.interpolate import BSpline

from reports.slices import Window, straightened
from reports.wall import sideways_frames
from segmentation.archive import unpack as unpack_archive
from segmentation.images import read_ct
from segmentation.mesh_files import read_surface
from tubeplan_viz.bench.renal import hubmap_tips, orifice_and_calyces
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.verify import verify_run

SHARED = Path(__file__).parents[2].parent / "shared"
DATA = SHARED / "data"

pytestmark = pytest.mark.skipif(not SHARED.is_dir(), reason="the shared data do not stand beside the source tree")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of DICOM slices in a data set's archive, unpacked once."""
    folder = tmp_path_factory.mktemp("dicom")

    def unpack(name: str) -> Path:
        target = folder / name
        if not target.exists():
            (archive,) = (DATA / name).glob("*.tar.xz")
            unpack_archive(archive, target)
        return next(file for file in sorted(target.rglob("*")) if file.is_file()).parent

    return unpack


def plan_airway(image: Path, target: Path, goal: str, *more: str) -> dict[str, Any]:
    """Plan from the root to a tip with an instrument of 2 mm radius; the result, verified."""
    status = status_of(
        ["plan", "tube", "--ct", str(image), "--anatomy", "airway", "--start", "E1", "--goal", goal, "--clearance-min", "2",
         "-o", str(target), "--quiet", *more]
    )  # fmt: skip
    assert status in (0, 3, 4)
    result: dict[str, Any] = json.loads((target / "result.json").read_text())
    assert result["status"] == {0: "ok", 3: "flagged", 4: "infeasible"}[status]
    assert bool(result["flagged_intervals"]) == (status != 0)
    verification = verify_run(target)
    assert verification.holds, [check.text for check in verification.faults]
    return result


# Volumes in ml: asked for in the issue for the first; the others are the stable ranges stated with the data
# (growing there was done by hand, with a fixed limit), a little widened.
@pytest.mark.parametrize(
    ("name", "goal", "low", "high"),
    [
        ("cmb_crc_chest_ct", "E2", 30.0, 45.0),
        ("lungfcp_trachea_ct", "E2", 17.0, 23.0),
        ("cip_ct64_dicom", "E2", 12.0, 30.0),
        ("elastix_right_lung", "E2", 22.0, 29.0),
    ],
)
def test_an_airway_is_grown_without_a_leak_and_planned_with_honest_flags(
    name: str, goal: str, low: float, high: float, unpacked: Callable[[str], Path], tmp_path: Path
) -> None:
    image = DATA / name / "3DCT_lung.mha" if name == "elastix_right_lung" else unpacked(name)
    # Recording and report take as long as the rest: they are made of the largest scan alone.
    shown = name == "cmb_crc_chest_ct"
    result = plan_airway(image, tmp_path / "run", goal, *([] if shown else ["--no-recording", "--no-report"]))
    assert (tmp_path / "run" / "report.html").exists() == shown
    if shown:
        assert (tmp_path / "run" / "report.html").stat().st_size < 8e6
    details = result["details"]
    assert result["frame"] == "LPS"
    assert low <= details["surface"]["volume_ml"] <= high
    # No threshold was given: the limit was chosen before the leak, and the leak is named.
    assert details["growth"]["chosen_hu"] == details["hu_max"]
    assert len(details["growth"]["limits_hu"]) == len(details["growth"]["volumes_ml"])
    assert result["metrics"]["centerline_distance_mean_mm"] < 1.0
    assert lumen_is_dark(image, result)
    # All of these run along the trachea, head to feet.
    assert abs(result["path"]["points_mm"][0][2] - result["path"]["points_mm"][-1][2]) > 50.0


def lumen_is_dark(image: Path, result: dict[str, Any]) -> bool:
    """Whether the reformation along the centerline is as dark as the grown lumen in its middle, all along."""
    volume = read_ct(image).volume
    line = np.asarray(result["centerline"]["points_mm"])
    _, normal, _ = sideways_frames(line)
    chosen = float(result["details"]["growth"]["chosen_hu"])
    window = Window("test", "test", chosen, 400.0)
    picture = straightened(volume, line, normal, 0.25, window, rows=3)
    # The ends lie on caps and tips, where half of what is seen is wall.
    inner = picture[:, np.searchsorted(polyline_s(line), 3.0) : np.searchsorted(polyline_s(line), polyline_s(line)[-1] - 3.0)]
    return bool((inner <= 128 + 0.15 * 255).all())  # at most 60 HU lighter than the limit: noise where the image was smoothed


def polyline_s(points: np.ndarray) -> np.ndarray:
    """Arc length at the points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def exact_distance(points: np.ndarray, surface: Any) -> np.ndarray:
    """Distance to the wall's triangles, caps left out, by a query of its own."""
    faces = np.ascontiguousarray(surface.faces[surface.face_cap < 0])
    squared = igl.point_mesh_squared_distance(np.ascontiguousarray(points), np.array(surface.vertices), faces)[0]
    return np.sqrt(squared)


def narrow_stretches(result: dict[str, Any], surface: Any, limit: float) -> list[tuple[float, float]]:
    """Where the path of a result is nearer to the wall than the limit, from its spline at 0.01 mm."""
    spline = BSpline(np.array(result["spline"]["knots"]), np.array(result["spline"]["control_points_mm"]), 3)
    u = np.linspace(0.0, 1.0, int(result["metrics"]["length_mm"] / 0.01))
    points = spline(u)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    bad = np.concatenate([[False], exact_distance(points, surface) < limit, [False]])
    edges = np.flatnonzero(bad[1:] != bad[:-1])
    return [(float(s[a]), float(s[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@pytest.mark.parametrize("side", ["L", "R"])
def test_a_ureter_is_flagged_exactly_where_it_is_narrower_than_the_endoscope(side: str, tmp_path: Path) -> None:
    mesh = DATA / "hubmap_ureter_female" / f"fused_F_{side}_mm.stl"
    orifice, calyces = orifice_and_calyces(hubmap_tips(mesh)[3])
    # The orifice is the lowest end of the model (y is up): within a few mm of the tip stated with the data.
    assert np.linalg.norm(orifice.point - {"L": [10.4, 9.1, -53.2], "R": [-36.2, 11.2, -58.4]}[side]) < 6.0
    # All three calyces of one side; of the other the highest alone, since each way is 300 mm long.
    for number, calyx in enumerate(calyces if side == "L" else calyces[-1:]):
        target = tmp_path / f"run{number}"
        status = status_of(
            ["plan", "tube", "--mesh", str(mesh), "--curvature-max", "0.125", "--clearance-min", "1.2",
             "--start", ",".join(map(str, orifice.point)), "--goal", ",".join(map(str, calyx.point)),
             "--method", "feature_iteration", "--max-rounds", "20", "-o", str(target), "--no-recording", "--no-report", "--quiet"]
        )  # fmt: skip
        assert status == 3
        result = json.loads((target / "result.json").read_text())
        verification = verify_run(target)
        assert verification.holds, [check.text for check in verification.faults]
        expected = narrow_stretches(result, read_surface(target / "mesh.ply").surface, 1.2)
        found = [(f["from_mm"], f["to_mm"]) for f in result["flagged_intervals"] if f["kind"] == "clearance"]
        assert same_cover(found, expected, result["metrics"]["length_mm"]) < 0.5
        assert len(found) > 0


def same_cover(found: list[tuple[float, float]], expected: list[tuple[float, float]], length: float) -> float:
    """The longest stretch in mm that is in one cover and not in the other."""
    s = np.arange(0.0, length, 0.005)

    def covered(stretches: list[tuple[float, float]]) -> np.ndarray:
        inside = np.zeros(len(s), dtype=bool)
        for start, end in stretches:
            inside |= (s >= start) & (s <= end)
        return inside

    different = np.concatenate([[False], covered(found) != covered(expected), [False]])
    edges = np.flatnonzero(different[1:] != different[:-1])
    return float(0.005 * (edges[1::2] - edges[::2]).max(initial=0))


@pytest.mark.parametrize("anatomy", ["airway", "urinary"])
def test_an_abdomen_without_a_tube_is_refused(anatomy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = DATA / "totalseg_abdomen_ct" / "example_ct.nii.gz"
    status = status_of(
        ["plan", "tube", "--ct", str(image), "--anatomy", anatomy, "--start", "E1", "--goal", "E2",
         "-o", str(tmp_path / "run"), "--quiet"]
    )  # fmt: skip
    error = capsys.readouterr().err
    assert status == 2
    assert len(error.splitlines()) == 1
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_jpeg_2000_slices_with_an_empty_series_uid_are_read() -> None:
    pytest.importorskip("openjpeg", reason="the extra for compressed series is not installed")
    image = read_ct(DATA / "totalseg_dicom_j2k" / "dicom")
    assert image.volume.voxels.shape == (20, 512, 512)
    # Spacing 2.0 between positions, although the slices say that they are 3 mm thick.
    np.testing.assert_allclose(image.volume.spacing, [2.0, 0.9765625, 0.9765625], atol=1e-4)
    assert image.volume.voxels.min() == -1024
    assert image.volume.voxels.max() == 1839


def test_objectives_are_better_in_what_they_name_and_keep_both_limits(unpacked: Callable[[str], Path], tmp_path: Path) -> None:
    image = unpacked("cip_ct64_dicom")
    best, short, straight = (
        # In the right bronchus where it is 2.16 mm wide to every side; its tip E2, 5 mm on, is too narrow for this instrument.
        plan_airway(image, tmp_path / name, "-22.7,-135.7,-169.9", "--objective", name, "--no-recording", "--no-report")
        for name in ("clearance", "length", "curvature")
    )
    assert all(result["certificate"]["holds"] for result in (best, short, straight))
    assert short["metrics"]["length_mm"] < min(best["metrics"]["length_mm"], straight["metrics"]["length_mm"])
    sharpest = {name: result["metrics"]["curvature_max_per_mm"] for name, result in (("best", best), ("straight", straight))}
    # The widest path takes the bend it is allowed; the straightest has no bend of 8 mm to make in a trachea and a bronchus.
    assert sharpest["straight"] < 0.5 * sharpest["best"]
    # The clearance beyond the limit of 2 mm, here 0.2 mm, is what both are paid with.
    for result in (short, straight):
        assert 2.0 <= result["certificate"]["clearance_lower_bound_mm"] < best["certificate"]["clearance_lower_bound_mm"]
