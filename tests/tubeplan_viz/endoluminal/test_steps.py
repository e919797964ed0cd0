"""Which way to turn where: a junction and bends with known angles."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.bench.models import y_junction
from tubeplan_viz.centerline import centerline_tree, voronoi_graph
from tubeplan_viz.endoluminal import clock, patient_words, walk_steps
from tubeplan_viz.geometry import WallDistance


@pytest.mark.parametrize(
    ("degrees", "hours"), [(0, 12), (14, 12), (16, 1), (90, 3), (180, 6), (-90, 9), (270, 9), (-14, 12), (-16, 11)]
)
def test_the_clock_has_its_top_at_twelve(degrees: float, hours: int) -> None:
    assert clock(np.radians(degrees)) == hours


def test_directions_are_told_as_the_patient_has_them() -> None:
    assert patient_words([0.0, 0.0, -1.0]) == "inferior"
    assert patient_words([-0.7, 0.0, -0.7]) in ("right and inferior", "inferior and right")
    assert patient_words([0.9, -0.5, 0.1]) == "left and anterior"


def bent(angle: float, roll: float) -> tuple[np.ndarray, np.ndarray]:
    """Straight down, one bend of radius 12 mm about an axis turned by `roll`, straight on: (arc length, points)."""
    radius, straight = 12.0, 30.0
    s = np.arange(0.0, 2 * straight + radius * angle, 0.1)
    t = np.clip((s - straight) / radius, 0.0, angle)
    after = np.maximum(s - straight - radius * angle, 0.0)
    down = np.minimum(s, straight) + radius * np.sin(t) + after * np.cos(angle)
    aside = radius * (1.0 - np.cos(t)) + after * np.sin(angle)
    return s, np.column_stack([-aside * np.sin(roll), -aside * np.cos(roll), -down])


@pytest.mark.parametrize(("roll", "hours"), [(0.0, 12), (np.pi / 2, 3), (np.pi, 6), (-np.pi / 2, 9)])
def test_one_bend_is_told_with_its_place_angle_and_hour(roll: float, hours: int) -> None:
    # Looking down, anterior (-y) is the picture's top and the patient's right (-x) its right.
    angle = np.radians(60.0)
    s, points = bent(angle, roll)
    (step,) = walk_steps(s, points)
    assert step.kind == "bend"
    assert step.arc_length == pytest.approx(30.0 + 0.5 * 12.0 * angle, abs=1.5)  # the middle of the bend
    assert step.clock == hours
    # The chords before and after reach into the bend, so some of its angle is lost.
    assert np.radians(25.0) < step.turn < angle + 1e-6
    assert step.openings == ()


def test_a_straight_line_has_no_step() -> None:
    s = np.linspace(0.0, 80.0, 801)
    assert walk_steps(s, np.column_stack([0 * s, 0 * s, s])) == ()
    assert walk_steps(s[:3], np.column_stack([0 * s, 0 * s, s])[:3]) == ()


def test_the_second_bend_is_rolled_against_the_first() -> None:
    angle = np.radians(60.0)
    _, points = bent(angle, 0.0)
    # A second bend, mirrored: the plane turns by half a turn, so the line comes back to its first direction.
    step = points[-1] - points[-2]
    step /= np.linalg.norm(step)
    t = np.arange(0.1, 12.0 * angle, 0.1) / 12.0
    normal = np.array([0.0, np.cos(angle), -np.sin(angle)])  # across the line, back towards posterior
    normal -= (normal @ step) * step
    normal /= np.linalg.norm(normal)
    back = points[-1] + 12.0 * (np.sin(t)[:, None] * step + (1.0 - np.cos(t))[:, None] * normal)
    tail = back[-1] + np.arange(0.1, 30.0, 0.1)[:, None] * (np.cos(t[-1]) * step + np.sin(t[-1]) * normal)
    line = np.vstack([points, back, tail])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    first, second = walk_steps(arc, line)
    assert abs(second.roll) == pytest.approx(np.pi, abs=0.1)
    assert first.clock == 12
    assert second.clock == 6


def test_a_fork_tells_the_branch_taken_and_the_one_left() -> None:
    model = y_junction()
    wall = WallDistance(model.surface)
    graph = voronoi_graph(model.surface, wall)
    start, goals = model.start, np.array([model.goal, model.branches[0][-1]])
    tree = centerline_tree(graph, wall, start, goals)
    for target in range(len(goals)):
        line = tree.path(target)
        assert line is not None
        steps = [step for step in walk_steps(line.arc_length, line.points, tree, target) if step.kind == "junction"]
        assert len(steps) == 1
        (step,) = steps
        trunk = float(tree.branches[0].length)
        assert step.arc_length == pytest.approx(trunk, abs=1.0)
        assert len(step.openings) == 1
        # The two branches leave on opposite sides.
        assert min((step.clock - step.openings[0]) % 12, (step.openings[0] - step.clock) % 12) >= 4
