"""The best path of one planar form: branch and bound over its free lengths.

# Strategy: the free lengths of a form, at most three, fill a box. It is cut into cells, and cells that can hold no path that
# keeps the limits and costs less than the best known one are dropped (`planar_bounds`); the rest are halved in every direction.
# The best known path comes from forms with a piece less, from middles of cells, and from a smooth finish where that promises
# more. When no cell is left, no path of the form is better by more than `WITHIN`, around whatever side of the obstacles it goes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tubeplan_viz.needle.planar_bodies import FlatScene
from tubeplan_viz.needle.planar_bounds import Appraisal, Cells, appraise
from tubeplan_viz.needle.planar_finish import Candidate, polished
from tubeplan_viz.needle.planar_motion import posed
from tubeplan_viz.needle.planar_shapes import PlanarProblem, sides_of

# Of the best cost, by how many lengths are free: less than the 0.1 % that is promised, and far less where cells are few.
WITHIN = {0: 0.0, 1: 1e-6, 2: 1e-4, 3: 8e-4}
FIRST = {1: 64, 2: 16, 3: 8}  # cells along each free length at the start, by how many there are
REACH = 1.5  # times the distance of the target: no piece is longer
BLIND = 0.014  # radius of the arcs, half width below which cells are given up that no derivative bounds: their paths end across
FINEST = 0.01  # mm, half width of the smallest cells
MOST = 150_000  # cells appraised for one form
SEEDS = 2  # paths of simpler forms that are finished first
PENALTY = 3.0  # of a mm that lacks, in mm of length, when cells are compared


@dataclass(frozen=True, eq=False)
class Found:
    """What is known of one form.

    Attributes
    ----------
    best : Candidate or None
        The best path; None if none was found.
    bound : float
        No path of the form costs less.
    nearest : Candidate or None
        Where there is no path: the one that comes least near to an obstacle, of those that end at the target.
    weighed : int
        Cells appraised.
    """

    best: Candidate | None
    bound: float
    nearest: Candidate | None
    weighed: int


def search_form(problem: PlanarProblem, scene: FlatScene, form: str, simpler: tuple[Candidate, ...] = ()) -> Found:
    """The best path of one form.

    Parameters
    ----------
    problem : PlanarProblem
    scene : FlatScene
        Its bodies.
    form : str
        Pieces in order, L and R.
    simpler : tuple of Candidate
        Best paths of forms with a piece less.
    """
    best = started(problem, scene, form, simpler)
    cells = first_cells(problem, form)
    tried: list[Candidate] = []
    nearest, least_short, weighed, unsettled, given_up = None, np.inf, 0, np.inf, np.inf
    while len(cells):
        if weighed + len(cells) > MOST or cells.half.max(initial=1.0) < FINEST:
            break
        weighed += len(cells)
        seen = appraise(problem, scene, cells, enough(best))
        if best is None and seen.short < least_short:
            nearest, least_short = (
                Candidate(seen.closest.middles[0], seen.closest.sides[0], float(seen.closest.roots[0])),
                seen.short,
            )
        for row in promising(seen, best, tried):
            begun = candidate(seen, row)
            tried.append(begun)
            made = polished(problem, scene, begun) if cells.half.size else begun
            made = min(made, begun, key=lambda one: one.cost)
            if np.isfinite(made.cost) and (best is None or made.cost < best.cost):
                best = made
        left = seen.least < enough(best)
        if cells.half.max(initial=0.0) < BLIND * problem.settings.radius:
            given_up = min(given_up, float(seen.least[left & seen.blind].min(initial=np.inf)))
            left &= ~seen.blind
        unsettled = float(seen.least[left].min(initial=np.inf))
        if not cells.half.size:
            return Found(best, enough(best), nearest, weighed)
        cells = seen.cells.take(np.flatnonzero(left)).split()
    return Found(best, min(unsettled, given_up, enough(best)), nearest, weighed)


def enough(best: Candidate | None) -> float:
    """The cost below which a path is worth looking for."""
    return np.inf if best is None else (1.0 - WITHIN[len(best.free)]) * best.cost


def first_cells(problem: PlanarProblem, form: str) -> Cells:
    """The box of all free lengths of a form, of all bend sides and both last pieces, in cells."""
    s = problem.settings
    free = len(form) - 1
    longest = np.array(
        [
            REACH * problem.distance if piece == "L" else min(s.turn_max * s.radius, REACH * problem.distance)
            for piece in form[:-1]
        ]
    )
    longest = np.maximum(longest, 2.0 * s.piece_min)
    count = FIRST.get(free, 1)
    half = 0.5 * (longest - s.piece_min) / count
    axes = [s.piece_min + width * (2.0 * np.arange(count) + 1.0) for width in half]
    middles = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, free) if free else np.empty((1, 0))
    sides = np.array(sides_of(form), dtype=float)
    # The mirror image of a way is another way: both roots with all sides.
    choices = 2 * len(sides)
    return Cells(
        np.tile(middles, (choices, 1)),
        half,
        np.repeat(np.repeat(sides, 2, axis=0), len(middles), axis=0),
        np.repeat(np.tile([1.0, -1.0], len(sides)), len(middles)),
    )


def candidate(seen: Appraisal, row: int) -> Candidate:
    """The middle of one cell."""
    cells = seen.cells
    return Candidate(cells.middles[row], cells.sides[row], float(cells.roots[row]), float(seen.costs[row]))


def promising(seen: Appraisal, best: Candidate | None, tried: list[Candidate]) -> list[int]:
    """Rows whose middles are worth a smooth finish: better than the best, or nearly so and far from those tried before."""
    rows: list[int] = []
    if not len(seen.cells):
        return rows
    known = np.inf if best is None else best.cost
    if seen.costs.min() < known:
        rows.append(int(seen.costs.argmin()))
    merit = seen.lengths + PENALTY * seen.lacking
    for row in (int(merit.argmin()), int(seen.least.argmin()) if best is None else -1):
        if row < 0 or row in rows or not merit[row] < known:
            continue
        if not any(near(candidate(seen, row), other, 4.0 * float(seen.cells.half.max())) for other in tried):
            rows.append(row)
    return rows


def near(first: Candidate, second: Candidate, within: float) -> bool:
    """Whether two paths go alike: same sides and all free lengths within some mm."""
    alike = first.root == second.root and bool((first.sides == second.sides).all())
    return alike and float(np.abs(first.free - second.free).max()) <= within


def started(problem: PlanarProblem, scene: FlatScene, form: str, simpler: tuple[Candidate, ...]) -> Candidate | None:
    """The best path made of those of simpler forms with one shortest piece more; None without one."""
    s = problem.settings
    choices = set(sides_of(form))
    begun: list[Candidate] = []
    for one in simpler:
        lengths = posed(problem, one.free[None], one.sides[None], np.array([one.root])).lengths[0]
        for k in range(len(form)):
            for side in (0.0,) if form[k] == "L" else (1.0, -1.0):
                sides = np.insert(one.sides, k, side)
                if tuple(sides) in choices:
                    free = np.insert(lengths, k, s.piece_min)[:-1]
                    begun.extend(Candidate(free, sides, root) for root in (1.0, -1.0))
    best: Candidate | None = None
    if begun:
        free, every = np.array([one.free for one in begun]), np.array([one.sides for one in begun])
        cells = Cells(free, np.zeros(len(form) - 1), every, np.array([one.root for one in begun]))
        seen = appraise(problem, scene, cells, np.inf)
        merit = seen.lengths + PENALTY * seen.lacking
        for row in np.argsort(merit)[:SEEDS]:
            made = polished(problem, scene, candidate(seen, int(row)))
            if np.isfinite(made.cost) and (best is None or made.cost < best.cost):
                best = made
    return best
