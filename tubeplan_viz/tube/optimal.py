"""The best path under a curvature limit: sequential convex programming with proved bounds."""

# Strategy: a cubic spline is fitted to the centerline. Every round solves one second-order-cone
# programme around it (`socp`) and takes the step if the true merit falls: the sampled clearance,
# exact to the faces found, and the curvature's proved bound. The boxes that hold the step grow and
# shrink with the agreement of promise and gain. A phase ends when it gains nothing more; then the clearance
# is bounded between the samples, places that the samples missed are added and the phase goes on.
# First the least clearance is raised, then the aim asked for follows with the least kept; of a mean clearance a little is
# given for a straighter path.

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.geometry import SplineCurve, clearance_lower_bound
from tubeplan_viz.tube.basis import Basis
from tubeplan_viz.tube.nearby import wall_rows
from tubeplan_viz.tube.passage import OBJECTIVES, OptimalSettings, Passage, Proposal, passage_of
from tubeplan_viz.tube.samples import Grid, State, evened, first_spline, turn_ends, warm_start
from tubeplan_viz.tube.socp import MEAN_SHARE, Aim, StepProblem, bend_unit

__all__ = ["CLEARANCE_TOLERANCE", "OBJECTIVES", "OptimalSettings", "Passage", "Proposal", "optimise", "passage_of"]

