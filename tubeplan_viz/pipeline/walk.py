"""The walk along a planned path: its steps for result.json, its pictures for recording and report."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from segmentation.mesh import Surface
from tubeplan_viz.centerline import CenterlineTree
from tubeplan_viz.endoluminal import Film, make_film, patient_words, walk_steps
from tubeplan_viz.plan import PathProfile, Plan


def walk_details(profile: PathProfile, branches: CenterlineTree, frame: str) -> dict[str, Any]:
    """Junctions and bends along the path; directions in words only where the axes are the patient's."""
    steps = walk_steps(profile.arc_length, profile.points, branches, -1)
    return {
        "steps": [
            {
                "kind": step.kind,
                "s_mm": step.arc_length,
                "turn_deg": float(np.degrees(step.turn)),
                "clock_h": step.clock,
                "roll_deg": float(np.degrees(step.roll)),
                "direction": step.direction,
                "toward": patient_words(step.direction) if frame == "LPS" else None,
                "other_openings_clock_h": list(step.openings),
            }
            for step in steps
        ]
    }


def film_of(surface: Surface, plan: Plan, progress: Callable[[int, int], None] | None = None) -> Film:
    """Pictures from the tip along a plan's path."""
    profile = plan.profile
    return make_film(surface, profile.arc_length, profile.points, profile.clearance, plan.flagged, progress=progress)
