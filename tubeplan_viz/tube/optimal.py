"""The best path under a curvature limit: sequential convex programming with proved bounds."""

# Strategy: a cubic spline is fitted to the centerline. Every round solves one second-order-cone
# programme around it (`socp`) and takes the step if the true merit falls: the sampled clearance,
# exact to the faces found, and the curvature's proved bound. The boxes that hold the step grow and
# shrink with the agreement of promise and gain. A phase ends when it gains nothing more; then the clearance
# is bounded between the samples, places that the samples missed are added and the phase goes on.
# First the least clearance is raised, then the aim asked for follows with the least kept.

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import CaseError
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import Bound, SplineCurve, WallDistance, clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.plan import Limits, NoPathError
from tubeplan_viz.tube.socp import MEAN_SHARE, Aim, Basis, StepProblem, WallRows, wall_rows

OBJECTIVES = ("clearance", "length", "curvature")
# Second aim of each objective, after the least clearance has been raised.
SECOND_AIM = {"clearance": "mean", "length": "length", "curvature": "curvature"}
# Aimed at, as a share of the curvature limit, so that the bound between the samples meets it.
CURVATURE_AIM = 0.9998
CLEARANCE_TOLERANCE = 0.002
CURVATURE_SAMPLES = 4


@dataclass(frozen=True, kw_only=True)
class OptimalSettings:
    """Numbers of the optimal refinement.

    Attributes
    ----------
    objective : {"clearance", "length", "curvature"}
        What is best: the largest least clearance and then the largest mean; or, with both
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
    keep: float = 0.998
    tolerance: float = 2e-4
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


@dataclass(frozen=True, eq=False)
class State:
    """Control points with what was measured on them."""

    control: FloatArray
    rows: WallRows
    curvature: float

    @property
    def least(self) -> float:
        """Least sampled clearance, mm."""
        return float(self.rows.clearance.min())

    @property
    def mean(self) -> float:
        """Mean sampled clearance, mm."""
        return float(self.rows.clearance.mean())


@dataclass(frozen=True, eq=False)
class Grid:
    """Knots and the samples at which a path is held to its limits."""

    knots: FloatArray
    clearance_u: FloatArray
    wall: WallDistance
    clearance_basis: Basis = field(init=False)
    curvature_basis: Basis = field(init=False)

    def __post_init__(self) -> None:
        breaks = np.unique(self.knots)
        share = np.arange(CURVATURE_SAMPLES) / CURVATURE_SAMPLES
        u = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * share).ravel(), 1.0)
        object.__setattr__(self, "clearance_basis", Basis.at(self.knots, self.clearance_u))
        object.__setattr__(self, "curvature_basis", Basis.at(self.knots, u))

    def curve(self, control: FloatArray) -> SplineCurve:
        """The cubic with these control points."""
        return SplineCurve(3, self.knots, control)

    def measure(self, control: FloatArray, limit: float) -> State:
        """Clearances at the samples and the proved curvature."""
        basis = self.clearance_basis
        rows = wall_rows(basis.curve(control), basis.curve(control, 1), self.wall)
        return State(control, rows, curvature_upper_bound(self.curve(control), limit=limit, tolerance=0.002).bound)

    def with_samples(self, u: FloatArray) -> Grid:
        """The same with more samples for the clearance."""
        return Grid(self.knots, np.union1d(self.clearance_u, u), self.wall)

    def reach(self, clearance: FloatArray) -> FloatArray:
        """Least clearance over the stretch that each control point moves, (n,) mm."""
        least = np.full(len(self.knots) - 4, np.inf)
        for j in range(4):
            np.minimum.at(least, self.clearance_basis.first + j, clearance)
        return np.where(np.isfinite(least), least, float(clearance.min()))


def optimise(passage: Passage, settings: OptimalSettings, *, warm: SplineCurve | None = None) -> Iterator[Proposal]:
    """Yield the fitted spline, then the path after every round; the last one is the answer.

    Parameters
    ----------
    passage : Passage
    settings : OptimalSettings
    warm : SplineCurve, optional
        A path to begin from instead of the passage's line, of an earlier answer in the same place.

    Raises
    ------
    NoPathError
        If no spline with this control spacing, nor with a quarter of it, stays inside the lumen along the line.
    """
    limits = passage.limits
    grid, control = warm_start(passage, warm) if warm is not None else first_spline(passage, settings)
    aim = Aim(goal="least", curvature=limits.curvature_max * CURVATURE_AIM)
    state = grid.measure(control, limits.curvature_max)
    yield proposal(grid, state, "fit", (f"spline of {len(control)} control points fitted to the centerline",))
    best: Proposal | None = None
    fixed = (settings.start_direction is not None, settings.goal_direction is not None)
    for done in run_phase(passage, grid, state, aim, fixed, settings):
        grid, state, shown = done
        best = shown
        yield shown
    assert best is not None
    assert best.clearance is not None
    second = SECOND_AIM[settings.objective]
    floor = best.clearance.bound * settings.keep
    if settings.objective == "clearance":
        floor = max(floor, min(best.clearance.bound, limits.clearance_min + CLEARANCE_TOLERANCE))
    else:
        floor = min(best.clearance.bound, limits.clearance_min + CLEARANCE_TOLERANCE)
    if best.curvature > limits.curvature_max:
        return
    aim = replace(aim, goal=second, floor=np.minimum(floor + 0.5 * CLEARANCE_TOLERANCE, state.rows.clearance))
    first = best
    for _, _, shown in run_phase(passage, grid, state, aim, fixed, settings):
        best = shown
        yield shown
    assert best.clearance is not None
    if best.clearance.bound < floor - CLEARANCE_TOLERANCE or best.curvature > limits.curvature_max:
        yield replace(first, decisions=("the second phase could not be proved: the path of the first stands",))


def run_phase(
    passage: Passage, grid: Grid, state: State, aim: Aim, fixed: tuple[bool, bool], settings: OptimalSettings
) -> Iterator[tuple[Grid, State, Proposal]]:
    """Rounds towards one aim, then its proof; what the samples missed is added and the rounds go on."""
    limit = passage.limits.curvature_max
    for attempt in range(4):
        for reached, note in rounds(grid, state, aim, limit, fixed, settings):
            state = reached
            yield grid, state, proposal(grid, state, aim.goal, (note,))
        curve = grid.curve(state.control)
        proved = clearance_lower_bound(curve, passage.wall, tolerance=CLEARANCE_TOLERANCE)
        missed = state.least - proved.sampled
        sharp = state.curvature > limit
        last = attempt == 3 or not (missed > 2.0 * CLEARANCE_TOLERANCE or (sharp and state.curvature < 1.02 * limit))
        note = f"clearance proved to be at least {proved.bound:.3f} mm, curvature at most {state.curvature:.4f} 1/mm"
        if last:
            yield grid, state, replace(proposal(grid, state, aim.goal, (note,)), clearance=proved)
            return
        if sharp:
            aim = replace(aim, curvature=aim.curvature * limit / state.curvature * CURVATURE_AIM)
        added = np.clip(proved.at + np.array([-0.5, 0.0, 0.5]) * np.diff(grid.clearance_u).min(), 0.0, 1.0)
        floor = np.interp(
            np.union1d(grid.clearance_u, added), grid.clearance_u, np.broadcast_to(aim.floor, grid.clearance_u.shape)
        )
        grid, aim = grid.with_samples(added), replace(aim, floor=floor)
        state = grid.measure(state.control, limit)


def rounds(
    grid: Grid, state: State, aim: Aim, limit: float, fixed: tuple[bool, bool], settings: OptimalSettings
) -> Iterator[tuple[State, str]]:
    """Accepted steps of one phase, each with what it did in words."""
    scale = max(float(np.median(state.rows.clearance)), 1e-3)
    penalty = 20.0 * scale
    trust, idle, refused = 0.3, 0, 0
    for _ in range(settings.max_rounds):
        problem = StepProblem(state.control, grid.clearance_basis, grid.curvature_basis, state.rows, fixed)
        now = merit(grid, state, aim, penalty)
        found = problem.solve(aim, trust * grid.reach(state.rows.clearance), penalty)
        if found is None:
            trust *= 0.25
            if trust < 1e-4:
                return
            continue
        control, cost = found
        after = grid.measure(control, limit)
        gain, promise = now - merit(grid, after, aim, penalty), now - cost
        if gain > 0.0:
            note = (
                f"{aim.goal}: clearance least {after.least:.3f}, mean {after.mean:.3f} mm, curvature {after.curvature:.4f} 1/mm"
            )
            if refused:
                note += f"; {refused} longer steps refused"
            state, refused = after, 0
            yield state, note
        else:
            refused += 1
        trust = trust * 0.3 if gain < 0.2 * promise else min(trust * 2.0, 0.5) if gain > 0.7 * promise else trust
        idle = (
            idle + 1
            if max(gain, 0.0) < settings.tolerance * scale and (gain > 0.0 or promise < settings.tolerance * scale)
            else 0
        )
        if idle >= 2 or trust < 1e-4:
            return


def merit(grid: Grid, state: State, aim: Aim, penalty: float) -> float:
    """Cost of a state as it truly is, in the units of the step's programme."""
    excess = max(state.curvature / aim.curvature - 1.0, 0.0)
    if aim.goal == "least":
        return penalty * excess - state.least - MEAN_SHARE * state.mean
    short = float(np.maximum(np.broadcast_to(aim.floor, state.rows.clearance.shape) - state.rows.clearance, 0.0).max())
    if aim.goal == "curvature":
        return state.curvature / aim.curvature + penalty * short
    if aim.goal == "mean":
        return penalty * (excess + short) - state.mean
    first = grid.curvature_basis.curve(state.control, 1)
    return penalty * (excess + short) + float(np.sqrt((first**2).sum(axis=1).mean()))


