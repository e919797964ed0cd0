"""A robot's run checked by other means: commands integrated as rates, saved states measured against mesh.ply.

# Strategy: a kinematic plan's base is integrated from its commands as a rigid frame that moves along its axis and turns at
# the rate of the proximal bend (Runge-Kutta of order 8), each section from its bend alike; the planner chains closed forms.
# States of a plan with dynamics cannot be computed again without the simulator, so those that were saved are measured: the
# axis, the front disc's rim, and that they and the track of the tip tell the same story.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.bronchoscope_told import INTEGRATED, check_told_robot, frame_off
from tubeplan_viz.verify.verification import Check
from tubeplan_viz.verify.wall import Lumen

RIM = 48  # the planners look at fewer places of the rim; between two of these it bulges by 0.004 mm
RIM_SLACK_MM = 0.05
SAME_MM = 1e-4  # states are written with six decimals
SPACING_MM = 1.0
# The planner turns the bend in steps of at most 1 mm of push and 0.12 rad, each taken at its middle.
INTEGRATED_MM = 0.05
# A contact is told midway between the robot and the plane that stands for the wall there; both differ by the skin and the lean.
CONTACT_MM = 0.35
LEAN_MM = {"kinematic": 0.0, "dynamic": 0.3}
COMMAND = ("phi_proximal_deg", "theta_proximal_deg", "phi_distal_deg", "theta_distal_deg", "push_mm")


def check_bronchoscope(folder: Path, result: Mapping[str, Any], lumen: Lumen) -> Iterator[Check]:
    """All checks of a robot's run that other planners' runs do not have."""
    steps = result["details"]["steps"]
    yield from check_told_robot(result)
    yield from check_commands(result)
    yield from check_end(result)
    yield from check_subgoals(result)
    yield from check_actuation(folder, result)
    states = read_states(folder)
    whole = states is not None and len(states) == len(steps)
    yield Check(
        name="states.csv",
        ok=whole,
        found="not readable" if states is None else f"{len(states)} states",
        expected=f"{len(steps)} states, one for each step",
        text="The robot's axis after every step is there.",
    )
    if states is not None and whole:
        yield from check_states(result, states)
        yield from check_body(result, states, lumen)
    yield from check_disc(result, lumen)
    yield from check_contacts(result, lumen)
    yield from check_track(result)
    if result["planner"]["method"] == "kinematic":
        yield from check_motion(result)


def check_commands(result: Mapping[str, Any]) -> Iterator[Check]:
    """No section is bent more than the robot can."""
    limit = result["details"]["robot"]["bend_max_deg"]
    commands = [step["command"] for step in result["details"]["steps"] if step["command"] is not None]
    largest = max((max(c["phi_proximal_deg"], c["phi_distal_deg"]) for c in commands), default=0.0)
    least = min((min(c["phi_proximal_deg"], c["phi_distal_deg"]) for c in commands), default=0.0)
    yield Check(
        name="actuation: bends",
        ok=largest <= limit + 1e-6 and least >= 0.0,
        found=f"{least:.2f} to {largest:.2f} degrees in {len(commands)} commands",
        expected=f"0 to {limit:.2f} degrees",
        text="Every section's bend is within what the robot can.",
    )


def check_end(result: Mapping[str, Any]) -> Iterator[Check]:
    """The tip ends where the metrics say, from the target of the case."""
    details, metrics = result["details"], result["metrics"]
    tip = np.array(details["steps"][-1]["tip_mm"], float)
    error = float(np.linalg.norm(tip - np.array(details["target"]["point_mm"], float)))
    gap = float(np.linalg.norm(np.array(result["path"]["points_mm"][-1], float) - tip))
    yield Check(
        name="tip: at the target",
        ok=abs(error - metrics["tip_error_mm"]) <= SAME_MM and gap <= SAME_MM,
        found=f"{error:.4f} mm from the target, the path's end {gap:.2g} mm from the tip",
        expected=f"{metrics['tip_error_mm']:.4f} mm, and the same place",
        text="The last step's tip, the path's end and the stated tip error agree.",
    )


def check_subgoals(result: Mapping[str, Any]) -> Iterator[Check]:
    """How far the tip was from each sub-goal when its stage ended, and the sum of these distances."""
    details = result["details"]
    names = [stage["name"] for stage in details["stages"]]
    last: dict[int, FloatArray] = {}
    for step in details["steps"]:
        last[names.index(step["stage"])] = np.array(step["tip_mm"], float)
    wrong, cost, tip = [], 0.0, None
    for number, stage in enumerate(details["stages"]):
        tip = last.get(number, tip)
        met = tip is not None and number <= max(last)
        away = float(np.linalg.norm(tip - np.array(stage["goal_mm"], float))) if met and tip is not None else None
        cost += away or 0.0
        told = stage["subgoal_distance_mm"]
        if (told is None) != (away is None) or (told is not None and away is not None and abs(told - away) > SAME_MM):
            wrong.append(stage["name"])
    yield Check(
        name="stages: distances to the sub-goals",
        ok=not wrong and abs(details["cost_mm"] - cost) <= SAME_MM,
        found=f"otherwise in {', '.join(wrong)}" if wrong else f"{details['cost_mm']:.4f} mm in all",
        expected=f"those of the tips at the stages' ends, {cost:.4f} mm in all",
        text="The cost is the sum of the tip's distances to the sub-goals where the stages end.",
    )


def check_actuation(folder: Path, result: Mapping[str, Any]) -> Iterator[Check]:
    """actuation.csv says the same as result.json."""
    steps = result["details"]["steps"]
    try:
        rows = list(csv.DictReader((folder / "actuation.csv").read_text(encoding="utf-8").splitlines()))
        stated = [[float(row[key]) for key in (*COMMAND, "tip_x_mm", "tip_y_mm", "tip_z_mm")] for row in rows]
    except (OSError, ValueError, KeyError, TypeError) as fault:
        yield Check(
            name="actuation.csv", ok=False, found=type(fault).__name__, expected="a whole table", text="It cannot be read."
        )
        return
    told = [[*(0.0 if s["command"] is None else s["command"][key] for key in COMMAND), *s["tip_mm"]] for s in steps]
    same = stated == told
    yield Check(
        name="actuation.csv",
        ok=same,
        found="the same" if same else f"{len(stated)} rows with other numbers",
        expected=f"the {len(told)} steps of result.json, to the last digit",
        text="The commands and tips of actuation.csv are those of result.json.",
    )


def read_states(folder: Path) -> list[FloatArray] | None:
    """The robot's axis after each step; None if states.csv cannot be read."""
    try:
        rows = list(csv.reader((folder / "states.csv").read_text(encoding="utf-8").splitlines()))[1:]
        table = np.array([[float(cell) for cell in row] for row in rows]).reshape(-1, 4)
    except (OSError, ValueError):
        return None
    count = int(table[:, 0].max(initial=-1.0)) + 1
    return [table[table[:, 0] == k, 1:] for k in range(count)]


