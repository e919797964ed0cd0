"""The tube planner: from a surface and two points to a plan, step by step."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from tubeplan_viz.centerline import Centerline, CenterlineSettings, VoronoiGraph, trace_centerline, voronoi_graph
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.plan import Feature, FeatureKind, FlaggedInterval, FlagKind, Limits, NoPathError, Plan, PlanStatus, PlanStep
from tubeplan_viz.profile import certify, flag_stretches, measure_closely, measure_path, path_metrics, with_peaks
from tubeplan_viz.tube.explain import explain
from tubeplan_viz.tube.features import FeatureSettings
from tubeplan_viz.tube.never_worse import never_worse
from tubeplan_viz.tube.passage import OptimalSettings, Proposal, passage_of
from tubeplan_viz.tube.refine import RefineSettings, Round, first_features, refine
from tubeplan_viz.tube.slices import SliceClearance

METHODS = ("optimal", "feature_iteration")


@dataclass(frozen=True, kw_only=True)
class TubeSettings:
    """Settings of every step of the tube planner."""

    method: str = "optimal"
    closed_ends: bool = False
    centerline: CenterlineSettings = field(default_factory=CenterlineSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    refine: RefineSettings = field(default_factory=RefineSettings)
    optimal: OptimalSettings = field(default_factory=OptimalSettings)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise CaseError(f"the tube planner has no method {self.method!r}; expected {' or '.join(METHODS)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class TubeProblem:
    """What the iteration works on: the wall and the centerline from start to goal."""

    surface: Surface
    wall: WallDistance
    centerline: Centerline
    start: FloatArray
    goal: FloatArray
    limits: Limits
    settings: TubeSettings

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", frozen_array(self.start, (3,), "start"))
        object.__setattr__(self, "goal", frozen_array(self.goal, (3,), "goal"))


def pose_problem(
    surface: Surface,
    start: ArrayLike,
    goal: ArrayLike,
    limits: Limits,
    settings: TubeSettings,
    *,
    wall: WallDistance | None = None,
    graph: VoronoiGraph | None = None,
) -> TubeProblem:
    """Check start and goal and find the centerline between them.

    Parameters
    ----------
    surface : Surface
    start, goal : (3,) array_like, mm
    limits : Limits
    settings : TubeSettings
    wall, graph : optional
        Reused when they were made before, for the end points.

    Raises
    ------
    CaseError
        If start or goal lies outside the lumen, or they are one point.
    NoPathError
        If no chain of inscribed spheres joins them.
    """
    ends = np.array([start, goal], dtype=float)
    wall = wall or WallDistance(surface, closed_ends=settings.closed_ends)
    for name, point in zip(("start", "goal"), ends, strict=True):
        check_inside(name, point, wall)
    if np.linalg.norm(ends[1] - ends[0]) < 1e-3:
        raise CaseError(f"start and goal are both {place(ends[0])}; expected two different points")
    graph = graph or voronoi_graph(surface, wall)
    centerline = trace_centerline(graph, wall, ends[0], ends[1], settings.centerline)
    if centerline is None:
        raise NoPathError(
            f"no way inside the lumen leads from the start {place(ends[0])} to the goal {place(ends[1])}: "
            "they lie in parts that no inscribed sphere joins; choose a goal in the same part or check the segmentation there"
        )
    return TubeProblem(
        surface=surface, wall=wall, centerline=centerline, start=ends[0], goal=ends[1], limits=limits, settings=settings
    )


def check_inside(name: str, point: FloatArray, wall: WallDistance) -> None:
    """Refuse a start or goal outside the lumen, saying how far off it is and where the lumen begins."""
    if wall.inside(point)[0]:
        return
    distance, _, foot = wall.nearest(point)
    raise CaseError(
        f"the {name} {place(point)} lies outside the lumen, {distance[0]:.2f} mm from its wall at {place(foot[0])}; "
        "give a point inside, or a label from `tubeplan endpoints`"
    )


def place(point: FloatArray) -> str:
    """A point as text, mm."""
    return f"({point[0]:.2f}, {point[1]:.2f}, {point[2]:.2f}) mm"


def tube_rounds(problem: TubeProblem) -> Iterator[Round]:
    """The bare iteration, without measuring each round for the reviewer."""
    settings = problem.settings
    if settings.method == "optimal":
        passage = passage_of(problem.wall, problem.centerline, problem.limits)

        def local_path() -> SplineCurve:
            return deque(feature_rounds(problem), maxlen=1)[0].curve

        return (round_of(index, proposal) for index, proposal in enumerate(never_worse(passage, settings.optimal, local_path)))
    return feature_rounds(problem)


def feature_rounds(problem: TubeProblem) -> Iterator[Round]:
    """The paper's iteration, whatever method the problem names."""
    settings = problem.settings
    slices = SliceClearance(problem.surface, problem.wall, limit=problem.limits.clearance_min, pairs=settings.refine.slice_pairs)
    features = first_features(problem.centerline, settings.features)
    return refine(features, problem.centerline, slices, problem.limits, settings.refine)


