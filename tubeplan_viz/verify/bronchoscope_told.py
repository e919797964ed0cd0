"""What a robot's run tells beside its motion: robot, route, target, contacts and rooms; each held against its source."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.alike import same
from tubeplan_viz.verify.verification import Check

INTEGRATED = 0.01  # of a frame's columns; the planner turns the bend in steps
ROUTE = ("name", "confidence", "generation", "diameter_mm", "length_mm", "turn_deg")


def check_told_robot(result: Mapping[str, Any]) -> Iterator[Check]:
    """All that needs nothing but the run's own numbers and its case."""
    details, metrics = result["details"], result["metrics"]
    settings = result["provenance"]["settings"]
    own, steps = settings["bronchoscope"], details["steps"]
    lengths = {key: float(own[key]) for key in ("diameter_mm", "proximal_length_mm", "distal_length_mm", "bend_max_deg")}
    shortest = min(lengths["proximal_length_mm"], lengths["distal_length_mm"])
    meant = {"name": own["robot"], **lengths, "curvature_max_per_mm": float(np.radians(lengths["bend_max_deg"]) / shortest)}
    yield same("robot", dict(details["robot"]), meant, "The robot is that of the case.")
    rooms = {
        "disc_clearance_end_mm": float(steps[-1]["disc_clearance_mm"]),
        "body_clearance_min_mm": float(min(step["body_clearance_mm"] for step in steps)),
    }
    yield same("metrics: of the steps", {key: metrics[key] for key in rooms}, rooms, "The rooms told are those of the steps.")
    reached = details["reached"]
    near = metrics["tip_error_mm"] <= own["goal_error_max_mm"] + 1e-9
    yield Check(
        name="reached",
        ok=isinstance(reached, bool) and (near if reached else result["status"] == "infeasible"),
        found=f"{'reached' if reached else 'not reached'}, {metrics['tip_error_mm']:.4f} mm from the target",
        expected=f"at most {own['goal_error_max_mm']:g} mm where it is reached, infeasible where it is not",
        text="A target counts as reached where the tip ends near enough.",
    )
    yield from _route(details)
    yield _target(details)
    yield same("contacts: counts", dict(details["contacts"]), contacts(steps), "The contacts told are those of the steps.")


def _route(details: Mapping[str, Any]) -> Iterator[Check]:
    """The route's branches are those of the tree, one the child of the other, from the first to the target's."""
    rows = details["route"]
    tree = details["branches"]
    named = [[k for k, branch in enumerate(tree) if all(branch[key] == row[key] for key in ROUTE)] for row in rows]
    first = min((k for k, branch in enumerate(tree) if branch["parent"] < 0), default=-1)
    joined = all(any(tree[b]["parent"] == a for a in one for b in other) for one, other in pairwise(named))
    whole = all(named) and joined and first in named[0] and rows[-1]["name"] == details["target"]["branch"]
    wrong = [row["name"] for row, found in zip(rows, named, strict=True) if not found]
    yield Check(
        name="route",
        ok=bool(whole),
        found=" to ".join(str(row["name"]) for row in rows) + (f"; not of the tree: {', '.join(wrong)}" if wrong else ""),
        expected="branches of the tree with their numbers, each the child of the one before, the last the target's",
        text="The route runs through the tree from its first branch to the target's.",
    )


def _target(details: Mapping[str, Any]) -> Check:
    """The target lies within its branch; a lesion is told with its distance."""
    target = details["target"]
    depth, most = float(target["depth_mm"]), float(details["route"][-1]["length_mm"])
    lesion, told = target["lesion_mm"], target["lesion_distance_mm"]
    meant = None if lesion is None else float(np.linalg.norm(np.array(lesion, float) - np.array(target["point_mm"], float)))
    good = (told is None) == (meant is None) and (meant is None or abs(told - meant) <= 1e-6)
    return Check(
        name="target",
        ok=good and 0.0 <= depth <= most + 1e-6,
        found=f"{depth:.3f} mm deep in {target['branch']}, lesion {told}",
        expected=f"0 to {most:.3f} mm, lesion {meant}",
        text="The target lies in its branch, as far from a lesion as told.",
    )


def contacts(steps: list[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts and the worst place of the contacts of all steps."""
    forces = [max((float(force) for force in step["forces_n"]), default=0.0) for step in steps]
    worst = int(np.argmax(forces))
    touching = forces[worst] > 0.0
    place = steps[worst]["contacts_mm"][int(np.argmax(steps[worst]["forces_n"]))] if touching else None
    return {
        "most": max(len(step["contacts_mm"]) for step in steps),
        "largest_force_n": forces[worst],
        "largest_force_step": worst if touching else None,
        "largest_force_mm": place,
        "at_end": len(steps[-1]["contacts_mm"]),
        "disc_brushes": sum(step["disc_clearance_mm"] < 0.0 for step in steps),
    }


def frame_off(step: Mapping[str, Any], base: FloatArray, tip: FloatArray) -> float:
    """How far a step's base and view are from frames that were integrated: the largest difference of a number."""
    stated = np.array(step["base"], float)
    turned = max(np.abs(stated[:3, :3] - base[:3, :3]).max(), np.abs(np.array(step["view"], float) - tip[:3, 2]).max())
    # Places in mm count by the same figure as their tolerance: 0.01 of a turn is 0.05 mm at the tip of a section.
    return float(max(turned, 0.2 * np.abs(stated[:3, 3] - base[:3, 3]).max(), np.abs(stated[3] - base[3]).max()))
