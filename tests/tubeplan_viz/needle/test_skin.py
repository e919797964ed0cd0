"""The skin of a made CT against its closed form, and entries that lie on it."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.errors import CaseError
from segmentation.volume import Volume
from tubeplan_viz.needle.kinematics import insertion_pose
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.skin import skin_at
from tubeplan_viz.needle.spatial import NeedleSettings, SpatialProblem
from tubeplan_viz.needle.swarm import plan_spatial

RADIUS = 60.0


def cylinder() -> Volume:
    """A body as a cylinder along z, with air in its middle (a lung) and a table beside it; voxels of 2 mm."""
    _, y, x = np.meshgrid(np.arange(0, 60, 2.0), np.arange(-90, 92, 2.0), np.arange(-90, 92, 2.0), indexing="ij")
    hu = np.where(np.hypot(x, y) <= RADIUS, 40, -1000)
    hu[np.hypot(x, y) <= 25.0] = -850
    hu[(y >= 70) & (y <= 74)] = 200
    matrix = np.array([[0.0, 0.0, 2.0, -90.0], [0.0, 2.0, 0.0, -90.0], [2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return Volume(hu.astype(np.int16), matrix)


def test_the_skin_of_a_cylinder_is_where_its_surface_is() -> None:
    pose, skin = skin_at(cylinder(), insertion_pose([-75.0, 0.0, 30.0], [1.0, 0.0, 0.0]), 20.0)
    # Voxels of 2 mm: the border of voxels lies within one of them from the circle.
    assert np.linalg.norm(pose.position - [-RADIUS, 0.0, 30.0]) < 2.0
    offsets = np.array([[a, b] for a in (-18.0, -7.0, 0.0, 9.0) for b in (-15.0, 0.0, 18.0)])
    places = pose.position + offsets @ pose.frame[:, :2].T + skin.depth(offsets)[:, None] * pose.tangent
    assert np.abs(np.hypot(places[:, 0], places[:, 1]) - RADIUS).max() < 2.0


def test_an_entry_within_the_body_is_moved_back_to_the_skin() -> None:
    pose, _ = skin_at(cylinder(), insertion_pose([-50.0, 0.0, 30.0], [1.0, 0.0, 0.0]), 0.0)
    assert pose.position[0] == pytest.approx(-RADIUS, abs=2.0)


def test_a_direction_that_meets_no_skin_is_refused() -> None:
    with pytest.raises(CaseError, match="there is no skin within 40 mm of the entry"):
        skin_at(cylinder(), insertion_pose([0.0, 0.0, 30.0], [0.0, 0.0, 1.0]), 0.0)


def test_a_free_entry_stays_on_the_skin_within_its_region() -> None:
    pose, skin = skin_at(cylinder(), insertion_pose([-75.0, 0.0, 30.0], [1.0, 0.0, 0.0]), 15.0)
    settings = NeedleSettings(kappa=0.01, entry_radius=15.0, cone=0.2)
    path = plan_spatial(SpatialProblem(pose, np.array([0.0, 25.0, 30.0]), Scene(()), settings, skin=skin), front=False)
    assert path.pose is not None
    start = path.pose.position
    assert np.hypot(start[0], start[1]) == pytest.approx(RADIUS, abs=2.0)
    assert np.linalg.norm((start - pose.position)[1:]) <= 15.0 + 1e-9
    assert path.error < 1e-6
    # Free to choose, it goes in nearer to the target than straight behind the entry given.
    assert start[1] > 5.0
