"""The optimal refinement held against the feature iteration: it never ends with less."""

# Strategy: the refinement is local, so that its end depends on the line it begins from. Where an end of the path binds,
# nothing more can be had. Elsewhere the feature iteration runs too; should it end with less excess of curvature or
# more clearance, both proved, the refinement goes on from its path, and if even that loses, the path itself is the answer.
# Where that leaves an excess of curvature, a line past the sharp places is searched over place and direction (`detour`), and
# what the refinement makes of it is the answer if it is better.

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace

from tubeplan_viz.geometry import SplineCurve, clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.plan import NoPathError
from tubeplan_viz.tube.detour import find_detour
from tubeplan_viz.tube.optimal import CLEARANCE_TOLERANCE, optimise
from tubeplan_viz.tube.passage import OptimalSettings, Passage, Proposal
from tubeplan_viz.tube.samples import with_knots

# Share of the clearance of the path's own ends above which no other path is looked for.
BINDING = 0.995


@dataclass(frozen=True, kw_only=True)
class Standing:
    """What is proved of a path: the share by which it exceeds the curvature limit, and its least clearance in mm."""

    excess: float
    clearance: float

    def beats(self, other: Standing) -> bool:
        """Whether it alone stays in the lumen, or else keeps the curvature limit better, or as well with more clearance."""
        return self.rank < other.rank

    @property
    def rank(self) -> tuple[bool, float, float]:
        """Less is better."""
        return (self.clearance <= 0.0, self.excess, -self.clearance)


def standing(curve: SplineCurve, passage: Passage) -> Standing:
    """The bounds of a path."""
    limit = passage.limits.curvature_max
    excess = curvature_upper_bound(curve, limit=limit).bound / limit - 1.0
    clearance = clearance_lower_bound(curve, passage.wall, tolerance=CLEARANCE_TOLERANCE).bound
    return Standing(excess=max(excess, 0.0), clearance=clearance)


def standing_of(proposal: Proposal, passage: Passage) -> Standing:
    """The bounds of a proposal: the end of a phase has them with it."""
    if proposal.clearance is None:
        return standing(proposal.curve, passage)
    excess = proposal.curvature / passage.limits.curvature_max - 1.0
    return Standing(excess=max(excess, 0.0), clearance=proposal.clearance.bound)


def never_worse(passage: Passage, settings: OptimalSettings, other: Callable[[], SplineCurve]) -> Iterator[Proposal]:
    """Yield the rounds of the optimal refinement; the last one is no worse than the path that `other` gives.

    Parameters
    ----------
    passage : Passage
    settings : OptimalSettings
        With another objective than clearance both limits count and not the most clearance: the
        other path is then looked at only where a limit is broken.
    other : callable
        Makes the path to compare with; called only where it could be better.

    Raises
    ------
    NoPathError
        If no spline follows the passage's line inside the lumen, and the other path leaves it too.
    """
    last: Proposal | None = None
    failure: NoPathError | None = None
    try:
        for last in optimise(passage, settings):
            yield last
    except NoPathError as error:
        failure = error
    ours = Standing(excess=float("inf"), clearance=0.0) if last is None else standing_of(last, passage)
    wanted = BINDING * float(passage.wall.distance(passage.line[[0, -1]]).min())
    if settings.objective != "clearance":
        wanted = min(wanted, passage.limits.clearance_min)
    # A path that keeps no directions at its ends is no answer where they are asked for.
    free = settings.start_direction is None and settings.goal_direction is None
    if not free or (ours.excess == 0.0 and ours.clearance >= wanted):
        if failure is not None:
            raise failure
        return
    touching = None if last is None else last.curve
    curve = other()
    theirs = standing(curve, passage)
    if theirs.beats(ours) and theirs.clearance > 0.0:
        last = yield from onwards(passage, settings, curve, theirs)
        ours = standing_of(last, passage)
    elif failure is not None:
        raise failure
    if last is not None and ours.excess > 0.0:
        yield from past_sharp_places(passage, settings, touching or last.curve, last, ours)


def onwards(
    passage: Passage, settings: OptimalSettings, curve: SplineCurve, theirs: Standing
) -> Generator[Proposal, None, Proposal]:
    """The refinement from the feature iteration's path; the last round is no worse than that path."""
    note = f"the feature iteration ends with {theirs.clearance:.3f} mm, better than this: the refinement goes on from its path"
    given: Proposal | None = None
    for proposal in optimise(passage, settings, warm=with_knots(curve, settings.control_spacing)):
        given = given or replace(proposal, decisions=(note,))
        last = given if proposal.phase == "fit" else proposal
        yield last
    assert given is not None
    if theirs.beats(standing_of(last, passage)):
        last = replace(given, decisions=("the refinement lost from there: the path of the feature iteration stands",))
        yield last
    return last


def past_sharp_places(
    passage: Passage, settings: OptimalSettings, touching: SplineCurve, best: Proposal, ours: Standing
) -> Iterator[Proposal]:
    """The refinement from a line past the places where the `touching` path is too sharp; it ends no worse than the best one."""
    found = find_detour(passage, settings, touching)
    if found is None or found.excess >= ours.excess:
        return
    where = " and ".join(f"({x:.1f}, {y:.1f}, {z:.1f}) mm" for x, y, z in found.places)
    note = (
        f"a search over place and direction found a line past the sharp bend at {where}, "
        f"{found.excess:.0%} over the curvature limit there, not {ours.excess:.0%}: the refinement begins again from it"
    )
    last = best
    try:
        for proposal in optimise(replace(passage, line=found.line), settings):
            last = replace(proposal, decisions=(note,)) if proposal.phase == "fit" else proposal
            yield last
    except NoPathError:
        # No spline follows the line found: the best path stands, and nothing was shown in its place.
        return
    if not standing_of(last, passage).beats(ours):
        yield replace(best, decisions=("the refinement ends no better from there: the path before the search stands",))
