"""What result.json says of a bronchoscope robot's plan beside its path: robot, route, stages, steps, contacts, the airway."""

from __future__ import annotations

from typing import Any

import numpy as np

from segmentation.mesh import Surface
from tubeplan_viz.bronchoscope.airway import AirwayTree
from tubeplan_viz.bronchoscope.mover import Step
from tubeplan_viz.bronchoscope.robot_plan import RobotPlan
from tubeplan_viz.bronchoscope.target import Target
from tubeplan_viz.bronchoscope.way import Way
from tubeplan_viz.cases.bronchoscope import BronchoscopeCase
from tubeplan_viz.pipeline.airway import Airway, case_name
from tubeplan_viz.pipeline.tree import endpoint_details
from tubeplan_viz.pipeline.tube import surface_details


def plan_details(case: BronchoscopeCase, given: Airway, goal: Target, way: Way, off: float) -> dict[str, Any]:
    """Route, stages, steps and tree for result.json.

    Parameters
    ----------
    case : BronchoscopeCase
    given : Airway
        The airway as it was read, in its own frame.
    goal : Target
    way : Way
        The plan with its line, guide and route.
    off : float, mm
        Greatest distance of the path's spline from any place of the tip's track.
    """
    plan, branches = way.plan, given.airway.branches
    return {
        "robot": {
            "name": case.robot.name,
            "diameter_mm": case.robot.diameter,
            "proximal_length_mm": case.robot.proximal_length,
            "distal_length_mm": case.robot.distal_length,
            "bend_max_deg": float(np.degrees(case.robot.bend_max)),
            "curvature_max_per_mm": case.robot.curvature_max,
        },
        "reached": plan.reached,
        "target": {
            "branch": branches[goal.branch].name,
            "depth_mm": goal.depth,
            "point_mm": goal.point,
            "lesion_mm": goal.lesion,
            "lesion_distance_mm": None if goal.lesion is None else float(np.linalg.norm(goal.lesion - goal.point)),
        },
        "entrance": given.entrance.pose,
        "route": [
            {
                "name": branches[k].name,
                "confidence": branches[k].confidence,
                "generation": branches[k].generation,
                "diameter_mm": 2.0 * branches[k].median_radius,
                "length_mm": branches[k].length,
                "turn_deg": float(np.degrees(branches[k].angle)),
            }
            for k in way.route
        ],
        "stages": [
            {
                "name": stage.name,
                "goal_mm": stage.goal,
                "sphere_radius_mm": stage.radius,
                "samples": tally.samples,
                "pushes": tally.pushes,
                "collided": tally.refused,
                "foreseen": tally.foreseen,
                "seconds": round(tally.seconds, 4),
                "subgoal_distance_mm": away,
            }
            for stage, tally, away in zip(plan.stages, plan.tallies, plan.subgoal_distances, strict=True)
        ],
        "cost_mm": sum(away for away in plan.subgoal_distances if away is not None),
        "steps": [step_details(k, step, plan) for k, step in enumerate(plan.steps)],
        "contacts": contact_details(plan),
        "tree": {
            "poses": len(plan.nodes),
            "collided": sum(not node.accepted for node in plan.nodes),
            "samples": len(plan.samples),
            "given_up": {"poses": plan.given_up[0], "samples": plan.given_up[1]},
        },
        "foreplan": None
        if way.foreplan is None
        else {"reached": way.foreplan.reached, "tip_error_mm": way.foreplan.tip_error, "poses": len(way.foreplan.nodes)},
        "track_fit_mm": off,
        "assumption": ASSUMPTIONS[case.method],
    }


ASSUMPTIONS = {
    "kinematic": "The passive section lies on the track of the proximal section's base; the wall forces that hold it there "
    "are not computed, and no part of the robot may meet the wall.",
    "dynamic": "Links, motors, gravity and contact with the wall are simulated; the body leans on the wall, only the front disc "
    "may not meet it.",
}


def contact_details(plan: RobotPlan) -> dict[str, Any]:
    """How the robot touches the wall while it rests after its steps, and where it presses most."""
    forces = [float(step.forces.max(initial=0.0)) for step in plan.steps]
    worst = int(np.argmax(forces))
    touching = forces[worst] > 0.0
    return {
        "most": max(len(step.contacts) for step in plan.steps),
        "largest_force_n": forces[worst],
        "largest_force_step": worst if touching else None,
        "largest_force_mm": plan.steps[worst].contacts[int(np.argmax(plan.steps[worst].forces))] if touching else None,
        "at_end": len(plan.steps[-1].contacts),
        "disc_brushes": sum(step.disc_clearance < 0.0 for step in plan.steps),
    }


def step_details(number: int, step: Step, plan: RobotPlan) -> dict[str, Any]:
    """One step for result.json."""
    command = step.command
    angles = (
        None
        if command is None
        else {
            "phi_proximal_deg": float(np.degrees(command.phi_proximal)),
            "theta_proximal_deg": float(np.degrees(command.theta_proximal)),
            "phi_distal_deg": float(np.degrees(command.phi_distal)),
            "theta_distal_deg": float(np.degrees(command.theta_distal)),
            "push_mm": command.push,
        }
    )
    return {
        "stage": plan.stages[plan.step_stages[number]].name,
        "command": angles,
        "base": step.base,
        "tip_mm": step.tip[:3, 3],
        "view": step.tip[:3, 2],
        "disc_clearance_mm": step.disc_clearance,
        "body_clearance_mm": step.body_clearance,
        "contacts_mm": step.contacts,
        "forces_n": step.forces,
    }


def case_details(case: BronchoscopeCase, given: Airway, surface: Surface, warnings: list[str]) -> dict[str, Any]:
    """What result.json says of the case beside the plan."""
    details = dict(given.lumen.details)
    deviation = details.pop("deviation_mm", None)
    return {
        **details,
        "case_id": case_name(case),
        "surface": surface_details(surface) | {"deviation_mm": deviation},
        "endpoints": [endpoint_details(tip) for tip in given.tree.endpoints],
        "branches": branch_rows(given.airway),
        "image": dict(given.lumen.facts),
        "closed_ends": False,
        "warnings": warnings,
    }


def branch_rows(airway: AirwayTree) -> list[dict[str, Any]]:
    """The named tree for result.json and reach.json."""
    return [
        {
            "name": branch.name,
            "confidence": branch.confidence,
            "label": branch.label,
            "parent": branch.parent,
            "generation": branch.generation,
            "length_mm": branch.length,
            "diameter_mm": 2.0 * branch.median_radius,
            "least_diameter_mm": 2.0 * branch.least_radius,
            "turn_deg": float(np.degrees(branch.angle)),
        }
        for branch in airway.branches
    ]
