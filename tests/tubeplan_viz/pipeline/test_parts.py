"""What the parts of a generated airway are called."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from segmentation.mesh import Surface
from segmentation.synthetic import weibel_airway
from tubeplan_viz.bench.models import straight_tube
from tubeplan_viz.bronchoscope.naming import NamedBranch
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.measures import path_parts
from tubeplan_viz.pipeline import grow_tree
from tubeplan_viz.pipeline.parts import end_names, entered_tree, lumen_parts, sure_name
from tubeplan_viz.pipeline.tree import Tree, branches_from_end


@pytest.fixture(scope="module")
def airway() -> Tree:
    return grow_tree(weibel_airway(generations=2, voxel=1.0).surface)


def test_the_way_to_every_tip_begins_in_the_trachea_and_ends_in_the_tips_part(airway: Tree) -> None:
    parts = lumen_parts("airway", airway, None)
    names = end_names(parts, airway)
    assert names["E1"] == "trachea"
    lobes = sorted(name for label, name in names.items() if label != "E1")
    assert lobes == ["bronchus intermedius", "left lower lobe", "left upper lobe", "right upper lobe"]
    ways = branches_from_end(airway, "E1")
    for target, label in enumerate(ways.labels):
        way = ways.branches.path(target)
        assert way is not None
        found = path_parts(parts, way.points, way.arc_length, way.points)
        side = "left" if names[label].startswith("left") else "right"
        assert [part["name"] for part in found] == ["trachea", f"{side} main bronchus", names[label]]
        # The trachea's own line ends at the fork; samples are 1 mm apart.
        assert found[0]["to_mm"] == pytest.approx(ways.branches.branches[0].length, abs=1.0)


@pytest.mark.parametrize("upside_down", [False, True])
def test_an_airway_without_a_carina_is_entered_from_above_and_its_ends_are_told_apart(upside_down: bool) -> None:
    model = straight_tube().surface  # along +y
    turn = Rotation.from_euler("x", -90.0 if upside_down else 90.0, degrees=True).as_matrix()
    caps = tuple(replace(cap, center=turn @ cap.center, normal=turn @ cap.normal) for cap in model.caps)
    surface = Surface(model.vertices @ turn.T, model.faces, model.face_cap, caps, "LPS")
    tree = entered_tree(surface, "airway")
    first, second = tree.endpoints
    assert (first.label, second.label) == ("E1", "E2")
    assert first.point[2] > second.point[2] + 10.0
    names = end_names(lumen_parts("airway", tree, None), tree)
    assert names == {"E1": "upper end of the trachea", "E2": "lower end of the trachea"}
    # A mesh's axes say nothing of above: the end that was found stays the first.
    plain = Surface(surface.vertices, surface.faces, surface.face_cap, surface.caps, "mesh")
    np.testing.assert_array_equal(entered_tree(plain, "airway").endpoints[0].point, grow_tree(plain).endpoints[0].point)


def test_sides_that_are_not_sure_are_not_told() -> None:
    def named(name: str, confidence: float, parent: int, generation: int) -> NamedBranch:
        line = Centerline(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.ones(2))
        return NamedBranch(
            name=name, confidence=confidence, label=None, line=line, parent=parent, generation=generation, angle=0.0
        )

    unsure = [named("trachea", 1.0, -1, 0), named("left main bronchus", 0.6, 0, 1), named("left upper lobe", 0.6, 1, 2)]
    assert [sure_name(unsure, number) for number in range(3)] == ["trachea", "main bronchus", "main bronchus"]
    sure = [*unsure[:1], named("left main bronchus", 0.9, 0, 1), named("left upper lobe", 0.5, 1, 2)]
    assert [sure_name(sure, number) for number in range(3)] == ["trachea", "left main bronchus", "left main bronchus"]


def test_an_anatomy_without_names_and_a_single_tube_have_no_parts(airway: Tree) -> None:
    assert lumen_parts("vessel", airway, None) == ()
    assert lumen_parts(None, airway, None) == ()
    assert end_names((), airway) == {}