def proposal(grid: Grid, state: State, phase: str, decisions: tuple[str, ...]) -> Proposal:
    """A state as it is shown."""
    return Proposal(
        curve=grid.curve(state.control),
        phase=phase,
        least=state.least,
        mean=state.mean,
        curvature=state.curvature,
        decisions=decisions,
    )


def first_spline(passage: Passage, settings: OptimalSettings) -> tuple[Grid, FloatArray]:
    """Spline fitted to the line, as smooth as it can be without losing more than half of the line's least clearance."""
    line, wall = passage.line, passage.wall
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    wanted = 0.5 * float(wall.distance(line).min())
    for refinement in (1.0, 2.0, 4.0):
        count = max(int(np.ceil(s[-1] * refinement / settings.control_spacing)), 8) + 3
        knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, count - 2), np.ones(3)])
        u = np.linspace(0.0, 1.0, 4 * count)
        target = np.column_stack([np.interp(u * s[-1], s, line[:, k]) for k in range(3)])
        basis = Basis.at(knots, u)
        for smoothing in (3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 1e-3):
            control = fit(basis, target, line[[0, -1]], count, smoothing)
            control = turn_ends(control, settings)
            grid = Grid(knots, u, wall)
            points = basis.curve(control)
            if wall.inside(points[1:-1]).all() and wall.distance(points).min() >= min(
                wanted, 0.9 * wall.distance(line[[0, -1]]).min()
            ):
                return Grid(knots, sample_parameters(grid.curve(control), wall), wall), control
    raise NoPathError(
        f"no spline with a control point every {settings.control_spacing / 4.0:.2g} mm follows the centerline inside the lumen; "
        "check the segmentation for folds, or give a smaller control_spacing"
    )


