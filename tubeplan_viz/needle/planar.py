"""Planar paths of lines and arcs: every form up to four pieces, each at its global optimum.

# Strategy: in the plane a path is a complex number: with w = z - i y and heading h, a push moves w by e^(ih).
# The shape of a path (its lengths and bend sides) does not depend on the insertion angle, which only turns it.
# So a shape reaches the target exactly if its end is as far from the entry as the target is, and the angle
# follows. Given all lengths but the last, the last one has a closed form (a line or circle met by a circle).
# What is left, at most three lengths, is searched densely for every form and side at once, cheapest first, and the
# best are refined by shrinking random steps.

Source: Zhao et al. (2013), China Mechanical Engineering 24(1), tables 1-2; it solves each form locally to 0.1 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.kinematics import Arcs, Controls, Pose, bend_from, planar_pose, push
from tubeplan_viz.needle.obstacles import Scene, danger

FORMS = {
    1: ("L", "R"),
    2: ("LR", "RL", "RR"),
    3: ("LRR", "RLR", "RRL", "LRL", "RRR"),
    4: ("LRLR", "LRRL", "LRRR", "RLRL", "RLRR", "RRLR", "RRRL", "RRRR"),
}
STARTS = 4  # refined per form and side
TRIES = 20  # random steps from each of them in one round
ROUNDS = 30
SHRINK = 0.68  # of the steps per round: 0.68^30 of the first step is 1e-5 of it
SCOUTS = 8  # shapes that all but keep the distance, per form and side: the way into a narrow gap of the grid
SCOUT_ROUNDS = 12
GRID = {1: 6000, 2: 110, 3: 22}  # places along each free length, by how many there are
CHUNK = 1024


@dataclass(frozen=True, kw_only=True)
class PlanarSettings:
    """What is asked of planar paths.

    Attributes
    ----------
    radius : float, mm
        Of the arcs; 50 mm in the source.
    safety : float, mm
        Least distance to any obstacle: a hard limit.
    degree_max : int
        Most pieces, 1 to 4.
    weight_length, weight_danger, weight_degree : float
        a1 (per mm), a2 and a4 (per piece) of F = a1 L + a2 D + a3 H + a4 N. The source does not print them; the two
        values of F in its table 2 differ by what a4 near 10 gives. a3 is not needed: nothing that hits is allowed.
    angle_max : float, radian
        Largest insertion angle to either side.
    piece_min : float, mm
        Least length of a piece: a shorter one would be another form.
    turn_max : float, radian
        Largest angle of one arc.
    """

    radius: float = 50.0
    safety: float = 0.0
    degree_max: int = 4
    weight_length: float = 1.0
    weight_danger: float = 0.0
    weight_degree: float = 10.0
    angle_max: float = np.pi / 2
    piece_min: float = 1.0
    turn_max: float = np.pi

    def __post_init__(self) -> None:
        if not 0.1 <= self.radius <= 1e4:
            raise CaseError(f"radius_mm is {self.radius:g}, expected 0.1 to 10000 (kappa is its reciprocal)")
        if not 0.0 <= self.safety <= 100.0:
            raise CaseError(f"safety_mm is {self.safety:g}, expected 0 to 100")
        if self.degree_max not in FORMS:
            raise CaseError(f"degree_max is {self.degree_max}, expected 1 to 4")
        if min(self.weight_length, self.weight_danger, self.weight_degree) < 0 or self.weight_length == 0:
            raise CaseError("weights must be 0 or more, that of the length more than 0")
        if not 0.0 < self.angle_max <= np.pi:
            raise CaseError(f"angle_max is {np.degrees(self.angle_max):g} degrees, expected more than 0 and at most 180")
        if not 1e-6 <= self.piece_min <= 100.0:
            raise CaseError(f"piece_min is {self.piece_min:g} mm, expected 0.000001 to 100")


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanarPath:
    """The best path of one form, or why there is none.

    Attributes
    ----------
    form : str
        Pieces in order, L (line) or R (arc).
    sides : tuple of int
        Of each piece: 0 for a line, 1 for an arc as inserted, -1 for one with the bevel turned by 180 degrees.
    pose : Pose or None
        At the entry, turned by `angle`.
    controls : Controls or None
    angle : float, radian
        Insertion angle about x.
    clearances : (m,) float array, mm
        Lower bound of the distance to each obstacle, along the whole path.
    score : float
        F of the source.
    reason : str or None
        Why there is no path.
    tried : int
        Paths of this form that reach the target and were weighed.
    """

    form: str
    sides: tuple[int, ...] = ()
    pose: Pose | None = None
    controls: Controls | None = None
    angle: float = 0.0
    clearances: FloatArray | None = None
    danger: float = 0.0
    score: float = np.inf
    tip_error: float = 0.0
    reason: str | None = None
    tried: int = 0

    @property
    def degree(self) -> int:
        """Number of pieces."""
        return len(self.form)

    @property
    def feasible(self) -> bool:
        """Whether there is a path."""
        return self.controls is not None

    @property
    def length(self) -> float:
        """Length, mm; infinite without a path."""
        return self.controls.length if self.controls is not None else np.inf


@dataclass(frozen=True, eq=False)
class PlanarProblem:
    """From where, to where, past what; `entry` and `target` are (y, z) in mm."""

    entry: FloatArray
    target: FloatArray
    scene: Scene
    settings: PlanarSettings

    def __post_init__(self) -> None:
        if self.distance < 1e-3:
            raise CaseError("the needle's target is its entry; expected two places apart")
        for name, place in (("entry", self.entry), ("target", self.target)):
            gaps = [float(body.distance(np.array([[0.0, *place]]))[0]) for body in self.scene.obstacles]
            for k, gap in enumerate(gaps):
                if gap < self.settings.safety:
                    raise CaseError(
                        f"the {name} ({place[0]:g}, {place[1]:g}) mm is {gap:.2f} mm from obstacle {k + 1} "
                        f"({self.scene.obstacles[k].kind}), expected at least safety_mm = {self.settings.safety:g}"
                    )

    @property
    def distance(self) -> float:
        """From entry to target, mm."""
        return float(np.linalg.norm(np.subtract(self.target, self.entry)))

    @property
    def bearing(self) -> float:
        """Insertion angle of the straight line to the target, radian."""
        y, z = np.subtract(self.target, self.entry)
        return float(np.arctan2(-y, z))


@dataclass(frozen=True, eq=False)
class Shapes:
    """Paths that reach the target: `lengths` (k, n) mm, `angles` (k,) radian, `sides` (n,) or (k, n), `costs` (k,)."""

    lengths: FloatArray
    angles: FloatArray
    sides: FloatArray
    costs: FloatArray

    def take(self, chosen: IntArray) -> Shapes:
        """Some of them."""
        sides = self.sides if self.sides.ndim == 1 else self.sides[chosen]
        return Shapes(self.lengths[chosen], self.angles[chosen], sides, self.costs[chosen])


def plan_planar(
    problem: PlanarProblem, *, rng: np.random.Generator | None = None, progress: Callable[[int, int], None] | None = None
) -> tuple[PlanarPath, ...]:
    """The best path of every form, in the order of `FORMS`.

    Parameters
    ----------
    problem : PlanarProblem
    rng : Generator, optional
        For the refinement; a fixed one by default.
    progress : callable, optional
        Told how many of how many control degrees are done.
    """
    rng = rng or np.random.default_rng(0)
    degrees = range(1, problem.settings.degree_max + 1)
    found: list[PlanarPath] = []
    for degree in degrees:
        found.extend(best_of_degree(problem, degree, rng))
        if progress is not None:
            progress(degree, len(degrees))
    return tuple(found)


def best(paths: tuple[PlanarPath, ...], degree: int | None = None) -> PlanarPath | None:
    """The path of least F, of one degree or of all; None if none is feasible."""
    able = [path for path in paths if path.feasible and degree in (None, path.degree)]
    return min(able, key=lambda path: (path.score, path.degree, path.form)) if able else None


def sides_of(form: str) -> list[tuple[int, ...]]:
    """Bend sides of a form's pieces: neighbouring arcs alternate, every run of arcs starts on either side."""
    runs = [k for k, piece in enumerate(form) if piece == "R" and (k == 0 or form[k - 1] == "L")]
    made = []
    for firsts in product((1, -1), repeat=len(runs)):
        first = dict(zip(runs, firsts, strict=True))
        sides: list[int] = []
        for k, piece in enumerate(form):
            sides.append(0 if piece == "L" else first.get(k, -sides[-1] if sides else 1))
        made.append(tuple(sides))
    return made


