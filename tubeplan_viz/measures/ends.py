"""Where infundibula begin and calyces end, on the edge that the CT shows."""

# Strategy: both ends are set by the wide parts of the hollow (`wide_part`). The pelvis's balls touch the innermost wall
# around them; its edge is found on the wall beside each lip. A calyx ends where its axis, from its neck through the
# centre of its wide part, meets the wall: the bottom of a blunted calyx, the tip of the papilla in a cup. The narrow rim
# around a papilla plays no part, since no scanner resolves it. What blur does to domes and papillae is taken back.

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.centerline import Centerline, CenterlineTree
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.measures.balls import WidePart, wide_part
from tubeplan_viz.measures.lines import Lumen, place
from tubeplan_viz.measures.outward import OutwardWall

TOUCH_MM = 0.6  # vertices this near to a ball are the wall that it touches
RIM_LEAST, LIP_REACH_MM = 20, 6.0
AXIS_RADII = 1.5  # of the calyx's largest ball: on a longer stretch the middle line still turns out of the infundibulum
AHEAD_STEP_MM, AHEAD_FARTHEST_MM = 0.1, 40.0


def calyx_bottoms(
    lumen: Lumen, ways: dict[int, Centerline], lips: dict[int, FloatArray], wall: OutwardWall, blur: float
) -> dict[int, FloatArray]:
    """For each calyx the place where its axis meets the wall at its end, (3,) mm: the tip of a papilla that dents it.

    A calyx is what lies nearer to the last branch of its way than to any other branch.
    """
    branches = lumen.tree.branches
    places = cKDTree(np.concatenate([branch.line.points for branch in branches]))
    owner = np.repeat(np.arange(len(branches)), [len(branch.line.points) for branch in branches])
    found = {}
    for target in lips:
        last = int(lumen.tree.last_branch[target])
        way = ways[target]
        begin = calyx_begin(lumen.tree, target, way)
        beyond = way.arc_length >= begin
        k = int(np.flatnonzero(beyond)[way.radii[beyond].argmax()])
        if owner[places.query(way.points[k])[1]] != last:
            continue
        part = wide_part(lumen.wall, way.points[k], float(way.radii[k]), within=partial(belongs, last, places, owner))
        heading = calyx_axis(lumen.tree, target, way, part)
        reach = wall_ahead(lumen.wall, part.center, heading)
        if reach is not None:
            reach = lumen.sections.ahead(part.center, heading, reach)
            reach += blur**2 * wall.bulge(part.center + reach * heading, heading)
            found[target] = part.center + reach * heading
    return found


def belongs(branch: int, places: cKDTree, owner: IntArray, sites: FloatArray) -> BoolArray:
    """Whether points, (n, 3) mm, lie nearer to one branch than to any other."""
    return np.asarray(owner[places.query(sites)[1]] == branch)


def calyx_axis(tree: CenterlineTree, target: int, way: Centerline, part: WidePart) -> FloatArray:
    """Unit direction from a calyx's neck to the centre of its wide part: over two of its radii, within its branch, (3,)."""
    middle = float(way.arc_length[np.linalg.norm(way.points - part.center, axis=1).argmin()])
    start = float(way.arc_length[-1]) - tree.branches[int(tree.last_branch[target])].length
    begin = min(max(middle - AXIS_RADII * part.largest, start), middle - part.largest)
    chord = part.center - place(way, max(begin, 0.0))
    return np.asarray(chord / np.linalg.norm(chord))


def wall_ahead(wall: WallDistance, point: FloatArray, heading: FloatArray) -> float | None:
    """Distance to the wall ahead of a point inside, mm; None from outside, or beyond `AHEAD_FARTHEST_MM`."""
    steps = np.arange(0.0, AHEAD_FARTHEST_MM, AHEAD_STEP_MM)
    clearance = wall.clearance(point + steps[:, None] * heading)
    outside = np.flatnonzero(clearance <= 0.0)
    if not len(outside) or outside[0] == 0:
        return None
    k = int(outside[0])
    return float(steps[k] - AHEAD_STEP_MM * clearance[k] / (clearance[k] - clearance[k - 1]))


def calyx_begin(tree: CenterlineTree, target: int, way: Centerline) -> float:
    """Arc length on a way from which its calyx is looked for: the far half of the last branch."""
    return float(way.arc_length[-1]) - 0.5 * tree.branches[int(tree.last_branch[target])].length


class Rim:
    """Where the edge of the pelvis lies in the CT, outside the balls that stand for it.

    Balls touch the innermost wall around them; the edge is farther out by as much as the surface is on average, and the
    edge in the CT than the surface. Blur moves the edge of a ball of radius r inward by s^2 / r, which is taken back.
    """

    def __init__(self, pelvis: WidePart, wall: OutwardWall, lumen: Lumen) -> None:
        level = pelvis.level(wall.points)
        near = np.abs(level) <= TOUCH_MM
        self._level, self._points, self._normals = level[near], wall.points[near], wall.normals[near]
        self._curvature, self._lumen = 1.0 / pelvis.largest, lumen

    def margin(self, around: FloatArray | None = None) -> tuple[float, float]:
        """Distance of the edge from the balls, within `LIP_REACH_MM` of a place or on the whole, and its blur, mm."""
        near = np.ones(len(self._points), dtype=bool)
        if around is not None:
            near = np.linalg.norm(self._points - around, axis=1) <= LIP_REACH_MM
        if near.sum() < RIM_LEAST:
            return 0.0, 0.0
        offset, blur = self._lumen.sections.outside(self._points[near], self._normals[near])
        return float(np.median(self._level[near])) + offset + blur**2 * self._curvature, blur
