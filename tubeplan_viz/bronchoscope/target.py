"""Where the tip should end: a branch, an end point, a place in the lumen, or a lesion beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import CaseError
from tubeplan_viz.bronchoscope.airway import AirwayTree
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.plan import NoPathError

# What a place beside the middle of a branch must leave free around the robot, mm; less than that no pose can be held.
ROOM = 0.1
# A place in the lumen further than this many inscribed radii from every centerline is in no branch of the tree.
ASTRAY = 3.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """A place for the tip.

    Attributes
    ----------
    branch : int
        Number of the branch in which it lies.
    depth : float, mm
        Arc length on that branch's line.
    point : (3,) float array, mm
    note : str or None
        What the user should know: the branch was followed to its wide end only, a lesion's distance.
    lesion : (3,) float array, mm, or None
    """

    branch: int
    depth: float
    point: FloatArray
    note: str | None = None
    lesion: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen_array(self.point, (3,), "target"))


def branch_target(airway: AirwayTree, name: str, robot: Robot) -> Target:
    """The far end of a branch, or the deepest place in it that is wide enough.

    Raises
    ------
    CaseError
        If there is no such branch.
    NoPathError
        If the branch is narrower than the robot from its mouth on.
    """
    number = airway.named(name)
    branch = airway.branches[number]
    depth = airway.wide_depth(number, robot.radius + ROOM)
    if depth <= 0.0:
        offered = offer(airway, branch.line.points[0], robot)
        raise NoPathError(
            f"{branch.name} cannot be entered: on the way to it, or at its mouth, the airway is narrower than the robot of "
            f"{robot.diameter:g} mm; the nearest reachable place is {offered}"
        )
    note = None
    if depth < branch.length - 0.5:
        left = branch.length - depth
        note = f"{branch.name} is wide enough for {depth:.1f} mm; its last {left:.1f} mm are too narrow for the robot"
    return Target(branch=number, depth=depth, point=airway.place(number, depth), note=note)


def point_target(airway: AirwayTree, point: FloatArray, robot: Robot) -> Target:
    """A place in the lumen.

    Raises
    ------
    CaseError
        If it lies outside the airway, in a part that is not joined with it, or where the robot does not fit; the nearest
        reachable place is offered.
    """
    here = "({:.1f}, {:.1f}, {:.1f}) mm".format(*point)
    clearance = float(airway.wall.clearance(point)[0])
    if clearance < 0.0:
        raise CaseError(
            f"the target {here} lies {-clearance:.1f} mm outside the airway; the nearest reachable place is "
            f"{offer(airway, point, robot)}; give that as --goal, or the point as --lesion"
        )
    number, depth, away = airway.nearest_place(point)
    line = airway.branches[number].line
    if away > ASTRAY * float(np.interp(depth, line.arc_length, line.radii)):
        raise CaseError(
            f"the target {here} lies in a part of the lumen that nothing joins with the airway at {airway.root.label}: the "
            f"nearest reachable place is {offer(airway, point, robot)}; give that as --goal, or check the mesh for other pieces"
        )
    if clearance < robot.radius + ROOM or airway.wide_depth(number, robot.radius + ROOM) < depth:
        raise CaseError(
            f"at the target {here} the wall is {clearance:.1f} mm away, or the way there is narrower than the robot of "
            f"{robot.diameter:g} mm; the nearest reachable place is {offer(airway, point, robot)}; give that as --goal"
        )
    return Target(branch=number, depth=depth, point=point)


def lesion_target(airway: AirwayTree, lesion: FloatArray, robot: Robot) -> Target:
    """The reachable place on a centerline that is nearest to a lesion."""
    number, depth, away = nearest_reachable(airway, lesion, robot)
    name = airway.branches[number].name
    return Target(
        branch=number,
        depth=depth,
        point=airway.place(number, depth),
        note=f"the lesion lies {away:.1f} mm from the nearest place that the robot may reach, in {name}",
        lesion=frozen_array(lesion, (3,), "lesion"),
    )


def nearest_reachable(airway: AirwayTree, point: FloatArray, robot: Robot) -> tuple[int, float, float]:
    """Branch, arc length on it, and distance, mm, of the place nearest to a point among all wide enough for the robot."""
    best = (0, 0.0, np.inf)
    for number, branch in enumerate(airway.branches):
        depth = airway.wide_depth(number, robot.radius + ROOM)
        able = branch.line.arc_length <= depth
        if depth <= 0.0 or not able.any():
            continue
        gaps = np.linalg.norm(branch.line.points[able] - point, axis=1)
        k = int(np.argmin(gaps))
        if gaps[k] < best[2]:
            best = (number, float(branch.line.arc_length[k]), float(gaps[k]))
    return best


def offer(airway: AirwayTree, point: FloatArray, robot: Robot) -> str:
    """The nearest place that is wide enough, in words."""
    number, depth, away = nearest_reachable(airway, point, robot)
    x, y, z = airway.place(number, depth)
    return f"{x:.1f},{y:.1f},{z:.1f} in {airway.branches[number].name}, {away:.1f} mm away"
