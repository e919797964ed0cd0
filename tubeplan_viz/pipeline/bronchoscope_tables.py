"""The tables of a bronchoscope robot's run folder: its drive step by step, and its axis after every step."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from typing import Any

from tubeplan_viz.bronchoscope.robot_plan import RobotPlan
from tubeplan_viz.pipeline.bronchoscope_details import step_details

ACTUATION_COLUMNS = (
    "step",
    "stage",
    "phi_proximal_deg",
    "theta_proximal_deg",
    "phi_distal_deg",
    "theta_distal_deg",
    "push_mm",
    "tip_x_mm",
    "tip_y_mm",
    "tip_z_mm",
    "view_x",
    "view_y",
    "view_z",
    "disc_clearance_mm",
    "body_clearance_mm",
    "contacts",
    "largest_force_n",
)
STATE_COLUMNS = ("step", "x_mm", "y_mm", "z_mm")


def actuation_table(plan: RobotPlan) -> str:
    """actuation.csv: what the robot's drive does step by step, and what came of it."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(ACTUATION_COLUMNS)
    for number, step in enumerate(plan.steps):
        row: Mapping[str, Any] = step_details(number, step, plan)
        angles = row["command"] or dict.fromkeys(ACTUATION_COLUMNS[2:7], 0.0)
        numbers = [angles[key] for key in ACTUATION_COLUMNS[2:7]]
        numbers += [*step.tip[:3, 3], *step.tip[:3, 2], step.disc_clearance, step.body_clearance]
        force = float(step.forces.max()) if len(step.forces) else 0.0
        writer.writerow([number, row["stage"], *(repr(float(v)) for v in numbers), len(step.contacts), repr(force)])
    return text.getvalue()


def states_table(plan: RobotPlan) -> str:
    """states.csv: the robot's axis after every step, from the entrance to the tip."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(STATE_COLUMNS)
    for number, step in enumerate(plan.steps):
        for place in step.body:
            writer.writerow([number, *(repr(round(float(v), 6)) for v in place)])
    return text.getvalue()