def close(problem: PlanarProblem, free: FloatArray, sides: FloatArray) -> Shapes:
    """Paths with given lengths of all pieces but the last, (k, n - 1) mm, that end at the target exactly.

    Parameters
    ----------
    problem : PlanarProblem
    free : (k, n - 1) array, mm
    sides : (n,) or (k, n) array of 0, 1, -1

    Returns
    -------
    Shapes
        2 k rows, the two roots after each other; the cost is infinite where there is no such path.
    """
    s, r, reach = problem.settings, problem.settings.radius, problem.distance
    count = len(free)
    sides = np.asarray(sides, dtype=float)
    bent = np.broadcast_to(sides, (count, sides.shape[-1]))
    w, heading = np.zeros(count, complex), np.ones(count, complex)
    for k in range(free.shape[1]):
        turned = heading * np.exp(1j * bent[:, k] * free[:, k] / r)
        w = w + np.where(bent[:, k] == 0, free[:, k] * heading, -1j * bent[:, k] * r * (turned - heading))
        heading = turned
    last = bent[:, -1]
    with np.errstate(invalid="ignore"):
        ahead = np.real(w * np.conj(heading))
        root = np.sqrt(ahead**2 + reach**2 - np.abs(w) ** 2)
        center = w + 1j * last * r * heading
        opening = np.arccos((reach**2 - np.abs(center) ** 2 - r**2) / (2.0 * r * np.maximum(np.abs(center), 1e-300)))
    begin = np.angle(-1j * np.where(last == 0, 1.0, last) * heading)
    ends = []
    for sign in (1.0, -1.0):
        line = -ahead + sign * root
        arc = r * np.mod(last * (np.angle(center) + sign * opening - begin), 2.0 * np.pi)
        ends.append(np.where(last == 0, line, arc))
    lengths = np.vstack([np.column_stack([free, end]) for end in ends])
    both = np.tile(bent, (2, 1))
    final = lengths[:, -1]
    w, heading, last = np.tile(w, 2), np.tile(heading, 2), np.tile(last, 2)
    with np.errstate(invalid="ignore"):
        w = w + np.where(last == 0, final * heading, -1j * last * r * heading * (np.exp(1j * last * final / r) - 1.0))
        angles = np.mod(problem.bearing - np.angle(w) + np.pi, 2.0 * np.pi) - np.pi
        fine = (lengths >= s.piece_min).all(axis=1) & ((both == 0) | (lengths <= s.turn_max * r)).all(axis=1)
        fine &= np.abs(angles) <= s.angle_max
        costs = np.where(fine, s.weight_length * lengths.sum(axis=1), np.inf)
    return Shapes(lengths, angles, sides if sides.ndim == 1 else both, costs)


