"""What the optimal refinement is asked for, and what it answers with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import CaseError
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import Bound, SplineCurve, WallDistance
from tubeplan_viz.plan import Limits

OBJECTIVES = ("clearance", "length", "curvature")


@dataclass(frozen=True, kw_only=True)
class OptimalSettings:
    """Numbers of the optimal refinement.

    Attributes
    ----------
    objective : {"clearance", "length", "curvature"}
        What is best: the largest least clearance and then the largest mean, less what bends cost; or, with both
        limits kept, the shortest or the straightest path.
    control_spacing : float, mm
        Distance between control points along the path. 2.5 mm loses under 0.3 % of the least
        clearance of bent cylinder 1 and its variants, 5 mm up to 1 %.
    keep : float
        Share of the largest least clearance that the second phase keeps.
    tolerance : float
        A phase ends when three rounds gain less than this share of the clearance.
    max_rounds : int
        Of each phase.
    start_direction, goal_direction : 3 floats, optional
        Direction of the path at its ends, from start to goal; free by default.
    """

    objective: str = "clearance"
    control_spacing: float = 2.5
    keep: float = 0.9995
    tolerance: float = 2.5e-4
    max_rounds: int = 40
    start_direction: tuple[float, float, float] | None = None
    goal_direction: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.objective not in OBJECTIVES:
            raise CaseError(f"objective is {self.objective!r}, expected {', '.join(OBJECTIVES)}")
        if not 0.5 <= self.control_spacing <= 20.0:
            raise CaseError(
                f"control_spacing is {self.control_spacing:g} mm, expected 0.5 to 20 (about one control point per 3 mm)"
            )
        if not 0.9 <= self.keep <= 1.0:
            raise CaseError(f"keep is {self.keep:g}, expected 0.9 to 1 (share of the least clearance)")
        if self.max_rounds < 1:
            raise CaseError(f"max_rounds is {self.max_rounds}, expected 1 or more")
        for name in ("start_direction", "goal_direction"):
            direction = getattr(self, name)
            if direction is not None and not 1e-9 < float(np.linalg.norm(direction)) < np.inf:
                raise CaseError(f"{name} is {direction}, expected three numbers that are not all zero")


@dataclass(frozen=True, eq=False, kw_only=True)
class Passage:
    """Where a path is to go: the wall, the line to begin from and what the instrument needs.

    Attributes
    ----------
    wall : WallDistance
    line : (n, 3) float array, mm
        Inside the lumen, from the start to the goal.
    limits : Limits
    """

    wall: WallDistance
    line: FloatArray
    limits: Limits

    def __post_init__(self) -> None:
        object.__setattr__(self, "line", frozen_array(self.line, (None, 3), "line"))


def passage_of(wall: WallDistance, centerline: Centerline, limits: Limits) -> Passage:
    """The passage along a centerline."""
    return Passage(wall=wall, line=centerline.points, limits=limits)


@dataclass(frozen=True, eq=False, kw_only=True)
class Proposal:
    """The path after one round.

    Attributes
    ----------
    curve : SplineCurve
    phase : str
        Aim of the phase it belongs to.
    least, mean : float, mm
        Sampled clearance.
    curvature : float, 1/mm
        Proved bound.
    clearance : Bound or None
        Proved at the end of a phase.
    decisions : tuple of str
    """

    curve: SplineCurve
    phase: str
    least: float
    mean: float
    curvature: float
    clearance: Bound | None = None
    decisions: tuple[str, ...] = ()
