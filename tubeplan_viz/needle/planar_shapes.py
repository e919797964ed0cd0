"""Shapes of planar paths: forms and bend sides, closed on the target exactly, and what they are worth.

# Strategy: in the plane a path is a complex number: with w = z - i y and heading h, a push moves w by e^(ih).
# The shape of a path (its lengths and bend sides) does not depend on the insertion angle, which only turns it.
# So a shape reaches the target exactly if its end is as far from the entry as the target is, and the angle
# follows. Given all lengths but the last, the last one has a closed form (a line or circle met by a circle).

Source of the forms: Zhao et al. (2013), China Mechanical Engineering 24(1), table 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.kinematics import Arcs, bend_from
from tubeplan_viz.needle.obstacles import Scene, danger

FORMS = {
    1: ("L", "R"),
    2: ("LR", "RL", "RR"),
    3: ("LRR", "RLR", "RRL", "LRL", "RRR"),
    4: ("LRLR", "LRRL", "LRRR", "RLRL", "RLRR", "RRLR", "RRRL", "RRRR"),
}


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
