"""From a case of the bronchoscope robot to the airway that it plans in: wall, named tree, entrance, and the place asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.errors import CaseError
from tubeplan_viz.bronchoscope.airway import AirwayTree, Entrance, airway_tree
from tubeplan_viz.bronchoscope.target import Target, branch_target, lesion_target, point_target
from tubeplan_viz.cases.bronchoscope import BronchoscopeCase
from tubeplan_viz.pipeline.lumen import Lumen, load_lumen
from tubeplan_viz.pipeline.parts import entered_tree
from tubeplan_viz.pipeline.progress import Stopwatch
from tubeplan_viz.pipeline.tree import Tree


@dataclass(frozen=True, eq=False, kw_only=True)
class Airway:
    """What a case gives: wall, tree, entrance."""

    lumen: Lumen
    tree: Tree
    airway: AirwayTree
    entrance: Entrance


def case_name(case: BronchoscopeCase) -> str:
    """The case's own id."""
    return case.input.case_id or "case"


def load_airway(case: BronchoscopeCase, watch: Stopwatch) -> Airway:
    """Wall, named tree and entrance of a case."""
    lumen = load_lumen(case.input, watch=watch)
    with watch.stage("centerline"):
        tree = entered_tree(lumen.surface, "airway")
        airway = airway_tree(tree.graph, tree.wall, tree.endpoints, root=case.start, frame=tree.surface.frame)
        entrance = airway.entrance_for(case.robot)
    return Airway(lumen=lumen, tree=tree, airway=airway, entrance=entrance)


def resolve_target(case: BronchoscopeCase, airway: AirwayTree, warnings: Sequence[str] = ()) -> Target:
    """The place that a case asks for.

    Raises
    ------
    CaseError
        If it asks for none or for two, or for a place that is none of the airway's; with what was told of the lumen while it
        was read (`warnings`), since a part that was left out may be the one that is meant.
    """
    if (case.goal is None) == (case.lesion is None):
        names = ", ".join(branch.name for branch in airway.branches[1:9])
        raise CaseError(
            "give either a goal (--goal: a branch's name, an end point's label, or X,Y,Z in mm) or a lesion beside the airway "
            f"(--lesion X,Y,Z), exactly one of them; branches are {names}"
        )
    if case.lesion is not None:
        return lesion_target(airway, np.array(case.lesion), case.robot)
    if isinstance(case.goal, str):
        return branch_target(airway, case.goal, case.robot)
    try:
        return point_target(airway, np.array(case.goal), case.robot)
    except CaseError as fault:
        if not warnings:
            raise
        raise CaseError(f"{fault} (of the airway: {'; '.join(warnings)})") from None
