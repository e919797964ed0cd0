"""Tips of the lumen: the right number at the right places, always with the same labels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from segmentation.mesh import Cap, Surface
from segmentation.synthetic import weibel_airway
from tubeplan_viz.centerline import Endpoint, find_endpoints, voronoi_graph
from tubeplan_viz.centerline.endpoints import lengths_beyond, own_lengths, path_lengths
from tubeplan_viz.geometry import WallDistance

Prepare = Callable[[str], Any]


def tips_of(surface: Surface) -> tuple[Endpoint, ...]:
    wall = WallDistance(surface)
    return find_endpoints(voronoi_graph(surface, wall), wall)


def without_caps(surface: Surface) -> Surface:
    return Surface(surface.vertices, surface.faces, np.full(len(surface.faces), -1), (), surface.frame)


def test_a_junction_has_three_tips_in_the_middle_of_its_caps(prepared: Prepare) -> None:
    case = prepared("junction")
    tips = find_endpoints(case.graph, case.wall)
    assert [tip.label for tip in tips] == ["E1", "E2", "E3"]
    assert sorted(tip.cap or "" for tip in tips) == ["C1", "C2", "C3"]
    # The root is the widest end: the parent's.
    np.testing.assert_allclose(tips[0].point, case.model.start, atol=0.01)
    children = {tip.cap: tip for tip in tips[1:]}
    np.testing.assert_allclose(children["C2"].point, case.model.goal, atol=0.01)
    np.testing.assert_allclose(children["C3"].point, case.model.branches[0][-1], atol=0.01)
    assert all(tip.confidence == 1.0 for tip in tips)
    assert all(case.wall.inside(tip.point)[0] for tip in tips)
    # From the parent's end to the farther child's: 25 + 20 mm.
    assert tips[0].branch_length == pytest.approx(45.0, abs=1.5)


@pytest.mark.parametrize("name", ["swept", "structured", "marching cubes", "helix"])
def test_a_tube_has_two_tips_on_its_caps(name: str, prepared: Prepare) -> None:
    case = prepared(name)
    tips = find_endpoints(case.graph, case.wall)
    assert [tip.label for tip in tips] == ["E1", "E2"]
    ends = sorted((tip.point for tip in tips), key=lambda p: float(np.linalg.norm(p - case.model.start)))
    np.testing.assert_allclose(ends, [case.model.start, case.model.goal], atol=0.01)


def test_the_longest_way_owns_what_lies_beyond_its_last_fork() -> None:
    # Root 0, fork 1 after 100 mm; tip 3 another 5 + 35 mm on, tip 5 another 6 + 2 mm, tip 6 hangs on the root by itself.
    previous = np.array([-9999, 0, 1, 2, 1, 4, 0])
    length = np.array([0.0, 100.0, 105.0, 140.0, 106.0, 108.0, 7.0])
    tips = [(3, 140.0, 8.0), (5, 8.0, 4.0), (6, 7.0, 6.0)]
    assert own_lengths(previous, length, tips) == [40.0, 8.0, 7.0]
    # A single tip has the whole way for itself.
    assert own_lengths(previous, length, tips[:1]) == [140.0]
    assert own_lengths(previous, length, []) == []


def test_every_bronchus_has_its_tip_in_its_round_end() -> None:
    airway = weibel_airway(generations=3, voxel=1.0)
    parents = {branch.parent for branch in airway.branches}
    leaves = [branch for number, branch in enumerate(airway.branches) if number not in parents]
    tips = tips_of(airway.surface)[1:]
    assert len(tips) == len(leaves) == 8
    for leaf in leaves:
        # The axis ends in the middle of a ball; past it the wall ahead comes nearer, and half the radius is left at half
        # the radius. Voxels are 1 mm wide.
        assert min(np.linalg.norm(tip.point - leaf.points[-1]) for tip in tips) < 0.5 * leaf.radius + 1.0


def test_labels_are_the_same_every_time(prepared: Prepare) -> None:
    surface = prepared("junction").model.surface
    first, second = tips_of(surface), tips_of(surface)
    for a, b in zip(first, second, strict=True):
        assert (a.label, a.cap, a.confidence) == (b.label, b.cap, b.confidence)
        np.testing.assert_array_equal(a.point, b.point)


def test_labels_move_along_with_a_rigid_motion(prepared: Prepare) -> None:
    surface = prepared("junction").model.surface
    turn, shift = Rotation.from_rotvec([-0.3, 0.9, 1.4]), np.array([-80.0, 15.0, 300.0])
    caps = tuple(
        Cap(c.label, c.origin, turn.apply(np.array(c.center)) + shift, turn.apply(np.array(c.normal)), c.area)
        for c in surface.caps
    )
    moved = Surface(turn.apply(np.array(surface.vertices)) + shift, surface.faces, surface.face_cap, caps, surface.frame)
    still = {tip.cap: tip for tip in tips_of(surface)}
    gone = {tip.cap: tip for tip in tips_of(moved)}
    assert gone.keys() == still.keys()
    assert gone["C1"].label == still["C1"].label == "E1"
    for cap, tip in gone.items():
        # A cap's middle may be taken a thousandth of a millimetre inside its plane.
        np.testing.assert_allclose(tip.point, turn.apply(np.array(still[cap].point)) + shift, atol=2e-3)
        assert tip.radius == pytest.approx(still[cap].radius, abs=5e-3)
    # The children are equally long, so the order of their labels may swap; the lengths may not.
    lengths = [sorted(tip.branch_length for tip in tips.values()) for tips in (still, gone)]
    # The tree's edges follow the diagram's vertices, which differ with the jitter: 1 mm in 45.
    np.testing.assert_allclose(lengths[0], lengths[1], atol=1.0)


def test_tips_without_caps_keep_off_the_very_end_and_lie_inside(prepared: Prepare) -> None:
    surface = without_caps(prepared("junction").model.surface)
    tips = tips_of(surface)
    wall = WallDistance(surface)
    assert len(tips) == 3
    assert all(tip.cap is None for tip in tips)
    for tip in tips:
        assert wall.clearance(tip.point)[0] > 1.0
    # The root is the wide end: the parent runs along +y from the origin.
    assert np.linalg.norm(tips[0].point) < 4.0


def test_a_root_may_be_given(prepared: Prepare) -> None:
    case = prepared("junction")
    tips = find_endpoints(case.graph, case.wall, root=case.model.goal)
    np.testing.assert_allclose(tips[0].point, case.model.goal, atol=0.01)
    assert tips[0].cap == "C2"
    assert len(tips) == 3


def test_lengths_in_a_small_tree_are_sums_of_its_edges() -> None:
    # A chain 0-1-2-3 with a side branch 1-4; node 5 is not reached.
    class Graph:
        nodes = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [6, 0, 0], [1, 5, 0], [9, 9, 9]])

    previous = np.array([-9999, 0, 1, 2, 1, -9999])
    length = path_lengths(Graph(), previous)  # type: ignore[arg-type]
    assert length.tolist() == [0.0, 1.0, 3.0, 6.0, 6.0, 0.0]
    covered = np.array([True, True, False, False, False, True])
    assert lengths_beyond(previous, length, covered).tolist() == [0.0, 0.0, 2.0, 5.0, 5.0, 0.0]