# Second aim of each objective, after the least clearance has been raised.
SECOND_AIM = {"clearance": "mean", "length": "length", "curvature": "curvature"}
# Aimed at, as a share of the curvature limit, so that the bound between the samples meets it.
CURVATURE_AIM = 0.9998
# How far below its least sample, in mm and as a share of it, the clearance is proved.
CLEARANCE_TOLERANCE = 0.002
PROOF_SHARE = 0.003
# Share of the largest least clearance that an answer of the second phase must be proved to keep.
KEPT = 0.998
# Share of the clearance that a control point may move in one round: under 1 / sqrt(3), so that no wall is passed.
TRUST_MAX = 0.5
TRUST_MIN = 0.01
# Share of the clearance begun with that is not given away for a bend: along the wall a path finds no way to straighten. Where
# the bend cannot be had so, all but the second share is.
GIVEN, SCRAPING = 0.5, 0.02
REFUSALS = 4
SECOND_ROUNDS = 8
# The excess of curvature stalls where so many rounds together take less than this share of it.
STALL_ROUNDS, STALL_SHARE = 4, 0.1
# An excess below this share of the limit is mended by asking for a little more than the limit.
SLIGHT = 0.02
ATTEMPTS = 3
# As often are places that the samples missed added while the least clearance is raised.
CLOSER_LOOKS = 6
# The second aim is worth less precision than the least clearance.
MEAN_COARSER = 20.0
# Share of the median clearance that a path gives away on the mean for bending nowhere instead of everywhere as much as it may:
# without it the path follows every bulge of the wall, which nearly doubles its turns for 1 or 2 % of the mean.
STRAIGHT = 0.3
# Nearer to a ceiling that no path passes is not worth a round.
CEILING_SHARE = 0.997


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
    state = grid.measure(control, limits.curvature_max)
    aim = Aim(goal="least", curvature=limits.curvature_max * CURVATURE_AIM, floor=GIVEN * state.least)
    yield proposal(grid, state, "fit", (f"spline of {len(control)} control points fitted to the centerline",))
    fixed = (settings.start_direction is not None, settings.goal_direction is not None)
    ends = passage.wall.distance(passage.line[[0, -1]])
    ceiling = float(ends.min())
    begun = state.least
    for reached in run_phase(passage, grid, state, aim, fixed, settings, ceiling=ceiling):
        yield reached[2]
    grid, state, first = reached
    if first.curvature > limits.curvature_max and state.least < 1.05 * GIVEN * begun:
        aim = replace(aim, floor=SCRAPING * begun)
        for reached in run_phase(passage, grid, state, aim, fixed, settings, ceiling=ceiling):
            yield reached[2]
        if reached[2].curvature > limits.curvature_max:
            yield replace(first, decisions=("nor does less clearance mend the bend: the path before stands",))
            return
        grid, state, first = reached
    assert first.clearance is not None
    if first.curvature > limits.curvature_max:
        return
    proved, slack = first.clearance.bound, tolerance_of(state)
    floor = needed = limits.clearance_min
    # A limit that is out of reach is no reason to hold on to the last digit.
    if settings.objective == "clearance" or proved < limits.clearance_min:
        # No more is kept than can be told: a proof is exact to the slack.
        floor, needed = settings.keep * proved, min(KEPT * proved, proved - slack)
        if proved >= limits.clearance_min:
            floor, needed = max(floor, min(proved, limits.clearance_min + slack)), max(needed, limits.clearance_min)
    else:
        floor = min(proved, floor + slack)
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
    straight = STRAIGHT * float(np.median(state.rows.clearance))
    aim = replace(aim, goal=SECOND_AIM[settings.objective], straight=straight)
    if aim.goal == "curvature":
        # The programme sees |F''| / |F'|^2, which is the curvature at even speed alone.
        state = grid.measure(turn_ends(evened(grid, state), settings), limits.curvature_max)
    for _ in range(ATTEMPTS):
        for reached in run_phase(passage, grid, state, aim, fixed, settings):
            yield reached[2]
        before, (grid, state, shown) = grid, reached
        assert shown.clearance is not None
        if shown.clearance.bound >= needed and shown.curvature <= limits.curvature_max:
            return
        # The samples hold the floor, the wall between them does not: hold a higher one.
        aim = aim.on(before.clearance_u, grid.clearance_u)
        aim = replace(aim, floor=np.asarray(aim.floor + max(needed - shown.clearance.bound, 0.0) + slack))
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
    looks = CLOSER_LOOKS if first_phase(aim) else ATTEMPTS
    # The first phase decides how much room there is; what follows it is worth a few rounds.
    left = looks * settings.max_rounds if first_phase(aim) else min(settings.max_rounds, SECOND_ROUNDS)
    for look in range(looks):
        for reached in rounds(grid, state, aim, limit, fixed, settings, most=min(left, settings.max_rounds)):
            grid, state, aim, note = reached
            left -= 1
            yield grid, state, proposal(grid, state, aim.goal, (note,))
            if state.least > CEILING_SHARE * ceiling and state.curvature <= limit:
                break
        missed = missed_places(grid, state, aim)
        sharp, slight = state.curvature > limit, state.curvature < (1.0 + SLIGHT) * limit
        if look == looks - 1 or not left or (sharp and look >= (ATTEMPTS - 1 if slight else 1)) or not (sharp or len(missed)):
            break
        if sharp and slight:
            aim = replace(aim, curvature=aim.curvature * limit / state.curvature * CURVATURE_AIM)
        before = grid.clearance_u
        grid, state = grid.with_samples(missed, state)
        aim = aim.on(before, grid.clearance_u)
        if sharp and not any(fixed):
            state = grid.measure(evened(grid, state), limit)
    proved = clearance_lower_bound(grid.curve(state.control), passage.wall, tolerance=tolerance_of(state))
    note = f"clearance proved to be at least {proved.bound:.3f} mm, curvature at most {state.curvature:.4f} 1/mm"
    yield grid, state, replace(proposal(grid, state, aim.goal, (note,)), clearance=proved)


def tolerance_of(state: State) -> float:
    """How exactly the least clearance of a state is to be known, mm."""
    return min(CLEARANCE_TOLERANCE, max(PROOF_SHARE * state.least, 1e-4))


def missed_places(grid: Grid, state: State, aim: Aim) -> FloatArray:
    """Parameters between the samples at which the clearance has a minimum below that of all samples in the aim's span."""
    wide = grid.wide_gaps(state)
    if not len(wide):
        return np.empty(0)
    share = np.arange(1, 4) / 4.0
    u = (grid.clearance_u[wide, None] + np.diff(grid.clearance_u)[wide, None] * share).ravel()
    basis = Basis.at(grid.knots, u)
    clearance = wall_rows(basis.curve(state.control), basis.curve(state.control, 1), grid.wall).clearance
    padded = np.concatenate([[np.inf], clearance, [np.inf]])
    lowest = (
        (clearance <= padded[:-2])
        & (clearance <= padded[2:])
        & (clearance < state.rows.clearance[aim.inside(grid.clearance_u)].min() - tolerance_of(state))
    )
    return np.asarray(u[lowest & aim.inside(u)])


