"""Needle paths in space by a dynamic-weight particle swarm, polished onto the target, with their Pareto front.

The swarm is that of Huo et al. (2015), Robot 37(4), 385-394, eq. 14 and steps 1-5: 50 particles, 1000 rounds, c1 = 1,
c2 = 2, inertia from 0.5 to 1.5, stop at a tip error under 0.1 mm. Not printed and chosen here: the weights
g1, g2 (`weights`), the course of the inertia (falling), and a limit on the speed of particles.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.front import pareto_front
from tubeplan_viz.needle.path import NeedlePath, SwarmRound, measured
from tubeplan_viz.needle.polish import polish_clear
from tubeplan_viz.needle.reach import unreachable
from tubeplan_viz.needle.spatial import SpatialProblem, Worth, worth
from tubeplan_viz.needle.zigzag import best_starts

CLOUD_EVERY = 10  # rounds between two pictures of the population
ZIGZAGS = 2  # starts of the polish besides the swarm's


@dataclass(frozen=True, kw_only=True)
class SwarmSettings:
    """The swarm of the source, and how often it is tried.

    Attributes
    ----------
    particles, rounds : int
    inertia : (float, float)
        At the last and at the first round.
    own, shared : float
        c1, pull to a particle's own best place, and c2, to the best of all.
    stop_error : float, mm
        The swarm ends when its best path ends this near to the target.
    restarts : int
        Swarms at most, until one can be polished; with a time budget as many as it allows, the best of them kept.
    """

    particles: int = 50
    rounds: int = 1000
    inertia: tuple[float, float] = (0.5, 1.5)
    own: float = 1.0
    shared: float = 2.0
    stop_error: float = 0.1
    restarts: int = 8

    def __post_init__(self) -> None:
        if not 5 <= self.particles <= 5000:
            raise CaseError(f"particles is {self.particles}, expected 5 to 5000")
        if not 1 <= self.rounds <= 100_000:
            raise CaseError(f"rounds is {self.rounds}, expected 1 to 100000")
        if not 1 <= self.restarts <= 1000:
            raise CaseError(f"restarts is {self.restarts}, expected 1 to 1000")
        if not 0.0 < self.stop_error <= 10.0:
            raise CaseError(f"stop_error_mm is {self.stop_error:g}, expected more than 0 and at most 10")


def weights(length: float, distance: float) -> tuple[float, float]:
    """K_t and K_L of eq. 14 from the best path's length: length first, then accuracy.

    The source gives the roles of g1 and g2, not their forms. Here both are linear in how far the
    length is above the straight distance, from 30 % above (K_t = 2, K_L = 1) to none (K_t = 20, K_L = 0.2).
    """
    share = float(np.clip((length / distance - 1.0) / 0.3, 0.0, 1.0))
    return 20.0 - 18.0 * share, 0.2 + 0.8 * share


def swarm_rounds(
    problem: SpatialProblem, settings: SwarmSettings, rng: np.random.Generator, *, restart: int = 0
) -> Iterator[SwarmRound]:
    """The printed swarm, round by round.

    Parameters
    ----------
    problem : SpatialProblem
        Its bounds are the box that the particles are drawn in.
    settings : SwarmSettings
    rng : numpy.random.Generator
    restart : int
        Number of the swarm, told with each round.
    """
    low, high = problem.bounds
    count, n = settings.particles, problem.settings.pieces
    width = high - low
    x = low + width * rng.random((count, len(low)))
    shares = rng.dirichlet(np.full(n, 2.0), count)
    x[:, n : 2 * n] = np.clip(shares * problem.distance * rng.uniform(1.0, 1.3, (count, 1)), low[n : 2 * n], high[n : 2 * n])
    speed = 0.1 * width * rng.uniform(-1.0, 1.0, x.shape)
    fastest = 0.15 * width
    own, own_worth, own_score = x.copy(), worth(problem, x), np.full(count, np.inf)
    lead: float | None = None
    for index in range(settings.rounds):
        now = own_worth if index == 0 else worth(problem, x)
        length = problem.distance * 1.3 if lead is None else lead
        k_error, k_length = weights(length, problem.distance)
        # The weights have changed since the best places were scored: score them again before comparing.
        own_score = score(own_worth, k_error, k_length)
        new_score = score(now, k_error, k_length)
        better = (new_score < own_score) | ((index == 0) & np.isfinite(new_score))
        own[better] = x[better]
        own_worth = Worth(
            np.where(better, now.error, own_worth.error),
            np.where(better, now.length, own_worth.length),
            np.where(better, now.danger, own_worth.danger),
        )
        own_score = np.where(better, new_score, own_score)
        leader = int(own_score.argmin())
        if np.isfinite(own_score[leader]):
            lead = float(own_worth.length[leader])
        state = SwarmRound(
            index,
            restart,
            own[leader].copy(),
            float(own_worth.error[leader]),
            float(own_worth.length[leader]),
            float(own_worth.danger[leader]),
            x.copy() if index % CLOUD_EVERY == 0 else None,
        )
        yield state
        if np.isfinite(own_score[leader]) and state.error < settings.stop_error:
            return
        fall = index / max(settings.rounds - 1, 1)
        inertia = settings.inertia[1] + (settings.inertia[0] - settings.inertia[1]) * min(1.0, 4.0 * fall)
        pull_own, pull_all = settings.own * rng.random(x.shape), settings.shared * rng.random(x.shape)
        speed = np.clip(inertia * speed + pull_own * (own - x) + pull_all * (own[leader] - x), -fastest, fastest)
        x = x + speed
        x[:, :n] = np.mod(x[:, :n] + np.pi, 2.0 * np.pi) - np.pi
        out = (x < low) | (x > high)
        speed[out] *= -0.5
        x = np.clip(x, low, high)


def score(found: Worth, k_error: float, k_length: float) -> FloatArray:
    """Eq. 14: K_t f_err + K_L f_len + f_danger."""
    return np.asarray(k_error * found.error + k_length * found.length + found.danger)


def plan_spatial(
    problem: SpatialProblem,
    settings: SwarmSettings | None = None,
    *,
    rng: np.random.Generator | None = None,
    time_budget: float | None = None,
    front: bool = True,
    watch: Callable[[SwarmRound], None] | None = None,
) -> NeedlePath:
    """The best path found, polished onto the target.

    Parameters
    ----------
    problem : SpatialProblem
    settings : SwarmSettings, optional
    rng : Generator, optional
        All randomness; the same one gives the same path (without a time budget).
    time_budget : float, s, optional
        Try swarms until it is used up and keep the best; without it the first that can be polished ends the search.
    front : bool
        Work out the Pareto front too.
    watch : callable, optional
        Told each round as it happens.

    Returns
    -------
    NeedlePath
    """
    settings = settings or SwarmSettings()
    rng = rng or np.random.default_rng(0)
    reason = unreachable(problem)
    if reason is not None:
        return NeedlePath(reason=reason)
    begun = time.perf_counter()
    rounds: list[SwarmRound] = []
    best: FloatArray | None = None
    best_cost = np.inf
    swarms = 0
    nearest: SwarmRound | None = None
    for restart in range(settings.restarts if time_budget is None else 1000):
        swarms += 1
        for state in swarm_rounds(problem, settings, rng, restart=restart):
            rounds.append(state)
            if watch is not None:
                watch(state)
            if time_budget is not None and time.perf_counter() - begun > time_budget and swarms > 1:
                break
        last = rounds[-1]
        if np.isfinite(last.danger) and (nearest is None or last.error < nearest.error):
            nearest = last
        for start in [last.best, *(best_starts(problem, ZIGZAGS) if restart == 0 else [])]:
            made = polish_clear(problem, start)
            if made is not None:
                cost = cost_of(problem, made)
                if cost < best_cost:
                    best, best_cost = made, cost
        if (time_budget is None and best is not None) or (time_budget is not None and time.perf_counter() - begun > time_budget):
            break
    if best is None:
        return NeedlePath(rounds=tuple(rounds), swarms=swarms, reason=no_path(problem, nearest, swarms))
    found = measured(problem, *problem.controls(best), rounds=tuple(rounds), swarms=swarms)
    return replace(found, front=pareto_front(problem, best, rounds)) if found.feasible and front else found


def plan_printed(
    problem: SpatialProblem,
    settings: SwarmSettings | None = None,
    *,
    rng: np.random.Generator | None = None,
    watch: Callable[[SwarmRound], None] | None = None,
) -> NeedlePath:
    """The printed method alone: one swarm, its best path as it is, a failure if it ends `stop_error` or more off the target."""
    settings = settings or SwarmSettings()
    rounds: list[SwarmRound] = []
    for state in swarm_rounds(problem, settings, rng or np.random.default_rng(0)):
        rounds.append(state)
        if watch is not None:
            watch(state)
    last = rounds[-1]
    if not np.isfinite(last.danger) or last.error >= settings.stop_error:
        nearest = last if np.isfinite(last.danger) else None
        return NeedlePath(rounds=tuple(rounds), swarms=1, reason=no_path(problem, nearest, 1))
    return measured(problem, *problem.controls(last.best), rounds=tuple(rounds), swarms=1)


def cost_of(problem: SpatialProblem, x: FloatArray) -> float:
    """Length and weighted danger of one path, mm."""
    found = worth(problem, x[None])
    return float(found.length[0] + problem.settings.weight_danger * found.danger[0])


def no_path(problem: SpatialProblem, nearest: SwarmRound | None, swarms: int) -> str:
    """Why no path was found, one sentence."""
    tried = f"{swarms} swarm{'' if swarms == 1 else 's'} of at most {problem.settings.pieces} pieces"
    if nearest is None:
        return f"no path was found: in {tried} every path came within {problem.settings.safety:g} mm of an obstacle"
    return f"no path was found: the nearest of {tried} that keeps its distance ends {nearest.error:.2f} mm from the target"
