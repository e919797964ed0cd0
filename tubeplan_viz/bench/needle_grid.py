"""The planar planner's optima put to the test: brute force that shares nothing with it but the case.

# Strategy: the planner closes a shape on the target by turning it and by its last piece. Here a path starts with a true insertion
# angle, walks forward in (y, z), and its last two pieces are found by construction with compass and ruler: a tangent to a circle,
# a circle that touches another. So the free numbers are the insertion angle and all lengths but the last two, on a jittered
# grid with every prefix that is too long or too near to an obstacle cut off. The best places that lie apart are then narrowed
# down, each for itself. What is found is walked again in small steps before it counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.needle.bodies import Sphere
from tubeplan_viz.needle.planar_shapes import PlanarProblem, sides_of

ANGLES, LENGTHS = 91, 40  # places of the grid: insertion angles, and lengths of each piece up to the length to beat
ANGLES_ONLY = 4000  # where the insertion angle alone is free
SEEDS = 30  # places that are narrowed down, for each choice of bend sides, of those that are clear and of those that are not
ROUNDS, SHRINK = 22, 0.66  # of the narrowing: 0.66^22 of 3 mm is 0.0003 mm
LACKING = 3.0  # mm that a place of the grid may lack, and what a lacking mm counts in mm of length
WALK = 0.01  # mm between two places of the path that is walked again


@dataclass(frozen=True, eq=False)
class Ground:
    """A problem as plain numbers: target from the entry (y, z), circles (m, 3) of y, z and radius with safety, in mm."""

    target: FloatArray
    circles: FloatArray
    radius: float
    angle_max: float
    piece_min: float
    arc_max: float


@dataclass(frozen=True, eq=False)
class Walk:
    """k tips under way: place y, z (mm), heading (radian from +z towards +y), length so far and least gap so far (mm)."""

    y: FloatArray
    z: FloatArray
    heading: FloatArray
    length: FloatArray
    gap: FloatArray

    def take(self, chosen: IntArray) -> Walk:
        """Some of them."""
        return Walk(self.y[chosen], self.z[chosen], self.heading[chosen], self.length[chosen], self.gap[chosen])


def shortest_path(problem: PlanarProblem, form: str, than: float, rng: np.random.Generator) -> float:
    """Length, mm, of the shortest path of a form that brute force finds below `than`; infinite if it finds none.

    Parameters
    ----------
    problem : PlanarProblem
        With circles as obstacles.
    form : str
        Pieces in order, L and R.
    than : float, mm
        Length to stay below; infinite to look for any path up to twice the distance of the target.
    rng : Generator
        Where the grid's places lie.

    Raises
    ------
    TypeError
        If an obstacle is no circle.
    """
    bodies = problem.scene.obstacles
    if not all(isinstance(body, Sphere) for body in bodies):
        raise TypeError("brute force is written for circles only")
    s = problem.settings
    rows = [[body.center[1], body.center[2], body.radius + s.safety] for body in bodies if isinstance(body, Sphere)]
    circles = np.array(rows).reshape(-1, 3) - [*problem.entry, 0.0]
    ground = Ground(
        np.subtract(problem.target, problem.entry), circles, s.radius, s.angle_max, s.piece_min, s.turn_max * s.radius
    )
    limit = min(than, 2.0 * problem.distance)
    least = np.inf
    for sides in sides_of(form):
        least = min(least, shortest_of_sides(ground, sides, min(limit, least), rng))
    return least


def shortest_of_sides(ground: Ground, sides: tuple[int, ...], limit: float, rng: np.random.Generator) -> float:
    """The same for one choice of bend sides."""
    if len(sides) == 1:
        return alone(ground, sides[0], limit)
    free = len(sides) - 1  # the insertion angle and all lengths but the last two
    turn = 2.0 * ground.angle_max / (ANGLES if free > 1 else ANGLES_ONLY)
    angles = -ground.angle_max + turn * (np.arange(round(2.0 * ground.angle_max / turn), dtype=float) + float(rng.random()))
    step = (limit - ground.piece_min) / LENGTHS
    walks, given = started(angles), angles[:, None]
    for side in sides[:-2]:
        lengths = ground.piece_min + step * (np.arange(LENGTHS, dtype=float) + float(rng.random()))
        rows, places = (v.ravel() for v in np.indices((len(given), LENGTHS)))
        fine = walks.length[rows] + lengths[places] < limit
        rows, places = rows[fine], places[fine]
        made = pushed(ground, walks.take(rows), float(side), lengths[places])
        rest = np.hypot(ground.target[0] - made.y, ground.target[1] - made.z)
        kept = np.flatnonzero((made.length + rest < limit) & (made.gap > -LACKING))
        walks, given = made.take(kept), np.column_stack([given[rows[kept]], lengths[places[kept]]])
    length, gap = ended(ground, walks, sides)
    steps = np.array([turn] + [step] * (free - 1))
    # Of those that keep their distance and of those that may be near such ones, since the second are often shorter.
    able, lacking = np.where(gap >= 0.0, length, np.inf), np.where(gap < 0.0, length - LACKING * gap, np.inf)
    seeds = np.concatenate([apart(given / steps, merits, limit) for merits in (able, lacking)])
    return narrowed(ground, sides, given[seeds], steps, limit)


def apart(places: FloatArray, merits: FloatArray, limit: float) -> IntArray:
    """Rows of the least merits that lie more than two steps of the grid apart."""
    left: IntArray = np.flatnonzero(merits < limit + LACKING)
    left = left[np.argsort(merits[left], kind="stable")][:5000]
    kept: list[int] = []
    while len(left) and len(kept) < SEEDS:
        kept.append(int(left[0]))
        left = left[np.abs(places[left] - places[left[0]]).max(axis=1) > 2.0]
    return np.array(kept, dtype=int)


def narrowed(ground: Ground, sides: tuple[int, ...], places: FloatArray, steps: FloatArray, limit: float) -> float:
    """Length of the shortest path below a limit around places, (k, free), each narrowed down for itself."""
    free = len(steps)
    cell = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * free, indexing="ij"), axis=-1).reshape(-1, free)
    least = np.inf
    for _ in range(ROUNDS if len(places) else 0):
        trial = (places[:, None, :] + steps * cell).reshape(-1, free)
        trial[:, 0] = np.clip(trial[:, 0], -ground.angle_max, ground.angle_max)
        trial[:, 1:] = np.maximum(trial[:, 1:], ground.piece_min)
        walks = started(trial[:, 0])
        for k, side in enumerate(sides[:-2]):
            walks = pushed(ground, walks, float(side), trial[:, k + 1])
        length, gap = ended(ground, walks, sides)
        able = np.flatnonzero((gap >= 0.0) & (length < min(limit, least)))
        for row in able[np.argsort(length[able])]:
            if walked_clear(ground, sides, trial[row], float(length[row])):
                least = float(length[row])
                break
        short = np.minimum(gap, 0.0).reshape(len(places), -1)
        merit = length.reshape(short.shape) - LACKING * short
        # A place that keeps its distance is only left for one that does so too.
        merit += np.where((short < 0.0) & (short == 0.0).any(axis=1, keepdims=True), 1e3, 0.0)
        places = trial.reshape(len(places), -1, free)[np.arange(len(places)), merit.argmin(axis=1)]
        steps = SHRINK * steps
    return least


def started(angles: FloatArray) -> Walk:
    """Tips at the entry."""
    zero = np.zeros(len(angles))
    return Walk(zero, zero, np.asarray(angles), zero, np.full(len(angles), np.inf))


def pushed(ground: Ground, walk: Walk, side: float, length: FloatArray) -> Walk:
    """Tips after one more piece: 0 a line, 1 and -1 an arc towards a growing and a falling heading."""
    dy, dz = np.sin(walk.heading), np.cos(walk.heading)
    circles = ground.circles
    if side == 0.0:
        y, z, heading = walk.y + length * dy, walk.z + length * dz, walk.heading
        off_y, off_z = circles[:, 0] - walk.y[:, None], circles[:, 1] - walk.z[:, None]
        along = np.minimum(np.maximum(off_y * dy[:, None] + off_z * dz[:, None], 0.0), length[:, None])
        gaps = np.hypot(off_y - along * dy[:, None], off_z - along * dz[:, None]) - circles[:, 2]
    else:
        r = ground.radius
        heading = walk.heading + side * length / r
        center_y, center_z = walk.y + side * r * dz, walk.z - side * r * dy
        y, z = center_y - side * r * np.cos(heading), center_z + side * r * np.sin(heading)
        off_y, off_z = circles[:, 0] - center_y[:, None], circles[:, 1] - center_z[:, None]
        # The heading that the tip would have where it passes nearest, and how far it has to turn until then.
        passing = np.arctan2(side * off_z, -side * off_y)
        turned = np.mod(side * (passing - walk.heading[:, None]), 2.0 * np.pi)
        beside = np.abs(np.hypot(off_y, off_z) - r)
        ends = np.minimum(
            np.hypot(circles[:, 0] - walk.y[:, None], circles[:, 1] - walk.z[:, None]),
            np.hypot(circles[:, 0] - y[:, None], circles[:, 1] - z[:, None]),
        )
        gaps = np.where(turned * r <= length[:, None], beside, ends) - circles[:, 2]
    return Walk(y, z, heading, walk.length + length, np.minimum(walk.gap, gaps.min(axis=1, initial=np.inf)))


def ended(ground: Ground, walk: Walk, sides: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Length and least gap, mm, of tips whose last two pieces lead to the target by the better of both ways; inf if none does."""
    best_length, best_gap = np.full(len(walk.y), np.inf), np.full(len(walk.y), -np.inf)
    for first, second in endings(ground, walk, sides):
        limits = [(ground.piece_min, ground.arc_max if side else np.inf) for side in sides[-2:]]
        fine = np.isfinite(first) & np.isfinite(second)
        for length, (low, high) in zip((first, second), limits, strict=True):
            fine &= (length >= low) & (length <= high)
        rows = np.flatnonzero(fine)
        whole = walk.take(rows)
        for side, length in zip(sides[-2:], (first, second), strict=True):
            whole = pushed(ground, whole, float(side), length[rows])
        better = (whole.length - LACKING * np.minimum(whole.gap, 0.0)) < (
            best_length[rows] - LACKING * np.minimum(best_gap[rows], 0.0)
        )
        best_length[rows[better]], best_gap[rows[better]] = whole.length[better], whole.gap[better]
    return best_length, best_gap


