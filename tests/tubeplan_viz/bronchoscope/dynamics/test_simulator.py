"""The robot in MuJoCo: determinism, restored states, free bending, pushing, and the lumen's wall."""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np
import pytest

from tubeplan_viz.bronchoscope.dynamics import Simulator
from tubeplan_viz.bronchoscope.kinematics import pose_along
from tubeplan_viz.bronchoscope.mover import Command
from tubeplan_viz.bronchoscope.robot import Robot

pytest.importorskip("mujoco", reason="MuJoCo is not installed")


@pytest.fixture(scope="module")
def free(phantoms: ModuleType) -> Simulator:
    """In a lumen so wide that nothing is touched."""
    tube = phantoms.straight_tube(length=150.0, radius=60.0)
    return Simulator(tube.surface, Robot(), pose_along([0.0, 5.0, 0.0], [0.0, 1.0, 0.0]))


def test_both_sections_bend_by_at_least_171_of_180_degrees_under_gravity(free: Simulator) -> None:
    half = math.pi / 2
    step = free.move(free.start(), Command(phi_proximal=half, theta_proximal=0.7, phi_distal=half, theta_distal=0.7, push=15.0))
    bend = math.degrees(math.acos(float(np.clip(step.base[:3, 2] @ step.tip[:3, 2], -1.0, 1.0))))
    assert bend >= 171.0


def test_the_same_command_from_the_same_state_has_the_same_outcome(free: Simulator) -> None:
    start = free.start()
    command = Command(phi_proximal=0.6, theta_proximal=0.3, phi_distal=0.9, theta_distal=-1.0, push=6.0)
    first = free.move(start, command)
    free.move(first, command)
    second = free.move(start, command)
    np.testing.assert_array_equal(first.state.values, second.state.values)
    np.testing.assert_array_equal(first.tip, second.tip)
