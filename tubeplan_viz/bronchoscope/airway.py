"""The airway's tree as the robot sees it: named branches, the entrance, and places in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import CaseError
from tubeplan_viz.bronchoscope.guide import Guide
from tubeplan_viz.bronchoscope.kinematics import pose_along
from tubeplan_viz.bronchoscope.naming import NamedBranch, name_branches
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.route import Passage
from tubeplan_viz.centerline import Centerline, CenterlineTree, Endpoint, VoronoiGraph, centerline_tree
from tubeplan_viz.geometry import WallDistance

# The direction into the lumen is that of the first so many mm of the trachea's line.
ENTRANCE_CHORD = 15.0
# The tip's line ends this much before the place where the lumen is as narrow as the robot, mm.
NOSE = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class AirwayTree:
    """Branches with names from one entrance.

    Attributes
    ----------
    branches : tuple of NamedBranch
        Parents before children; the first is the trachea's.
    wall : WallDistance
    root : Endpoint
        The tip at which the robot goes in.
    """

    branches: tuple[NamedBranch, ...]
    wall: WallDistance
    root: Endpoint

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the branches that leave each branch."""
        return tuple(
            tuple(k for k, branch in enumerate(self.branches) if branch.parent == number) for number in range(len(self.branches))
        )

    @cached_property
    def entrance(self) -> FloatArray:
        """Pose in the middle of the trachea's upper end, third column into the lumen, (4, 4)."""
        line = self.branches[0].line
        far = min(ENTRANCE_CHORD, float(line.arc_length[-1]))
        ahead = np.array([np.interp(far, line.arc_length, c) for c in line.points.T])
        return frozen_array(pose_along(line.points[0], ahead - line.points[0]), (4, 4), "entrance")

    def route_to(self, number: int) -> tuple[int, ...]:
        """Numbers of the branches from the trachea to a branch, by depth-first search."""
        waiting: list[tuple[int, ...]] = [(0,)]
        while waiting:
            route = waiting.pop()
            if route[-1] == number:
                return route
            waiting += [(*route, child) for child in reversed(self.children[route[-1]])]
        raise CaseError(f"the airway has no branch number {number}; it has {len(self.branches)}")

    def line_to(self, number: int, length: float | None = None) -> Centerline:
        """Centerline from the entrance to an arc length on a branch, its end by default."""
        lines = [self.branches[k].line for k in self.route_to(number)]
        points = np.concatenate([lines[0].points, *(line.points[1:] for line in lines[1:])])
        radii = np.concatenate([lines[0].radii, *(line.radii[1:] for line in lines[1:])])
        whole = Centerline(points, radii)
        if length is None:
            return whole
        before = sum(float(line.arc_length[-1]) for line in lines[:-1])
        s = whole.arc_length
        end = float(np.clip(before + length, 1.0, s[-1]))
        kept = s < end - 1e-6
        last = [np.interp(end, s, c) for c in points.T]
        return Centerline(np.vstack([points[kept], last]), np.append(radii[kept], np.interp(end, s, radii)))

    def passages(self, number: int, guide: Guide) -> tuple[Passage, ...]:
        """The route's branches with their arc lengths on a guide."""
        found: list[Passage] = []
        begin = walked = 0.0
        route = self.route_to(number)
        for k in route:
            branch = self.branches[k]
            walked += float(branch.line.arc_length[-1])
            near = guide.nearest(branch.line.points[-1], walked - 15.0, walked + 15.0)
            end = guide.length if k == route[-1] else min(max(near, begin + 0.5), guide.length)
            found.append(Passage(name=branch.name, begin=begin, end=end, turn=branch.angle, radius=branch.median_radius))
            begin = end
        return tuple(found)

    def wide_depth(self, number: int, robot: Robot) -> float:
        """How far into a branch the lumen beside the centerline is wider than the robot, mm; 0 if not at its mouth.

        A narrow place of a branch before counts too: then it is 0.
        """
        *before, last = self.route_to(number)
        if any(self.branches[k].line.radii.min() < robot.radius for k in before[1:]):
            return 0.0
        line = self.branches[last].line
        narrow = np.flatnonzero(line.radii < robot.radius + 0.01)
        narrow = narrow[line.arc_length[narrow] > 0.0] if last == 0 else narrow
        if last == 0:  # the trachea's first millimetres may be a closed end of the region
            narrow = narrow[line.arc_length[narrow] > robot.active_length]
        if len(narrow) == 0:
            return float(line.arc_length[-1])
        return max(float(line.arc_length[narrow[0]]) - NOSE, 0.0)

    def nearest_place(self, point: FloatArray) -> tuple[int, float, float]:
        """Branch, arc length on it and distance, mm, of the place on any centerline nearest to a point."""
        best = (0, 0.0, np.inf)
        for number, branch in enumerate(self.branches):
            gaps = np.linalg.norm(branch.line.points - point, axis=1)
            k = int(np.argmin(gaps))
            if gaps[k] < best[2]:
                best = (number, float(branch.line.arc_length[k]), float(gaps[k]))
        return best

    def place(self, number: int, s: float) -> FloatArray:
        """Place on a branch's line at an arc length, (3,) mm."""
        line = self.branches[number].line
        return np.array([np.interp(s, line.arc_length, c) for c in line.points.T])

    def named(self, name: str) -> int:
        """Number of the branch with a name or the label of a tip, whatever its case.

        Raises
        ------
        CaseError
            If there is none.
        """
        wanted = " ".join(name.lower().split())
        for number, branch in enumerate(self.branches):
            if wanted == branch.name.lower() or wanted == (branch.label or "").lower():
                return number
        listing = ", ".join(branch.name + (f" ({branch.label})" if branch.label else "") for branch in self.branches)
        raise CaseError(f"the airway has no branch or end point {name!r}; it has {listing}")


def airway_tree(
    graph: VoronoiGraph, wall: WallDistance, endpoints: Sequence[Endpoint], *, root: str = "E1", frame: str = "mesh"
) -> AirwayTree:
    """The named tree from one end point to all others.

    Parameters
    ----------
    graph : VoronoiGraph
    wall : WallDistance
    endpoints : sequence of Endpoint
        As `tubeplan endpoints` lists them.
    root : str
        Label of the end point where the robot goes in.
    frame : {"LPS", "mesh"}
        In LPS, left and right are known; on a mesh they are told by the shape of the main bronchi.

    Raises
    ------
    CaseError
        If there is no such label, or no branch leads on from it.
    """
    start = next((tip for tip in endpoints if tip.label == root), None)
    if start is None:
        raise CaseError(f"the lumen has no end point {root}; it has {', '.join(tip.label for tip in endpoints)}")
    others = [tip for tip in endpoints if tip.label != root]
    if not others:
        raise CaseError("the lumen has one end point only, so there is no airway to go into; expected a trachea with branches")
    tree: CenterlineTree = centerline_tree(graph, wall, start.point, np.array([tip.point for tip in others]))
    lost = [tip.label for tip, last in zip(others, tree.last_branch, strict=True) if last < 0]
    if not tree.branches or len(lost) == len(others):
        raise CaseError(
            f"the airway's tree is broken: nothing joins {root} with {', '.join(lost)}; "
            "check the mesh for separate pieces, or choose another entrance (--start)"
        )
    labels = {int(tree.last_branch[k]): tip.label for k, tip in enumerate(others) if tree.last_branch[k] >= 0}
    return AirwayTree(branches=name_branches(tree.branches, labels, frame=frame), wall=wall, root=start)
