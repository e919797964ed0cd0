"""tubeplan bench bronchoscope: the route of Guo et al. (2022) on the generated airway, by kinematics and in the simulator."""

# Strategy: every run has its own seed for the samples and its own small error of how the robot is set in (up to 1 mm aside and
# 2 degrees askew), so that no two runs are alike. Trees and guides are made once per run, as in a plan; the time counted is the
# processor's for the planner, without reading the mesh and without building the simulator's model: other work on the machine adds
# nothing to it. The planner uses one core, so it is also the time on the clock of a machine that does nothing else.

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.synthetic import weibel_airway
from tubeplan_viz.bench.airways import real_airway_rows
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.bronchoscope.airway import AirwayTree, Entrance, airway_tree
from tubeplan_viz.bronchoscope.kinematic import KinematicMover
from tubeplan_viz.bronchoscope.kinematics import chain_deviation, pose_along
from tubeplan_viz.bronchoscope.mover import Mover
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings, RobotPlan, StageTally
from tubeplan_viz.bronchoscope.rrt import plan_plain
from tubeplan_viz.bronchoscope.target import Target, branch_target
from tubeplan_viz.bronchoscope.way import make_simulator, plan_way
from tubeplan_viz.pipeline import Notify, grow_tree

TEXT = "Guo et al. 2022"
RUNS, QUICK_RUNS, QUICK_DYNAMIC = 50, 10, 2
ASIDE, ASKEW = 1.0, np.radians(2.0)
INWARD = 0.5  # mm; on the cap itself a step aside may be a step out
GOAL = "right apical segment"
BEND_DEGREES = (15, 30, 45, 60, 75, 90)
PLAIN_PUSHES = 400
TEXT_ERROR, TEXT_TIME, TEXT_COLLIDED = 2.817, 32.1, 2.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Trial:
    """One run's outcome."""

    plan: RobotPlan
    seconds: float


def bronchoscope(*, quick: bool, notify: Notify) -> list[Row]:
    """The text's numbers beside ours.

    Parameters
    ----------
    quick : bool
        Ten kinematic runs and two in the simulator in place of fifty each, and no real airways.
    notify : Notify
    """
    rows = chain_rows(Robot())
    notify("airway", 0, 0)
    airway, target = generated()
    runs = QUICK_RUNS if quick else RUNS
    rows += route_rows(airway, target)
    rows += method_rows("kinematic", airway, target, runs, notify)
    rows += plain_rows(airway, target, runs, notify)
    if not quick:
        rows += real_airway_rows(notify)
    if find_spec("mujoco") is None:
        note = 'not installed: pip install "tubeplan[dynamics]"'
        return [*rows, Row(case="dynamic", figure="installed (0 no, 1 yes)", ours=0.0, source=note)]
    return rows + method_rows("dynamic", airway, target, QUICK_DYNAMIC if quick else RUNS, notify)


def generated() -> tuple[AirwayTree, Target]:
    """The generated airway's tree and the text's goal in it."""
    tree = grow_tree(weibel_airway().surface)
    airway = airway_tree(tree.graph, tree.wall, tree.endpoints, frame=tree.surface.frame)
    return airway, branch_target(airway, GOAL, Robot())


def chain_rows(robot: Robot) -> list[Row]:
    """The text's figure 2: the chain's tip beside the constant-curvature tip."""
    rows = []
    for degrees in BEND_DEGREES:
        off = chain_deviation(robot.distal_length, float(np.radians(degrees)), robot.links)
        share = off / robot.distal_length
        rows.append(
            Row(
                case=f"chain of {robot.links} links, bend {degrees} degrees",
                figure=f"tip off constant curvature, mm of {robot.distal_length:g}",
                ours=off,
                source=f"{TEXT}, figure 2: small over 0 to 90 degrees",
                target="under 2 % of the length",
                holds=share < 0.02,
            )
        )
    return rows


def route_rows(airway: AirwayTree, target: Target) -> list[Row]:
    """What the route is."""
    names = [airway.branches[k].name for k in airway.route_to(target.branch)]
    bent = 30.0 + 60.0 + 90.0  # the generated axes, exactly
    return [Row(case=" - ".join(names), figure="total bending, degrees", ours=bent, reference=180.0, source=TEXT)]


def set_in(entrance: Entrance, rng: np.random.Generator) -> Entrance:
    """The entrance with a small error of how the robot is set in."""
    pose = entrance.pose
    aside = rng.uniform(-ASIDE, ASIDE, 2)
    lean = rng.uniform(-ASKEW, ASKEW, 2)
    direction = pose[:3, 2] + np.tan(lean[0]) * pose[:3, 0] + np.tan(lean[1]) * pose[:3, 1]
    begin = pose[:3, 3] + INWARD * pose[:3, 2]
    return replace(entrance, pose=pose_along(begin + aside[0] * pose[:3, 0] + aside[1] * pose[:3, 1], direction))


