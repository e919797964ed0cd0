"""Which bronchi get a name, and which do not: trees of straight branches."""

from __future__ import annotations

import numpy as np

from tubeplan_viz.bronchoscope.naming import name_branches
from tubeplan_viz.centerline import Branch, Centerline

DOWN = np.array([0.0, 0.0, -1.0])
LEFT, RIGHT = np.array([0.6, 0.0, -0.8]), np.array([-0.6, 0.0, -0.8])


def branch(
    parent: Branch | None, number: int, heading: np.ndarray, length: float, radius: float, turn_deg: float = 30.0
) -> Branch:
    """A straight branch from its parent's end."""
    begin = np.zeros(3) if parent is None else parent.line.points[-1]
    s = np.linspace(0.0, length, round(length) + 1)
    line = Centerline(begin + s[:, None] * heading, np.full(len(s), radius))
    return Branch(line=line, parent=number, generation=0, targets=(), angle=np.radians(turn_deg))


def names(branches: list[Branch], frame: str) -> list[str]:
    return [found.name for found in name_branches(branches, {}, frame=frame)]


def test_equal_main_bronchi_of_a_mesh_have_no_side() -> None:
    trachea = branch(None, -1, DOWN, 80.0, 8.0)
    one, two = branch(trachea, 0, LEFT, 60.0, 6.0), branch(trachea, 0, RIGHT, 62.0, 6.2, 33.0)
    assert names([trachea, one, two], "mesh") == ["trachea", "main bronchus b", "main bronchus a"]
    # The axes of a CT tell the sides without any vote.
    assert names([trachea, one, two], "LPS") == ["trachea", "left main bronchus", "right main bronchus"]


def test_votes_that_agree_tell_the_sides_and_votes_against_each_other_do_not() -> None:
    trachea = branch(None, -1, DOWN, 80.0, 8.0)
    wide = branch(trachea, 0, LEFT, 60.0, 7.0, 20.0)
    narrow = branch(trachea, 0, RIGHT, 60.0, 5.5, 45.0)
    found = name_branches([trachea, wide, narrow], {}, frame="mesh")
    assert [(one.name, one.confidence) for one in found[1:]] == [("right main bronchus", 0.9), ("left main bronchus", 0.9)]
    # One vote and none against it is less sure.
    only = [trachea, branch(trachea, 0, LEFT, 60.0, 6.0, 30.0), branch(trachea, 0, RIGHT, 60.0, 6.0, 45.0)]
    assert [one.confidence for one in name_branches(only, {}, frame="mesh")] == [1.0, 0.75, 0.75]
    against = [trachea, branch(trachea, 0, LEFT, 60.0, 7.0, 45.0), branch(trachea, 0, RIGHT, 60.0, 5.5, 20.0)]
    assert names(against, "mesh")[1:] == ["main bronchus a", "main bronchus b"]


def test_a_left_main_bronchus_that_the_image_cuts_short_has_no_lobes() -> None:
    trachea, right = branch(None, -1, DOWN, 80.0, 8.0), branch(branch(None, -1, DOWN, 80.0, 8.0), 0, RIGHT, 60.0, 6.0)
    for length, expected in (
        (16.0, ["left main bronchus a", "left main bronchus b"]),
        (20.0, ["left upper lobe", "left lower lobe"]),
    ):
        left = branch(trachea, 0, LEFT, length, 6.0)  # 1.5 widths are 18 mm
        lobes = [branch(left, 2, np.array([1.0, 0.0, 0.0]), 20.0, 3.0), branch(left, 2, DOWN, 20.0, 3.0)]
        assert names([trachea, right, left, *lobes], "LPS")[3:] == expected
