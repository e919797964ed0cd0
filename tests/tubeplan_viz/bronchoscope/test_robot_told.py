"""A number of a robot's run that is altered alone is refused, though no page tells it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.verify.bronchoscope import check_motion
from tubeplan_viz.verify.bronchoscope_told import check_told_robot

Altered = Callable[..., set[str]]


@pytest.fixture
def altered(plant: Callable[..., None]) -> Altered:
    """Names of the checks that do not hold when one value of result.json is changed."""

    def found(run: Path, way: str, change: Callable[[Any], Any] | None = None) -> set[str]:
        document = json.loads((run / "result.json").read_text())
        assert all(check.ok for check in check_told_robot(document))
        plant(document, way, change)
        return {check.name for check in (*check_told_robot(document), *check_motion(document)) if not check.ok}

    return found


@pytest.mark.parametrize(
    ("place", "check"),
    [
        ("metrics.disc_clearance_end_mm", "metrics: of the steps"),
        ("metrics.body_clearance_min_mm", "metrics: of the steps"),
        ("details.steps.-1.disc_clearance_mm", "metrics: of the steps"),
        ("details.robot.name", "robot"),
        ("details.robot.bend_max_deg", "robot"),
        ("details.robot.curvature_max_per_mm", "robot"),
        ("details.reached", "reached"),
        ("details.target.branch", "route"),
        ("details.target.depth_mm", "target"),
        ("details.route.1.diameter_mm", "route"),
        ("details.route.0.length_mm", "route"),
        ("details.route.1.turn_deg", "route"),
        ("details.route.1.confidence", "route"),
        ("details.contacts.most", "contacts: counts"),
        ("details.contacts.disc_brushes", "contacts: counts"),
        ("details.steps.3.base.0.0", "frames: from the commands"),
        ("details.steps.3.base.2.3", "frames: from the commands"),
        ("details.steps.5.view.1", "frames: from the commands"),
    ],
)
def test_one_altered_value_of_a_robots_run_is_named(robot_run: Path, altered: Altered, place: str, check: str) -> None:
    assert check in altered(robot_run, place)


def test_a_lesion_that_the_case_does_not_have_is_named(robot_run: Path, altered: Altered) -> None:
    assert "target" in altered(robot_run, "details.target.lesion_mm", lambda _: [1.0, 2.0, 3.0])