def endings(ground: Ground, walk: Walk, sides: tuple[int, ...]) -> list[tuple[FloatArray, FloatArray]]:
    """Lengths, mm, of the last two pieces that lead to the target: two ways; not finite where there is none."""
    r, one, two = ground.radius, float(sides[-2]), float(sides[-1])
    dy, dz = np.sin(walk.heading), np.cos(walk.heading)
    to_y, to_z = ground.target[0] - walk.y, ground.target[1] - walk.z
    ways = []
    with np.errstate(invalid="ignore", divide="ignore"):
        if one == 0.0:  # the second circle moves along the line until it meets the target
            off_y, off_z = to_y - two * r * dz, to_z + two * r * dy
            along, across = off_y * dy + off_z * dz, off_y * dz - off_z * dy
            half = np.sqrt(r**2 - across**2)
            for line in (along - half, along + half):
                heading = np.arctan2(two * (off_z - line * dz), -two * (off_y - line * dy))
                ways.append((line, r * np.mod(two * (heading - walk.heading), 2.0 * np.pi)))
            return ways
        off_y, off_z = to_y - one * r * dz, to_z + one * r * dy  # from the first circle's centre to the target
        far, toward = np.hypot(off_y, off_z), np.arctan2(off_y, off_z)
        if two == 0.0:  # the tangent from the target to the first circle
            line = np.sqrt(far**2 - r**2)
            heading = toward + one * np.arctan2(r, line)
            return [(r * np.mod(one * (heading - walk.heading), 2.0 * np.pi), line)]
        # The second centre is 2 r from the first and r from the target.
        opening = np.arccos((far**2 + 3.0 * r**2) / (4.0 * r * far))
        for sign in (1.0, -1.0):
            at = toward + sign * opening
            middle = at + one * 0.5 * np.pi  # heading where the circles touch
            last_y, last_z = off_y - 2.0 * r * np.sin(at), off_z - 2.0 * r * np.cos(at)
            heading = np.arctan2(two * last_z, -two * last_y)
            first = r * np.mod(one * (middle - walk.heading), 2.0 * np.pi)
            ways.append((first, r * np.mod(two * (heading - middle), 2.0 * np.pi)))
    return ways


