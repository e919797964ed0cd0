"""One plan from the entrance to a target: route, guide and stages, then kinematics, then, if asked, the dynamics."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.bronchoscope.airway import AirwayTree, Entrance
from tubeplan_viz.bronchoscope.guide import STEP, Guide, make_guide
from tubeplan_viz.bronchoscope.kinematic import KinematicMover
from tubeplan_viz.bronchoscope.mover import Mover
from tubeplan_viz.bronchoscope.planner import plan_segmented
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import Node, PlannerSettings, RobotPlan
from tubeplan_viz.bronchoscope.route import Stage, make_stages
from tubeplan_viz.bronchoscope.sequence import plan_at_once
from tubeplan_viz.bronchoscope.target import Target
from tubeplan_viz.centerline import Centerline, even_points
from tubeplan_viz.geometry import WallDistance

# A robot with contacts lies on the wall; deeper than this its body is out of the lumen (the simulator's leak bound), mm.
LEAK = 0.3
# So far a soft contact lets the disc's rim into the wall that it brushes, mm.
BRUSH = 0.05
# Body clearance asked of the kinematic plan before a dynamic one, mm.
ROOMY = 0.2
# Samples before all commands are laid at once.
FIRST_SAMPLES = 30
# With weight: samples beyond one for each stage before the robot begins anew, the share of the longest push that it then has, and
# samples while it learns how its base goes.
SPARE, SHORTER, LEARNING = 2, 0.6, 20
# Over the last millimetres the guide leaves the middle for a target beside it.
LAST_BEND = 8.0

Watch = Callable[[Node, int], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Way:
    """A plan with what led to it.

    Attributes
    ----------
    plan : RobotPlan
        By the mover that was asked for.
    centerline : Centerline
        From the entrance to the target.
    guide : Guide
        Along which the robot was steered.
    route : tuple of int
        Numbers of the branches.
    foreplan : RobotPlan or None
        The kinematic plan that came before a dynamic one.
    """

    plan: RobotPlan
    centerline: Centerline
    guide: Guide
    route: tuple[int, ...]
    foreplan: RobotPlan | None = None


def plan_way(
    airway: AirwayTree,
    entrance: Entrance,
    target: Target,
    robot: Robot,
    settings: PlannerSettings,
    *,
    rng: np.random.Generator,
    simulator: Mover | None = None,
    watch: Watch | None = None,
) -> Way:
    """Plan to a target.

    Parameters
    ----------
    airway : AirwayTree
    entrance : Entrance
    target : Target
    robot : Robot
    settings : PlannerSettings
    rng : numpy.random.Generator
    simulator : Mover, optional
        Moves the robot with dynamics; the kinematic plan's shape then guides it. Without one the kinematic plan is the plan.
    watch : callable, optional
        Called with each node of the tree of the mover that was asked for.
    """
    begun = time.perf_counter()
    line = airway.line_to(target.branch, target.depth, begin=entrance.offset)
    guide = towards(make_guide(line, robot), target.point)
    mover = KinematicMover(airway.wall, robot, entrance.pose)
    stages = stages_on(airway, entrance, target, guide, robot)

    seen = watch if simulator is None else None

    def foreplan(margin: float, samples: int) -> RobotPlan:
        left = time_left(settings, begun)
        asked = replace(settings, body_margin=margin, samples_max=min(samples, settings.samples_max), time_budget=left)
        return plan_segmented(mover, robot, guide, stages, asked, wall=airway.wall, rng=rng, watch=seen)

    # What is to guide a robot with weight keeps more room where it can. Where few samples find nothing, the bends are too
    # tight to be taken one by one; the many samples that are allowed are the last resort.
    first = foreplan(settings.body_margin if simulator is None else ROOMY, FIRST_SAMPLES)
    if not first.reached:
        first = plan_at_once(first, mover, robot, guide, settings, wall=airway.wall, watch=seen)
    if not first.reached and settings.samples_max > FIRST_SAMPLES:
        first = foreplan(settings.body_margin, settings.samples_max)
    route = airway.route_to(target.branch)
    if simulator is None:
        exact = replayed(KinematicMover(airway.wall, robot, entrance.pose, far=np.inf), first)
        return Way(plan=exact, centerline=line, guide=guide, route=route)
    if first.reached:
        guide = guide_of(first, airway, target.point)
    stages = stages_on(airway, entrance, target, guide, robot)
    leaning = replace(
        settings,
        body_margin=min(settings.body_margin, -LEAK),
        disc_margin=min(settings.disc_margin, -BRUSH),
        time_budget=time_left(settings, begun),
    )
    plan = plan_moved(simulator, robot, guide, stages, leaning, wall=airway.wall, rng=rng, watch=watch)
    return Way(plan=plan, centerline=line, guide=guide, route=route, foreplan=first)


def plan_moved(
    simulator: Mover,
    robot: Robot,
    guide: Guide,
    stages: tuple[Stage, ...],
    settings: PlannerSettings,
    *,
    wall: WallDistance,
    rng: np.random.Generator,
    watch: Watch | None = None,
) -> RobotPlan:
    """Plan with a mover that knows weight and contact; parameters as `plan_segmented`.

    What a tree does not reach with few samples it seldom reaches with many: a tip that has missed a mouth does not come back.
    So the robot begins anew from the entrance: with shorter pushes, which follow the guide more closely; then by learning how
    far the base follows the bend before it, which it does where walls hold the shaft and not in a wide lumen, where a tip
    that is aimed as if it did sinks; then as at first, with all samples that are left. Of plans that do not reach the
    goal, the one that came nearest is kept.
    """
    begun, few = time.perf_counter(), len(stages) + SPARE
    tries = ((1.0, False, few), (SHORTER, False, few), (1.0, True, LEARNING), (1.0, False, settings.samples_max))
    best, samples, poses = None, 0, 0
    for share, learns, most in tries:
        left = time_left(settings, begun)
        if best is not None and (best.reached or samples >= settings.samples_max or left == 0.0):
            break
        asked = replace(
            settings,
            samples_max=min(most, settings.samples_max - samples),
            push_max=max(share * settings.push_max, settings.push_min),
            time_budget=left,
        )
        further = None if watch is None else partial(told_later, watch, poses)
        plan = plan_segmented(simulator, robot, guide, stages, asked, wall=wall, rng=rng, learns=learns, watch=further)
        samples, poses = samples + len(plan.samples), poses + len(plan.nodes)
        if best is None or plan.reached or plan.tip_error < best.tip_error:
            best = plan
    assert best is not None
    return replace(best, given_up=(poses - len(best.nodes), samples - len(best.samples)))


def told_later(watch: Watch, before: int, node: Node, number: int) -> None:
    """Tell of a pose by its number after the poses of trees before it."""
    watch(node, before + number)


def time_left(settings: PlannerSettings, begun: float) -> float | None:
    """What is left of the time budget, s, for what began at `begun` of the clock; None without a budget."""
    return None if settings.time_budget is None else max(settings.time_budget - (time.perf_counter() - begun), 0.0)


def replayed(mover: Mover, plan: RobotPlan) -> RobotPlan:
    """The same plan with its steps moved anew, by a mover that measures every clearance."""
    steps = [mover.start()]
    for step in plan.steps[1:]:
        assert step.command is not None
        steps.append(mover.move(steps[-1], step.command))
    return replace(plan, steps=tuple(steps))


def stages_on(airway: AirwayTree, entrance: Entrance, target: Target, guide: Guide, robot: Robot) -> tuple[Stage, ...]:
    """The stages of a route on a guide."""
    return make_stages(guide, airway.passages(target.branch, guide, begin=entrance.offset), target.point, robot)


def towards(guide: Guide, point: FloatArray) -> Guide:
    """The guide with its end moved onto a point, fading out over its last millimetres."""
    left = np.clip(1.0 - (guide.length - guide.arc_length) / LAST_BEND, 0.0, 1.0)
    moved = guide.points + (left * left * (3.0 - 2.0 * left))[:, None] * (point - guide.points[-1])
    return Guide(moved, guide.radii)


def guide_of(plan: RobotPlan, airway: AirwayTree, goal: FloatArray) -> Guide:
    """The robot's shape at the end of a plan as a guide: no sharper than its sections bend, and clear of the wall."""
    body = plan.steps[-1].body
    gaps = np.concatenate([[True], np.linalg.norm(np.diff(body, axis=0), axis=1) > 1e-6])
    points = even_points(body[gaps], STEP)
    return towards(Guide(points, airway.wall.distance(points)), goal)


def make_simulator(airway: AirwayTree, entrance: Entrance, robot: Robot) -> Mover:
    """The robot's dynamics in MuJoCo.

    Raises
    ------
    CaseError
        If MuJoCo is not installed.
    """
    if find_spec("mujoco") is None:
        raise CaseError(
            'the method dynamic needs MuJoCo, which is not installed: pip install "tubeplan[dynamics]", '
            "or plan without it (--method kinematic)"
        )
    from tubeplan_viz.bronchoscope.dynamics import Simulator

    return Simulator(airway.wall.surface, robot, entrance.pose)
