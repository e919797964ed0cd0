"""The generated airway: its wall is that of its tree, its route is the published one."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.errors import CaseError
from segmentation.mesh_repair import edge_map, face_components
from segmentation.synthetic import Airway, weibel_airway
from segmentation.synthetic.airway import WEIBEL_DIAMETERS


@pytest.fixture(scope="module")
def airway() -> Airway:
    return weibel_airway(voxel=0.8)


def test_the_wall_is_one_closed_sheet_without_handles(airway: Airway) -> None:
    faces = airway.surface.faces
    edges = edge_map(faces)
    assert (edges.count == 2).all()
    assert face_components(faces, edges)[0] == 1
    # Euler's V - E + F = 2 of a sphere: no two branches touch each other beside their junction.
    assert len(airway.surface.vertices) - len(edges.ends) + len(faces) == 2


def test_the_wall_lies_on_the_tubes(airway: Airway) -> None:
    wall = airway.surface.vertices[np.unique(airway.surface.wall_faces)]
    away = np.abs(airway.clearance(wall))
    # Linear interpolation of a distance is off by about voxel^2 / (8 r), 0.05 mm at r = 1.75; only the creases at the
    # carinae, where two tubes meet, and the trachea's rim are rounded, by less than a voxel.
    assert np.percentile(away, 99) < 0.05
    assert away.max() < 0.8


def test_the_route_to_the_apical_segment_bends_by_180_degrees(airway: Airway) -> None:
    route = [airway.branches[number] for number in airway.route()]
    assert [branch.name for branch in route] == ["trachea", "right main bronchus", "right upper lobe", "right apical segment"]
    assert np.degrees(sum(branch.turn for branch in route)) == pytest.approx(180.0)
    steps = np.diff(airway.axis(), axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    turned = np.arccos(np.clip(np.einsum("ij,ij->i", steps[1:], steps[:-1]), -1.0, 1.0)).sum()
    assert np.degrees(turned) == pytest.approx(180.0, abs=1e-6)
    assert airway.branches[0].direction == pytest.approx(-route[-1].direction)


def test_five_generations_have_weibels_diameters(airway: Airway) -> None:
    assert len(airway.branches) == 63
    for branch in airway.branches:
        assert 2.0 * branch.radius == WEIBEL_DIAMETERS[branch.generation]
    names = [branch.name for branch in airway.branches]
    assert len(set(names)) == len(names)


def test_one_cap_closes_the_trachea(airway: Airway) -> None:
    cap = airway.surface.caps[0]
    assert len(airway.surface.caps) == 1
    assert cap.area == pytest.approx(np.pi * 9.0**2, rel=0.03)  # the chamfer of one voxel is counted in
    assert airway.entrance == pytest.approx(cap.center)


def test_a_parameter_out_of_range_is_refused() -> None:
    with pytest.raises(CaseError, match="expected 1 to 5"):
        weibel_airway(generations=6)
    with pytest.raises(CaseError, match=r"expected 0\.2 to 1"):
        weibel_airway(voxel=2.0)
    with pytest.raises(CaseError, match="has no branch 'nose'"):
        weibel_airway(generations=1, voxel=1.0).number("nose")