def alone(ground: Ground, side: int, limit: float) -> float:
    """Length of the one line or arc to the target, if it is clear and below a limit."""
    far, bearing = float(np.hypot(*ground.target)), float(np.arctan2(*ground.target))
    if side == 0:
        length, angle = far, bearing
    elif far > 2.0 * ground.radius:
        return np.inf
    else:
        half = float(np.arcsin(0.5 * far / ground.radius))
        length, angle = 2.0 * ground.radius * half, bearing - side * half
    fine = length < limit and length <= (ground.arc_max if side else np.inf) and abs(angle) <= ground.angle_max
    gap = float(pushed(ground, started(np.array([angle])), float(side), np.array([length])).gap[0]) if fine else -np.inf
    return length if gap >= 0.0 else np.inf


def walked_clear(ground: Ground, sides: tuple[int, ...], place: FloatArray, length: float) -> bool:
    """Whether a path, walked in small steps, keeps its distance, ends at the target and is as long as said."""
    start = started(place[:1])
    for k, side in enumerate(sides[:-2]):
        start = pushed(ground, start, float(side), place[k + 1 : k + 2])
    for ends in endings(ground, start, sides):
        lengths = [*place[1:], float(ends[0][0]), float(ends[1][0])]
        if np.isfinite(lengths).all() and abs(sum(lengths) - length) < 1e-9:
            y, z, heading, nearest = 0.0, 0.0, float(place[0]), np.inf
            for side, part in zip(sides, lengths, strict=True):
                count = int(np.ceil(part / WALK))
                # Between two headings of an arc the chord is exact if it is shortened: 2 r sin of half the turn.
                turn = side * part / count / ground.radius
                chord = part / count if side == 0 else 2.0 * ground.radius * np.sin(0.5 * abs(turn))
                headings = heading + turn * (np.arange(count) + 0.5)
                ys, zs = y + np.cumsum(chord * np.sin(headings)), z + np.cumsum(chord * np.cos(headings))
                gaps = np.hypot(ys[:, None] - ground.circles[:, 0], zs[:, None] - ground.circles[:, 1]) - ground.circles[:, 2]
                nearest = min(nearest, float(gaps.min(initial=np.inf)))
                y, z, heading = float(ys[-1]), float(zs[-1]), heading + side * part / ground.radius
            if nearest >= -1e-9 and np.hypot(y - ground.target[0], z - ground.target[1]) < 1e-6:
                return True
    return False
