"""Insertion with replanning: what is pushed is not quite what was planned, so the rest is planned anew.

# Strategy: the needle is pushed in short steps with its true curvature, and its tip is measured after each. All
# that was pushed so far is known, so one number explains the measurements: the ratio of the true to the modelled
# curvature. It is fitted to all of them (with a prior), and the pose that follows from it is where the rest starts.
# When the rest would miss the target, or an obstacle or the target has moved, the rest is mended from its
# present controls, or planned anew; when neither gives a path, the needle is withdrawn.

Source: Huo et al. (2015), Robot 37(4), section 4.2.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.events import Event, applied
from tubeplan_viz.needle.kinematics import Controls, Pose, joined, poses_along, push
from tubeplan_viz.needle.replan import LAST_MM, bent, first_part, misses, renewed, still_fine
from tubeplan_viz.needle.spatial import SpatialProblem

PRIOR = 0.05  # of the curvature's ratio: what is usual between tissues of one kind
RATIO_STEP = 1e-6


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

    @property
    def pushed_tip(self) -> FloatArray:
        """Where the true tip ended, mm, (3,)."""
        return push(self.pose, self.pushed).tips if len(self.pushed) else self.pose.position


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


class _State:
    """What was pushed and measured; the true pose is known to the simulation alone."""

    def __init__(self, pose: Pose) -> None:
        self.entry, self.pushed, self.depth = pose, pose, 0.0
        self.last = joined([])
        self._true: list[Controls] = []
        self._base = pose  # believed pose from which the present ratio is fitted
        self._asked: list[Controls] = []
        self._tips: list[FloatArray] = []
        self._fitted = 1.0

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
        self._asked, self._tips, self._fitted = [], [], 1.0

    def believed(self, ratio: float) -> Pose:
        return push(self._base, bent(joined(self._asked), ratio)).end_pose() if self._asked else self._base

    def ratio(self, noise: float) -> float:
        """Ratio of the curvatures that fits all measured tips since the last restart: Gauss-Newton in one unknown."""
        measured, value, sigma = np.array(self._tips), self._fitted, max(noise, 1e-6)
        asked = joined(self._asked)
        ends = np.cumsum([len(part) for part in self._asked]) - 1
        for _ in range(8):
            now, beside = poses_along(self._base, asked, np.array([value, value + RATIO_STEP]))[ends, :, :3, 3].swapaxes(0, 1)
            slope = (beside - now).ravel() / RATIO_STEP / sigma
            off = (measured - now).ravel() / sigma
            change = float((slope @ off + (1.0 - value) / PRIOR**2) / (slope @ slope + 1.0 / PRIOR**2))
            value = float(np.clip(value + change, 0.3, 3.0))
            if abs(change) < 1e-9:
                break
        self._fitted = value
        return value

    def controls(self) -> Controls:
        return joined(self._true)
