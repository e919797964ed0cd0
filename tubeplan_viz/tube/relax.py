"""What little would have to give: the least change of the limits that lets a path through."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tubeplan_viz.plan import Limits
from tubeplan_viz.tube.optimal import CLEARANCE_TOLERANCE, OptimalSettings, Passage, optimise

# A proved clearance less this share, so that planning again at the value proves it with room.
SAFE = 0.998
# The bracket of the bend radius is closed to this ratio, well within the 2 % that must make the difference.
RATIO = 1.008
WIDEN = 1.3
FARTHER = 1.5
# So often is the place within the bracket guessed from the clearances around it, then halved.
GUESSES = 6
# An instrument more flexible than this many times is another instrument.
FLEXIBLE = 6.0
# The line between the two single changes is drawn through at least so many stretches.
LINE_STRETCHES = 4


@dataclass(frozen=True, kw_only=True)
class Trade:
    """One point of the Pareto line: at this curvature limit this clearance is proved, mm and 1/mm."""

    clearance: float
    curvature: float


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """The smallest changes that make a path feasible.

    Attributes
    ----------
    limits : Limits
        That no path was found for.
    clearance : float or None, mm
        Largest instrument radius at the given bend radius; None when no path keeps the curvature limit.
    curvature : float or None, 1/mm
        Least curvature limit at the given instrument radius; None when none up to `FLEXIBLE`
        times the given one was found to do.
    pareto : tuple of Trade
        From the stiffest and thinnest to the thickest and most flexible.
    """

    limits: Limits
    clearance: float | None
    curvature: float | None
    pareto: tuple[Trade, ...]

    @property
    def clearance_change(self) -> float | None:
        """By what share the instrument radius would have to change; negative."""
        asked = self.limits.clearance_min
        return None if self.clearance is None or asked == 0.0 else self.clearance / asked - 1.0

    @property
    def bend_radius_change(self) -> float | None:
        """By what share the bend radius would have to change; negative."""
        return None if self.curvature is None else self.limits.curvature_max / self.curvature - 1.0

    @property
    def smallest(self) -> str | None:
        """The single change that is the smaller share of its limit; None when neither was found to do."""
        changes = {"instrument radius": self.clearance_change, "bend radius": self.bend_radius_change}
        known = {name: abs(change) for name, change in changes.items() if change is not None}
        return min(known, key=lambda name: known[name]) if known else None

    def details(self) -> dict[str, object]:
        """For result.json."""
        thinner, softer = self.clearance_change, self.bend_radius_change
        return {
            "smallest": self.smallest,
            "clearance_mm": self.clearance,
            "clearance_change_percent": None if thinner is None else 100.0 * thinner,
            "curvature_per_mm": self.curvature,
            "bend_radius_mm": None if self.curvature is None else 1.0 / self.curvature,
            "bend_radius_change_percent": None if softer is None else 100.0 * softer,
            "pareto": [
                {"clearance_mm": trade.clearance, "curvature_per_mm": trade.curvature, "bend_radius_mm": 1.0 / trade.curvature}
                for trade in self.pareto
            ],
        }


def largest_clearance(passage: Passage, settings: OptimalSettings, curvature: float) -> float | None:
    """Largest least clearance that is proved under a curvature limit, mm; None when the limit itself is not kept.

    It is what planning again with that limit proves: the same rounds from the same line.
    """
    limits = Limits(curvature_max=curvature, clearance_min=passage.limits.clearance_min)
    for proposal in optimise(replace(passage, limits=limits), settings):
        # A phase that ends beyond the limit is followed by another one, or by nothing.
        if proposal.clearance is not None and proposal.curvature <= curvature:
            return proposal.clearance.bound if proposal.clearance.bound > 0.0 else None
    return None


def smallest_relaxation(passage: Passage, settings: OptimalSettings, *, ceiling: float) -> Relaxation:
    """Least change of the instrument's radius alone, of its bend radius alone, and the line between.

    Parameters
    ----------
    passage : Passage
        With the limits that no path was found for.
    settings : OptimalSettings
    ceiling : float, mm
        No path keeps a larger clearance, however it bends: with a larger limit, no
        bend radius is looked for.
    """
    given, wanted = passage.limits.curvature_max, passage.limits.clearance_min + CLEARANCE_TOLERANCE
    found: dict[float, float] = {}
    bare = given  # the line of trades begins here, or where no path was found at all

    def reaches(curvature: float) -> bool:
        nonlocal bare
        clearance = largest_clearance(passage, settings, curvature)
        if clearance is None:
            bare = max(bare, curvature)
        else:
            found[curvature] = clearance
        return clearance is not None and clearance >= wanted

    high: float | None = given
    if not reaches(given):
        high = bracket(reaches, found, given, wanted) if ceiling >= wanted else None
    if high is not None and high > given:
        for curvature in between(min(bare, high), high, found):
            reaches(curvature)
    alone = found.get(given)
    return Relaxation(
        limits=passage.limits,
        clearance=None if alone is None else SAFE * alone,
        curvature=high,
        pareto=trades(found, high),
    )


def bracket(reaches: Callable[[float], bool], found: dict[float, float], low: float, wanted: float) -> float | None:
    """Least curvature limit above `low` that reaches, to within `RATIO`; None when none was found.

    Parameters
    ----------
    reaches : callable
        Whether the clearance wanted is reached under a curvature limit; what it finds goes into `found`.
    found : dict
        Clearance in mm by curvature limit.
    low : float, 1/mm
        A limit that does not reach.
    wanted : float, mm
    """
    first, high = low, low
    while True:
        low, high = high, high * widening(found, high, wanted)
        if high > FLEXIBLE * first:
            return None
        if reaches(high):
            break
    guesses = 0
    while high > RATIO * low:
        middle = (low * high) ** 0.5
        if guesses < GUESSES:
            # First a little above the root, then as far below it as closes the bracket.
            guess = root(found, low, high, wanted) * RATIO**0.35
            middle = guess if guess < high / RATIO**0.5 else max(high / RATIO**0.98, middle if low not in found else 0.0)
            middle = max(middle, low * RATIO**0.5)
            guesses += 1
        low, high = (low, middle) if reaches(middle) else (middle, high)
    return high


def widening(found: dict[float, float], last: float, wanted: float) -> float:
    """By how many times the limit is widened next: a little farther than the clearance's rise between the last two promises."""
    known = sorted(limit for limit in found if limit <= last)[-2:]
    if last not in found or len(known) < 2 or found[known[1]] <= found[known[0]]:
        return WIDEN
    rise = (found[known[1]] - found[known[0]]) / np.log(known[1] / known[0])
    return float(np.clip(np.exp(FARTHER * (wanted - found[last]) / rise), RATIO, WIDEN))


