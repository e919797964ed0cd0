"""From a needle's case and what it goes through to the outcome: plan, insertion with events, insertions at random."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from tubeplan_viz.cases.needle import NeedleCase
from tubeplan_viz.cases.needle_rows import EventCase
from tubeplan_viz.needle.bodies import MaskObstacle
from tubeplan_viz.needle.events import Event
from tubeplan_viz.needle.insertion import insert
from tubeplan_viz.needle.kinematics import Arcs, push
from tubeplan_viz.needle.monte_carlo import monte_carlo
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.path import NeedlePath, SwarmRound
from tubeplan_viz.needle.planar import PlanarProblem, best, plan_planar
from tubeplan_viz.needle.rrt import plan_rrt
from tubeplan_viz.needle.spatial import SpatialProblem
from tubeplan_viz.needle.swarm import plan_printed, plan_spatial
from tubeplan_viz.pipeline.needle_details import (
    DRAWN_SPACING,
    SPACING,
    Outcome,
    cloud_paths,
    convergence,
    form_details,
    front_details,
    insertion_details,
    monte_carlo_details,
    population,
    sampled,
)
from tubeplan_viz.pipeline.progress import Stopwatch
from tubeplan_viz.recording.needle import NeedleRecording

Progress = Callable[[int, int], None]
EVERY = 10  # rounds between two pictures of the swarm


def planned_flat(case: NeedleCase, scene: Scene, watch: Stopwatch) -> Outcome:
    """The planar planner's outcome."""
    problem = PlanarProblem(np.array(case.entry), np.array(case.target), scene, case.planar)
    with watch.stage("plan") as progress:
        paths = plan_planar(problem, progress=progress)
    chosen = best(paths)
    per_degree = {str(n): one.form for n in range(1, case.planar.degree_max + 1) if (one := best(paths, n)) is not None}
    details = {
        "forms": [form_details(path) for path in paths],
        "chosen_form": None if chosen is None else chosen.form,
        "best_per_degree": per_degree,
        "insertion_angle_deg": None if chosen is None else float(np.degrees(chosen.angle)),
    }
    if chosen is None:
        nearest = [path for path in paths if path.tried]
        most, safety = case.planar.degree_max, case.planar.safety
        reason = f"no form of up to {most} pieces reaches the target and keeps {safety:g} mm from all obstacles"
        return Outcome(reason=reason if nearest else str(paths[0].reason), details=details)
    return Outcome(
        pose=chosen.pose,
        controls=chosen.controls,
        clearances=chosen.clearances,
        reason=None,
        details=details,
        metrics={"tip_error_mm": chosen.tip_error, "score": chosen.score, "danger": chosen.danger},
    )


def planned_in_space(case: NeedleCase, problem: SpatialProblem, watch: Stopwatch, stream: NeedleRecording | None) -> Outcome:
    """The outcome in space, how the insertion goes if events are given, and how many at random go."""
    with watch.stage("plan") as progress:
        found = searched(case, problem, progress, partial(shown_round, case, problem, progress, stream))
    details: dict[str, Any] = {"swarms": found.swarms, "rounds": len(found.rounds), "convergence": convergence(found)}
    details |= {"population": population(problem, found), "pareto": [front_details(point) for point in found.front]}
    if found.nodes:
        details["nodes"] = found.nodes
    if problem.skin is not None:
        details["skin"] = {"given_mm": list(case.entry), "moved_mm": float(np.linalg.norm(problem.pose.position - case.entry))}
    if found.controls is None or found.pose is None:
        return Outcome(reason=found.reason, details=details)
    reason = unknown_ground(push(found.pose, found.controls), problem.scene)
    events = tuple(event_of(event) for event in case.events)
    if events and reason is None:
        with watch.stage("insertion"):
            made = insert(problem, found.pose, found.controls, events)
        details["insertion"] = insertion_details(made)
        reason = made.withdrawn
    if case.monte_carlo.runs:
        with watch.stage("Monte Carlo") as progress:
            rng = np.random.default_rng([case.rng_seed, 1])
            many = monte_carlo(problem, found.pose, found.controls, case.monte_carlo, rng=rng, events=events, watch=progress)
        details["monte_carlo"] = monte_carlo_details(case, many)
    return Outcome(
        pose=found.pose,
        controls=found.controls,
        clearances=found.clearances,
        reason=reason,
        details=details,
        metrics={"tip_error_mm": found.error, "danger": found.danger},
    )


def searched(case: NeedleCase, problem: SpatialProblem, progress: Progress, shown: Callable[[SwarmRound], None]) -> NeedlePath:
    """The path by the case's method."""
    rng = np.random.default_rng(case.rng_seed)
    if case.method == "printed":
        return plan_printed(problem, case.swarm, rng=rng, watch=shown)
    if case.method == "rrt":
        return plan_rrt(problem, rng=rng, time_budget=case.time_budget, watch=progress)
    return plan_spatial(problem, case.swarm, rng=rng, time_budget=case.time_budget, watch=shown)


def shown_round(
    case: NeedleCase, problem: SpatialProblem, progress: Progress, stream: NeedleRecording | None, state: SwarmRound
) -> None:
    """One round of the swarm told to whoever watches."""
    progress(state.index, case.swarm.rounds)
    if stream is not None and state.index % EVERY == 0:
        stream.log_round(
            state.index + state.restart * case.swarm.rounds,
            sampled(problem.arcs(state.best), DRAWN_SPACING)[1],
            None if state.cloud is None else cloud_paths(problem, state.cloud),
            {"error": state.error, "length": state.length, "danger": state.danger},
        )


def unknown_ground(arcs: Arcs, scene: Scene) -> str | None:
    """Why a path cannot count: it leaves the part of a label volume that is known; None if it does not."""
    points = sampled(arcs, SPACING)[1]
    for k, body in enumerate(scene.obstacles):
        if isinstance(body, MaskObstacle):
            index = body.volume.to_index(points)
            if (index < -0.5).any() or (index > np.array(body.volume.voxels.shape) - 0.5).any():
                where = f"obstacle {k + 1}'s label volume, or its part around entry and target"
                return f"the best path leaves {where}; nothing is known there"
    return None


def event_of(event: EventCase) -> Event:
    """An event of the case file as the simulation uses it."""
    return Event(
        at=event.at_mm,
        obstacle=None if event.obstacle is None else event.obstacle - 1,
        place=None if event.center is None else np.array(event.center),
        target=None if event.target is None else np.array(event.target),
        kappa=event.kappa,
    )
