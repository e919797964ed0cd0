"""tubeplan bench dynamics: the simulated robot against the text's tests, against itself at half the step, and the wall."""

# Strategy: free bending and pushing are the text's first experiment. Halved steps and the leak test need the orders of a real
# plan: those of the plan to the right apical segment of the generated airway. The leak test leaves that plan's poses by
# orders drawn at random, which no planner would give.

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.bench.bronchoscope import TEXT, generated
from tubeplan_viz.bench.models import straight_tube
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.bronchoscope.dynamics import DynamicsSettings, Simulator
from tubeplan_viz.bronchoscope.kinematics import pose_along
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings
from tubeplan_viz.bronchoscope.way import plan_way
from tubeplan_viz.pipeline import Notify

FREE_RADIUS = 70.0  # mm: nothing is touched
RANDOM_RUNS, QUICK_RUNS, RUN_ORDERS = 20, 3, 5
LEAK = 0.3
NATIVE = "MuJoCo 4.0's own contact in a straight tube, 89 degrees of freedom, 1 ms steps"


def dynamics(*, quick: bool, notify: Notify) -> list[Row]:
    """Rows of the simulator.

    Parameters
    ----------
    quick : bool
        Three random runs in place of twenty, and no halved step.
    notify : Notify
    """
    rows = free_rows(Robot())
    airway, target = generated()
    entrance = airway.entrance_for(Robot())
    simulator = Simulator(airway.wall.surface, Robot(), entrance.pose)
    begun, steps = time.process_time(), simulator.steps
    rng = np.random.default_rng(0)
    plan = plan_way(airway, entrance, target, Robot(), PlannerSettings(), rng=rng, simulator=simulator).plan
    milliseconds = 1e3 * (time.process_time() - begun) / max(simulator.steps - steps, 1)
    case = "plan to the right apical segment, generated airway"
    faces = len(airway.wall.surface.faces)
    rows += [
        Row(case=case, figure="steps of 2 ms", ours=float(simulator.steps)),
        Row(
            case=case, figure=f"CPU per step, ms, wall of {faces} faces, prisms", ours=milliseconds, reference=1.8, source=NATIVE
        ),
        Row(case=case, figure="CPU per step, ms, mesh distance", ours=milliseconds, reference=4.6, source=NATIVE),
        depth_row(case, plan.steps),
    ]
    if not quick:
        rows += step_rows(simulator, plan.steps, notify)
    return [*rows, leak_row(simulator, plan.steps, QUICK_RUNS if quick else RANDOM_RUNS, notify)]


def free_rows(robot: Robot) -> list[Row]:
    """The text's section 2.1: push at 15 mm/s, both sections bent by 90 degrees under gravity."""
    tube = straight_tube(length=150.0, radius=FREE_RADIUS)
    simulator = Simulator(
        tube.surface, robot, pose_along([0.0, 5.0, 0.0], [0.0, 1.0, 0.0]), DynamicsSettings(gravity=(0.0, 0.0, -9.81))
    )
    start = simulator.start()
    bent = simulator.move(start, order(robot.bend_max, 0.7, robot.bend_max, 0.7, 20.0))
    total = float(np.degrees(np.arccos(np.clip(bent.base[:3, 2] @ bent.tip[:3, 2], -1.0, 1.0))))
    speeds = np.array([moment.push_speed for moment in simulator.moments(start, order(0.0, 0.0, 0.0, 0.0, 15.0))])
    pushed = speeds[: round(15.0 / robot.push_speed / simulator.settings.time_step)]
    over = 100.0 * (float(pushed.max()) / robot.push_speed - 1.0)
    held = 100.0 * float(np.abs(pushed[len(pushed) // 4 :] / robot.push_speed - 1.0).max())
    case = "free robot under gravity"
    return [
        Row(
            case=case,
            figure="bend of both sections, degrees of 180",
            ours=total,
            reference=171.0,
            source=TEXT,
            target="at least 171",
            holds=total >= 171.0,
        ),
        Row(case=case, figure="push speed's overshoot at the start, %", ours=over, source=f"{TEXT}: seen, not stated"),
        Row(case=case, figure="push speed off 15 mm/s after that, %", ours=held, target="under 1", holds=held < 1.0),
    ]


def depth_row(case: str, steps: tuple[Step, ...]) -> Row:
    """How deep the body gets into the wall on a plan."""
    depth = -min(step.body_clearance for step in steps)
    return Row(
        case=case,
        figure="deepest in the wall, mm",
        ours=depth,
        reference=0.11,
        source=f"prisms, {NATIVE}",
        target=f"under {LEAK:g}",
        holds=depth < LEAK,
    )


def step_rows(simulator: Simulator, steps: tuple[Step, ...], notify: Notify) -> list[Row]:
    """The plan's orders again with half the time step, and with other links of the passive section."""
    made = []
    others = {
        "half the time step": replace(simulator.settings, time_step=0.5 * simulator.settings.time_step),
        "passive links half as long": replace(
            simulator.settings, fine_link=0.5 * simulator.settings.fine_link, coarse_link=0.5 * simulator.settings.coarse_link
        ),
    }
    for number, (name, settings) in enumerate(others.items()):
        notify(name, number, len(others))
        other = Simulator(simulator.wall.exact.surface, simulator.robot, np.asarray(simulator.entrance), settings)
        off = float(np.linalg.norm(replayed_tip(other, steps) - steps[-1].tip[:3, 3]))
        made.append(Row(case=name, figure="final tip moves by, mm", ours=off, target="under 0.2", holds=off < 0.2))
    return made


def replayed_tip(simulator: Simulator, steps: tuple[Step, ...]) -> FloatArray:
    """The tip after the orders of a plan, (3,) mm."""
    step = simulator.start()
    for made in steps[1:]:
        assert made.command is not None
        step = simulator.move(step, made.command)
    return np.asarray(step.tip[:3, 3])


def leak_row(simulator: Simulator, steps: tuple[Step, ...], runs: int, notify: Notify) -> Row:
    """Random orders from random poses of a plan: bends of up to 90 degrees in any plane, pushes of -6 to 9 mm."""
    rng, least = np.random.default_rng(1), np.inf
    for run in range(runs):
        notify("random orders", run, runs)
        step = steps[int(rng.integers(len(steps)))]
        for _ in range(RUN_ORDERS):
            bend, plane = rng.uniform(0.0, simulator.robot.bend_max, 2), rng.uniform(-np.pi, np.pi, 2)
            push = max(float(rng.uniform(-6.0, 9.0)), -step.state.inserted)
            step = simulator.move(step, order(float(bend[0]), float(plane[0]), float(bend[1]), float(plane[1]), push))
            least = min(least, step.body_clearance)
    return Row(
        case=f"{runs * RUN_ORDERS} random orders in the generated airway",
        figure="deepest in the wall, mm",
        ours=-least,
        target=f"under {LEAK:g}",
        holds=-least < LEAK,
    )


def order(phi_proximal: float, theta_proximal: float, phi_distal: float, theta_distal: float, push: float) -> Command:
    """A command by its five numbers."""
    return Command(
        phi_proximal=phi_proximal,
        theta_proximal=theta_proximal,
        phi_distal=phi_distal,
        theta_distal=theta_distal,
        push=push,
    )