def round_of(index: int, proposal: Proposal) -> Round:
    """A round of the optimal refinement: it has no features but its ends, and moves all control points."""
    start, goal = proposal.curve([0.0, 1.0])
    features = (Feature(kind=FeatureKind.START, point=start, u=0.0), Feature(kind=FeatureKind.GOAL, point=goal, u=1.0))
    return Round(index=index, curve=proposal.curve, features=features, moved=0, added=0, decisions=proposal.decisions)


def tube_steps(problem: TubeProblem, *, time_budget: float | None = None) -> Iterator[PlanStep]:
    """Yield every round, measured over the whole path against both limits.

    Parameters
    ----------
    problem : TubeProblem
    time_budget : float, s, optional
        After it no further round is begun; the rounds up to then stand.

    Notes
    -----
    Insertion for clearance can undo what relaxation had mended. When the feature iteration
    ends worse than it once stood, a last step goes back to the round that broke the limits
    least; the text would give out the last round.
    """
    begun = time.monotonic()
    best: PlanStep | None = None
    step: PlanStep | None = None
    for state in tube_rounds(problem):
        profile = measure_path(state.curve, problem.wall)
        flagged = flag_stretches(profile, problem.limits)
        late = time_budget is not None and time.monotonic() - begun > time_budget
        decisions = (*state.decisions, f"time budget of {time_budget:g} s used up") if late else state.decisions
        step = PlanStep(
            index=state.index,
            curve=state.curve,
            features=state.features,
            profile=profile,
            flagged=flagged,
            moved=state.moved,
            added=state.added,
            decisions=decisions,
        )
        yield step
        if best is None or excess(step, problem.limits) <= excess(best, problem.limits):
            best = step
        if late:
            break
    if step is None or best is None or best is step or problem.settings.method != "feature_iteration":
        return
    decision = f"back to round {best.index}, which breaks the limits least; the last one stands worse"
    yield replace(best, index=step.index + 1, moved=0, added=0, decisions=(decision,))


def excess(step: PlanStep, limits: Limits) -> float:
    """By what shares a step breaks both limits, added; a path outside the lumen is worse than any other."""
    curvature = max(float(step.profile.curvature.max()) / limits.curvature_max - 1.0, 0.0)
    least = float(step.profile.clearance.min())
    clearance = max(1.0 - least / limits.clearance_min, 0.0) if limits.clearance_min > 0 else 0.0
    return curvature + clearance + (1e6 if least <= 0 else 0.0)


