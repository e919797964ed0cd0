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
# How far below its least sample, in mm and as a share of it, the clearance is proved.
CLEARANCE_TOLERANCE = 0.002
PROOF_SHARE = 0.003
CURVATURE_SAMPLES = 4
# Share of the largest least clearance that an answer of the second phase must be proved to keep.
KEPT = 0.996
# Share of the clearance that a control point may move in one round: under 1 / sqrt(3), so that no wall is passed.
TRUST_MAX = 0.5
REFUSALS = 4
ATTEMPTS = 3
# The second aim is worth less precision than the least clearance.
MEAN_COARSER = 6.0
# Nearer to a ceiling that no path passes is not worth a round.
CEILING_SHARE = 0.997


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
    keep: float = 0.999
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

    def measure(self, control: FloatArray, limit: float, *, known: State | None = None) -> State:
        """Clearances at the samples, with the faces found for a state near by too, and the proved curvature."""
        basis = self.clearance_basis
        rows = wall_rows(basis.curve(control), basis.curve(control, 1), self.wall, None if known is None else known.rows.faces)
        return State(control, rows, curvature_upper_bound(self.curve(control), limit=limit, tolerance=0.002).bound)

    def inside(self, control: FloatArray) -> bool:
        """Whether all samples but the ends, which may lie on caps, are in the lumen."""
        return bool(self.wall.inside(self.clearance_basis.curve(control)[1:-1]).all())

    def with_samples(self, u: FloatArray) -> Grid:
        """The same with more samples for the clearance."""
        return Grid(self.knots, np.union1d(self.clearance_u, u), self.wall)


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
    fixed = (settings.start_direction is not None, settings.goal_direction is not None)
    ends = passage.wall.distance(passage.line[[0, -1]])
    ceiling = float(ends.min())
    for reached in run_phase(passage, grid, state, aim, fixed, settings, ceiling=ceiling):
        yield reached[2]
    grid, state, first = reached
    assert first.clearance is not None
    if first.curvature > limits.curvature_max:
        return
    floor, slack = first.clearance.bound * settings.keep, tolerance_of(state)
    if settings.objective == "clearance":
        floor = max(floor, min(first.clearance.bound, limits.clearance_min + slack))
    else:
        floor = min(first.clearance.bound, limits.clearance_min + slack)
    aim = replace(aim, floor=np.minimum(floor + 0.5 * slack, state.rows.clearance))
    span = interior(grid, state, ends)
    if settings.objective == "clearance" and first.least > 0.99 * ceiling and span != (0.0, 1.0):
        yield replace(first, decisions=("an end of the path binds: the least clearance away from it is raised next",))
        for reached in run_phase(passage, grid, state, replace(aim, span=span), fixed, settings):
            yield reached[2]
        grid, state, _ = reached
        inside = replace(aim, span=span).inside(grid.clearance_u)
        kept = np.where(inside, settings.keep * state.rows.clearance[inside].min(), floor + 0.5 * slack)
        aim = replace(aim, floor=np.minimum(np.maximum(kept, floor + 0.5 * slack), state.rows.clearance))
    needed = min(first.clearance.bound, limits.clearance_min)
    if settings.objective == "clearance":
        needed = max(KEPT * first.clearance.bound, needed)
    aim = replace(aim, goal=SECOND_AIM[settings.objective])
    for _ in range(ATTEMPTS):
        for reached in run_phase(passage, grid, state, aim, fixed, settings):
            yield reached[2]
        shown = reached[2]
        assert shown.clearance is not None
        if shown.clearance.bound >= needed and shown.curvature <= limits.curvature_max:
            return
        # The samples hold the floor, the wall between them does not: hold a higher one.
        higher = aim.floor + max(needed - shown.clearance.bound, 0.0) + slack
        aim = replace(aim, floor=np.minimum(higher, state.rows.clearance))
    yield replace(first, decisions=("the second phase could not be proved: the path of the first stands",))


def interior(grid: Grid, state: State, ends: FloatArray) -> tuple[float, float]:
    """Parameters between which the ends' own clearances bind no more.

    2 mm of path are left to an end for every mm that it is short of the median clearance;
    an end that is short by less than 3 % is left none.
    """
    median = float(np.median(state.rows.clearance))
    short = np.where(ends < 0.97 * median, median - ends, 0.0)
    curve = grid.curve(state.control)
    margin = np.minimum(2.0 * short, 0.15 * curve.length)
    first, last = curve.parameter([margin[0], curve.length - margin[1]])
    return (float(first) if short[0] > 0.0 else 0.0, float(last) if short[1] > 0.0 else 1.0)