def check_states(result: Mapping[str, Any], states: list[FloatArray]) -> Iterator[Check]:
    """Each state runs from the entrance to its step's tip without a gap."""
    entrance = np.array(result["details"]["entrance"], float)[:3, 3]
    gaps = [float(np.linalg.norm(np.diff(state, axis=0), axis=1).max()) for state in states]
    ends = [
        float(np.linalg.norm(state[-1] - np.array(step["tip_mm"], float)))
        for state, step in zip(states, result["details"]["steps"], strict=True)
    ]
    begin = max(float(np.linalg.norm(state[0] - entrance)) for state in states)
    # A simulated shaft leans on the wall of the entrance too.
    allowed = SAME_MM if result["planner"]["method"] == "kinematic" else 10.0
    yield Check(
        name="states: whole",
        ok=max(gaps) <= SPACING_MM + SAME_MM and max(ends) <= SAME_MM and begin <= allowed,
        found=f"places up to {max(gaps):.3f} mm apart, ends up to {max(ends):.2g} mm from the tips, begins {begin:.2g} mm off",
        expected=f"at most {SPACING_MM:g} mm apart, from the entrance to the tip",
        text="Every saved state is the whole robot from the entrance to its tip.",
    )


def check_body(result: Mapping[str, Any], states: list[FloatArray], lumen: Lumen) -> Iterator[Check]:
    """The body of every saved state stays in the lumen, as far from the wall as stated."""
    radius = 0.5 * result["details"]["robot"]["diameter_mm"]
    allowed = LEAN_MM[result["planner"]["method"]]
    # Places that several states share, as the trail of a kinematic robot, are measured once.
    places, where = np.unique(np.concatenate(states), axis=0, return_inverse=True)
    order = np.lexsort(np.round(places / 4.0).T)
    clearance = np.empty(len(places))
    clearance[order] = lumen.clearance(places[order], on_surface=SAME_MM)[0]
    margins = np.split(clearance[where.ravel()] - radius, np.cumsum([len(state) for state in states])[:-1])
    if result["planner"]["method"] == "dynamic":
        # The simulated robot ends in a flat disc, whose rim is judged by itself: its middle may look at a wall that is near.
        thick = [np.linalg.norm(state - state[-1], axis=1) >= radius for state in states]
        margins = [margin[kept] for margin, kept in zip(margins, thick, strict=True)]
    least = np.array([float(margin.min()) for margin in margins])
    worst = int(least.argmin())
    yield Check(
        name="states: body to wall",
        ok=bool(least[worst] >= -allowed - SAME_MM) or result["status"] == "infeasible",
        found=f"{least[worst]:.3f} mm after step {worst}",
        expected=f"at least {-allowed:g} mm",
        text="The distance of the robot's surface to the triangles of mesh.ply, over all saved states.",
    )
    stated = result["metrics"]["body_clearance_min_mm"]
    yield Check(
        name="metrics: body_clearance_min_mm",
        ok=stated <= least.min() + 5e-3,
        found=f"{stated:.4f} mm",
        expected=f"no more than {least.min():.4f} mm",
        text="The stated least distance is not better than that of the saved states.",
    )


