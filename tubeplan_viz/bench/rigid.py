"""tubeplan bench rigid: the tangent search against brute force, the envelope against the exact test, on a calculated head."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from segmentation.anatomy.nasal import propose_lesion, propose_scene, shrink
from segmentation.arrays import BoolArray
from segmentation.synthetic.nasal import NasalPhantomSettings, nasal_phantom
from tubeplan_viz.bench.head_ct import CRANIUM, read_head_ct
from tubeplan_viz.bench.rigid_brute import BruteForce, brute_force
from tubeplan_viz.bench.rigid_exact import free_paths
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.memory import peak_memory
from tubeplan_viz.pipeline import Notify, silent
from tubeplan_viz.rigid import (
    CoupledInstrument,
    Problem,
    RigidPath,
    SearchResult,
    SearchSettings,
    Weights,
    make_problem,
    posed,
    rank,
    refined,
    search,
)
from tubeplan_viz.rigid.collision import collide, to_frame
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.planner import path_goals, ranked_paths

POSES = 100_000
SPACING_MM = 2.0  # of the phantom for brute force: at 1 mm it would try fifty times as much
GRIDS_MM = ((2.0, 4.0), (1.0, 2.0), (0.5, 1.0))  # lines and nodes on them, of brute force
EVERY_PATH = 1  # the grid all of whose paths are ranked
BORDER_MM = (0.125, 1.0)  # lines as near to one another as the search has them, for starts beside feasible ones
BENT_COMPARED = 1000
SEED = 20211


def rigid(*, quick: bool = False, notify: Notify = silent) -> list[Row]:
    """All rows; `quick` takes fewer poses and only the two coarser grids of brute force, on one side.

    Brute force has no roll, and so the search has none here. One unit is counted on both sides: a pose or a push that is put
    to a test of any kind. `quick` has no row of that number, nor of the same starts, since its grid finds less than the search.
    """
    phantom = nasal_phantom(NasalPhantomSettings(spacing=(SPACING_MM,) * 3))
    rows: list[Row] = []
    for side in ("left",) if quick else ("left", "right"):
        scene = shrink(phantom.scene, 1.0, side).scene
        problem = make_problem(scene, side, phantom.lesions[side], instrument=CoupledInstrument())
        notify(f"search, {side}", 0, 0)
        found = search(problem.judge(), problem.starts, problem.goal, SearchSettings(rolls=1, nodes=1))
        grids: list[BruteForce] = []
        for k, (line, step) in enumerate(GRIDS_MM[:2] if quick else GRIDS_MM):
            notify(f"brute force, {side}, lines {line:g} mm apart", k, len(GRIDS_MM))
            known = grids[-1].paths if grids else ()
            every = k == EVERY_PATH and not quick
            grids.append(brute_force(problem, line_mm=line, step_mm=step, every=every, known=known))
        if not quick:
            notify(f"brute force, {side}, starts at the border", len(GRIDS_MM), len(GRIDS_MM))
        finest = grids[-1] if quick else at_border(problem, grids[-1])
        rows += compared(f"phantom, {side}", problem, found, grids, finest, notify, quick=quick)
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
    memory = peak_memory() / 1024.0
    case = "real head CT, left"
    return [
        Row(case=case, figure="starts", ours=float(len(problem.starts))),
        Row(case=case, figure="feasible starts", ours=float(found.feasible.sum())),
        Row(case=case, figure="time with the scene, s", ours=seconds, target="under 60", holds=seconds < 60.0),
        Row(case=case, figure="greatest memory, GB", ours=memory, target="under 3", holds=memory < 3.0),
    ]


def at_border(problem: Problem, coarser: BruteForce) -> BruteForce:
    """Brute force on a finer grid for the starts whose neighbours are feasible: what a coarser grid missed lies there."""
    beside, _ = cKDTree(problem.starts[coarser.feasible]).query(problem.starts)
    near = np.asarray(beside <= np.sqrt(3.0) * SPACING_MM + 1e-6)
    line, step = BORDER_MM
    return brute_force(problem, line_mm=line, step_mm=step, every=False, known=coarser.paths, only=near)


def compared(
    case: str,
    problem: Problem,
    found: SearchResult,
    grids: Sequence[BruteForce],
    finest: BruteForce,
    notify: Notify,
    *,
    quick: bool,
) -> list[Row]:
    """Feasible starts, tests and best paths of the search beside those of brute force.

    Every start that either finds is confirmed by the octree test. The starts are compared with those of `finest`, the tests
    with those of the last of `grids`, which needs fewer.
    """
    notify("octree test", 0, 0)
    first = {path.start: path for path in reversed(finest.paths)}
    mine, theirs = confirmed(problem, found.paths), confirmed(problem, list(first.values()))
    both, either = float((mine & theirs).sum()), float((mine | theirs).sum())
    brute, tests = "brute force, finest grid", grids[-1].tests
    same = Row(case=case, figure="feasible starts, IoU of search and brute force", ours=both / either)
    rows = [
        Row(
            case=case, figure="feasible starts", ours=float(mine.sum()), reference=float(theirs.sum()), source=brute,
        ),
        same if quick else replace(same, target="at least 0.98", holds=both / either >= 0.98),
        Row(
            case=case, figure="starts not confirmed by the octree test", ours=float((found.feasible & ~mine).sum()),
            reference=float((finest.feasible & ~theirs).sum()), source=brute, target="none",
            holds=bool((found.feasible == mine).all() and (finest.feasible == theirs).all()),
        ),
        *(
            Row(
                case=case, figure=f"starts of brute force, lines {line:g} mm, nodes {step:g} mm apart",
                ours=float(grid.feasible.sum()), reference=either, source="all confirmed starts",
            )
            for (line, step), grid in zip(GRIDS_MM, grids, strict=False)
        ),
        Row(case=case, figure="starts found by the search alone", ours=float((mine & ~theirs).sum())),
        Row(case=case, figure="starts found by brute force alone", ours=float((theirs & ~mine).sum())),
        Row(case=case, figure="share of all confirmed starts that the search finds", ours=float(mine.sum()) / either),
        Row(case=case, figure="tests decided by a witness", ours=float(found.tests - found.evaluations)),
        Row(case=case, figure="tests by the envelope", ours=float(found.evaluations)),
    ]  # fmt: skip
    if not quick:
        row = Row(
            case=case, figure="tests, poses and pushes", ours=float(found.tests), reference=float(tests),
            source="brute force, coarser by one", target="at least 10 times fewer", holds=tests >= 10.0 * found.tests,
        )  # fmt: skip
        rows += [row, *best_paths(case, problem, found, grids[EVERY_PATH])]
    return rows


def confirmed(problem: Problem, paths: Sequence[RigidPath]) -> BoolArray:
    """Starts with a path that the octree test finds free, (n,)."""
    made = np.zeros(len(problem.starts), dtype=bool)
    free = free_paths(problem, paths)
    made[[path.start for path, ok in zip(paths, free, strict=True) if ok]] = True
    return made


def best_paths(case: str, problem: Problem, found: SearchResult, every: BruteForce) -> list[Row]:
    """The four best paths, refined, beside the best of all that brute force found."""
    ranked = ranked_paths(found.paths)
    mine, own = refined(problem, ranked, path_goals(problem, ranked), Weights())
    straight = tuple(path for path in every.paths if len(path.nodes) == 2)
    bent = sorted((path for path in every.paths if len(path.nodes) > 2), key=lambda path: path.length)
    theirs = straight + tuple(bent[:1]) + tuple(bent[:: max(1, len(bent) // BENT_COMPARED)])
    goals = np.vstack([own, path_goals(problem, theirs)])
    # One scale for both: the goals are normalised over all paths together.
    score, n, rows = rank(goals, Weights()).score, len(mine), []
    for name, values, sign in (
        ("farthest from the brain, mm", goals[:, 0], -1.0), ("shortest, mm", goals[:, 4], 1.0),
        ("least tissue, voxels", goals[:, 5], 1.0), ("overall best, F", score, 1.0),
    ):  # fmt: skip
        ours, best = float((sign * values[:n]).min() * sign), float((sign * values[n:]).min() * sign)
        holds = sign * (ours - best) <= 0.02 * abs(best) + 1e-9
        source = f"brute force, {len(theirs)} of {len(every.paths)} paths"
        rows.append(Row(case=case, figure=name, ours=ours, reference=best, source=source, target="within 2 %", holds=holds))
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
