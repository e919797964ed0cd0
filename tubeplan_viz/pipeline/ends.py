"""Start and goal of a case, given as coordinates, by label or by the name of a part, put on the lumen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from segmentation.caps import mark_flat_ends
from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import Place, is_label
from tubeplan_viz.cases.tube import Case
from tubeplan_viz.centerline import Endpoint, voronoi_graph
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.pipeline.lumen import Lumen
from tubeplan_viz.pipeline.parts import end_names, entered_tree, lumen_parts
from tubeplan_viz.pipeline.tree import Tree
from tubeplan_viz.tube import TubeProblem, pose_problem


def resolve_end(
    name: str, given: Place | None, endpoints: Sequence[Endpoint], names: Mapping[str, str] | None = None
) -> np.ndarray:
    """Coordinates of a start or goal given as coordinates, by the label of an end point or by the name of its part.

    Parameters
    ----------
    name : {"start", "goal"}
        For messages.
    given : Place or None
    endpoints : sequence of Endpoint
    names : mapping of label to name, optional
        Of the parts in which the end points lie.

    Raises
    ------
    CaseError
        If nothing was given, or no end point or more than one is meant.
    """
    names = names or {}
    if given is None:
        raise CaseError(
            f"no {name} was given; give --{name} X,Y,Z in mm or one of the lumen's end points: {listing(endpoints, names)}"
        )
    if not isinstance(given, str):
        return np.array(given, dtype=float)
    return np.array(find_end(name, given, endpoints, names).point)


def find_end(name: str, given: str, endpoints: Sequence[Endpoint], names: Mapping[str, str]) -> Endpoint:
    """The end point of a label, or of a name: a piece of the whole one will do, as long as no other's name holds it.

    Raises
    ------
    CaseError
        If there is none, or more than one.
    """
    found = [tip for tip in endpoints if tip.label == given]
    if not found and not is_label(given):
        called = {tip.label: names.get(tip.label, "").casefold() for tip in endpoints}
        found = [tip for tip in endpoints if called[tip.label] == given] or [
            tip for tip in endpoints if given in called[tip.label]
        ]
    if len(found) == 1:
        return found[0]
    if found:
        raise CaseError(f"the {name} {given!r} fits {len(found)} end points, {listing(found, names)}; give one of their labels")
    known = "" if names or is_label(given) else "; names of parts are known with --anatomy airway or urinary"
    what = f"end point {given}" if is_label(given) else f"end point in a part named {given!r}"
    raise CaseError(f"the lumen has no {what}; it has {listing(endpoints, names)}{known}")


def listing(endpoints: Sequence[Endpoint], names: Mapping[str, str]) -> str:
    """End points with their places and parts, for a message."""
    return "; ".join(
        "{}{} ({:.1f}, {:.1f}, {:.1f})".format(tip.label, f" {names[tip.label]}" if tip.label in names else "", *tip.point)
        for tip in endpoints
    )


def pose_case(case: Case, lumen: Lumen) -> tuple[TubeProblem, Tree]:
    """Start and goal on the wall made ready, and the centerline between them."""
    settings = case.tube_settings
    tree = case_tree(case, lumen)
    asked = {name: getattr(case.planner, name) for name in ("start", "goal")}
    by_name = any(isinstance(place, str) and not is_label(place) for place in asked.values())
    names = case_end_names(case, lumen, tree) if by_name else {}
    start, goal = (resolve_end(name, place, tree.endpoints, names) for name, place in asked.items())
    if not settings.closed_ends:
        marked = mark_flat_ends(tree.surface, np.array([start, goal]))
        if len(marked.caps) != len(tree.surface.caps):
            wall = WallDistance(marked)
            tree = replace(tree, surface=marked, wall=wall, graph=voronoi_graph(marked, wall))
    problem = pose_problem(tree.surface, start, goal, case.limits, settings, wall=tree.wall, graph=tree.graph)
    return problem, tree


def case_tree(case: Case, lumen: Lumen) -> Tree:
    """The lumen of a case made ready for planning, its end points labelled as its anatomy is entered."""
    settings = case.tube_settings
    return entered_tree(lumen.surface, case.input.anatomy, closed_ends=settings.closed_ends, settings=settings.centerline)


def case_end_names(case: Case, lumen: Lumen, tree: Tree) -> dict[str, str]:
    """For the label of each end point of a case the part in which it lies; empty where no parts are known."""
    return end_names(lumen_parts(case.input.anatomy, tree, lumen.volume), tree)