def check_disc(result: Mapping[str, Any], lumen: Lumen) -> Iterator[Check]:
    """The front disc's rim after every step."""
    radius = 0.5 * result["details"]["robot"]["diameter_mm"]
    steps = result["details"]["steps"]
    turn = 2.0 * np.pi * np.arange(RIM) / RIM
    rims = []
    for step in steps:
        axis = np.array(step["view"], float)
        side = np.linalg.svd(axis[None])[2][1:]
        rims.append(
            np.array(step["tip_mm"], float) + radius * (np.cos(turn)[:, None] * side[0] + np.sin(turn)[:, None] * side[1])
        )
    least = lumen.clearance(np.concatenate(rims), on_surface=SAME_MM)[0].reshape(len(steps), RIM).min(axis=1)
    stated = np.array([step["disc_clearance_mm"] for step in steps])
    over = stated - least
    worst = int(over.argmax())
    yield Check(
        name="disc: clearance",
        ok=bool(over[worst] <= RIM_SLACK_MM),
        found=f"{stated[worst]:.3f} mm stated after step {worst}",
        expected=f"no more than {least[worst]:.3f} mm",
        text="No step states more room around its front disc than the rim has when it is measured.",
    )
    yield Check(
        name="disc: no collision at the end",
        ok=bool(least[-1] >= -1e-6) or result["status"] == "infeasible",
        found=f"{least[-1]:.3f} mm",
        expected="0 or more",
        text="After the last step the front disc does not cut the wall.",
    )


def check_contacts(result: Mapping[str, Any], lumen: Lumen) -> Iterator[Check]:
    """The stated contacts lie on the wall, and the largest force is that of the steps."""
    steps, stated = result["details"]["steps"], result["details"]["contacts"]["largest_force_n"]
    largest = max((max(step["forces_n"], default=0.0) for step in steps), default=0.0)
    places = np.concatenate([np.array(step["contacts_mm"], float).reshape(-1, 3) for step in steps])
    off = float(np.abs(lumen.clearance(places, on_surface=SAME_MM)[0]).max()) if len(places) else 0.0
    yield Check(
        name="contacts",
        ok=bool(abs(stated - largest) <= 1e-9 and off <= CONTACT_MM),
        found=f"{stated:.4f} N, {len(places)} places up to {off:.3f} mm from the wall",
        expected=f"{largest:.4f} N, places within {CONTACT_MM:g} mm of the wall",
        text="The contacts of all steps lie on the wall, and the largest force is the largest of theirs.",
    )


