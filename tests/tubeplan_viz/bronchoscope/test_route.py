"""Stages of a route in closed form, the sphere of samples, and how far into a branch a width goes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tubeplan_viz.bronchoscope.airway import ENTRANCE_SEARCH
from tubeplan_viz.bronchoscope.guide import Guide
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.route import Passage, Stage, make_stages

# The text's route: turns of 30, 60 and 90 degrees; lengths and radii like those of a grown man.
ROUTE = (
    Passage(name="trachea", begin=0.0, end=100.0, turn=0.0, radius=9.0),
    Passage(name="main", begin=100.0, end=125.0, turn=np.radians(30.0), radius=6.0),
    Passage(name="lobe", begin=125.0, end=142.0, turn=np.radians(60.0), radius=4.2),
    Passage(name="segment", begin=142.0, end=160.0, turn=np.radians(90.0), radius=2.8),
)


def staged(*passages: Passage, radius: float = 5.0) -> tuple[Stage, ...]:
    """Stages on a straight guide through a lumen of one radius."""
    length = passages[-1].end
    points = np.column_stack([np.zeros(321), np.linspace(0.0, length, 321), np.zeros(321)])
    return make_stages(Guide(points, np.full(321, radius)), passages, np.array([0.3, length, 0.0]), Robot())


def test_the_texts_route_has_six_stages_one_into_each_branch_that_turns_sharply() -> None:
    stages = staged(*ROUTE)
    assert [stage.name for stage in stages] == [
        "along trachea",
        "along main",
        "into lobe",
        "along lobe",
        "into segment",
        "along segment",
    ]
    # A stage into a branch ends one of its diameters past the junction: 125 + 8.4 and 142 + 5.6 mm.
    assert [stage.end for stage in stages] == pytest.approx([100.0, 125.0, 133.4, 142.0, 147.6, 160.0])
    assert [stage.begin for stage in stages] == pytest.approx([0.0, 100.0, 125.0, 133.4, 142.0, 147.6])
    for stage in stages[:-1]:
        assert stage.goal == pytest.approx([0.0, stage.end, 0.0], abs=1e-9)
    assert stages[-1].goal == pytest.approx([0.3, 160.0, 0.0])  # the goal itself, wherever it lies


def test_a_branch_too_short_for_a_stage_of_its_own_into_it_has_none() -> None:
    short = Passage(name="stub", begin=125.0, end=134.0, turn=np.radians(80.0), radius=4.2)
    assert [stage.name for stage in staged(*ROUTE[:2], short)] == ["along trachea", "along main", "along stub"]


def test_stages_that_the_robot_has_passed_at_the_start_are_none() -> None:
    early = (
        Passage(name="trachea", begin=0.0, end=20.0, turn=0.0, radius=9.0),  # shorter than both active sections
        Passage(name="main", begin=20.0, end=60.0, turn=0.3, radius=6.0),
    )
    (stage,) = staged(*early)
    assert (stage.name, stage.begin, stage.end) == ("along main", 0.0, 60.0)
    assert [stage.name for stage in staged(early[0])] == ["along trachea"]  # the goal's own stage stays


@pytest.mark.parametrize(("radius", "sphere"), [(12.0, 9.6), (5.0, 3.25), (1.9, 0.3)])
def test_the_sphere_of_samples_is_four_fifths_of_the_lumen_and_no_more_than_its_room(radius: float, sphere: float) -> None:
    # 0.8 of 12; 5 less the robot's 1.75; 0.3 where there is hardly any room.
    assert staged(*ROUTE, radius=radius)[0].radius == pytest.approx(sphere)


@pytest.mark.parametrize("width", [1.0, 2.0, 2.6, 4.0])
def test_the_depth_of_a_width_is_where_the_first_sphere_is_narrower(made_airway: Any, width: float) -> None:
    tree, cut = made_airway.tree, 0
    for number, branch in enumerate(tree.branches):
        depth, line = tree.wide_depth(number, width), branch.line
        if depth == 0.0:
            continue
        inner = line.arc_length > (ENTRANCE_SEARCH if number == 0 else -1.0)
        assert (line.radii[inner & (line.arc_length <= depth)] >= width).all()
        if depth < branch.length:
            cut += 1
            (further,) = np.flatnonzero(inner & (line.arc_length > depth))[:1]
            assert line.radii[further] < width
        for above in tree.route_to(number)[1:-1]:
            assert tree.branches[above].line.radii.min() >= width
    assert cut > 0 or width == 1.0
