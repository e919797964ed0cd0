"""Many insertions of one plan at random: where the tip ends, what it comes near to, how often it is withdrawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.events import Event
from tubeplan_viz.needle.insertion import Insertion, InsertionSettings, insert
from tubeplan_viz.needle.kinematics import Controls, Pose
from tubeplan_viz.needle.spatial import SpatialProblem

LATEST = 0.6  # of the path: the target moves no later, or nothing that bends as needles do could follow it


@dataclass(frozen=True, kw_only=True)
class MonteCarloSettings:
    """How insertions differ from each other.

    Attributes
    ----------
    runs : int
        Insertions; 0 for none.
    curvature_error : float
        Standard deviation of the true curvature, relative to the model's.
    noise : float, mm
        Standard deviation of the measured tip along each axis.
    target_motion : float, mm
        The target moves by this much in a random direction, at a random depth up to `LATEST` of the path.
    """

    runs: int = 0
    curvature_error: float = 0.05
    noise: float = 0.5
    target_motion: float = 3.0

    def __post_init__(self) -> None:
        if not 0 <= self.runs <= 100_000:
            raise CaseError(f"the runs of the Monte Carlo are {self.runs}, expected 0 to 100000")
        if not 0.0 <= self.curvature_error <= 0.3:
            raise CaseError(f"curvature_error is {self.curvature_error:g}, expected 0 to 0.3 (a share of kappa)")
        if not 0.0 <= self.noise <= 20.0:
            raise CaseError(f"tip_noise_mm is {self.noise:g}, expected 0 to 20")
        if not 0.0 <= self.target_motion <= 100.0:
            raise CaseError(f"target_motion_mm is {self.target_motion:g}, expected 0 to 100")


@dataclass(frozen=True, eq=False, kw_only=True)
class MonteCarlo:
    """How many insertions went.

    Attributes
    ----------
    insertions : tuple of Insertion
        In the order in which they were drawn.
    """

    insertions: tuple[Insertion, ...]

    @property
    def ended(self) -> tuple[Insertion, ...]:
        """Those that were not withdrawn."""
        return tuple(made for made in self.insertions if made.withdrawn is None)

    @property
    def withdrawn(self) -> int:
        """How many were withdrawn before the target."""
        return len(self.insertions) - len(self.ended)

    @property
    def errors(self) -> FloatArray:
        """Final tip errors of those that ended, mm, (k,)."""
        return np.array([made.error for made in self.ended])

    @property
    def clearances(self) -> FloatArray:
        """Least distance of every insertion to any obstacle, withdrawn ones too, mm, (runs,); infinite without obstacles."""
        return np.array([made.clearances.min(initial=np.inf) for made in self.insertions])

    @property
    def touched(self) -> int:
        """How many met an obstacle."""
        return int(np.count_nonzero(self.clearances <= 0.0))


def monte_carlo(
    problem: SpatialProblem,
    pose: Pose,
    controls: Controls,
    settings: MonteCarloSettings,
    *,
    rng: np.random.Generator,
    events: tuple[Event, ...] = (),
    watch: Callable[[int, int], None] | None = None,
) -> MonteCarlo:
    """Insertions of one plan, each with its own true curvature, noise and motion of the target.

    Parameters
    ----------
    problem : SpatialProblem
        As planned.
    pose, controls : Pose, Controls
        The plan.
    settings : MonteCarloSettings
    rng : Generator
        Gives every insertion a generator of its own: the first insertions are the same, however many follow.
    events : tuple of Event
        What happens in every insertion besides.
    watch : callable, optional
        Told how many are done, of how many.
    """
    made = []
    for k, own in enumerate(rng.spawn(settings.runs)):
        if watch is not None:
            watch(k, settings.runs)
        kappa = problem.settings.kappa * (1.0 + settings.curvature_error * float(np.clip(own.standard_normal(), -3.0, 3.0)))
        way = own.standard_normal(3)
        place = problem.target + settings.target_motion * way / np.linalg.norm(way)
        moves = (Event(at=float(own.uniform(0.0, LATEST)) * controls.length, target=place),) if settings.target_motion > 0 else ()
        watched = InsertionSettings(noise=settings.noise, tolerance=max(0.5 * settings.noise, 0.1))
        made.append(insert(problem, pose, controls, (*events, *moves), watched, rng=own, true_kappa=kappa))
    return MonteCarlo(insertions=tuple(made))
