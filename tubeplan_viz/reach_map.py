"""Which branches of an airway the robot reaches, and why not the others."""

# Strategy: the robot is planned into the deepest branches that are wide enough; a branch on the way of a plan that
# succeeds is reached too. A branch that the robot cannot enter as far as its middle is refused with a proof: the widest way
# from the entrance to that middle, which bounds the clearance of every path whatever its bends, is narrower than
# the robot. Where a branch is wide enough and no plan was found, that is said, with what stopped the robot, and not called
# impossible.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from tubeplan_viz.bronchoscope.airway import AirwayTree, Entrance
from tubeplan_viz.bronchoscope.mover import Mover
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings, RobotPlan
from tubeplan_viz.bronchoscope.target import ROOM, Target
from tubeplan_viz.bronchoscope.way import plan_way
from tubeplan_viz.tube.bottleneck import widest_way

# A section bent this much has nothing left.
FULL_BEND = 0.97
# The tip is in a branch when it is past so much of its length, or at its end.
HALF = 0.5
# A wide mouth shorter than this is no way in, mm.
LEAST_WAY = 2.0


class Verdict(StrEnum):
    """What is known of one branch."""

    REACHED = "reached"
    DIAMETER = "diameter"
    BEND = "bend"
    COLLISION = "collision"


@dataclass(frozen=True, eq=False, kw_only=True)
class BranchReach:
    """The robot against one branch.

    Attributes
    ----------
    verdict : Verdict
    reason : str or None
        Why it is not reached.
    depth : float, mm
        How far into the branch a plan came; 0 without one.
    tip_error : float, mm, or None
        Of the plan that ends in this branch.
    bound : float, mm, or None
        Upper bound of any path's clearance to the branch's middle, where that is the proof.
    plan : RobotPlan or None
        That ends in this branch.
    """

    verdict: Verdict
    reason: str | None
    depth: float
    tip_error: float | None = None
    bound: float | None = None
    plan: RobotPlan | None = None


def reach_map(
    airway: AirwayTree,
    entrance: Entrance,
    robot: Robot,
    settings: PlannerSettings,
    *,
    rng_seed: int = 0,
    simulator: Mover | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[BranchReach, ...]:
    """Judge every branch; in the order of ``airway.branches``.

    Parameters
    ----------
    airway : AirwayTree
    entrance : Entrance
    robot : Robot
    settings : PlannerSettings
    rng_seed : int
    simulator : Mover, optional
        Without one the plans are kinematic.
    progress : callable, optional
        Called with the number of branches judged and of all.
    """
    found: dict[int, BranchReach] = {}
    order = sorted(range(len(airway.branches)), key=lambda k: (-airway.branches[k].generation, k))
    for done, number in enumerate(order):
        branch = airway.branches[number]
        depth = airway.wide_depth(number, robot.radius + ROOM)
        passed = any(found[child].depth > 0.0 for child in airway.children[number] if child in found)
        if passed:
            found[number] = BranchReach(verdict=Verdict.REACHED, reason=None, depth=branch.length)
        elif depth < HALF * branch.length:
            into = planned(airway, entrance, number, depth, robot, settings, rng_seed, simulator) if depth > LEAST_WAY else None
            found[number] = too_narrow(airway, entrance, number, into, robot) or (
                into or planned(airway, entrance, number, depth, robot, settings, rng_seed, simulator)
            )
        else:
            found[number] = planned(airway, entrance, number, depth, robot, settings, rng_seed, simulator)
        if progress is not None:
            progress(done + 1, len(order))
    return tuple(found[number] for number in range(len(airway.branches)))


def too_narrow(airway: AirwayTree, entrance: Entrance, number: int, into: BranchReach | None, robot: Robot) -> BranchReach | None:
    """The refusal of a branch by its width, proved, with the plan `into` its wide part; None where the proof fails."""
    branch = airway.branches[number]
    begin = entrance.pose[:3, 3] + robot.active_length * entrance.pose[:3, 2]
    middle = airway.place(number, HALF * branch.length)
    neck = widest_way(airway.wall, begin, middle, limit=robot.radius)
    if neck.bound >= robot.radius:
        return None
    x, y, z = neck.place
    why = f"no way to its middle is wider than {2.0 * neck.bound:.1f} mm, at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
    refusal = BranchReach(verdict=Verdict.DIAMETER, reason=why, depth=0.0, bound=float(neck.bound))
    if into is None or into.verdict is not Verdict.REACHED:
        return refusal
    return replace(refusal, depth=into.depth, tip_error=into.tip_error, plan=into.plan)


def planned(
    airway: AirwayTree,
    entrance: Entrance,
    number: int,
    depth: float,
    robot: Robot,
    settings: PlannerSettings,
    rng_seed: int,
    simulator: Mover | None,
) -> BranchReach:
    """A plan into a branch, as deep as it is wide enough, or else to its middle."""
    deepest = max(depth, 0.5)
    middle = HALF * airway.branches[number].length
    for wanted in (deepest, middle) if middle < deepest else (deepest,):
        target = Target(branch=number, depth=wanted, point=airway.place(number, wanted))
        way = plan_way(airway, entrance, target, robot, settings, rng=np.random.default_rng(rng_seed), simulator=simulator)
        plan = way.plan
        if plan.reached:
            return BranchReach(verdict=Verdict.REACHED, reason=None, depth=wanted, tip_error=plan.tip_error, plan=plan)
    verdict, why = stopped_by(plan, robot)
    return BranchReach(verdict=verdict, reason=why, depth=0.0, tip_error=plan.tip_error)


def stopped_by(plan: RobotPlan, robot: Robot) -> tuple[Verdict, str]:
    """What stopped a plan where it came nearest to its target."""
    goal = plan.stages[-1].goal
    refused = [node for node in plan.nodes if not node.accepted]
    near = min(refused or plan.nodes, key=lambda node: float(np.linalg.norm(node.tip - goal)))
    command = near.step.command
    where = f"the tip came within {plan.tip_error:.1f} mm"
    if command is not None and max(command.phi_proximal, command.phi_distal) >= FULL_BEND * robot.bend_max:
        return Verdict.BEND, f"a section is at its largest bend; {where}"
    part = "front disc" if near.step.disc_clearance < 0.0 else "body"
    return Verdict.COLLISION, f"the {part} meets the wall; {where}"
