"""tubeplan reach: which branches of an airway the robot reaches, and why not the others."""

# Strategy: the robot is planned into the deepest branches that are wide enough; a branch on the way of a plan that
# succeeds is reached too. A branch that the robot cannot enter as far as its middle is refused with a proof: the widest way
# from the entrance to that middle, which bounds the clearance of every path whatever its bends, is narrower than
# the robot. Where a branch is wide enough and no plan was found, that is said, with what stopped the robot, and not called
# impossible.

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from reports import render_reach, write_page
from segmentation.mesh_files import write_ply
from tubeplan_viz.bronchoscope.airway import AirwayTree, Entrance
from tubeplan_viz.bronchoscope.mover import Mover
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings, RobotPlan
from tubeplan_viz.bronchoscope.target import ROOM, Target
from tubeplan_viz.bronchoscope.way import make_simulator, plan_way
from tubeplan_viz.cases.bronchoscope import BronchoscopeCase, bronchoscope_case_table
from tubeplan_viz.pipeline import Notify, Stopwatch, silent
from tubeplan_viz.pipeline.airway import case_name, load_airway
from tubeplan_viz.pipeline.bronchoscope_details import branch_rows
from tubeplan_viz.recording import record_reach
from tubeplan_viz.result import Provenance, RunFolder, plain
from tubeplan_viz.tube.bottleneck import widest_way

REACH_FILES = ("reach.json", "reach.csv", "report.html", "recording.rrd", "mesh.ply")
# Samples for one branch before all commands are laid at once: a number, no time, so that the map is the same on every machine.
SAMPLES = 12
# A section bent this much has nothing left.
FULL_BEND = 0.97
# The tip is in a branch when it is past so much of its length, or at its end.
HALF = 0.5
# A wide mouth shorter than this is no way in, mm.
LEAST_WAY = 2.0
RULE = (
    "Reached: a plan by the stated method ends there, or passes through. Too narrow: proved, the widest way from the entrance "
    "to the branch's middle is narrower than the robot, whatever the bends. Bend and collision: wide enough, but no plan was "
    "found; what stopped the robot is named, and that there is no way is not proved."
)


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
        elif depth < min(HALF * branch.length, branch.length):
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


def run_reach(
    case: BronchoscopeCase,
    target: Path,
    *,
    force: bool = False,
    recording: bool = True,
    report: bool = True,
    notify: Notify = silent,
) -> dict[str, Any]:
    """Judge every branch of a case's airway and write the folder.

    Parameters
    ----------
    case : BronchoscopeCase
        Its goal does not count.
    target : Path
        The folder to make.

    Returns
    -------
    dict
        The content of reach.json.

    Raises
    ------
    TubeplanError
        If the input is bad; then no folder is left.
    """
    watch = Stopwatch(notify)
    with RunFolder(target, force=force, files=REACH_FILES) as folder:
        given = load_airway(case, watch)
        simulator = make_simulator(given.airway, given.entrance, case.robot) if case.method == "dynamic" else None
        samples = case.settings.samples_max if simulator is not None else min(SAMPLES, case.settings.samples_max)
        with watch.stage("plan") as progress:

            def judged(done: int, total: int) -> None:
                progress(done, total)
                folder.check_interrupted()

            reach = reach_map(
                given.airway,
                given.entrance,
                case.robot,
                replace(case.settings, samples_max=samples, time_budget=case.time_budget),
                rng_seed=case.rng_seed,
                simulator=simulator,
                progress=judged,
            )
        written = write_ply(given.tree.surface, folder.path("mesh.ply"))
        provenance = Provenance(inputs=given.lumen.inputs, rng_seed=case.rng_seed, settings=bronchoscope_case_table(case))
        document = plain(reach_document(case, given.airway, reach, provenance, watch.seconds))
        document |= {"frame": written.frame, "warnings": list(given.lumen.warnings)}
        if recording:
            with watch.stage("recording"):
                record_reach(document, written, folder.path("recording.rrd"))
        folder.write_text("reach.csv", reach_csv(document))
        if report:
            write_page(render_reach(document, written), folder.path("report.html"))
        folder.write_json("reach.json", document)
        folder.appear()
    return document


def reach_document(
    case: BronchoscopeCase,
    airway: AirwayTree,
    reach: tuple[BranchReach, ...],
    provenance: Provenance,
    timings_s: Mapping[str, float],
) -> dict[str, Any]:
    """The content of reach.json."""
    rows = []
    for number, (row, judged) in enumerate(zip(branch_rows(airway), reach, strict=True)):
        line = airway.branches[number].line
        rows.append(
            row
            | {
                "verdict": judged.verdict,
                "proved": judged.verdict in (Verdict.REACHED, Verdict.DIAMETER),
                "reason": judged.reason,
                "leaf": not airway.children[number],
                "depth_mm": judged.depth,
                "tip_error_mm": judged.tip_error,
                "clearance_bound_mm": judged.bound,
                "middle_mm": airway.place(number, HALF * airway.branches[number].length),
                "deepest_mm": airway.place(number, judged.depth) if judged.depth > 0.0 else None,
                "points_mm": line.points,
                "body_mm": None if judged.plan is None else judged.plan.steps[-1].body[::2],
            }
        )
    return {
        "software": provenance.software,
        "provenance": provenance.details(),
        "case_id": case_name(case),
        "method": case.method,
        "robot": {
            "name": case.robot.name,
            "diameter_mm": case.robot.diameter,
            "active_length_mm": case.robot.active_length,
            "bend_max_deg": float(np.degrees(case.robot.bend_max)),
        },
        "rule": RULE,
        "counts": {verdict.value: sum(judged.verdict is verdict for judged in reach) for verdict in Verdict},
        "branches": rows,
        "timings_s": timings_s,
    }


CSV_COLUMNS = (
    "name",
    "label",
    "generation",
    "diameter_mm",
    "least_diameter_mm",
    "length_mm",
    "turn_deg",
    "verdict",
    "proved",
    "depth_mm",
    "tip_error_mm",
    "clearance_bound_mm",
    "confidence",
    "reason",
)


def reach_csv(document: Mapping[str, Any]) -> str:
    """reach.csv: one row for each branch."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for row in document["branches"]:
        writer.writerow(["" if row[key] is None else row[key] for key in CSV_COLUMNS])
    return text.getvalue()
