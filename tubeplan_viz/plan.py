"""What every planner takes and gives: limits, one iteration, the plan.

Planners yield frozen `PlanStep` objects and end in a `Plan`; recording, report,
result file and verifier know these types and no planner.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, frozen_array
from segmentation.errors import CaseError, TubeplanError
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import SplineCurve


class NoPathError(TubeplanError):
    """No path can even be begun: start and goal are not joined (exit status 4)."""


class PlanStatus(StrEnum):
    """How a planning run ended; the values are those of result.json."""

    OK = "ok"
    FLAGGED = "flagged"
    INFEASIBLE = "infeasible"


class FlagKind(StrEnum):
    """The limit that a stretch of the path breaks."""

    CURVATURE = "curvature"
    CLEARANCE = "clearance"


class FeatureKind(StrEnum):
    """Why a point carries the spline: an end, a scan of the centerline, or a round's repair."""

    START = "start"
    GOAL = "goal"
    EXTREMUM = "extremum"
    SEGMENT = "segment"
    INFLECTION = "inflection"
    NODE = "node"
    CLEARANCE = "clearance"


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the instrument needs.

    Attributes
    ----------
    curvature_max : float, 1/mm
        Reciprocal of the least bend radius.
    clearance_min : float, mm
        Least distance of the path to the wall: the instrument's radius.
    """

    curvature_max: float
    clearance_min: float

    def __post_init__(self) -> None:
        if not 1e-4 <= self.curvature_max <= 10.0:
            raise CaseError(
                f"curvature_max is {self.curvature_max:g} 1/mm, expected 0.0001 to 10 (a bend radius of 0.1 mm to 10 m)"
            )
        if not 0.0 <= self.clearance_min <= 100.0:
            raise CaseError(f"clearance_min is {self.clearance_min:g} mm, expected 0 to 100 (the instrument's radius)")


@dataclass(frozen=True, eq=False, kw_only=True)
class PathProfile:
    """A path sampled along its arc length, ends included; evenly unless said otherwise.

    Attributes
    ----------
    arc_length : (n,) float array, mm
    points, tangents : (n, 3) float array, mm and unit vectors
    curvature, torsion : (n,) float array, 1/mm
    clearance : (n,) float array, mm
        Signed exact distance to the wall, caps left out; negative outside the lumen.
    """

    arc_length: FloatArray
    points: FloatArray
    tangents: FloatArray
    curvature: FloatArray
    torsion: FloatArray
    clearance: FloatArray

    def __post_init__(self) -> None:
        n = len(self.arc_length)
        for name, shape in [
            ("arc_length", (n,)),
            ("points", (n, 3)),
            ("tangents", (n, 3)),
            ("curvature", (n,)),
            ("torsion", (n,)),
            ("clearance", (n,)),
        ]:
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))

    @property
    def length(self) -> float:
        """Arc length of the whole path, mm."""
        return float(self.arc_length[-1])


@dataclass(frozen=True, kw_only=True)
class FlaggedInterval:
    """A stretch of the path, in mm of arc length, on which one limit is broken.

    `worst` is the least clearance in mm or the largest curvature in 1/mm, met at `worst_at`.
    """

    kind: FlagKind
    start: float
    end: float
    worst: float
    worst_at: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Feature:
    """A point that the spline passes through; `u` is its parameter on the curve, `moved` how often it was moved."""

    kind: FeatureKind
    point: FloatArray
    u: float
    moved: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen_array(self.point, (3,), "feature point"))


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanStep:
    """State after one iteration; iteration 0 is the spline before any repair.

    `moved` and `added` count the features moved and added in making this state from
    the one before; `decisions` says in words what was found and done.
    """

    index: int
    curve: SplineCurve
    features: tuple[Feature, ...]
    profile: PathProfile
    flagged: tuple[FlaggedInterval, ...]
    moved: int = 0
    added: int = 0
    decisions: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Bounds that hold for every u, between the samples too."""

    holds: bool
    curvature_upper_bound: float
    clearance_lower_bound: float
    method: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """The end of a planning run, with the best path found even when a limit is broken.

    `metrics` and `details` use the names of result.json.
    """

    planner: str
    method: str
    status: PlanStatus
    reason: str | None
    limits: Limits
    curve: SplineCurve
    profile: PathProfile
    features: tuple[Feature, ...]
    centerline: Centerline
    steps: tuple[PlanStep, ...]
    flagged: tuple[FlaggedInterval, ...]
    certificate: Certificate
    metrics: Mapping[str, float]
    details: Mapping[str, Any] = field(default_factory=dict)


def broken(profile: PathProfile, limits: Limits) -> tuple[BoolArray, BoolArray]:
    """Samples whose curvature, and whose clearance, breaks its limit: two (n,) masks."""
    return (
        np.asarray(profile.curvature > limits.curvature_max),
        np.asarray(profile.clearance < limits.clearance_min),
    )
