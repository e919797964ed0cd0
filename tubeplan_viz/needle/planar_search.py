"""The search among planar shapes: a dense grid, cheapest first, then shrinking random steps, then a smooth finish.

# Strategy: at most three lengths are free. A grid over them is weighed cheapest first; the best and those that all but keep
# their distance are refined by random steps, for every form and side at once; the winners end where the constraints meet by
# sequential quadratic programming.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.needle.obstacles import danger
from tubeplan_viz.needle.planar_shapes import PlanarProblem, Shapes, arcs_of, close, slack, weigh

STARTS = 4  # refined per form and side
TRIES = 20  # random steps from each of them in one round
ROUNDS = {2: 30, 3: 30, 4: 14}  # by control degree; SHRINK^30 of the first step is 1e-5 of it, four pieces end smoothly
SHRINK = 0.68  # of the steps per round
SCOUTS = 8  # shapes that all but keep the distance, per form and side: the way into a narrow gap of the grid
SCOUT_ROUNDS = 12
GRID = {1: 6000, 2: 110, 3: 22}  # places along each free length, by how many there are
CHUNK = 1024
STEP = 1e-6  # mm, of differences
EDGE = 1e-9  # mm kept beyond a limit, so that rounding does not break it
FAR = 1e6  # mm, in place of what does not close


def grid(problem: PlanarProblem, sides: FloatArray) -> FloatArray:
    """Lengths of the free pieces on a grid, (k, n - 1) mm."""
    s = problem.settings
    per_axis = GRID[len(sides)]
    axes = []
    for side in sides:
        longest = 1.3 * problem.distance if side == 0 else min(s.turn_max * s.radius, 1.3 * problem.distance)
        axes.append(s.piece_min + (max(longest, 2.0 * s.piece_min) - s.piece_min) * np.linspace(0.0, 1.0, per_axis))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(sides))


def gathered(problem: PlanarProblem, groups: list[tuple[int, Shapes]]) -> tuple[Shapes, IntArray]:
    """Shapes of several forms and sides as one population, (k, n) sides, and to which each belongs, (k,)."""
    owner = np.concatenate([np.full(len(shapes.costs), index) for index, shapes in groups]) if groups else np.empty(0)
    lengths = np.vstack([shapes.lengths for _, shapes in groups])
    sides = np.vstack([np.broadcast_to(shapes.sides, shapes.lengths.shape) for _, shapes in groups])
    angles = np.concatenate([shapes.angles for _, shapes in groups])
    return Shapes(lengths, angles, sides, problem.settings.weight_length * lengths.sum(axis=1)), owner.astype(int)


def joined(first: Shapes, second: Shapes) -> Shapes:
    """Two populations as one."""
    names = ("lengths", "angles", "sides", "costs")
    return Shapes(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names))


def promising(problem: PlanarProblem, pool: Shapes, owner: IntArray) -> tuple[Shapes, IntArray]:
    """Of each form and side the `STARTS` cheapest; where none is feasible, those that come nearest to it."""
    costs, spare = weigh(problem, pool)
    kept: list[int] = []
    for index in np.unique(owner):
        rows = np.flatnonzero(owner == index)
        kept.extend(rows[np.lexsort((-spare[rows], costs[rows]))][:STARTS].tolist())
    chosen = np.array(kept, dtype=int)
    return pool.take(chosen), owner[chosen]


def spacing(problem: PlanarProblem, degree: int) -> float:
    """Between neighbours of the grid, mm."""
    return 1.3 * problem.distance / GRID[degree - 1]


def cheapest(problem: PlanarProblem, shapes: Shapes, degree: int) -> tuple[Shapes, Shapes]:
    """A few feasible shapes of low cost that differ, and a few still cheaper ones that are all but feasible.

    A gap between obstacles may be narrower than the grid: a shape that is short of the distance by no more than the grid
    is coarse may have feasible neighbours.
    """
    order = np.argsort(shapes.costs, kind="stable")
    costs, spare = np.full(len(order), np.inf), np.full(len(order), -np.inf)
    seen = 0
    while seen < len(order):
        rows = order[seen : seen + CHUNK * (1 if seen == 0 else 4)]
        seen += len(rows)
        costs[rows], spare[rows] = weigh(problem, shapes.take(rows))
        if problem.settings.weight_danger == 0.0 and np.count_nonzero(np.isfinite(costs)) >= 4 * STARTS:
            break
    able = np.flatnonzero(np.isfinite(costs))
    ranked = able[np.argsort(costs[able], kind="stable")] if len(able) else np.argsort(-spare, kind="stable")
    coarse = min(2.0 * spacing(problem, degree), 3.0) if degree > 1 else 0.0
    least = float(costs.min(initial=np.inf))
    close_by = np.flatnonzero(~np.isfinite(costs) & (spare >= -coarse) & (shapes.costs < least))
    apart = 0.06 * problem.distance
    cheap, near = (close_by[np.argsort(rank[close_by], kind="stable")] for rank in (shapes.costs, -spare))
    scouts = [
        differing(shapes.lengths, rows, apart, count) for rows, count in ((cheap, SCOUTS // 4), (near, SCOUTS - SCOUTS // 4))
    ]
    return shapes.take(differing(shapes.lengths, ranked, apart, STARTS)), shapes.take(np.unique(np.concatenate(scouts)))


def differing(lengths: FloatArray, ranked: IntArray, apart: float, count: int) -> IntArray:
    """The first of `ranked` rows that differ in some length by more than `apart` mm from those before, at most `count`."""
    kept: list[int] = []
    left = ranked[:4000]
    while len(left) and len(kept) < count:
        kept.append(int(left[0]))
        left = left[np.abs(lengths[left] - lengths[left[0]]).max(axis=1) > apart]
    return np.array(kept, dtype=int)


def refine(
    problem: PlanarProblem, pool: Shapes, rng: np.random.Generator, *, rounds: int, step: float
) -> tuple[Shapes, FloatArray, FloatArray]:
    """Random steps around each shape, smaller from round to round; a step is kept if it is cheaper (or nearer to feasible)."""
    costs, spare = weigh(problem, pool)
    lengths, angles = pool.lengths.copy(), pool.angles.copy()
    count, free = len(costs), lengths.shape[1] - 1
    for _ in range(rounds if count else 0):
        scale = step * rng.choice([1.0, 0.3, 0.1], size=(count, TRIES, 1))
        trial = lengths[:, None, :free] + scale * rng.standard_normal((count, TRIES, free))
        trial = np.maximum(trial, problem.settings.piece_min)
        sides = np.repeat(pool.sides, TRIES, axis=0)
        shapes = close(problem, trial.reshape(-1, free), sides)
        limit = np.tile(np.repeat(np.where(np.isfinite(costs), costs, np.inf), TRIES), 2)
        held = np.where(shapes.costs < limit, shapes.costs, np.inf)
        shapes = Shapes(shapes.lengths, shapes.angles, shapes.sides, held)
        new, room = weigh(problem, shapes)
        new, room = (v.reshape(2, count, TRIES).transpose(1, 0, 2).reshape(count, -1) for v in (new, room))
        rows = np.arange(count)
        take = np.where(np.isfinite(new.min(axis=1)), new.argmin(axis=1), room.argmax(axis=1))
        better = np.where(np.isfinite(costs), new[rows, take] < costs, (new[rows, take] < np.inf) | (room[rows, take] > spare))
        flat = np.where(take >= TRIES, count * TRIES, 0) + rows * TRIES + take % TRIES
        lengths[better], angles[better] = shapes.lengths[flat[better]], shapes.angles[flat[better]]
        costs[better], spare[better] = new[rows, take][better], room[rows, take][better]
        step *= SHRINK
    return Shapes(lengths, angles, pool.sides, problem.settings.weight_length * lengths.sum(axis=1)), costs, spare


def sharpened(problem: PlanarProblem, shape: Shapes) -> Shapes:
    """One shape with its lengths where the cost is least, smoothly; the shape itself where that gains nothing."""
    s = problem.settings
    sides = shape.sides.reshape(-1)
    keep = s.safety + slack(problem.scene) + EDGE
    last = float(shape.lengths[0, -1])
    limit = s.turn_max * s.radius

    def closed(free: FloatArray) -> Shapes:
        both = close(problem, free, sides)
        count = len(free)
        off = np.abs(both.lengths[:, -1].reshape(2, count) - last)
        return both.take(np.where(np.nan_to_num(off, nan=np.inf).argmin(axis=0) == 0, 0, count) + np.arange(count))

    def rows(free: FloatArray) -> FloatArray:
        shapes = closed(free)
        lengths = np.nan_to_num(shapes.lengths, nan=FAR)
        ends = [lengths[:, -1] - s.piece_min, np.where(sides[-1] == 0, 1.0, limit - lengths[:, -1])]
        cost = s.weight_length * lengths.sum(axis=1)
        if len(problem.scene):
            gaps = np.nan_to_num(problem.scene.piece_distances(arcs_of(problem, shapes)).min(axis=1), nan=-FAR)
            if s.weight_danger > 0.0:
                cost = cost + s.weight_danger * danger(np.maximum(gaps, max(s.safety, 1e-6)), s.safety)
            return np.column_stack([cost, *ends, gaps - keep])
        return np.column_stack([cost, *ends])

    def slopes(free: FloatArray) -> FloatArray:
        steps = STEP * np.eye(len(free))
        found = rows(np.vstack([free + steps, free - steps]))
        # In C order: SLSQP reads a transposed array as if it were not.
        return np.ascontiguousarray(((found[: len(free)] - found[len(free) :]) / (2.0 * STEP)).T)

    start = shape.lengths[0, :-1]
    highest = [limit if side else None for side in sides[:-1]]
    found = minimize(
        lambda x: float(rows(x[None])[0, 0]),
        start,
        jac=lambda x: slopes(x)[0],
        bounds=[(s.piece_min, high) for high in highest],
        constraints=[{"type": "ineq", "fun": lambda x: rows(x[None])[0, 1:], "jac": lambda x: slopes(x)[1:]}],
        method="SLSQP",
        options={"maxiter": 15, "ftol": 1e-7},
    )
    if not np.isfinite(found.x).all():
        return shape
    made = closed(np.maximum(found.x, s.piece_min)[None])
    made = Shapes(made.lengths, made.angles, shape.sides, made.costs)
    costs, _ = weigh(problem, made)
    before, _ = weigh(problem, shape)
    return made if costs[0] < before[0] else shape
