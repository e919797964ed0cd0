"""Problems posed once: model tubes with their wall and centerline."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from tubeplan_viz.bench.models import Model, bent_cylinder_1, narrow_neck, straight_tube, variant_2
from tubeplan_viz.bench.paper import CYLINDER_1, SETTINGS
from tubeplan_viz.bench.random_tubes import random_path, random_tube
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import SplineCurve, WallDistance, clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube import TubeProblem, TubeSettings, pose_problem
from tubeplan_viz.tube.bend import STEP, resampled


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


@dataclass(frozen=True, kw_only=True)
class KeptPath:
    """A path in a random tube with what it is proved to keep, and the tube's axis as a centerline."""

    path: SplineCurve
    wall: WallDistance
    way: Centerline
    clearance: float
    curvature: float


@pytest.fixture(scope="session")
def kept_paths() -> Callable[[int, int, float], Iterator[KeptPath]]:
    """So many paths of a seed in random tubes, bent by more than so much and less than 0.2 1/mm."""

    def made(seed: int, count: int, least_curvature: float) -> Iterator[KeptPath]:
        rng = np.random.default_rng(seed)
        while count:
            tube = random_tube(rng)
            path = random_path(tube, rng, sway=0.35)
            wall = WallDistance(tube.surface)
            clearance = clearance_lower_bound(path, wall, tolerance=0.01).bound
            curvature = curvature_upper_bound(path, limit=0.5).bound
            if clearance <= 0.05 or not least_curvature < curvature < 0.2:
                continue
            count -= 1
            points = tube.axis.at(np.linspace(0.0, tube.axis.length, 200))[0]
            way = resampled(Centerline(points, wall.distance(points)), STEP / curvature)
            yield KeptPath(path=path, wall=wall, way=way, clearance=clearance, curvature=curvature)

    return made
