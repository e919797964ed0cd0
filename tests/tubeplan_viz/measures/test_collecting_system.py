"""Measures of the generated urography, through its CT, against its exact tree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import ndimage

from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.synthetic import CollectingSystem, UrographySettings, collecting_system, urography
from segmentation.volume import Volume
from tubeplan_viz.cases.measures import MeasureCase
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.measures import Lumen, StoneFacts, UrinaryMeasures, UrinarySettings, stone_facts
from tubeplan_viz.measures.urinary import angle_measures, ureter_place
from tubeplan_viz.pipeline import grow_tree
from tubeplan_viz.pipeline.measures import measured_urinary

# The surface lies up to 0.2 mm outside the cups, and the probe goes the farther into their narrow rims: 0.3 mm on average.
ANGLE_DEG, LENGTH_MM, WIDTH_MM = 2.0, 0.7, 0.3
LEVEL_MM, PROBE_MM, GRID_MM = 40.0, 1.0, 0.4
CORONAL = np.array([1.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Truth:
    """The measures of the exact lumen, by their definitions."""

    angle: Mapping[str, float]
    coronal: Mapping[str, float]
    width: Mapping[str, float]
    length: Mapping[str, float]
    tips: Mapping[str, np.ndarray]
    ureter_least: float


def depth(system: CollectingSystem, low: np.ndarray, high: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Places of a box and how deep they lie in the lumen, mm."""
    grid = np.stack(np.meshgrid(*(np.arange(a, b, step) for a, b in zip(low, high, strict=True)), indexing="ij"), axis=-1)
    inside = system.clearance(grid.reshape(-1, 3)).reshape(grid.shape[:-1]) > 0.0
    # To the middle of the nearest outer voxel: half a step less is the wall.
    return grid, ndimage.distance_transform_edt(inside) * step - 0.5 * step


def reach(system: CollectingSystem, tip: np.ndarray, cup: float, lip: np.ndarray) -> float:
    """Farthest from the lip that a ball of `PROBE_MM` reaches in a cup with a papilla, mm: it touches the cup from inside."""
    heading = np.random.default_rng(0).normal(size=(40000, 3))  # neighbours are 1 degree apart: 0.05 mm
    centers = tip + (cup - PROBE_MM) * heading / np.linalg.norm(heading, axis=1, keepdims=True)
    papilla = system.papillae[np.argmin(np.linalg.norm(system.papillae[:, :3] - tip, axis=1))]
    fits = np.linalg.norm(centers - papilla[:3], axis=1) >= papilla[3] + PROBE_MM
    return float(np.linalg.norm(centers[fits] - lip, axis=1).max()) + PROBE_MM


def between(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))))


@pytest.fixture(scope="module")
def truth() -> Truth:
    system = collecting_system(-78.5)  # the lower face of the generated scan
    branches = {branch.name: branch for branch in system.branches}
    trunk = branches["ureter and pelvis"]
    radius = float(trunk.radii.max())  # the largest ball is the trunk's last
    grid, deep = depth(system, np.array([38.0, 14.0, -12.0]), np.array([54.0, 28.0, 6.0]), GRID_MM)
    pelvis = grid[deep >= 0.85 * radius].mean(axis=0)
    away = np.linalg.norm(trunk.points - pelvis, axis=1)
    down = trunk.points[np.flatnonzero(away >= LEVEL_MM)[-1]] - pelvis  # points are 1 mm apart: 0.1 degrees
    angle, coronal, width, length, tips = {}, {}, {}, {}, {}
    for name in ("upper", "middle", "lower"):
        branch = branches[name]
        gone = np.linalg.norm(branch.points - pelvis, axis=1)
        k = int(np.flatnonzero(gone <= radius)[-1])
        share = (radius - gone[k]) / (gone[k + 1] - gone[k])
        lip = branch.points[k] + share * (branch.points[k + 1] - branch.points[k])
        line = np.vstack([lip, branch.points[k + 1 :]])
        axis = np.linalg.svd(line - line.mean(axis=0))[2][0]
        axis = axis if axis @ (line[-1] - line[0]) > 0 else -axis
        angle[name], coronal[name] = between(down, axis), between(down * CORONAL, axis * CORONAL)
        width[name] = 2.0 * float(branch.radii[k:].min())
        for calyx in system.branches:
            if calyx.name.startswith(f"{name} "):
                tips[calyx.name] = calyx.points[-1]
                length[calyx.name] = reach(system, calyx.points[-1], float(calyx.radii[-1]), lip)
    return Truth(angle=angle, coronal=coronal, width=width, length=length, tips=tips, ureter_least=2.0 * float(trunk.radii.min()))


