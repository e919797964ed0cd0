"""tubeplan bench needle3d: the paper's scenes, success over seeds, replanning, insertions at random."""

from __future__ import annotations

import time

import numpy as np

from tubeplan_viz.bench.needle_scenes import SCENES, TARGETS, columns, replanned, scattered
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.cases.needle import NeedleCase, make_needle_case
from tubeplan_viz.needle.insertion import insert
from tubeplan_viz.needle.kinematics import insertion_pose, push
from tubeplan_viz.needle.monte_carlo import MonteCarloSettings, monte_carlo
from tubeplan_viz.needle.rrt import plan_rrt
from tubeplan_viz.needle.spatial import SpatialProblem
from tubeplan_viz.needle.swarm import plan_spatial
from tubeplan_viz.pipeline import Notify, silent
from tubeplan_viz.pipeline.needle_ground import load_ground
from tubeplan_viz.pipeline.needle_plan import event_of

HUO = "Huo et al. 2015"


def needle3d(*, quick: bool = False, notify: Notify = silent) -> list[Row]:
    """Nine targets and ten seeds in each scene, the three cases of replanning, and a Monte Carlo run."""
    rows: list[Row] = []
    seeds = 2 if quick else 10
    for name, table in (("scene 1", scattered()), ("scene 2", columns())):
        rows.extend(success(name, make_needle_case(table), seeds, notify))
        rows.extend(success(f"{name}, random tree", make_needle_case(table), seeds, notify, rrt=True))
    printed = {"obstacle": 102.59, "target": 125.27, "model": 101.39}
    for kind, length in printed.items():
        case = make_needle_case(replanned(kind))
        problem = space_problem(case)
        path = plan_spatial(problem, case.swarm, rng=np.random.default_rng(0), front=False)
        assert path.pose is not None
        assert path.controls is not None
        made = insert(problem, path.pose, path.controls, tuple(event_of(event) for event in case.events))
        spent = max(step.seconds for step in made.replans)
        told = f"replan, {kind}"
        done = made.withdrawn is None and made.error < 0.1
        rows.append(Row(case=told, figure="error, mm", ours=made.error, target="under 0.1", holds=done))
        rows.append(Row(case=told, figure="length, mm", ours=made.length, reference=length, source=f"{HUO}, 5.3"))
        rows.append(Row(case=told, figure="longest replan, s", ours=spent, target="under 0.2", holds=spent < 0.2))
    for name, table, target in (
        ("one obstacle, straight", SCENES["replan-model"], None),
        ("scene 1, target aside", scattered(), TARGETS[0]),
    ):
        rows.extend(insertions(name, make_needle_case(table), target, 20 if quick else 200, notify))
    return rows


def insertions(name: str, case: NeedleCase, target: tuple[float, ...] | None, runs: int, notify: Notify) -> list[Row]:
    """Where the tip ends with 5 % of curvature error, 0.5 mm of noise and a target that moves by 3 mm."""
    notify("Monte Carlo", 0, 0)
    problem = space_problem(case, target)
    path = plan_spatial(problem, case.swarm, rng=np.random.default_rng(0), front=False)
    assert path.pose is not None
    assert path.controls is not None
    found = monte_carlo(problem, path.pose, path.controls, MonteCarloSettings(runs=runs), rng=np.random.default_rng(1))
    told = f"{runs} insertions, {name}"
    middle, high = (float(np.percentile(found.errors, share)) for share in (50, 95))
    return [
        Row(case=told, figure="median final error, mm", ours=middle, target="under 1", holds=middle < 1.0),
        Row(case=told, figure="95 % of final errors, mm", ours=high),
        Row(case=told, figure="touching an obstacle", ours=float(found.touched), target="none", holds=found.touched == 0),
        Row(case=told, figure="withdrawn", ours=float(found.withdrawn)),
    ]


def space_problem(case: NeedleCase, target: tuple[float, ...] | None = None) -> SpatialProblem:
    """A case in space posed, to its own target or another."""
    pose = insertion_pose(case.entry, case.direction)
    return SpatialProblem(pose, np.array(target or case.target), load_ground(case).scene, case.needle)


def success(name: str, case: NeedleCase, seeds: int, notify: Notify, *, rrt: bool = False) -> list[Row]:
    """How often, how long, how fast and how near over nine targets."""
    times, straight, lengths, reached, violated, errors = [], [], [], 0, 0, []
    for k, target in enumerate(TARGETS):
        notify(name, k, len(TARGETS))
        problem = space_problem(case, target)
        for seed in range(seeds):
            begun = time.process_time()
            rng = np.random.default_rng(seed)
            path = plan_rrt(problem, rng=rng) if rrt else plan_spatial(problem, case.swarm, rng=rng, front=False)
            times.append(time.process_time() - begun)
            if path.pose is None or path.controls is None:
                continue
            reached += path.error < 1e-3
            errors.append(path.error)
            lengths.append(path.length)
            arcs = push(path.pose, path.controls)
            points = arcs.points(arcs.lengths[:, None] * np.linspace(0.0, 1.0, 2001)).reshape(-1, 3)
            violated += bool(problem.scene.distances(points).min() < case.safety)
            if target[:2] == (0.0, 0.0):
                straight.append(path.length)
    total = seeds * len(TARGETS)
    longest = max(straight, default=np.inf)
    middle, whole = float(np.median(times)), float(np.sum(times))
    if rrt:
        return [
            Row(case=name, figure=f"within 0.001 mm, of {total}", ours=float(reached)),
            Row(case=name, figure="safety violations", ours=float(violated), target="none", holds=violated == 0),
            Row(case=name, figure="longest to (0, 0, 100), mm", ours=longest),
            Row(case=name, figure="mean length, all targets, mm", ours=float(np.mean(lengths))),
            Row(case=name, figure="median plan, CPU s", ours=middle),
        ]
    near, most = f"{HUO}, within 0.1 mm", float(total)
    return [
        Row(case=name, figure=f"within 0.001 mm, of {total}", ours=float(reached), reference=most, source=near, target="all",
            holds=reached == total),
        Row(case=name, figure="largest error, mm", ours=max(errors, default=np.inf), reference=0.1, source=HUO),
        Row(case=name, figure="longest to (0, 0, 100), mm", ours=longest, reference=102.03, source=HUO, target="at most 102.03",
            holds=longest <= 102.03),
        Row(case=name, figure="safety violations", ours=float(violated), target="none", holds=violated == 0),
        Row(case=name, figure="mean length, all targets, mm", ours=float(np.mean(lengths))),
        Row(case=name, figure="median plan, CPU s", ours=middle, target="under 0.5", holds=middle < 0.5),
        Row(case=name, figure="all plans, CPU s", ours=whole, target="under 60", holds=whole < 60.0),
    ]  # fmt: skip
