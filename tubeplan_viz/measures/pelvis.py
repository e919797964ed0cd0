"""Where the renal pelvis lies in a collecting system, as a bag or as two arms."""

# Strategy: on the way from the ureter to a calyx the lumen is widest in the pelvis or in the calyx, and a neck lies
# between the two. So each way is followed from where the lumen first divides until it has become clearly narrower than
# it was: the widest place before that is the pelvis's. Most pelves are a bag through which all ways lead; one that divides
# before it widens has an arm for each group of calyces, and then the widest place of each arm counts.

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tubeplan_viz.centerline import Centerline, CenterlineTree
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.measures.balls import WidePart, wide_part

# A part of a division must lead on for this long: a bulge of the ureter is none. Minor calyces are 10 to 20 mm from the pelvis.
LEADS_ON_MM = 10.0
# The lumen has a neck where its radius falls below this share of the largest before. In two kidneys whose parts are known by name
# (HuBMAP reference organs) necks of the major calyces have 0.50 to 0.61 of it, waves of pelvis and arms 0.86 and more.
NECK = 0.75


def division(tree: CenterlineTree) -> float | None:
    """Arc length from the root at which two parts of the tree first go apart that both lead on, mm; None without one."""
    children = [[k for k, branch in enumerate(tree.branches) if branch.parent == number] for number in range(len(tree.branches))]
    onward = [branch.length for branch in tree.branches]
    for number in reversed(range(len(tree.branches))):  # children come after parents
        onward[number] += max((onward[k] for k in children[number]), default=0.0)
    number, length = 0, 0.0
    while True:
        length += tree.branches[number].length
        leading = [k for k in children[number] if onward[k] >= LEADS_ON_MM]
        if len(leading) > 1:
            return length
        if not leading:
            return None
        number = leading[0]


def widest_place(way: Centerline, divided: float | None) -> int:
    """Index of the widest place of a way before its first neck beyond the division; of the whole way without one."""
    if divided is None:
        return int(way.radii.argmax())
    beyond = way.arc_length > divided
    largest = np.maximum.accumulate(way.radii)
    necks = np.flatnonzero(beyond & (way.radii < NECK * largest))
    return int(way.radii[: necks[0] if len(necks) else None].argmax())


def pelvis_parts(
    wall: WallDistance, ways: Mapping[int, Centerline], divided: float | None
) -> tuple[int, int, tuple[WidePart, ...]]:
    """The way through the widest place, that place's index on it, and what balls nearly as large as there reach, arm by arm."""
    places = {target: widest_place(way, divided) for target, way in ways.items()}
    order = sorted(ways, key=lambda target: -float(ways[target].radii[places[target]]))
    found: list[WidePart] = []
    for target in order:
        point, radius = ways[target].points[places[target]], float(ways[target].radii[places[target]])
        if all(part.level(point[None])[0] > 0.0 for part in found):
            found.append(wide_part(wall, point, radius))
    return order[0], places[order[0]], tuple(found)