def conclude(problem: TubeProblem, steps: Sequence[PlanStep]) -> Plan:
    """Verify the last round over the full interval, prove it between the samples, and say how it ended."""
    last = steps[-1]
    limits = problem.limits
    fine = measure_closely(last.curve, problem.wall, limits)
    flagged = with_peaks(flag_stretches(fine, limits), last.curve, problem.wall)
    certificate = certify(last.curve, problem.wall, limits)
    metrics = path_metrics(last.profile, problem.centerline)
    # Extremes are those of the fine samples: a reader must not find a worse one in a flag.
    sharpest = (flag.worst for flag in flagged if flag.kind is FlagKind.CURVATURE)
    tightest = (flag.worst for flag in flagged if flag.kind is FlagKind.CLEARANCE)
    metrics["curvature_max_per_mm"] = float(max(fine.curvature.max(), last.profile.curvature.max(), *sharpest))
    metrics["clearance_min_mm"] = float(min(fine.clearance.min(), last.profile.clearance.min(), *tightest))
    widest = int(np.argmax(problem.centerline.radii))
    narrowest = int(np.argmin(problem.centerline.radii))
    status, reason = verdict(problem, flagged, certificate.holds, widest)
    details: dict[str, Any] = {
        "closed_ends": problem.settings.closed_ends,
        "centerline_radius_min": bottleneck(problem.centerline, narrowest),
        "feature_scans": list(problem.settings.features.scans),
        "start_mm": problem.start,
        "goal_mm": problem.goal,
    }
    if problem.settings.method == "optimal" and status is not PlanStatus.OK:
        path = last.curve if certificate.curvature_upper_bound <= limits.curvature_max else None
        why = explain(problem.wall, problem.centerline, limits, problem.settings.optimal, path=path)
        details |= why.details
        status = PlanStatus.INFEASIBLE if why.impossible else status
        reason = why.sentence if why.impossible else f"{reason}; {why.sentence}"
    return Plan(
        planner="tube",
        method=problem.settings.method,
        status=status,
        reason=reason,
        limits=limits,
        curve=last.curve,
        profile=last.profile,
        features=last.features,
        centerline=problem.centerline,
        steps=tuple(steps),
        flagged=flagged,
        certificate=certificate,
        metrics=metrics,
        details=details,
    )


def verdict(
    problem: TubeProblem, flagged: tuple[FlaggedInterval, ...], holds: bool, widest: int
) -> tuple[PlanStatus, str | None]:
    """Status and its reason in one sentence."""
    limits, radii = problem.limits, problem.centerline.radii
    if radii[widest] < limits.clearance_min:
        return PlanStatus.INFEASIBLE, (
            "the lumen is narrower than the instrument everywhere: its widest inscribed sphere on the way has a radius of "
            f"{radii[widest]:.2f} mm at {problem.centerline.arc_length[widest]:.1f} mm, "
            f"{place(problem.centerline.points[widest])}; "
            f"{limits.clearance_min:g} mm are required"
        )
    if flagged:
        return PlanStatus.FLAGGED, flag_sentence(flagged, limits)
    if not holds:
        return PlanStatus.FLAGGED, "every sample keeps both limits, but the bounds between the samples could not be proved"
    return PlanStatus.OK, None


def flag_sentence(flagged: tuple[FlaggedInterval, ...], limits: Limits) -> str:
    """What is broken, how badly and where, worst of each kind."""
    parts = []
    clearance = [f for f in flagged if f.kind is FlagKind.CLEARANCE]
    curvature = [f for f in flagged if f.kind is FlagKind.CURVATURE]
    if clearance:
        worst = min(clearance, key=lambda f: f.worst)
        parts.append(
            f"clearance falls to {worst.worst:.2f} mm at {worst.worst_at:.1f} mm where {limits.clearance_min:g} mm are required "
            f"({stretches(clearance)})"
        )
    if curvature:
        worst = max(curvature, key=lambda f: f.worst)
        parts.append(
            f"curvature rises to {worst.worst:.4f} 1/mm at {worst.worst_at:.1f} mm "
            f"where {limits.curvature_max:g} 1/mm are allowed "
            f"({stretches(curvature)})"
        )
    return "; ".join(parts)


def stretches(flagged: list[FlaggedInterval]) -> str:
    """How many stretches and how long they are in all."""
    total = sum(f.end - f.start for f in flagged)
    return f"{len(flagged)} stretch{'es' if len(flagged) > 1 else ''}, {total:.1f} mm in all"


def bottleneck(centerline: Centerline, narrowest: int) -> dict[str, Any]:
    """Smallest inscribed sphere of the way through, for result.json."""
    return {
        "radius_mm": centerline.radii[narrowest],
        "at_mm": centerline.arc_length[narrowest],
        "point_mm": centerline.points[narrowest],
    }