def root(found: dict[float, float], low: float, high: float, wanted: float) -> float:
    """Where the clearance passes the one wanted, from what is known on both sides; the middle where that tells nothing.

    The logarithm of the limit is a parabola in the clearance through the three nearest limits, as far as it rises.
    """
    middle = float((low * high) ** 0.5)
    if low not in found or not found[low] < wanted <= found[high]:
        return middle
    around = [k for k in sorted(found, key=lambda k: abs(np.log(k / middle))) if k not in (low, high)][:1]
    limits = sorted([low, high, *around])
    clearances = [found[k] for k in limits]
    if any(b - a < 1e-6 for a, b in pairwise(clearances)):
        limits, clearances = [low, high], [found[low], found[high]]
    guess = float(np.exp(np.polyval(np.polyfit(clearances, np.log(limits), len(limits) - 1), wanted)))
    return guess if low < guess < high else middle


def between(low: float, high: float, found: Iterable[float]) -> list[float]:
    """Curvature limits at even ratios between two, without those that were looked at near by already."""
    step = (high / low) ** (1.0 / LINE_STRETCHES)
    wanted = [low * step**k for k in range(1, LINE_STRETCHES)]
    known = list(found)
    return [curvature for curvature in wanted if all(abs(np.log(curvature / other)) > 0.5 * np.log(step) for other in known)]


def trades(found: dict[float, float], last: float | None) -> tuple[Trade, ...]:
    """The programmes solved on the way, without those that another beats in both."""
    line: list[Trade] = []
    for curvature in sorted(found):
        clearance = SAFE * found[curvature]
        if (last is None or curvature <= last) and (not line or clearance > line[-1].clearance):
            line.append(Trade(clearance=clearance, curvature=curvature))
    return tuple(line)
