"""The walk along a planned path: its steps for result.json, its pictures for recording and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from segmentation.mesh import Surface
from tubeplan_viz.bronchoscope.mover import Step
from tubeplan_viz.centerline import CenterlineTree
from tubeplan_viz.endoluminal import Camera, Film, FilmSettings, Still, film_stills, make_film, patient_words, walk_steps
from tubeplan_viz.plan import PathProfile, Plan


def walk_details(profile: PathProfile, branches: CenterlineTree, target: int, frame: str) -> dict[str, Any]:
    """Junctions and bends along the path to a target of the tree; directions in words only where the axes are the patient's."""
    steps = walk_steps(profile.arc_length, profile.points, branches, target)
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


def stage_stills(
    surface: Surface, profile: PathProfile, steps: Sequence[Step], goals: Sequence[Sequence[float]]
) -> tuple[Still, ...]:
    """What a camera in the robot's tip sees at the start and where it ends each stage.

    Parameters
    ----------
    surface : Surface
    profile : PathProfile
        Of the tip's track.
    steps : sequence of Step
    goals : sequence of (x, y, z), mm
        Sub-goals of the stages, in order.
    """
    tips = np.array([step.tip for step in steps])
    chosen = [0]
    for goal in goals:  # in order: the way may come near an earlier place again
        later = np.arange(chosen[-1], len(tips))
        chosen.append(int(later[np.linalg.norm(tips[later, :3, 3] - np.asarray(goal), axis=1).argmin()]))
    cameras, places = [], []
    for k in chosen:
        up, forward, position = tips[k, :3, 0], tips[k, :3, 2], tips[k, :3, 3]
        cameras.append(Camera(position=position, right=np.cross(forward, up), up=up, forward=forward))
        places.append(profile.arc_length[int(np.linalg.norm(profile.points - position, axis=1).argmin())])
    arc, points, clearance = profile.arc_length, profile.points, profile.clearance
    return film_stills(surface, np.array(places), cameras, arc, points, clearance, (), FilmSettings())
