"""What the parts of a generated airway are called."""

from __future__ import annotations

import pytest

from segmentation.synthetic import weibel_airway
from tubeplan_viz.measures import path_parts
from tubeplan_viz.pipeline import grow_tree
from tubeplan_viz.pipeline.parts import end_names, lumen_parts
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


def test_an_anatomy_without_names_and_a_single_tube_have_no_parts(airway: Tree) -> None:
    assert lumen_parts("vessel", airway, None) == ()
    assert lumen_parts(None, airway, None) == ()
    assert end_names((), airway) == {}
