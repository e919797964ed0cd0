"""The bronchoscope robot in real airways: every branch judged by kinematics, the deepest reached ends in the simulator too."""

from __future__ import annotations

import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from tubeplan_viz.bench.anatomies import SHARED, SOURCES, read_lumen
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.bronchoscope.airway import AirwayTree, Entrance, airway_tree
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings
from tubeplan_viz.bronchoscope.target import Target
from tubeplan_viz.bronchoscope.way import LEAK, make_simulator, plan_way
from tubeplan_viz.pipeline import Notify, entered_tree
from tubeplan_viz.reach import SAMPLES
from tubeplan_viz.reach_map import BranchReach, Verdict, reach_map

AIRWAYS = {"cmb_crc_chest_ct": "cmb_crc", "elastix_right_lung": "elastix", "hubmap_airway_female": "HuBMAP airway"}
# In the simulator a plan takes ten seconds, so the deepest few of each airway are enough.
DYNAMIC = 3
TIP_ERROR = 2.5  # mm, as on the generated airway


def real_airway_rows(notify: Notify) -> list[Row]:
    """Rows of all airways at hand; one row that says so where the shared data are not beside the source tree."""
    if not SHARED.exists():
        return [Row(case="real airways", figure="at hand", ours=0.0, source="skipped: no ../shared/data beside the source tree")]
    rows: list[Row] = []
    for name, source in AIRWAYS.items():
        notify(name, 0, 0)
        file, anatomy, _ = SOURCES[source]
        assert file is not None
        with tempfile.TemporaryDirectory() as folder:
            surface = read_lumen(SHARED / file, anatomy, Path(folder))
        tree = entered_tree(surface, "airway")
        airway = airway_tree(tree.graph, tree.wall, tree.endpoints, frame=tree.surface.frame)
        entrance = airway.entrance_for(Robot())
        reach = reach_map(airway, entrance, Robot(), PlannerSettings(samples_max=SAMPLES))
        rows.append(kinematic_row(name, reach))
        if find_spec("mujoco") is not None:
            rows += dynamic_rows(name, airway, entrance, reach, notify)
    return rows


def kinematic_row(name: str, reach: tuple[BranchReach, ...]) -> Row:
    """How many branches are neither reached nor refused with a proof."""
    counts = [sum(judged.verdict is verdict for judged in reach) for verdict in (Verdict.REACHED, Verdict.DIAMETER)]
    undecided = len(reach) - sum(counts)
    return Row(
        case=f"{name}, kinematic: {counts[0]} of {len(reach)} branches reached, {counts[1]} proved too narrow",
        figure="branches without either",
        ours=undecided,
        target="0",
        holds=undecided == 0,
    )


def dynamic_rows(name: str, airway: AirwayTree, entrance: Entrance, reach: tuple[BranchReach, ...], notify: Notify) -> list[Row]:
    """The deepest ends that kinematics reach, in the simulator: tip error, depth in the wall, time."""
    ends = [k for k, judged in enumerate(reach) if judged.plan is not None]
    ends.sort(key=lambda k: (-airway.branches[k].generation, airway.branches[k].median_radius))
    rows = []
    for k in ends[:DYNAMIC]:
        branch = airway.branches[k]
        notify(f"{name}, {branch.name}, dynamic", 0, 0)
        target = Target(branch=k, depth=reach[k].depth, point=airway.place(k, reach[k].depth))
        simulator = make_simulator(airway, entrance, Robot())
        begun = time.process_time()
        rng = np.random.default_rng(0)
        plan = plan_way(airway, entrance, target, Robot(), PlannerSettings(samples_max=60), rng=rng, simulator=simulator).plan
        seconds, deepest = time.process_time() - begun, -min(step.body_clearance for step in plan.steps)
        case = f"{name}, dynamic, {branch.name}, {reach[k].depth:.0f} of {branch.length:.0f} mm"
        good = plan.reached and plan.tip_error < TIP_ERROR
        rows += [
            Row(case=case, figure="tip error mm", ours=plan.tip_error, target=f"reached, under {TIP_ERROR:g}", holds=good),
            Row(case=case, figure="deepest in the wall mm", ours=deepest, target=f"under {LEAK:g}", holds=deepest < LEAK),
            Row(case=case, figure="plan time, CPU s", ours=seconds),
        ]
    return rows