def check_track(result: Mapping[str, Any]) -> Iterator[Check]:
    """The path passes the tips of all steps."""
    points = np.array(result["path"]["points_mm"], float)
    tips = np.array([step["tip_mm"] for step in result["details"]["steps"]], float)
    off = np.array([float(np.linalg.norm(points - tip, axis=1).min()) for tip in tips])
    allowed = result["details"]["track_fit_mm"] + 0.13  # half the path's spacing
    worst = int(off.argmax())
    yield Check(
        name="path: the tips' track",
        ok=bool(off[worst] <= allowed),
        found=f"{off[worst]:.3f} mm from the tip after step {worst}",
        expected=f"at most {allowed:.3f} mm",
        text="The path passes the place of the tip after every step, within the stated fit of its spline.",
    )


def check_motion(result: Mapping[str, Any]) -> Iterator[Check]:
    """The tips of a kinematic plan come from its commands, integrated as rates."""
    details = result["details"]
    lengths = details["robot"]["proximal_length_mm"], details["robot"]["distal_length_mm"]
    base = np.array(details["entrance"], float)
    bends = np.zeros((2, 2))
    worst, worst_at, turned = 0.0, 0, 0.0
    for number, step in enumerate(details["steps"]):
        if step["command"] is not None:
            wanted = bend_vectors(step["command"])
            base = pushed(base, bends[0] / lengths[0], wanted[0] / lengths[0], step["command"]["push_mm"])
            bends = wanted
        tip = base
        for length, bend in zip(lengths, bends, strict=True):
            tip = pushed(tip, bend / length, bend / length, length)
        turned = max(turned, frame_off(step, base, tip))
        off = float(np.linalg.norm(tip[:3, 3] - np.array(step["tip_mm"], float)))
        if off > worst:
            worst, worst_at = off, number
    yield Check(
        name="frames: from the commands",
        ok=turned <= INTEGRATED,
        found=f"{turned:.2g} off at most",
        expected=f"at most {INTEGRATED:g}",
        text="Base and view of every step are where the commands lead.",
    )
    yield Check(
        name="tips: from the commands",
        ok=worst <= INTEGRATED_MM,
        found=f"{worst:.4f} mm off after step {worst_at}",
        expected=f"at most {INTEGRATED_MM:g} mm",
        text="The tips are where the commands lead when base and sections are integrated as moving frames.",
    )


def bend_vectors(command: Mapping[str, float]) -> FloatArray:
    """Bends as vectors in the frames of the sections' bases, (2, 2) rad."""
    made = np.empty((2, 2))
    for row, part in enumerate(("proximal", "distal")):
        phi, theta = np.radians(command[f"phi_{part}_deg"]), np.radians(command[f"theta_{part}_deg"])
        made[row] = phi * np.cos(theta), phi * np.sin(theta)
    return made


def pushed(pose: FloatArray, first: FloatArray, last: FloatArray, length: float) -> FloatArray:
    """A frame after moving along its third axis while it bends at a curvature that goes evenly from one vector to another."""
    if length == 0.0:
        return pose

    def rate(share: float, state: FloatArray) -> FloatArray:
        turned = state[3:].reshape(3, 3)
        k = first + share * (last - first)
        spin = np.array([[0.0, 0.0, k[0]], [0.0, 0.0, k[1]], [-k[0], -k[1], 0.0]])
        return length * np.concatenate([turned[:, 2], (turned @ spin).ravel()])

    start = np.concatenate([pose[:3, 3], pose[:3, :3].ravel()])
    end = solve_ivp(rate, (0.0, 1.0), start, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    made = np.eye(4)
    made[:3, 3], made[:3, :3] = end[:3], end[3:].reshape(3, 3)
    return made