def rounds(
    grid: Grid, state: State, aim: Aim, limit: float, fixed: tuple[bool, bool], settings: OptimalSettings, *, most: int
) -> Iterator[tuple[Grid, State, Aim, str]]:
    """Accepted steps of one phase, each with the samples it is seen at, the aim there, and what it did in words."""
    excess = [max(state.curvature / limit - 1.0, 0.0)]
    scale = max(float(np.median(state.rows.clearance)), 1e-3)
    penalty = 20.0 * scale
    coarse = settings.tolerance * (1.0 if first_phase(aim) else MEAN_COARSER)
    trust, idle, refused = 0.3, 0, 0
    for _ in range(most):
        problem = StepProblem(
            state.control, grid.clearance_u, state.weight, grid.clearance_basis, grid.curvature_basis, state.rows, fixed
        )
        unit = bend_unit(grid.curvature_basis, state.control, aim.curvature)
        now = merit(grid, state, aim, limit, penalty, unit)
        # A gain is measured against the clearance, or the curvature as the merit has it, as a share of its limit.
        enough = coarse * (now if aim.goal == "curvature" else scale)
        found = problem.solve(aim, trust, penalty)
        gain, promise = 0.0, np.inf
        if found is not None:
            after = grid.measure(found[0], limit, known=state)
            gain, promise = now - merit(grid, after, aim, limit, penalty, unit), now - found[1]
        if found is not None and gain > 0.0 and grid.inside(found[0]):
            note = (
                f"{aim.goal}: clearance least {after.least:.3f}, mean {after.mean:.3f} mm, curvature {after.curvature:.4f} 1/mm"
            )
            if refused:
                note += f"; {refused} longer steps refused"
            state, refused = after, 0
            idle = idle + 1 if gain < enough else 0
            missing = grid.stretched(state)
            if len(missing):
                before = grid.clearance_u
                grid, state = grid.with_samples(missing, state)
                aim = aim.on(before, grid.clearance_u)
                # A dip that only the new samples show is worth another round, however little the last one gained.
                if state.least < after.least - tolerance_of(state):
                    idle, promise = 0, max(promise, enough)
            yield grid, state, aim, note
            excess.append(max(state.curvature / limit - 1.0, 0.0))
            if excess[-1] > (1.0 - STALL_SHARE) * excess[max(len(excess) - 1 - STALL_ROUNDS, 0)] and len(excess) > STALL_ROUNDS:
                return
        else:
            refused += 1
            if found is not None:
                state = grid.warned(state, after)
        if gain < 0.25 * promise:
            trust *= 0.3
        elif gain > 0.7 * promise:
            trust = min(2.0 * trust, TRUST_MAX)
        if idle >= (2 if first_phase(aim) else 1) or max(promise, gain) < enough or refused >= REFUSALS or trust < TRUST_MIN:
            return


def first_phase(aim: Aim) -> bool:
    """Whether it is the least clearance of the whole path that is raised."""
    return aim.goal == "least" and aim.span == (0.0, 1.0)


def merit(grid: Grid, state: State, aim: Aim, limit: float, penalty: float, unit: float) -> float:
    """Cost of a state as it truly is, in the units of the step's programme; bends up to the limit itself are free.

    `unit` makes squared curvatures of accelerations, at the speed of the path that the step begins from.
    """
    excess = max(state.curvature / limit - 1.0, 0.0)
    short = float(np.maximum(np.broadcast_to(aim.floor, state.rows.clearance.shape) - state.rows.clearance, 0.0).max())
    if aim.goal == "least":
        least = float(state.rows.clearance[aim.inside(grid.clearance_u)].min())
        return penalty * (excess + short) - least - MEAN_SHARE * state.mean
    if aim.goal == "curvature":
        return state.curvature / aim.curvature + penalty * short
    if aim.goal == "mean":
        second = grid.curvature_basis.curve(state.control, 2)
        return penalty * (excess + short) - state.mean + aim.straight * unit * float((second**2).sum(axis=1).mean())
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
