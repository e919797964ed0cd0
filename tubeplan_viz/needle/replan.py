"""Insertion with replanning: what is pushed is not quite what was planned, so the rest is planned anew.

# Strategy: the needle is pushed in short steps with its true curvature, and its tip is measured after each. All
# that was pushed so far is known, so one number explains the measurements: the ratio of the true to the modelled
# curvature. It is fitted to all of them (with a prior), and the pose that follows from it is where the rest starts.
# When the rest would miss the target, or an obstacle or the target has moved, the rest is mended from its
# present controls, or planned anew; when neither gives a path, the needle is withdrawn.

Source: Huo et al. (2015), Robot 37(4), section 4.2, which replans from the pose reached.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.kinematics import Controls, Pose, push
from tubeplan_viz.needle.obstacles import Capsule, Obstacle, Scene, Sphere
from tubeplan_viz.needle.polish import polish
from tubeplan_viz.needle.spatial import SpatialProblem
from tubeplan_viz.needle.swarm import SwarmSettings, cost_of, plan_spatial
from tubeplan_viz.needle.zigzag import best_starts

PRIOR = 0.05  # of the curvature's ratio: what is usual between tissues of one kind
LAST_MM = 3.0  # nothing is mended over the last stretch: a needle of usual curvature cannot be moved aside there


@dataclass(frozen=True, eq=False, kw_only=True)
class Event:
    """Something that changes when the needle has been pushed `at` mm: one of the others is given.

    Attributes
    ----------
    at : float, mm
    obstacle, place : int and (3,) array, mm
        The obstacle, counted from 0, whose centre (first point) moves to `place`.
    target : (3,) array, mm
    kappa : float, 1/mm
        The true curvature of the needle that does not spin, from here on.
    """

    at: float
    obstacle: int | None = None
    place: FloatArray | None = None
    target: FloatArray | None = None
    kappa: float | None = None

    def __post_init__(self) -> None:
        told = [self.obstacle is not None and self.place is not None, self.target is not None, self.kappa is not None]
        if sum(told) != 1:
            raise CaseError("an event needs at_mm and exactly one of: obstacle with center, target, kappa")
        if not self.at >= 0.0:
            raise CaseError(f"an event is at_mm {self.at:g}, expected 0 or more")
        if self.kappa is not None and not 0.0 < self.kappa <= 10.0:
            raise CaseError(f"an event has kappa {self.kappa:g} 1/mm, expected more than 0 and at most 10")

    @property
    def cause(self) -> str:
        """In words."""
        if self.obstacle is not None:
            return f"obstacle {self.obstacle + 1} has moved"
        return "the target has moved" if self.target is not None else "the curvature is not that of the model"


@dataclass(frozen=True, kw_only=True)
class InsertionSettings:
    """How the insertion is watched.

    Attributes
    ----------
    step : float, mm
        Push between two measurements.
    noise : float, mm
        Standard deviation of the measured tip along each axis.
    tolerance : float, mm
        The rest is planned anew when it would miss the target by more than this.
    """

    step: float = 5.0
    noise: float = 0.0
    tolerance: float = 0.05

    def __post_init__(self) -> None:
        if not 0.1 <= self.step <= 100.0:
            raise CaseError(f"the push between measurements is {self.step:g} mm, expected 0.1 to 100")
        if not 0.0 <= self.noise <= 20.0:
            raise CaseError(f"the noise of the measured tip is {self.noise:g} mm, expected 0 to 20")


@dataclass(frozen=True, eq=False)
class Replan:
    """One change of plan: where, mm, why, what came of it, the whole path then expected, mm, and the time it took, s."""

    at: float
    cause: str
    found: bool
    length: float
    seconds: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Insertion:
    """How an insertion went.

    Attributes
    ----------
    pose : Pose
        At the entry.
    pushed : Controls
        What was pushed, with the true curvatures: the true path.
    replans : tuple of Replan
    error : float, mm
        From the true tip to where the target is at the end.
    clearances : (m,) float array, mm
        Least distance of the true path to each obstacle where it stood while the tip passed.
    withdrawn : str or None
        Why the needle was withdrawn before the target.
    problem : SpatialProblem
        The scene and target at the end.
    """

    pose: Pose
    pushed: Controls
    replans: tuple[Replan, ...]
    error: float
    clearances: FloatArray
    withdrawn: str | None
    problem: SpatialProblem

    @property
    def length(self) -> float:
        """Length pushed, mm."""
        return self.pushed.length


def moved(scene: Scene, index: int, place: FloatArray) -> Scene:
    """The scene with one obstacle moved: its centre, or first point, to `place`.

    Raises
    ------
    CaseError
        If there is no such obstacle, or it is a mesh, polygon or mask.
    """
    if not 0 <= index < len(scene):
        raise CaseError(f"an event moves obstacle {index + 1}, the case has {len(scene)}")
    body = scene.obstacles[index]
    new: Obstacle
    if isinstance(body, Sphere):
        new = replace(body, center=np.asarray(place, dtype=float))
    elif isinstance(body, Capsule):
        new = replace(body, points=body.points + (np.asarray(place, dtype=float) - body.points[0]))
    else:
        raise CaseError(f"an event moves obstacle {index + 1}, a {body.kind}; only spheres and capsules can move")
    bodies = [new if k == index else other for k, other in enumerate(scene.obstacles)]
    return Scene(tuple(bodies), spacing=scene.spacing)


def insert(
    problem: SpatialProblem,
    pose: Pose,
    controls: Controls,
    events: tuple[Event, ...],
    settings: InsertionSettings | None = None,
    *,
    rng: np.random.Generator | None = None,
    true_kappa: float | None = None,
) -> Insertion:
    """Push a planned path through a scene that changes, measuring and replanning.

    Parameters
    ----------
    problem : SpatialProblem
        As planned.
    pose, controls : Pose, Controls
        The plan.
    events : tuple of Event
    settings : InsertionSettings, optional
    rng : Generator, optional
        Noise of the measurements.
    true_kappa : float, 1/mm, optional
        Of the needle from the start; that of the model by default.

    Returns
    -------
    Insertion
    """
    settings = settings or InsertionSettings()
    rng = rng or np.random.default_rng(0)
    kappa = problem.settings.kappa
    ratio = (true_kappa or kappa) / kappa
    waiting = sorted(events, key=lambda event: event.at)
    state = _State(pose)
    replans: list[Replan] = []
    withdrawn = None
    rest = controls
    gaps = np.full(len(problem.scene), np.inf)
    known = 1.0
    while len(rest) and rest.length > 1e-9:
        causes = []
        while waiting and waiting[0].at <= state.depth + 1e-9:
            event = waiting.pop(0)
            if event.kappa is not None:
                # Seen by its effect alone; what was measured before it says nothing of the new curvature.
                ratio = event.kappa / kappa
                state.restart(known)
                continue
            problem = applied(problem, event)
            causes.append(event.cause)
        here = state.believed(known)
        scene_changed = bool(causes)
        if not causes and misses(problem, here, rest, known) > settings.tolerance and rest.length > LAST_MM:
            causes.append(Event(at=0.0, kappa=kappa).cause)
        if causes:
            begun_at = time.perf_counter()
            made = renewed(problem, here, rest, known, changed=scene_changed)
            spent = time.perf_counter() - begun_at
            expected = state.depth + (made.length if made is not None else 0.0)
            replans.append(Replan(state.depth, " and ".join(causes), made is not None, expected, spent))
            if made is None and not (still_fine(problem, here, rest, known) and rest.length < 4.0 * LAST_MM):
                withdrawn = (
                    f"at {state.depth:.1f} mm {' and '.join(causes)}, and no path from there was found: withdraw the needle"
                )
                break
            rest = made if made is not None else rest
        ahead = min(settings.step, rest.length, max((waiting[0].at - state.depth) if waiting else np.inf, 0.1))
        begun = state.pushed
        state.advance(first_part(rest, ahead), ratio)
        piece = push(begun, state.last)
        if len(problem.scene):
            gaps = np.minimum(gaps, problem.scene.least_distance(piece, tolerance=1e-2))
        rest = rest.after(ahead)
        state.measure(rng.normal(0.0, settings.noise, 3) if settings.noise else np.zeros(3))
        known = state.ratio(settings.noise)
    tip = state.pushed.position
    return Insertion(
        pose=pose,
        pushed=state.controls(),
        replans=tuple(replans),
        error=float(np.linalg.norm(tip - problem.target)),
        clearances=gaps,
        withdrawn=withdrawn,
        problem=problem,
    )


def applied(problem: SpatialProblem, event: Event) -> SpatialProblem:
    """The problem after an event that moves an obstacle or the target."""
    if event.target is not None:
        return replace(problem, target=np.asarray(event.target, dtype=float))
    assert event.obstacle is not None
    assert event.place is not None
    return replace(problem, scene=moved(problem.scene, event.obstacle, event.place))


def first_part(rest: Controls, ahead: float) -> Controls:
    """The first `ahead` mm of controls."""
    ends = np.cumsum(rest.lengths)
    count = min(int(np.searchsorted(ends, ahead - 1e-12)) + 1, len(rest))
    lengths = rest.lengths[:count].copy()
    lengths[-1] -= max(ends[count - 1] - ahead, 0.0)
    return Controls(rest.turns[:count], lengths, rest.curvatures[:count])


def bent(controls: Controls, ratio: float) -> Controls:
    """Controls with curvatures as the tissue gives them."""
    return Controls(controls.turns, controls.lengths, controls.curvatures * ratio)


class _State:
    """What was pushed and measured; the true pose is known to the simulation alone."""

    def __init__(self, pose: Pose) -> None:
        self.entry, self.pushed, self.depth = pose, pose, 0.0
        self.last = Controls(np.empty(0), np.empty(0), np.empty(0))
        self._true: list[Controls] = []
        self._base = pose  # believed pose from which the present ratio is fitted
        self._asked: list[Controls] = []
        self._tips: list[FloatArray] = []

    def advance(self, part: Controls, ratio: float) -> None:
        self.last = bent(part, ratio)
        self.pushed = push(self.pushed, self.last).end_pose()
        self.depth += part.length
        self._true.append(self.last)
        self._asked.append(part)

    def measure(self, noise: FloatArray) -> None:
        self._tips.append(self.pushed.position + noise)

    def restart(self, ratio: float) -> None:
        self._base = self.believed(ratio)
        self._asked, self._tips = [], []

    def believed(self, ratio: float) -> Pose:
        pose = self._base
        for part in self._asked:
            pose = push(pose, bent(part, ratio)).end_pose()
        return pose

    def tips(self, ratio: float) -> FloatArray:
        found, pose = [], self._base
        for part in self._asked:
            pose = push(pose, bent(part, ratio)).end_pose()
            found.append(pose.position)
        return np.array(found)

    def ratio(self, noise: float) -> float:
        """Ratio of the curvatures that fits all measured tips since the last restart: Gauss-Newton in one unknown."""
        measured, value, sigma = np.array(self._tips), 1.0, max(noise, 1e-6)
        for _ in range(6):
            now = self.tips(value)
            slope = (self.tips(value + 1e-6) - now).ravel() / 1e-6 / sigma
            off = (measured - now).ravel() / sigma
            change = float((slope @ off + (1.0 - value) / PRIOR**2) / (slope @ slope + 1.0 / PRIOR**2))
            value = float(np.clip(value + change, 0.3, 3.0))
            if abs(change) < 1e-10:
                break
        return value

    def controls(self) -> Controls:
        if not self._true:
            return Controls(np.empty(0), np.empty(0), np.empty(0))
        parts = [np.concatenate([getattr(c, name) for c in self._true]) for name in ("turns", "lengths", "curvatures")]
        return Controls(*parts)


def misses(problem: SpatialProblem, here: Pose, rest: Controls, ratio: float) -> float:
    """By how much the rest would miss the target, mm."""
    return float(np.linalg.norm(push(here, bent(rest, ratio)).tips - problem.target))


def still_fine(problem: SpatialProblem, here: Pose, rest: Controls, ratio: float) -> bool:
    """Whether the rest keeps its distance, wherever it ends."""
    if not len(problem.scene):
        return True
    return bool(problem.scene.least_distance(push(here, bent(rest, ratio))).min() >= problem.settings.safety)


def renewed(problem: SpatialProblem, here: Pose, rest: Controls, ratio: float, *, changed: bool) -> Controls | None:
    """The rest mended, or planned anew, in controls of the model; None if there is no path.

    The needle that is planned for is the one believed in: curvature times `ratio`. `changed` says that an obstacle or the
    target has moved.
    """
    settings = replace(problem.settings, kappa=problem.settings.kappa * ratio)
    left = replace(problem, pose=here, settings=settings, under_way=True)
    if left.distance < LAST_MM:
        return None
    # The present controls mended are the least change; where the scene has changed, other ways may be shorter now.
    x = mended(left, [padded(left, bent(rest, ratio)), *(best_starts(left, 1) if changed else [])])
    if x is None:
        x = mended(left, best_starts(left, 3))
    if x is not None:
        controls = left.controls(x)[1]
    else:
        found = plan_spatial(left, SwarmSettings(restarts=2, rounds=300), rng=np.random.default_rng(0), front=False)
        if found.controls is None:
            return None
        controls = found.controls
    return Controls(controls.turns, controls.lengths, np.minimum(controls.curvatures / ratio, problem.settings.kappa))


def mended(problem: SpatialProblem, starts: list[FloatArray]) -> FloatArray | None:
    """The cheapest path that the polish makes of some starts and that keeps its distance everywhere, or None."""
    made = [x for start in starts if (x := polish(problem, start)) is not None and bounded(problem, x)]
    return min(made, key=lambda row: cost_of(problem, row)) if made else None


def bounded(problem: SpatialProblem, x: FloatArray) -> bool:
    """Whether the path keeps its distance at every point of it."""
    return not len(problem.scene) or bool(problem.scene.least_distance(problem.arcs(x)).min() >= problem.settings.safety)


def padded(problem: SpatialProblem, rest: Controls) -> FloatArray:
    """Unknowns of the rest: its last pieces, the longest split until there are as many as asked."""
    turns, lengths, curvatures = (list(v) for v in (rest.turns, rest.lengths, rest.curvatures))
    n = problem.settings.pieces
    while len(lengths) > n:
        k = int(np.argmin(lengths[:-1])) if len(lengths) > 1 else 0
        lengths[k + 1] += lengths.pop(k)
        turns[k + 1] += turns.pop(k)
        curvatures.pop(k)
    while len(lengths) < n:
        k = int(np.argmax(lengths))
        lengths[k] *= 0.5
        lengths.insert(k, lengths[k])
        turns.insert(k + 1, 0.0)
        curvatures.insert(k, curvatures[k])
    low, high = problem.bounds
    x = np.array(turns + lengths + (curvatures if problem.free[0] else []))
    x[:n] = np.mod(x[:n] + np.pi, 2.0 * np.pi) - np.pi
    return np.clip(x, low, high)


@dataclass(frozen=True, eq=False, kw_only=True)
class MonteCarlo:
    """Final errors, mm, of the insertions that ended, least distance of each to any obstacle, mm, and how many were withdrawn."""

    errors: FloatArray
    clearances: FloatArray
    withdrawn: int
    touched: int


def monte_carlo(
    problem: SpatialProblem,
    pose: Pose,
    controls: Controls,
    *,
    runs: int = 200,
    curvature_error: float = 0.05,
    noise: float = 0.5,
    target_motion: float = 3.0,
    rng: np.random.Generator | None = None,
) -> MonteCarlo:
    """Many insertions of one plan, each with its own true curvature, noise and motion of the target.

    Parameters
    ----------
    runs : int
    curvature_error : float
        Standard deviation of the true curvature, relative.
    noise : float, mm
        Of the measured tip along each axis.
    target_motion : float, mm
        The target moves by this much in a random direction, at a random depth up to 60 % of the path.
    rng : Generator, optional
    """
    rng = rng or np.random.default_rng(0)
    errors, clearances, withdrawn, touched = [], [], 0, 0
    for _ in range(runs):
        kappa = problem.settings.kappa * (1.0 + curvature_error * float(np.clip(rng.standard_normal(), -3.0, 3.0)))
        way = rng.standard_normal(3)
        place = problem.target + target_motion * way / np.linalg.norm(way)
        event = Event(at=float(rng.uniform(0.0, 0.6)) * controls.length, target=place)
        settings = InsertionSettings(noise=noise, tolerance=max(0.5 * noise, 0.1), step=5.0)
        made = insert(problem, pose, controls, (event,), settings, rng=rng, true_kappa=kappa)
        nearest = float(made.clearances.min()) if len(made.clearances) else np.inf
        touched += nearest <= 0.0
        if made.withdrawn is None:
            errors.append(made.error)
            clearances.append(nearest)
        else:
            withdrawn += 1
    return MonteCarlo(errors=np.array(errors), clearances=np.array(clearances), withdrawn=withdrawn, touched=touched)
