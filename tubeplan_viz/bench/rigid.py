"""tubeplan bench rigid: the tangent search against brute force, the envelope against the exact test, on a calculated head."""

from __future__ import annotations

import resource
import time

import numpy as np

from segmentation.anatomy.nasal import propose_lesion, propose_scene, shrink
from segmentation.synthetic.nasal import NasalPhantomSettings, nasal_phantom
from tubeplan_viz.bench.head_ct import CRANIUM, read_head_ct
from tubeplan_viz.bench.rigid_brute import BruteForce, brute_force
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.pipeline import Notify, silent
from tubeplan_viz.rigid import (
    CoupledInstrument,
    Problem,
    SearchResult,
    SearchSettings,
    Weights,
    make_problem,
    posed,
    rank,
    search,
)
from tubeplan_viz.rigid.collision import collide, to_frame
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.planner import path_goals, ranked_paths

POSES = 100_000
SPACING_MM = 2.0  # of the phantom for brute force: at 1 mm it would try fifty times as much
DEPTHS, DEPTHS_QUICK = 20, 6
BENT_COMPARED = 300
SEED = 20211


def rigid(*, quick: bool = False, notify: Notify = silent) -> list[Row]:
    """All rows; `quick` takes fewer poses and a coarser grid of nodes for brute force.

    Brute force has no roll, and so the search has none here.
    """
    phantom = nasal_phantom(NasalPhantomSettings(spacing=(SPACING_MM,) * 3))
    rows: list[Row] = []
    for side in ("left",) if quick else ("left", "right"):
        scene = shrink(phantom.scene, 1.0, side).scene
        problem = make_problem(scene, side, phantom.lesions[side], instrument=CoupledInstrument())
        notify(f"search, {side}", 0, 0)
        found = search(problem.judge(), problem.starts, problem.goal, SearchSettings(rolls=1, nodes=1))
        notify(f"brute force, {side}", 0, 0)
        every = brute_force(problem, np.zeros(1), depths=DEPTHS_QUICK if quick else DEPTHS)
        rows += compared(f"phantom, {side}", problem, found, every)
        if side == "left":
            notify("random poses", 0, 0)
            rows += poses(problem, POSES // 10 if quick else POSES)
    if not CRANIUM.exists():
        notify("skipped: the real head CT (Debian's package invesalius-examples is not installed)", 0, 0)
        return rows
    return rows + real_head(notify)


def real_head(notify: Notify) -> list[Row]:
    """Starts, time and memory of the search for the left optic canal on a real head CT, with the mucosa shrunken."""
    notify("real head CT", 0, 0)
    begun = time.perf_counter()
    scene = propose_scene(read_head_ct())
    lesion = propose_lesion(scene, "left")
    if lesion is None:
        return [Row(case="real head CT, left", figure="target at the optic canal", ours=0.0, target="found", holds=False)]
    problem = make_problem(shrink(scene, 1.0, "left").scene, "left", lesion.center, instrument=CoupledInstrument())
    found = search(problem.judge(), problem.starts, problem.goal, SearchSettings())
    seconds = time.perf_counter() - begun
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    case = "real head CT, left"
    return [
        Row(case=case, figure="starts", ours=float(len(problem.starts))),
        Row(case=case, figure="feasible starts", ours=float(found.feasible.sum())),
        Row(case=case, figure="time with the scene, s", ours=seconds, target="under 60", holds=seconds < 60.0),
        Row(case=case, figure="greatest memory, GB", ours=memory, target="under 3", holds=memory < 3.0),
    ]


def compared(case: str, problem: Problem, found: SearchResult, every: BruteForce) -> list[Row]:
    """Feasible starts, evaluations and best paths of the search beside those of brute force."""
    both, either = (found.feasible & every.feasible).sum(), (found.feasible | every.feasible).sum()
    share, saved = float(both / max(either, 1)), every.evaluations / max(found.evaluations, 1)
    rows = [
        Row(
            case=case, figure="feasible starts", ours=float(found.feasible.sum()), reference=float(every.feasible.sum()),
            source="brute force",
        ),
        Row(case=case, figure="feasible starts, IoU", ours=share, target="at least 0.98", holds=share >= 0.98),
        Row(
            case=case, figure="collision evaluations", ours=float(found.evaluations), reference=float(every.evaluations),
            source="brute force", target="at least 10 times fewer", holds=saved >= 10.0,
        ),
    ]  # fmt: skip
    mine = ranked_paths(found.paths)
    straight = tuple(path for path in every.paths if len(path.nodes) == 2)
    bent = tuple(path for path in every.paths if len(path.nodes) > 2)
    theirs = straight + bent[:: max(1, len(bent) // BENT_COMPARED)]
    goals = path_goals(problem, (*mine, *theirs))
    # One scale for both: the goals are normalised over all paths together.
    score = rank(goals, Weights()).score
    n = len(mine)
    for name, values, sign in (
        ("farthest from the brain, mm", goals[:, 0], -1.0), ("shortest, mm", goals[:, 4], 1.0),
        ("least tissue, voxels", goals[:, 5], 1.0), ("overall best, F", score, 1.0),
    ):  # fmt: skip
        ours, best = float((sign * values[:n]).min() * sign), float((sign * values[n:]).min() * sign)
        holds = sign * (ours - best) <= 0.02 * abs(best) + 1e-9
        row = Row(case=case, figure=name, ours=ours, reference=best, source="brute force", target="within 2 %", holds=holds)
        rows.append(row)
    return rows


def poses(problem: Problem, count: int) -> list[Row]:
    """The envelope's verdicts on random poses beside the exact ones."""
    rng = np.random.default_rng(SEED)
    corners = np.vstack([problem.starts, problem.goal])
    tips = rng.uniform(corners.min(axis=0), corners.max(axis=0), (count, 3))
    starts = problem.starts[rng.integers(len(problem.starts), size=count)]
    ways = unit(tips - starts + rng.normal(0.0, 0.1, (count, 3)))
    bodies = to_frame(posed(problem.instrument, tips, ways, rng.uniform(-0.3, 0.3, count)), problem.obstacles.frame)
    begun = time.perf_counter()
    envelope = collide(problem.obstacles, bodies, exact=False).free.reshape(count, 2).all(axis=1)
    seconds = time.perf_counter() - begun
    exact = collide(problem.obstacles, bodies, exact=True).free.reshape(count, 2).all(axis=1)
    wrong, over = int((envelope & ~exact).sum()), float((exact & ~envelope).sum()) / count
    case = f"{count} random poses"
    return [
        Row(case=case, figure="passed wrongly by the envelope", ours=float(wrong), target="none", holds=wrong == 0),
        Row(case=case, figure="refused too early, share", ours=over, target="at most 0.02", holds=over <= 0.02),
        Row(case=case, figure="time of the envelope, s", ours=seconds),
    ]
