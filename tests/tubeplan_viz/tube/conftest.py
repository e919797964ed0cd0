"""Problems posed once: model tubes with their wall and centerline."""

from __future__ import annotations

import pytest

from tubeplan_viz.bench.models import Model, bent_cylinder_1, narrow_neck, straight_tube, variant_2
from tubeplan_viz.bench.paper import CYLINDER_1, SETTINGS
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube import TubeProblem, TubeSettings, pose_problem


def posed(model: Model, limits: Limits, settings: TubeSettings = SETTINGS) -> TubeProblem:
    return pose_problem(model.surface, model.start, model.goal, limits, settings)


@pytest.fixture(scope="package")
def cylinder_1() -> TubeProblem:
    """Bent cylinder 1 with the paper's limits and its spacing of 0.8 mm."""
    return posed(bent_cylinder_1(), CYLINDER_1)


@pytest.fixture(scope="package")
def variant() -> TubeProblem:
    """Variant 2: its first bend of 8 mm is sharper than the limit of 10 mm."""
    return posed(variant_2(), CYLINDER_1)


@pytest.fixture(scope="package")
def tube() -> Model:
    """A straight tube along +y, radius 3 mm, length 40 mm."""
    return straight_tube()


@pytest.fixture(scope="package")
def straight(tube: Model) -> TubeProblem:
    """The straight tube with limits that hold everywhere."""
    return posed(tube, Limits(curvature_max=0.1, clearance_min=2.0))


@pytest.fixture(scope="package")
def neck_model() -> Model:
    """A straight tube that narrows to 1 mm in its middle."""
    return narrow_neck()