def arcs_of(problem: PlanarProblem, shapes: Shapes) -> Arcs:
    """The pieces of all shapes in space, x = 0."""
    count = len(shapes.lengths)
    zero = np.zeros(count)
    position = np.broadcast_to(np.array([0.0, *problem.entry]), (count, 3))
    c, s = np.cos(shapes.angles), np.sin(shapes.angles)
    tangent, normal = np.column_stack([zero, -s, c]), np.column_stack([zero, -c, -s])
    sides = np.broadcast_to(shapes.sides, shapes.lengths.shape)
    return bend_from(position, tangent, normal, turns_of(sides), shapes.lengths, np.abs(sides) / problem.settings.radius)


def turns_of(sides: FloatArray) -> FloatArray:
    """Turn of the bevel before each piece, radian, (..., n): pi where an arc bends to the other side than the last (first: 1)."""
    turns = np.zeros(sides.shape)
    now = np.ones(sides.shape[:-1])
    for k in range(sides.shape[-1]):
        here = np.where(sides[..., k] == 0, now, sides[..., k])
        turns[..., k] = np.where(here != now, np.pi, 0.0)
        now = here
    return turns


def weigh(problem: PlanarProblem, shapes: Shapes) -> tuple[FloatArray, FloatArray]:
    """Cost with danger, infinite where a limit breaks, and least distance to any obstacle less the safety distance: (k,) both."""
    s = problem.settings
    if not len(problem.scene):
        return shapes.costs, np.full(len(shapes.costs), np.inf)
    reached = np.isfinite(shapes.costs)
    costs, spare = np.full(len(shapes.costs), np.inf), np.full(len(shapes.costs), -np.inf)
    chosen = np.flatnonzero(reached)
    if len(chosen):
        gaps = problem.scene.piece_distances(arcs_of(problem, shapes.take(chosen))).min(axis=1)
        spare[chosen] = gaps.min(axis=1) - s.safety - slack(problem.scene)
        risk = s.weight_danger * danger(gaps, s.safety) if s.weight_danger > 0 else 0.0
        costs[chosen] = np.where(spare[chosen] >= 0.0, shapes.costs[chosen] + risk, np.inf)
    return costs, spare


