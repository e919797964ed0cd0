"""The planes that stand for the wall, in a straight tube where each is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.bench.models import straight_tube
from tubeplan_viz.bronchoscope.dynamics.wall import RANGE, RENEWAL, SIDES, PatientWall, WallPlanes

RADIUS, BALL = 4.0, 1.75


@pytest.fixture(scope="module")
def wall() -> PatientWall:
    return PatientWall(straight_tube(60.0, RADIUS).surface)


def asked(wall: PatientWall, *centers: tuple[float, float, float], radius: float = BALL) -> WallPlanes:
    planes = WallPlanes(wall, np.full(len(centers), radius))
    planes.renew(np.array(centers), np.ones(len(centers), dtype=bool))
    return planes


def test_the_first_plane_touches_the_wall_beside_the_ball_and_looks_inwards(wall: PatientWall) -> None:
    planes = asked(wall, (2.0, 30.0, 0.0))
    assert planes.used[0, 0]
    # The mesh's facets lie within the cylinder by a hundredth of a millimetre.
    assert planes.distance[0] == pytest.approx(RADIUS - 2.0, abs=0.02)
    assert planes.points[0, 0] == pytest.approx([RADIUS, 30.0, 0.0], abs=0.15)
    assert planes.normals[0, 0] == pytest.approx([-1.0, 0.0, 0.0], abs=0.05)


def test_a_ball_whose_middle_has_passed_the_wall_is_pushed_back_through_it(wall: PatientWall) -> None:
    planes = asked(wall, (RADIUS + 0.3, 30.0, 0.0))
    assert planes.distance[0] == pytest.approx(-0.3, abs=0.02)
    assert planes.normals[0, 0] == pytest.approx([-1.0, 0.0, 0.0], abs=0.05)
    # Along the normal it has its radius and what it is beyond to go before it touches no more.
    gap = float((np.array([RADIUS + 0.3, 30.0, 0.0]) - planes.points[0, 0]) @ planes.normals[0, 0]) - BALL
    assert gap == pytest.approx(-BALL - 0.3, abs=0.02)


def test_a_ball_that_fills_the_lumen_has_planes_on_several_sides(wall: PatientWall) -> None:
    planes = asked(wall, (0.1, 30.0, 0.0), radius=RADIUS - 0.2)
    assert planes.used[0].all()
    normals = planes.normals[0]
    assert len(normals) == SIDES
    # Each looks to the axis, and none says what another does: more than 50 degrees lie between neighbours in turn.
    towards = -planes.points[0] * [1.0, 0.0, 1.0]
    assert np.einsum("ki,ki->k", normals, towards / np.linalg.norm(towards, axis=1, keepdims=True)).min() > 0.98
    for one, other in ((0, 1), (1, 2)):
        assert np.degrees(np.arccos(normals[one] @ normals[other])) > 50.0


def test_a_ball_away_from_the_wall_has_no_plane_and_is_not_asked_again_before_it_could_need_one(wall: PatientWall) -> None:
    planes = asked(wall, (0.0, 30.0, 0.0))
    assert not planes.used.any()
    free = RADIUS - BALL - RANGE  # of its way until the wall may be in range
    assert not planes.renew(np.array([[0.95 * free, 30.0, 0.0]]), np.ones(1, dtype=bool)).any()
    assert planes.distance[0] == pytest.approx(RADIUS, abs=0.02)  # as at the first question
    assert planes.renew(np.array([[free + RENEWAL, 30.0, 0.0]]), np.ones(1, dtype=bool)).all()
    assert planes.used[0, 0]


def test_a_ball_in_the_sheath_touches_nothing(wall: PatientWall) -> None:
    planes = WallPlanes(wall, np.full(2, BALL))
    planes.renew(np.array([[2.2, 30.0, 0.0], [2.2, 30.0, 0.0]]), np.array([True, False]))
    assert planes.used[0].any()
    assert not planes.used[1].any()
    # Drawn back into the sheath, one that touched does so no more.
    planes.renew(np.array([[2.2, 30.0, 0.0], [2.2, 30.0, 0.0]]), np.array([False, False]))
    assert not planes.used.any()
