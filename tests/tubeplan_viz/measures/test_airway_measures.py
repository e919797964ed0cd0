"""Measures of the generated airway against the numbers that it is made with."""

from __future__ import annotations

import pytest

from segmentation.synthetic import weibel_airway
from tubeplan_viz.pipeline import grow_tree
from tubeplan_viz.pipeline.measures import measured_airway


def test_diameters_lengths_and_turns_are_those_the_airway_is_made_with() -> None:
    tree = grow_tree(weibel_airway(generations=2, voxel=1.0).surface)
    measures, *_ = measured_airway(tree, None)
    found = {(m.of, m.key): m.value for m in measures}
    # Marching cubes at 1 mm cut a circle of radius 6 by (1 / 6)^2 / 8 of its radius, 0.02 mm.
    assert found["", "trachea_diameter_mm"] == pytest.approx(18.0, abs=0.1)
    # The main bronchi turn by 30 and 45 degrees to either side; their lines round the corner.
    assert found["", "carinal_angle_deg"] == pytest.approx(75.0, abs=2.0)
    of = {value: part for (part, key), value in found.items() if key == "branch_length_mm" and found[part, "generation"] == 1.0}
    right, left = (of[length] for length in sorted(v for v in of if v is not None))
    assert found[right, "branch_length_mm"] == pytest.approx(25.0, abs=1.5)  # the line leaves the trachea's a little late
    assert found[left, "branch_length_mm"] == pytest.approx(48.0, abs=1.5)
    for part, turn in ((right, 30.0), (left, 45.0)):
        assert found[part, "branch_diameter_mm"] == pytest.approx(12.2, abs=0.1)
        assert found[part, "branch_angle_deg"] == pytest.approx(turn, abs=3.0)
    # The second generation is 8.3 mm wide and 18 mm long: half of a branch lies beside its sister, which must not count.
    second = [part for (part, key), value in found.items() if key == "generation" and value == 2.0]
    assert len(second) == 4
    assert [found[part, "branch_diameter_mm"] for part in second] == pytest.approx([8.3] * 4, abs=0.1)
