"""Measures of three generated kidneys, through their CTs, against their construction.

Two are made of straight pieces, so that every answer is a closed form: a ball with three blunted calyces, and the right
kidney of another anatomy with a long pelvis, four infundibula and seven calyces. The third is the curved one of the
demonstration. Each is scanned otherwise, two with +-50 HU in every voxel; `tubeplan bench measures` has them all at every
slice thickness, with noise and without. Nothing is set for one of them.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from segmentation.synthetic import PLAIN, SECOND, StraightPlan, straight_system
from segmentation.volume import Volume
from tubeplan_viz.bench.measures import ANGLE_DEG, LENGTH_MM, NOISE_HU, WIDTH_MM, Measured, measured, noisy
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.measures import StoneFacts, UrinarySettings, path_parts, stone_facts
from tubeplan_viz.measures.balls import wide_part
from tubeplan_viz.measures.collecting_system import calyx_mouth
from tubeplan_viz.measures.edges import WALL_HU, edges
from tubeplan_viz.measures.urinary import angle_measures, narrowest, ureter_place

SCANS = [("plain", 0.8, True), ("second", 0.6, True), ("curved", 1.0, False)]


@pytest.fixture(scope="module", params=SCANS, ids=lambda scan: f"{scan[0]} {scan[1]} mm{' noise' if scan[2] else ''}")
def found(request: pytest.FixtureRequest) -> Measured:
    anatomy, slice_mm, noise = request.param
    return measured(anatomy, slice_mm, noise=noise)


def test_angles_lengths_and_widths_are_those_of_the_construction(found: Measured) -> None:
    off = found.errors()
    limits = {"angle": ANGLE_DEG, "coronal angle": ANGLE_DEG, "length": LENGTH_MM, "width": WIDTH_MM}
    assert (ANGLE_DEG, LENGTH_MM, WIDTH_MM) == (2.0, 0.5, 0.3)
    assert len(off) == 3 * len(found.truth) + sum(len(one.calyces) for one in found.truth)
    over = {key: round(value, 2) for key, value in off.items() if not abs(value) <= limits[key[0]]}
    assert over == {}


def test_infundibula_are_named_from_above(found: Measured) -> None:
    names = [one.name for one in found.measures.infundibula]
    middle = ["middle"] if len(found.truth) == 3 else ["middle 1", "middle 2"]
    assert names == ["upper", *middle, "lower"]
    assert [len(one.targets) for one in found.measures.infundibula] == [len(one.calyces) for one in found.truth]


def test_the_way_to_a_calyx_runs_from_the_ureter_through_the_pelvis_and_its_infundibulum(found: Measured) -> None:
    for one in found.measures.infundibula:
        for target in one.targets:
            way = found.lumen.tree.path(target)
            assert way is not None
            parts = path_parts(found.measures.parts, way.points, way.arc_length, way.points)
            names = [part["name"] for part in parts]
            calyx = f"{one.name} calyx {found.lumen.labels[target]}"
            assert names == ["ureter", "renal pelvis", f"{one.name} infundibulum", calyx]
            # A sample of the middle line, 1 mm apart, belongs to one of the two parts that meet between it and the next.
            assert parts[2]["from_mm"] == pytest.approx(one.lip, abs=1.0)
            assert parts[2]["to_mm"] == pytest.approx(calyx_mouth(one, way), abs=1.0)
            assert len(one.targets) == 1 or calyx_mouth(one, way) == one.end


def test_nothing_is_known_of_scores_without_stones(found: Measured) -> None:
    assert stone_facts([], found.lumen, found.measures, abnormal=False) == StoneFacts(abnormal=False)


@pytest.mark.parametrize("plan", [PLAIN, SECOND])
def test_the_straight_kidneys_are_what_their_plans_say(plan: StraightPlan) -> None:
    system = straight_system(plan, lower_border=-64.0)
    down = np.array(plan.down) / np.linalg.norm(plan.down)
    for piece, truth in zip(plan.infundibula, system.infundibula, strict=True):
        branch = next(one for one in system.lumen.branches if one.name == piece.name)
        axis = (branch.points[-1] - branch.points[0]) / np.linalg.norm(branch.points[-1] - branch.points[0])
        assert np.degrees(np.arccos(axis @ down)) == pytest.approx(truth.angle_deg, abs=1e-6)
        # The lip lies on the pelvis: its distance from the pelvis's axis, or from the nearer ball's centre, is the radius.
        low, high = np.array(plan.pelvis), np.array(plan.pelvis) - plan.pelvis_length * down
        along = np.clip(-(truth.lip - low) @ down, 0.0, plan.pelvis_length)
        assert np.linalg.norm(truth.lip - (low - along * down)) == pytest.approx(plan.pelvis_radii[0], abs=1e-6)
        assert plan.pelvis_length == 0.0 or np.linalg.norm(high - low) == pytest.approx(plan.pelvis_length)
        # Wall at half the width beside the axis, half way along; and at the bottom of every calyx.
        beside = np.cross(axis, down) / np.linalg.norm(np.cross(axis, down))
        middle = truth.lip + 0.5 * (branch.points[-1] - truth.lip)
        np.testing.assert_allclose(system.lumen.clearance([middle + 0.5 * truth.width * beside]), 0.0, atol=1e-6)
        bottoms = np.array([calyx.bottom for calyx in truth.calyces])
        np.testing.assert_allclose(system.lumen.clearance(bottoms), 0.0, atol=1e-6)
        for calyx in truth.calyces:
            assert calyx.length == pytest.approx(float(np.linalg.norm(calyx.bottom - truth.lip)))
    if plan is PLAIN:
        # A ball, and everything on one line: to the end ball's far side, less the pelvis's radius.
        lengths = [one.calyces[0].length for one in system.infundibula]
        assert lengths == pytest.approx([24.0 + 8.0 + 5.0 - 7.5, 18.0 + 6.0 + 4.0 - 7.5, 26.0 + 7.0 + 4.5 - 7.5])


def test_the_wide_part_of_a_tube_reaches_to_both_its_ends(phantoms: ModuleType) -> None:
    tube = wide_part(WallDistance(phantoms.capsule(20.0, 4.0)), np.array([0.0, 0.0, 10.0]), 4.0)
    assert tube.largest == pytest.approx(4.0, abs=0.01)  # 48 facets: 4 cos(pi / 48) = 3.991
    np.testing.assert_allclose(tube.center, [0.0, 0.0, 10.0], atol=0.05)
    ends = np.array([[0.0, 0.0, -4.0], [0.0, 0.0, 24.0], [0.0, 0.0, 30.0], [4.0, 0.0, 10.0]])
    # Balls stand on a grid of 0.5 mm; the deepest of them leaves less than 0.1 mm at an end.
    np.testing.assert_allclose(tube.level(ends), [0.0, 0.0, 6.0, 0.0], atol=0.1)


def test_an_edge_lies_half_way_between_the_filling_and_what_bounds_it() -> None:
    steps = np.arange(-1.0, 2.45, 0.1)
    core, kidney, fat = 350.0, 170.0, -105.0
    ramp = np.clip(0.5 - (steps - 0.23), 0.0, 1.0)  # falls evenly over 1 mm around 0.23
    found = edges(np.array([kidney + ramp * (core - kidney), WALL_HU + ramp * (core - WALL_HU)]), steps, core)
    np.testing.assert_allclose(found.place, 0.23, atol=1e-9)
    # Fat beyond a thin wall does not draw the edge outward: the wall's grey is the other side.
    found = edges(np.array([fat + ramp * (core - fat)]), steps, core)
    share = (0.5 * (core + WALL_HU) - fat) / (core - fat)
    np.testing.assert_allclose(found.place, 0.23 + 0.5 - share, atol=1e-9)
    assert np.isnan(edges(np.full((1, len(steps)), core), steps, core).place).all()


def test_the_narrowest_place_is_no_single_section() -> None:
    assert narrowest(np.array([5.0, 4.0, 4.0, 1.0, 4.0, 4.0, 5.0])) == 4.0
    assert narrowest(np.array([3.0, 2.0])) == 2.5


def test_noise_is_what_it_is_said_to_be() -> None:
    still = Volume(np.full((20, 20, 20), 100, dtype=np.int16), np.eye(4)[:, [2, 1, 0, 3]])
    change = noisy(still).voxels.astype(float) - 100.0
    assert np.abs(change).max() == NOISE_HU
    assert change.std() == pytest.approx(NOISE_HU / np.sqrt(3.0), rel=0.03)  # 8000 draws: 1 % of itself


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
