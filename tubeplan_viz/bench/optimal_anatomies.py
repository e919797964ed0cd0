"""Rows of tubeplan bench optimal on anatomy: every end point of every data set at hand, both methods, one curvature limit."""

# Strategy: no path keeps more than its own ends and the computed bottleneck leave, nor, under the curvature limit, than the
# bends on the way; the least of them is the reference of the first row of a way. Where bends are proved to let no path pass,
# none is what is to be found; where they are proved to leave less than is asked of a neck, the way is shown without a target.
# The second row holds the optimal path against the feature iteration's, proved alike.

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass

from tubeplan_viz.bench.anatomies import Anatomy, anatomies
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.geometry import SplineCurve, clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.pipeline import Notify
from tubeplan_viz.tube import TubeProblem, TubeSettings, pose_problem, tube_rounds
from tubeplan_viz.tube.bend import bend_bound
from tubeplan_viz.tube.bottleneck import widest_way

QUICK_NAMES = ("generated urography", "cip_ct64")
QUICK_WAYS = 2
TOLERANCE = 0.002
# Share of what the lumen leaves, and seconds, that a way must reach; ways with a neck under 0.3 mm are shown only.
NECK = 0.3
RENAL_SHARE, NECK_SHARE = 0.99, 0.97
SECONDS, LONG_SECONDS = 3.0, 10.0


@dataclass(frozen=True, kw_only=True)
class Proved:
    """One path: its bounds and the processor seconds of search and proof."""

    curve: SplineCurve
    clearance: float
    curvature: float
    seconds: float


def anatomy_rows(*, quick: bool, notify: Notify) -> list[Row]:
    """Rows of all ways; a few of two small data sets when quick."""
    rows: list[Row] = []
    for anatomy in anatomies(QUICK_NAMES if quick else None):
        goals = anatomy.goals[:QUICK_WAYS] if quick else anatomy.goals
        for number, (label, _) in enumerate(goals):
            notify(anatomy.name, number, len(goals))
            rows += way_rows(anatomy, label)
    return rows


def way_rows(anatomy: Anatomy, label: str) -> list[Row]:
    """Rows of one way."""
    tree, goal = anatomy.tree, dict(anatomy.goals)[label]
    problems = [
        pose_problem(
            tree.surface, anatomy.start, goal, anatomy.limits, TubeSettings(method=method), wall=tree.wall, graph=tree.graph
        )
        for method in ("optimal", "feature_iteration")
    ]
    ours, theirs = (proved(problem) for problem in problems)
    limit = anatomy.limits.curvature_max
    way = widest_way(tree.wall, anatomy.start, goal, known=max(ours.clearance, 0.0))
    long = anatomy.name.startswith("HuBMAP ureter")
    share, seconds = (NECK_SHARE, LONG_SECONDS) if long else (RENAL_SHARE, SECONDS)
    kept = ours.curvature <= limit
    most, which = way.bound, f"the {way.end}" if way.end else "bottleneck"
    if not kept or ours.clearance < share * most - TOLERANCE:
        bend = bend_bound(
            tree.wall,
            problems[0].centerline,
            curvature=limit,
            ceiling=way.bound,
            limit=share * most if kept else 0.0,
            known=max(ours.clearance, 0.0) if kept else 0.0,
        )
        if bend is not None:
            most, which = bend.bound, "a bend" if bend.bound > 0.0 else "bends that no path passes"
    # Where it is proved that there is no path, none is what is to be found.
    met = ours.clearance >= share * most - TOLERANCE if kept else most == 0.0
    # What is asked of a neck is asked where the neck binds, and not a bend that is proved to leave less than that.
    bent = long and 0.0 < most < share * way.bound and not met
    wide = way.bound >= NECK
    case = f"{anatomy.name}, {label}"
    return [
        Row(
            case=case,
            figure="least clearance mm, proved",
            ours=ours.clearance,
            reference=most,
            source=f"most that any path can have: {which}",
            target=f"at least {share:.0%}" if wide and not bent else "",
            holds=met if wide and not bent else None,
        ),
        Row(
            case=case,
            figure=f"the same beside feature iteration at {limit:g} 1/mm",
            ours=ours.clearance,
            reference=theirs.clearance,
            source="feature iteration"
            if theirs.curvature <= limit
            else f"feature iteration, bent to {theirs.curvature:.3f} 1/mm",
            target="never less" if theirs.curvature <= limit else "",
            # Two proofs of the same clearance differ by their tolerance.
            holds=kept and ours.clearance >= theirs.clearance - TOLERANCE if theirs.curvature <= limit else None,
        ),
        Row(
            case=case,
            figure="solve and proof, processor s",
            ours=ours.seconds,
            target=f"at most {seconds:g}" if wide else "",
            holds=ours.seconds <= seconds if wide else None,
        ),
    ]


def proved(problem: TubeProblem) -> Proved:
    """Search one path and prove it."""
    begun = time.process_time()
    curve: SplineCurve = deque(tube_rounds(problem), maxlen=1)[0].curve
    curvature = curvature_upper_bound(curve, limit=problem.limits.curvature_max).bound
    clearance = clearance_lower_bound(curve, problem.wall, tolerance=TOLERANCE).bound
    return Proved(curve=curve, clearance=clearance, curvature=curvature, seconds=time.process_time() - begun)