def slack(scene: Scene) -> float:
    """What the search keeps beyond the safety distance, mm: samples may miss the nearest place of a body without a formula."""
    return 1e-9 if scene.exact else 0.02


def best_of_degree(problem: PlanarProblem, degree: int, rng: np.random.Generator) -> list[PlanarPath]:
    """The best path of each form of one control degree."""
    cases = [(form, np.array(sides, dtype=float)) for form in FORMS[degree] for sides in sides_of(form)]
    starts: list[tuple[int, Shapes]] = []
    scouts: list[tuple[int, Shapes]] = []
    tried = dict.fromkeys(FORMS[degree], 0)
    for index, (form, sides) in enumerate(cases):
        free = np.zeros((1, 0)) if degree == 1 else grid(problem, sides[:-1])
        shapes = close(problem, free, sides)
        shapes = shapes.take(np.flatnonzero(np.isfinite(shapes.costs)))
        tried[form] += len(shapes.costs)
        for found, group in zip(cheapest(problem, shapes, degree), (starts, scouts), strict=True):
            group.append((index, found))
    pool, owner = gathered(problem, starts)
    if degree == 1:
        costs, spare = weigh(problem, pool)
    else:
        ahead, scout_owner = gathered(problem, scouts)
        ahead, *_ = refine(problem, ahead, rng, rounds=SCOUT_ROUNDS, step=0.5 * spacing(problem, degree))
        pool, owner = joined(pool, ahead), np.concatenate([owner, scout_owner])
        pool, owner = promising(problem, pool, owner)
        pool, costs, spare = refine(problem, pool, rng, rounds=ROUNDS, step=0.06 * problem.distance)
    result = []
    for form in FORMS[degree]:
        mine = [row for row, k in enumerate(owner) if cases[k][0] == form]
        if not mine:
            result.append(PlanarPath(form=form, reason=unreachable(problem, form), tried=0))
            continue
        row = min(mine, key=lambda k: (costs[k], -spare[k]))
        result.append(finished(problem, form, pool.take(np.array([row])), tried[form]))
    return result


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


def unreachable(problem: PlanarProblem, form: str) -> str:
    """Why no path of a form ends at the target."""
    s = problem.settings
    if form == "R" and problem.distance > 2.0 * s.radius:
        return f"the target is {problem.distance:.1f} mm away, more than the diameter {2 * s.radius:g} mm of the arc"
    limits = f"insertion angle up to {np.degrees(s.angle_max):.0f} degrees, pieces of at least {s.piece_min:g} mm"
    return f"no path of this form ends at the target with an {limits} and arcs up to {np.degrees(s.turn_max):.0f} degrees"


def finished(problem: PlanarProblem, form: str, shape: Shapes, tried: int) -> PlanarPath:
    """One shape as a path with its own measures, or with the reason why it is none."""
    s = problem.settings
    sides, lengths = shape.sides.reshape(-1), shape.lengths[0]
    pose = planar_pose(problem.entry, float(shape.angles[0]))
    controls = Controls(turns_of(sides), lengths, np.abs(sides) / s.radius)
    arcs = push(pose, controls)
    gaps = problem.scene.least_distance(arcs)
    if len(gaps) and gaps.min() < s.safety - 1e-9:
        worst = int(gaps.argmin())
        return PlanarPath(
            form=form,
            tried=tried,
            reason=f"every path of this form that ends at the target ({tried} tried) comes nearer than {s.safety:g} mm to an "
            f"obstacle; the best comes to {gaps[worst]:.2f} mm from obstacle {worst + 1} ({problem.scene.obstacles[worst].kind})",
        )
    risk = float(danger(gaps, s.safety)) if len(gaps) else 0.0
    risk = risk if np.isfinite(risk) else float(danger(np.maximum(gaps, s.safety), s.safety))
    return PlanarPath(
        form=form,
        sides=tuple(int(side) for side in sides),
        pose=pose,
        controls=controls,
        angle=float(shape.angles[0]),
        clearances=gaps,
        danger=risk,
        score=s.weight_length * controls.length + s.weight_danger * risk + s.weight_degree * len(form),
        tip_error=float(np.linalg.norm(arcs.tips - np.array([0.0, *problem.target]))),
        tried=tried,
    )
