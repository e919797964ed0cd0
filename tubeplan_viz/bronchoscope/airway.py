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

# How far down the trachea a place is sought where the straight robot fits, and what it must leave free there, mm.
ENTRANCE_SEARCH, ENTRANCE_ROOM = 40.0, 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Entrance:
    """Where the robot goes in.

    Attributes
    ----------
    pose : (4, 4) float array
        Of the proximal section's base at the start; third column into the lumen.
    offset : float, mm
        How far down the trachea's line that is.
    """

    pose: FloatArray
    offset: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", frozen_array(self.pose, (4, 4), "entrance"))


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

    def entrance_for(self, robot: Robot) -> Entrance:
        """Where the straight robot fits into the trachea: at its upper end, or as little further down as need be.

        Raises
        ------
        CaseError
            If it fits nowhere in the first `ENTRANCE_SEARCH` mm.
        """
        line = self.branches[0].line
        for offset in np.arange(0.0, min(ENTRANCE_SEARCH, max(self.branches[0].length - robot.active_length, 0.0)) + 1.0, 1.0):
            begin, end = (self.place(0, s) for s in (offset, offset + robot.active_length))
            axis = begin + np.linspace(0.0, 1.0, 40)[:, None] * (end - begin)
            if float(self.wall.clearance(axis).min()) >= robot.radius + ENTRANCE_ROOM:
                return Entrance(pose=pose_along(begin, end - begin), offset=float(offset))
        widest = 2.0 * float(line.radii[line.arc_length <= ENTRANCE_SEARCH].max())
        raise CaseError(
            f"the robot of {robot.diameter:g} mm does not fit straight into the airway at {self.root.label}, which is at most "
            f"{widest:.1f} mm wide in its first {ENTRANCE_SEARCH:g} mm; choose another entrance (--start) or a thinner robot"
        )

    def route_to(self, number: int) -> tuple[int, ...]:
        """Numbers of the branches from the trachea to a branch, by depth-first search."""
        waiting: list[tuple[int, ...]] = [(0,)]
        while waiting:
            route = waiting.pop()
            if route[-1] == number:
                return route
            waiting += [(*route, child) for child in reversed(self.children[route[-1]])]
        raise CaseError(f"the airway has no branch number {number}; it has {len(self.branches)}")

    def line_to(self, number: int, length: float | None = None, *, begin: float = 0.0) -> Centerline:
        """Centerline from `begin` mm down the trachea to an arc length on a branch, its end by default."""
        lines = [self.branches[k].line for k in self.route_to(number)]
        points = np.concatenate([lines[0].points, *(line.points[1:] for line in lines[1:])])
        radii = np.concatenate([lines[0].radii, *(line.radii[1:] for line in lines[1:])])
        whole = Centerline(points, radii)
        s = whole.arc_length
        before = sum(float(line.arc_length[-1]) for line in lines[:-1])
        end = float(s[-1]) if length is None else float(np.clip(before + length, begin + 1.0, s[-1]))
        kept = (s > begin + 1e-6) & (s < end - 1e-6)
        first, last = ([np.interp(place, s, c) for c in points.T] for place in (begin, end))
        ends = np.interp([begin, end], s, radii)
        return Centerline(np.vstack([first, points[kept], last]), np.concatenate([ends[:1], radii[kept], ends[1:]]))

    def passages(self, number: int, guide: Guide, *, begin: float = 0.0) -> tuple[Passage, ...]:
        """The route's branches with their arc lengths on a guide, which starts `begin` mm down the trachea."""
        found: list[Passage] = []
        walked, begin = -begin, 0.0
        route = self.route_to(number)
        for k in route:
            branch = self.branches[k]
            walked += float(branch.line.arc_length[-1])
            near = guide.nearest(branch.line.points[-1], walked - 15.0, walked + 15.0)
            end = guide.length if k == route[-1] else min(max(near, begin + 0.5), guide.length)
            found.append(Passage(name=branch.name, begin=begin, end=end, turn=branch.angle, radius=branch.median_radius))
            begin = end
        return tuple(found)

    def wide_depth(self, number: int, width: float) -> float:
        """How far into a branch inscribed spheres of radius `width` follow each other, mm; 0 if not to its mouth.

        The trachea's first stretch is left out: it may be the closed end of a grown region.
        """
        *before, last = self.route_to(number)
        for k in before:
            line = self.branches[k].line
            if float(line.radii[line.arc_length > (ENTRANCE_SEARCH if k == 0 else 0.0)].min(initial=np.inf)) < width:
                return 0.0
        line = self.branches[last].line
        narrow = np.flatnonzero((line.radii < width) & (line.arc_length > (ENTRANCE_SEARCH if last == 0 else -1.0)))
        return self.branches[last].length if len(narrow) == 0 else float(line.arc_length[max(int(narrow[0]) - 1, 0)])

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