def run_phase(
    passage: Passage,
    grid: Grid,
    state: State,
    aim: Aim,
    fixed: tuple[bool, bool],
    settings: OptimalSettings,
    *,
    ceiling: float = np.inf,
) -> Iterator[tuple[Grid, State, Proposal]]:
    """Rounds towards one aim, then its proof; what the samples missed is added and the rounds go on.

    No more is asked once the least clearance comes within a thousandth of the `ceiling`.
    """
    limit = passage.limits.curvature_max
    for attempt in range(ATTEMPTS):
        for reached, note in rounds(grid, state, aim, limit, fixed, settings):
            state = reached
            yield grid, state, proposal(grid, state, aim.goal, (note,))
            if state.least > CEILING_SHARE * ceiling and state.curvature <= limit:
                break
        missed = missed_places(grid, state, aim)
        sharp = state.curvature > limit
        if attempt == ATTEMPTS - 1 or not (len(missed) or sharp):
            break
        if sharp and state.curvature < 1.02 * limit:
            aim = replace(aim, curvature=aim.curvature * limit / state.curvature * CURVATURE_AIM)
        finer = grid.with_samples(missed)
        floor = np.interp(finer.clearance_u, grid.clearance_u, np.broadcast_to(aim.floor, grid.clearance_u.shape))
        grid, aim = finer, replace(aim, floor=floor)
        control = state.control if not sharp or any(fixed) else evened(grid, state)
        state = grid.measure(control, limit)
    proved = clearance_lower_bound(grid.curve(state.control), passage.wall, tolerance=tolerance_of(state))
    note = f"clearance proved to be at least {proved.bound:.3f} mm, curvature at most {state.curvature:.4f} 1/mm"
    yield grid, state, replace(proposal(grid, state, aim.goal, (note,)), clearance=proved)


def evened(grid: Grid, state: State) -> FloatArray:
    """Control points of nearly the same path at even speed, where the programme's curvature is the true one."""
    curve = grid.curve(state.control)
    count = len(state.control)
    u = np.linspace(0.0, 1.0, 4 * count)
    target = curve(curve.parameter(u * curve.length))
    return fit(Basis.at(grid.knots, u), target, state.control[[0, -1]], count, 1e-4)


def tolerance_of(state: State) -> float:
    """How exactly the least clearance of a state is to be known, mm."""
    return min(CLEARANCE_TOLERANCE, max(PROOF_SHARE * state.least, 1e-4))


def missed_places(grid: Grid, state: State, aim: Aim) -> FloatArray:
    """Parameters between the samples at which the clearance has a minimum below that of all samples in the aim's span."""
    share = np.arange(1, 4) / 4.0
    u = (grid.clearance_u[:-1, None] + np.diff(grid.clearance_u)[:, None] * share).ravel()
    basis = Basis.at(grid.knots, u)
    clearance = wall_rows(basis.curve(state.control), basis.curve(state.control, 1), grid.wall).clearance
    padded = np.concatenate([[np.inf], clearance, [np.inf]])
    lowest = (
        (clearance <= padded[:-2])
        & (clearance <= padded[2:])
        & (clearance < state.rows.clearance[aim.inside(grid.clearance_u)].min() - CLEARANCE_TOLERANCE)
    )
    return np.asarray(u[lowest & aim.inside(u)])


def rounds(
    grid: Grid, state: State, aim: Aim, limit: float, fixed: tuple[bool, bool], settings: OptimalSettings
) -> Iterator[tuple[State, str]]:
    """Accepted steps of one phase, each with what it did in words."""
    scale = max(float(np.median(state.rows.clearance)), 1e-3)
    penalty = 20.0 * scale
    enough = settings.tolerance * scale * (1.0 if aim.goal == "least" else MEAN_COARSER)
    trust, idle, refused = 0.3, 0, 0
    for _ in range(settings.max_rounds):
        problem = StepProblem(state.control, grid.clearance_u, grid.clearance_basis, grid.curvature_basis, state.rows, fixed)
        now = merit(grid, state, aim, limit, penalty)
        found = problem.solve(aim, trust, penalty)
        gain, promise = 0.0, np.inf
        if found is not None:
            after = grid.measure(found[0], limit, known=state)
            gain, promise = now - merit(grid, after, aim, limit, penalty), now - found[1]
        if found is not None and gain > 0.0 and grid.inside(found[0]):
            note = (
                f"{aim.goal}: clearance least {after.least:.3f}, mean {after.mean:.3f} mm, curvature {after.curvature:.4f} 1/mm"
            )
            if refused:
                note += f"; {refused} longer steps refused"
            state, refused = after, 0
            idle = idle + 1 if gain < enough else 0
            yield state, note
        else:
            refused += 1
            if found is not None:
                state = grid.measure(state.control, limit, known=after)
        if gain < 0.25 * promise:
            trust *= 0.3
        elif gain > 0.7 * promise:
            trust = min(2.0 * trust, TRUST_MAX)
        if idle >= (2 if aim.goal == "least" else 1) or max(promise, gain) < enough or refused >= REFUSALS:
            return


def merit(grid: Grid, state: State, aim: Aim, limit: float, penalty: float) -> float:
    """Cost of a state as it truly is, in the units of the step's programme; bends up to the limit itself are free."""
    excess = max(state.curvature / limit - 1.0, 0.0)
    short = float(np.maximum(np.broadcast_to(aim.floor, state.rows.clearance.shape) - state.rows.clearance, 0.0).max())
    if aim.goal == "least":
        least = float(state.rows.clearance[aim.inside(grid.clearance_u)].min())
        return penalty * (excess + short) - least - MEAN_SHARE * state.mean
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