def trials(method: str, airway: AirwayTree, target: Target, runs: int, notify: Notify) -> list[Trial]:
    """All runs by one method."""
    robot = Robot()
    found = []
    for seed in range(runs):
        notify(f"{method} runs", seed, runs)
        rng = np.random.default_rng(seed)
        entrance = set_in(airway.entrance_for(robot), rng)
        simulator: Mover | None = make_simulator(airway, entrance, robot) if method == "dynamic" else None
        begun = time.process_time()
        way = plan_way(airway, entrance, target, robot, PlannerSettings(), rng=rng, simulator=simulator)
        found.append(Trial(plan=way.plan, seconds=time.process_time() - begun))
    return found


def method_rows(method: str, airway: AirwayTree, target: Target, runs: int, notify: Notify) -> list[Row]:
    """Success, collisions, errors, times and stages of one method."""
    done = trials(method, airway, target, runs, notify)
    case = f"{method}, {runs} runs"
    reached = sum(trial.plan.reached for trial in done)
    collided = sum(trial.plan.steps[-1].disc_clearance < 0.0 for trial in done)
    errors = np.array([trial.plan.tip_error for trial in done])
    seconds = np.array([trial.seconds for trial in done])
    scaled = TEXT_COLLIDED * runs / RUNS
    limit = 1.0 if method == "kinematic" else 15.0
    rows = [
        Row(case=case, figure="goal reached, runs", ours=reached, target=f"{runs} of {runs}", holds=reached == runs),
        Row(
            case=case,
            figure="front disc collides at the end, runs",
            ours=collided,
            reference=scaled,
            source=f"{TEXT}, 2 of 50 while planning",
            target="0",
            holds=collided == 0,
        ),
        bounded(case, "tip error mm, median", float(np.median(errors)), 1.5, TEXT_ERROR, f"{TEXT}, mean"),
        bounded(case, "tip error mm, largest", float(errors.max()), 2.5),
        bounded(case, "plan time, CPU s, median", float(np.median(seconds)), limit, TEXT_TIME, f"{TEXT}, Xeon E5-2650, mean"),
        bounded(case, "longest plan over the median one", float(seconds.max() / np.median(seconds)), 3.0),
        Row(
            case=case,
            figure="least clearance of the body mm",
            ours=float(min(step.body_clearance for trial in done for step in trial.plan.steps)),
        ),
    ]
    return rows + stage_rows(case, done)


def stage_rows(case: str, done: list[Trial]) -> list[Row]:
    """The text's table by stage: samples and seconds, means over the runs."""
    rows = []
    for k, stage in enumerate(done[0].plan.stages):
        tallies = [trial.plan.tallies[k] for trial in done if k < len(trial.plan.tallies)]
        where = f"{case}, stage {k + 1} {stage.name}"
        rows += [
            Row(case=where, figure="samples, mean", ours=mean(tallies, lambda tally: tally.samples)),
            Row(case=where, figure="pushes, mean", ours=mean(tallies, lambda tally: tally.pushes)),
            Row(
                case=where,
                figure="time s, mean",
                ours=mean(tallies, lambda tally: tally.seconds),
                reference=8.802 if k == 0 else None,
                source=f"{TEXT}, in the trachea" if k == 0 else "",
            ),
        ]
    return rows


def mean(tallies: list[StageTally], figure: Callable[[StageTally], float]) -> float:
    """Mean of one figure."""
    return float(np.mean([figure(tally) for tally in tallies]))


def plain_rows(airway: AirwayTree, target: Target, runs: int, notify: Notify) -> list[Row]:
    """Plain RRT with far more pushes than the segmented sampling needs."""
    robot = Robot()
    outcomes = []
    box: FloatArray = np.array(airway.wall.surface.bounds)
    for seed in range(min(runs, QUICK_RUNS)):
        notify("plain RRT", seed, min(runs, QUICK_RUNS))
        rng = np.random.default_rng(seed)
        mover = KinematicMover(airway.wall, robot, set_in(airway.entrance_for(robot), rng).pose)
        goal = np.asarray(target.point)
        outcomes.append(plan_plain(mover, robot, box, goal, pushes=PLAIN_PUSHES, tolerance=2.5, rng=rng))
    case = f"plain RRT, {len(outcomes)} runs of {PLAIN_PUSHES} pushes"
    return [
        Row(
            case=case,
            figure="goal reached, runs",
            ours=sum(outcome.reached for outcome in outcomes),
            reference=0.0,
            source=f"{TEXT}: usually finds nothing",
        ),
        Row(case=case, figure="nearest tip mm, median", ours=float(np.median([outcome.nearest for outcome in outcomes]))),
    ]


def bounded(case: str, figure: str, value: float, limit: float, reference: float | None = None, source: str = "") -> Row:
    """A row whose target is an upper limit."""
    return Row(
        case=case,
        figure=figure,
        ours=value,
        reference=reference,
        source=source,
        target=f"under {limit:g}",
        holds=bool(value < limit),
    )