@dataclass(frozen=True, eq=False)
class Found:
    """What the product measured."""

    lumen: Lumen
    measures: UrinaryMeasures

    def value(self, key: str, of: str = "") -> float:
        found = [m.value for m in self.measures.measures if m.key == key and m.of == of]
        assert len(found) == 1
        assert found[0] is not None
        return found[0]


@pytest.fixture(scope="module", params=["1 mm", "0.6 mm with noise"])
def found(request: pytest.FixtureRequest) -> Found:
    if request.param == "1 mm":
        volume = urography().volume
    else:
        thin = urography(settings=UrographySettings(shape=(226, 224, 256), spacing=(0.6, 0.75, 0.75))).volume
        noise = np.random.default_rng(1).uniform(-50.0, 50.0, thin.voxels.shape)
        volume = Volume(np.clip(np.rint(thin.voxels + noise), -1024, 3071).astype(np.int16), thin.index_to_lps)
    region = segment_lumen(volume, SegmentationSettings(anatomy="urinary"))
    tree = grow_tree(lumen_surface(volume, region, SurfaceSettings()).surface)
    lumen, measures = measured_urinary(tree, MeasureCase(), volume, None)
    assert lumen is not None
    assert measures is not None
    return Found(lumen, measures)


@pytest.mark.parametrize("name", ["upper", "middle", "lower"])
def test_angles_and_widths_are_those_of_the_exact_tree(found: Found, truth: Truth, name: str) -> None:
    of = f"{name} infundibulum"
    assert found.value("infundibulopelvic_angle_deg", of) == pytest.approx(truth.angle[name], abs=ANGLE_DEG)
    assert found.value("infundibulopelvic_angle_coronal_deg", of) == pytest.approx(truth.coronal[name], abs=ANGLE_DEG)
    assert found.value("infundibular_width_mm", of) == pytest.approx(truth.width[name], abs=WIDTH_MM)


def test_lengths_to_all_calyces_are_those_of_the_exact_tree(found: Found, truth: Truth) -> None:
    bottoms = {k.removeprefix("bottom of "): p for k, p in found.measures.drawing.points.items() if k.startswith("bottom of ")}
    off = {}
    for name, tip in truth.tips.items():
        label = min(bottoms, key=lambda label: float(np.linalg.norm(bottoms[label] - tip)))
        off[name] = found.value("infundibular_length_mm", f"calyx {label}, {name.split()[0]}") - truth.length[name]
    assert len(off) == 8
    assert max(map(abs, off.values())) <= LENGTH_MM, off
    assert np.mean(list(map(abs, off.values()))) <= 0.5, off


def test_the_least_diameter_of_the_ureter_is_that_of_the_exact_tree(found: Found, truth: Truth) -> None:
    assert found.value("ureter_diameter_min_mm") == pytest.approx(truth.ureter_least, abs=WIDTH_MM)


def test_a_level_beyond_the_ureters_end_is_not_computable_and_says_so() -> None:
    trunk = Centerline(np.column_stack([np.zeros(31), np.zeros(31), np.arange(-30.0, 1.0)]), np.full(31, 2.0))
    place = ureter_place(trunk, np.zeros(3), 12.5)
    assert place is not None
    np.testing.assert_allclose(place, [0.0, 0.0, -12.5], atol=1e-12)
    level = ureter_place(trunk, np.zeros(3), 40.0)
    assert level is None
    lacking = angle_measures("LPS", np.zeros(3), level, np.array([0.0, 0.0, 1.0]), UrinarySettings(), "lower infundibulum")
    assert [m.value for m in lacking] == [None, None]
    assert all("less than 40 mm" in m.reason for m in lacking)


def test_nothing_is_known_of_scores_without_stones(found: Found) -> None:
    assert stone_facts([], found.lumen, found.measures, abnormal=False) == StoneFacts(abnormal=False)
