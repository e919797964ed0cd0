from __future__ import annotations

import re
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from segmentation.dicom import read_series
from segmentation.synthetic import Urography, round_cone_distance, urography, write_demo_series

README = Path(__file__).resolve().parents[3] / "datasets" / "README.md"


@pytest.fixture(scope="module")
def scan() -> Urography:
    return urography()


@pytest.fixture(scope="module")
def lumen(scan) -> np.ndarray:
    """Voxels of at least 240 HU joined to the start: half way between contrast and its surroundings."""
    label, _ = ndimage.label(scan.volume.voxels >= 240)
    seed = tuple(np.rint(scan.volume.to_index(scan.truth.start)).astype(int))
    assert label[seed] > 0
    return label == label[seed]


def bend(points: np.ndarray) -> np.ndarray:
    """Curvature at the inner points of a polyline, 1/mm (circle through three neighbours)."""
    a, b, c = points[:-2], points[1:-1], points[2:]
    sides = [np.linalg.norm(x, axis=1) for x in (b - a, c - b, c - a)]
    return 2.0 * np.linalg.norm(np.cross(b - a, c - b), axis=1) / np.prod(sides, axis=0)


def test_round_cone_distance_is_the_distance_to_its_balls():
    a, b, ra, rb = np.array([0.0, 0.0, 0.0]), np.array([6.0, 2.0, -1.0]), 2.0, 0.7
    points = np.random.default_rng(4).uniform(-4.0, 9.0, (500, 3))
    share = np.linspace(0.0, 1.0, 4001)[:, None, None]
    balls = np.linalg.norm(points - (a + share * (b - a)), axis=-1) - (ra + share[..., 0] * (rb - ra))
    exact = round_cone_distance(points, a, b, ra, rb)
    outside = exact > 0.0
    assert outside.sum() > 100
    assert (~outside).sum() > 5
    # Outside, the nearest of the balls; 4001 of them leave less than (6.4 / 4000)^2 / (8 * 0.7) mm.
    np.testing.assert_allclose(exact[outside], balls.min(axis=0)[outside], atol=1e-5)
    np.testing.assert_array_equal(exact < 0.0, balls.min(axis=0) < 0.0)


def test_the_voxels_are_those_of_the_recorded_checksum(scan):
    recorded = re.search(r"`urography` voxels \(sha256\): `([0-9a-f]{64})`", README.read_text())
    assert recorded is not None
    assert scan.checksum == recorded[1]


def test_another_scan_is_made_in_seconds_with_other_noise_and_the_same_tree(scan):
    tracemalloc.start()
    begun = time.process_time()
    other = urography(seed=5)
    took = time.process_time() - begun
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert took < 8.0  # s of processor time; 2.5 s were measured without the tracing of memory
    assert peak < 500e6
    assert other.checksum != scan.checksum
    np.testing.assert_array_equal(other.truth.start, scan.truth.start)
    assert np.corrcoef(other.volume.voxels[60].ravel(), scan.volume.voxels[60].ravel())[0, 1] > 0.97


def test_tissues_have_their_hounsfield_units(scan):
    def patch(x, y, z, half=3.0):
        low, up = (np.rint(scan.volume.to_index([x + s * half, y + s * half, z + s * half])).astype(int) for s in (-1, 1))
        return scan.volume.voxels[low[0] : up[0] + 1, low[1] : up[1] + 1, low[2] : up[2] + 1]

    assert patch(148.0, -60.0, 0.0).mean() == pytest.approx(-1000.0, abs=15.0)  # air beside the flank
    assert patch(27.0, 64.0, -20.0).mean() == pytest.approx(58.0, abs=8.0)  # muscle of the back
    assert patch(27.0, 64.0, -20.0).std() == pytest.approx(12.0, abs=3.0)  # noise of the scanner
    assert 140.0 < patch(80.0, 30.0, 12.0).mean() < 205.0  # kidney
    assert patch(9.0, -10.0, -20.0).mean() == pytest.approx(135.0, abs=8.0)  # aorta
    assert scan.volume.voxels.max() > 500  # cortical bone
    pelvis = patch(*scan.truth.branches[0].points[-1], half=2.0)
    assert 250.0 < pelvis.min() < pelvis.max() < 420.0


def test_noise_is_correlated_like_a_reconstruction(scan):
    muscle = scan.volume.voxels[20:80, 186:194, 82:98].astype(float)
    muscle -= muscle.mean(axis=(1, 2), keepdims=True)
    neighbour = (muscle[:, :, 1:] * muscle[:, :, :-1]).mean() / muscle.var()
    far = (muscle[:, :, 4:] * muscle[:, :, :-4]).mean() / muscle.var()
    assert 0.1 < neighbour < 0.8
    assert abs(far) < 0.15


