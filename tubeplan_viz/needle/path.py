"""What planners in space give: a path, how it was found, and what it is traded against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.needle.kinematics import Controls, Pose, push
from tubeplan_viz.needle.spatial import SpatialProblem


@dataclass(frozen=True, eq=False)
class SwarmRound:
    """The swarm after one round; `best` (d,) unknowns, `cloud` (k, d) of the whole population now and then, or None."""

    index: int
    restart: int
    best: FloatArray
    error: float
    length: float
    danger: float
    cloud: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """One path of the Pareto front: no other found is better in error, length and danger at once."""

    pose: Pose
    controls: Controls
    error: float
    length: float
    danger: float
    clearance: float


@dataclass(frozen=True, eq=False, kw_only=True)
class NeedlePath:
    """A path in space that ends on the target, or why there is none.

    Attributes
    ----------
    pose, controls : Pose and Controls, or None without a path
    clearances : (m,) float array, mm
        Lower bound of the distance to each obstacle, along the whole path.
    error, length, danger : float
    rounds : tuple of SwarmRound
    front : tuple of Tradeoff
        By danger and length.
    reason : str or None
    swarms, nodes : int
        Swarms that were run, poses of the tree of `--method rrt`.
    """

    pose: Pose | None = None
    controls: Controls | None = None
    clearances: FloatArray | None = None
    error: float = np.inf
    danger: float = np.inf
    rounds: tuple[SwarmRound, ...] = ()
    front: tuple[Tradeoff, ...] = ()
    reason: str | None = None
    swarms: int = 0
    nodes: int = 0

    @property
    def feasible(self) -> bool:
        """Whether there is a path."""
        return self.controls is not None

    @property
    def length(self) -> float:
        """Length, mm; infinite without a path."""
        return np.inf if self.controls is None else self.controls.length

    @property
    def clearance(self) -> float:
        """Least distance to any obstacle, mm; infinite without obstacles."""
        return np.inf if self.clearances is None or not len(self.clearances) else float(self.clearances.min())


def measured(
    problem: SpatialProblem,
    pose: Pose,
    controls: Controls,
    *,
    rounds: tuple[SwarmRound, ...] = (),
    swarms: int = 0,
    nodes: int = 0,
) -> NeedlePath:
    """A path with its own measures, its distances bounded over every point of it; a reason instead if it comes too near.

    Parameters
    ----------
    problem : SpatialProblem
    pose : Pose
        In which the needle stands at the entry, mm in the case's frame.
    controls : Controls
        Turns (rad), pushes (mm) and curvatures (1/mm) of its pieces.
    rounds, swarms, nodes
        What the search that found it went through, kept with the path.
    """
    arcs = push(pose, controls)
    gaps = problem.scene.least_distance(arcs)
    if len(gaps) and gaps.min() < problem.settings.safety:
        worst = int(gaps.argmin())
        return NeedlePath(
            rounds=rounds,
            swarms=swarms,
            nodes=nodes,
            reason=f"the best path comes to {gaps[worst]:.3f} mm from obstacle {worst + 1}, "
            f"under safety_mm {problem.settings.safety:g}",
        )
    return NeedlePath(
        pose=pose,
        controls=controls,
        clearances=gaps,
        error=float(np.linalg.norm(arcs.tips - problem.target)),
        danger=float((problem.settings.safety / gaps).sum()) if len(gaps) else 0.0,
        rounds=rounds,
        swarms=swarms,
        nodes=nodes,
    )