def fit(basis: Basis, target: FloatArray, ends: FloatArray, count: int, smoothing: float) -> FloatArray:
    """Least-squares control points through fixed ends, with a cost on their third differences."""
    matrix = np.zeros((len(target), count))
    np.put_along_axis(matrix, basis.first[:, None] + np.arange(4), basis.values[0], axis=1)
    rough = np.sqrt(smoothing) * np.diff(np.eye(count), n=3, axis=0)
    whole = np.concatenate([matrix, rough])
    right = np.concatenate([target, np.zeros((len(rough), 3))]) - whole[:, [0, -1]] @ ends
    inner = np.linalg.lstsq(whole[:, 1:-1], right, rcond=None)[0]
    return np.concatenate([ends[:1], inner, ends[1:]])


def turn_ends(control: FloatArray, settings: OptimalSettings) -> FloatArray:
    """Second and last but one control point moved onto the directions asked for at the ends."""
    control = np.array(control)
    for direction, end, inner, sign in ((settings.start_direction, 0, 1, 1.0), (settings.goal_direction, -1, -2, -1.0)):
        if direction is not None:
            unit = sign * np.asarray(direction) / np.linalg.norm(direction)
            control[inner] = control[end] + np.linalg.norm(control[inner] - control[end]) * unit
    return control


def sample_parameters(curve: SplineCurve, wall: WallDistance) -> FloatArray:
    """Parameters whose distance along the path is at most 0.3 times the clearance there, and 1 mm."""
    u = curve.uniform_parameters(0.25)
    spacing = np.clip(0.3 * wall.distance(curve(u)), 0.05, 1.0)
    s = curve.arc_length(u)
    # As many samples as the integral of their density.
    density = np.concatenate([[0.0], np.cumsum(np.diff(s) / np.minimum(spacing[1:], spacing[:-1]))])
    count = int(np.ceil(density[-1])) + 1
    picked = np.interp(np.linspace(0.0, density[-1], count + 1), density, u)
    picked[0], picked[-1] = 0.0, 1.0
    return np.unique(picked)


def warm_start(passage: Passage, warm: SplineCurve) -> tuple[Grid, FloatArray]:
    """The grid of an earlier answer."""
    return Grid(warm.knots, sample_parameters(warm, passage.wall), passage.wall), np.array(warm.control_points)


def passage_of(wall: WallDistance, centerline: Centerline, limits: Limits) -> Passage:
    """The passage along a centerline."""
    return Passage(wall=wall, line=centerline.points, limits=limits)