def test_the_contrast_filled_lumen_grows_from_the_start_into_every_calyx(scan, lumen):
    for _, goal in scan.truth.goals:
        assert lumen[tuple(np.rint(scan.volume.to_index(goal)).astype(int))]
    # Nothing else is that bright and joined: a leak into the kidney alone would be 80 ml.
    assert 4.5 < lumen.sum() * scan.volume.voxel_ml < 8.0
    assert lumen[0].any()  # the ureter is cut by the lower border
    other_faces = [lumen[-1], lumen[:, 0], lumen[:, -1], lumen[:, :, 0], lumen[:, :, -1]]
    assert not any(face.any() for face in other_faces)


def test_the_isosurface_of_the_scan_lies_on_the_known_wall(scan, lumen):
    grey = np.where(ndimage.binary_dilation(lumen, iterations=2), scan.volume.voxels, 0).astype(float)
    vertices = marching_cubes(grey, 235.0)[0]
    points = scan.volume.to_lps(vertices)
    inner = points[:, 2] > scan.volume.to_lps([2, 0, 0])[2]
    deviation = scan.truth.clearance(points[inner])
    # One limit cannot be half way for fat (50 HU of the wall) and kidney (156 to 194 HU) both; voxels are 0.75 mm.
    assert abs(deviation.mean()) < 0.1
    assert np.percentile(np.abs(deviation), 95) < 0.75


def test_clearance_is_zero_on_the_balls_and_never_more_than_the_distance_to_the_wall(scan):
    truth = scan.truth
    ureter = truth.branches[0]
    tangent = np.gradient(ureter.points[:30], axis=0)
    side = np.cross(tangent, [0.3, -0.9, 0.2])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    # Radii change by at most 0.05 a mm along the ureter, so a ball touches the wall within 0.13 % of its radius.
    np.testing.assert_allclose(truth.clearance(ureter.points[:30] + ureter.radii[:30, None] * side), 0.0, atol=0.02)
    # Around the pelvis, where tubes overlap: wall samples of their own from the union of balls.
    grid = np.stack(
        np.meshgrid(*(np.arange(lo, up, 0.7) for lo, up in [(30, 66), (8, 36), (-22, 14)]), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    wall = grid[np.abs(truth.clearance(grid)) < 0.3]
    axis = np.unique(np.concatenate([route for _, route in truth.routes]), axis=0)
    axis = axis[(axis[:, 2] > -15.0) & (axis[:, 2] < 7.0) & (axis[:, 0] < 59.0)]
    # A wall sample lies up to 0.3 mm inside the wall.
    assert np.all(truth.clearance(axis) <= cKDTree(wall).query(axis)[0] + 0.3)


def test_the_tree_is_of_human_size(scan):
    truth = scan.truth
    radii = truth.branches[0].radii
    points = truth.branches[0].points
    assert radii.min() == pytest.approx(1.9, abs=0.05)  # the ureteropelvic junction
    assert 6.0 < radii.max() < 8.0
    assert np.all((radii[points[:, 2] < -30.0] > 1.5) & (radii[points[:, 2] < -30.0] < 2.5))
    assert len(truth.goals) == 8
    # Infundibulopelvic angle: between the axis from the pelvis down the ureter and that into the lower infundibulum.
    pelvis = points[-1]
    ureter = points[np.argmin(np.abs(points[:, 2] + 35.0))] - pelvis
    lower = next(branch for branch in truth.branches if branch.name == "lower")
    into = lower.points[-1] - lower.points[np.argmax(lower.radii < 3.5)]
    angle = np.degrees(np.arccos(ureter @ into / np.linalg.norm(ureter) / np.linalg.norm(into)))
    assert 55.0 < angle < 75.0


@pytest.mark.parametrize("goal", ["upper 1", "upper 2", "middle 1"])
def test_axes_to_the_upper_and_middle_calyces_suit_a_ureteroscope(scan, goal):
    route = dict(scan.truth.routes)[goal]
    assert scan.truth.clearance(route).min() > 1.2  # mm, its radius
    assert bend(route[::2]).max() < 0.125  # 1/mm, bend radius 8 mm
    np.testing.assert_array_equal(route[0], scan.truth.start)
    np.testing.assert_array_equal(route[-1], scan.truth.goal(goal))
    assert np.linalg.norm(np.diff(route, axis=0), axis=1).max() < 1.5  # no jump where branches meet


def test_the_demo_series_is_the_scan(scan, tmp_path):
    truth = write_demo_series(tmp_path / "demo")
    back = read_series(tmp_path / "demo")
    # The reader may count slices from either end; the voxel at a place in the patient is the same.
    upward = back.volume.index_to_lps[2, 0] > 0.0
    np.testing.assert_array_equal(back.volume.voxels[:: 1 if upward else -1], scan.volume.voxels)
    first = back.volume.to_lps([0 if upward else len(back.volume.voxels) - 1, 0, 0])
    np.testing.assert_allclose(first, scan.volume.to_lps([0, 0, 0]), atol=1e-6)
    np.testing.assert_array_equal(truth.start, scan.truth.start)
    size = sum(path.stat().st_size for path in (tmp_path / "demo").iterdir())
    assert size < 20e6
