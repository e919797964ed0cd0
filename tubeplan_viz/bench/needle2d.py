"""tubeplan bench needle2d: the planar paper's cases, and every form of random scenes against brute force."""

from __future__ import annotations

import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from tubeplan_viz.bench.needle_grid import shortest_path
from tubeplan_viz.bench.needle_scenes import planar
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.cases.needle import NeedleCase, make_needle_case
from tubeplan_viz.needle.bodies import Sphere
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.planar import FORMS, PlanarPath, PlanarProblem, PlanarSettings, best, plan_planar
from tubeplan_viz.pipeline import Notify, silent
from tubeplan_viz.pipeline.needle_ground import load_ground

ZHAO = "Zhao et al. 2013, table 2"
PRINTED = {"RL": 93.72, "LRL": 92.79}  # mm
SEED = 2013
RUNS = 5  # of the printed case: the machine is noisy
MARGIN = 1.01  # brute force looks for paths up to so many times the planner's, to show what it can find


@dataclass(frozen=True, kw_only=True)
class Judged:
    """One form of one scene: the planner's length and the bound on it, and brute force's length, mm; infinite without a path."""

    form: str
    ours: float
    bound: float
    grid: float

    @property
    def over(self) -> float:
        """By how much ours is longer than the grid's, as a share; 0 where either has none."""
        return self.ours / self.grid - 1.0 if np.isfinite(self.ours) and np.isfinite(self.grid) else 0.0

    @property
    def missed(self) -> bool:
        """Whether there is a path that the planner did not find."""
        return bool(np.isinf(self.ours) and np.isfinite(self.grid))


def needle2d(*, quick: bool = False, notify: Notify = silent) -> list[Row]:
    """The planar case and random scenes; targets of the paper's cases and of the grid's optima."""
    return [*without_obstacles(), *printed_case(), *random_scenes(10 if quick else 200, notify)]


def without_obstacles() -> list[Row]:
    """The straight line."""
    line = best(plan_planar(flat_problem(make_needle_case(planar(obstacles=False)))))
    assert line is not None
    angle = float(np.degrees(line.angle))
    return [
        Row(case="no obstacle", figure="length, mm", ours=line.length, reference=94.7683, source=ZHAO, target="94.8683 exact",
            holds=abs(line.length - float(np.hypot(30.0, 90.0))) < 1e-9),
        Row(case="no obstacle", figure="angle, degrees", ours=angle, reference=-18.4378, source=ZHAO, target="-18.4349 exact",
            holds=abs(angle + float(np.degrees(np.arctan2(30.0, 90.0)))) < 1e-9),
    ]  # fmt: skip


def printed_case() -> list[Row]:
    """Three circles: every form, against brute force, and the time of the whole case."""
    case, name = flat_problem(make_needle_case(planar())), "three circles"
    paths = plan_planar(case)  # what is imported on first use is not the planner's time
    runs = []
    for _ in range(RUNS):
        begun, clock = time.process_time(), time.perf_counter()
        plan_planar(case)
        runs.append((time.process_time() - begun, time.perf_counter() - clock))
    spent, waited = np.median(runs, axis=0).tolist()
    rows = []
    for path in paths:
        known = PRINTED.get(path.form)
        source = ZHAO if known else ""
        if path.degree > 1:
            holds = path.feasible and path.tip_error < 1e-6
            target = "tip within 1e-6 mm, clear"
            figure = f"{path.form} length, mm"
            rows.append(
                Row(case=name, figure=figure, ours=path.length, reference=known, source=source, target=target, holds=holds)
            )
    judged = [judge(case, path, np.random.default_rng([SEED, k])) for k, path in enumerate(paths)]
    return [
        *rows,
        *against_grid(f"{name}, brute force", judged),
        Row(case=name, figure=f"all forms, median CPU s of {RUNS} runs", ours=spent, target="under 1", holds=spent < 1.0),
        Row(case=name, figure=f"all forms, median s on the clock of {RUNS} runs", ours=waited),
    ]


def random_scenes(count: int, notify: Notify) -> list[Row]:
    """Scenes of four circles, on all cores."""
    rng = np.random.default_rng(SEED)
    problems = [random_scene(rng) for _ in range(count)]
    jobs = min(len(os.sched_getaffinity(0)), count)
    judged: list[Judged] = []
    times: list[float] = []
    # Not forked: the caller's threads (progress bars, linear algebra) would not survive it.
    with ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn")) as pool:
        for k, (found, spent) in enumerate(pool.map(judged_scene, problems, range(count))):
            notify("random scenes", k, count)
            judged.extend(found)
            times.append(spent)
    name = f"{count} random scenes, brute force"
    return [
        *against_grid(name, judged),
        Row(case=name, figure="all forms of a scene, median CPU s", ours=float(np.median(times))),
        Row(case=name, figure="all forms of a scene, longest CPU s", ours=float(np.max(times))),
    ]


def against_grid(name: str, judged: list[Judged]) -> list[Row]:
    """Rows of what brute force found beside what the planner found."""
    rows = []
    for degree, forms in FORMS.items():
        mine = [one for one in judged if one.form in forms]
        plural = "s" if degree > 1 else ""
        over = 100.0 * max((one.over for one in mine), default=0.0)
        figure = f"ours over the grid's best, {degree} piece{plural}, worst %"
        rows.append(Row(case=name, figure=figure, ours=over, target="at most 0.1", holds=over <= 0.1))
        beyond = 100.0 * max((-one.over for one in mine), default=0.0)
        rows.append(Row(case=name, figure=f"the grid's best over ours, {degree} piece{plural}, worst %", ours=beyond))
    able = [one for one in judged if np.isfinite(one.ours)]
    missed, unseen = sum(one.missed for one in judged), sum(bool(np.isinf(one.grid)) for one in able)
    bounded = sum(one.ours <= 1.001 * one.bound for one in able)
    return [
        *rows,
        Row(case=name, figure="forms missed", ours=float(missed), target="none", holds=missed == 0),
        Row(case=name, figure=f"forms that the grid missed, of {len(able)}", ours=float(unseen)),
        Row(case=name, figure=f"forms within 0.1 % of their own bound, of {len(able)}", ours=float(bounded)),
    ]


def judged_scene(problem: PlanarProblem, index: int) -> tuple[list[Judged], float]:
    """All forms of one scene and the processor's time that the planner took, s."""
    begun = time.process_time()
    paths = plan_planar(problem)
    spent = time.process_time() - begun
    rng = np.random.default_rng([SEED, index])
    return [judge(problem, path, rng) for path in paths], spent


def judge(problem: PlanarProblem, path: PlanarPath, rng: np.random.Generator) -> Judged:
    """One form against brute force."""
    s = problem.settings
    grid = shortest_path(problem, path.form, MARGIN * path.length, rng)
    return Judged(
        form=path.form, ours=path.length, bound=(path.bound - s.weight_degree * path.degree) / s.weight_length, grid=grid
    )


def flat_problem(case: NeedleCase) -> PlanarProblem:
    """A planar case posed."""
    return PlanarProblem(np.array(case.entry), np.array(case.target), load_ground(case).scene, case.planar)


def random_scene(rng: np.random.Generator) -> PlanarProblem:
    """Four circles between the entry and a target at a depth of 95 mm."""
    bodies = tuple(
        Sphere(np.array([0.0, rng.uniform(-30, 30), rng.uniform(25, 70)]), float(rng.uniform(4, 11)), "circle") for _ in range(4)
    )
    target = np.array([rng.uniform(-15, 15), 95.0])
    return PlanarProblem(np.zeros(2), target, Scene(bodies), PlanarSettings(safety=1.5))
