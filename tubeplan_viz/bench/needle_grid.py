"""The planar planner's optima put to the test: a search by brute force for shorter paths of the same form.

# Strategy: a form of n pieces that closes on the target exactly has n - 1 free lengths, and only paths that are shorter than
# the planner's could prove it wrong. So the grid covers the corner in which the free lengths together are shorter than it,
# at places jittered anew for every scene, and only what closes to a shorter path is weighed at all. Around those that come
# nearest to keeping their distance the grid is made finer, again and again.
"""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.needle.planar_shapes import PlanarProblem, Shapes, close, sides_of, weigh

PER_AXIS = {1: 4000, 2: 160, 3: 40}  # places along each free length, by how many there are
ZOOMS = 4
SEEDS = 40  # places around which the grid is made finer
FINE = 5  # places along each axis of a finer grid
SHRINK = 0.4
CHUNK = 2048


def shorter_path(problem: PlanarProblem, form: str, than: float, rng: np.random.Generator) -> float:
    """Length of the shortest path of a form that a grid finds, mm, if it is shorter than `than`; infinite if none is.

    Parameters
    ----------
    problem : PlanarProblem
    form : str
        Pieces in order, L and R.
    than : float, mm
        Length to beat; infinite to look for any path at all.
    rng : Generator
        Where the grid's places lie.
    """
    least = np.inf
    for sides in sides_of(form):
        least = min(least, shorter_of_sides(problem, np.array(sides, dtype=float), min(than, least), rng))
    return least


def shorter_of_sides(problem: PlanarProblem, sides: FloatArray, than: float, rng: np.random.Generator) -> float:
    """The same for one choice of bend sides."""
    count = len(sides) - 1
    if count == 0:
        return best_below(problem, close(problem, np.zeros((1, 0)), sides), than)[0]
    longest = min(than, 1.5 * problem.distance)
    step = (longest - problem.settings.piece_min) / PER_AXIS[count]
    axes = [problem.settings.piece_min + step * (np.arange(PER_AXIS[count]) + rng.random()) for _ in range(count)]
    free = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, count)
    free = free[free.sum(axis=1) < longest]
    least = np.inf
    for level in range(ZOOMS + 1):
        found, seeds = best_below(problem, close(problem, free, sides), min(than, least))
        least = min(least, found)
        if level == ZOOMS or not len(seeds):
            break
        step *= SHRINK
        offsets = step * (np.arange(FINE) - FINE // 2)
        cell = np.stack(np.meshgrid(*[offsets] * count, indexing="ij"), axis=-1).reshape(-1, count)
        free = (seeds[:, None, :] + cell[None]).reshape(-1, count)
        free = free[(free >= problem.settings.piece_min).all(axis=1)]
    return least


def best_below(problem: PlanarProblem, shapes: Shapes, than: float) -> tuple[float, FloatArray]:
    """Length of the shortest shape that is shorter than `than` and keeps its distance; free lengths of some that nearly do."""
    order = np.flatnonzero(shapes.costs < than)
    order = order[np.argsort(shapes.costs[order], kind="stable")]
    spare = np.full(len(order), -np.inf)
    least = np.inf
    for first in range(0, len(order), CHUNK):  # shortest first: the first that keeps its distance is the shortest
        rows: IntArray = order[first : first + CHUNK]
        costs, spare[first : first + CHUNK] = weigh(problem, shapes.take(rows))
        if np.isfinite(costs.min()):
            least = float(costs.min())
            break
    near = order[np.argsort(-spare, kind="stable")[:SEEDS]]
    return least, shapes.lengths[near, :-1]
