"""A bend too sharp for the room there: an upper bound on the clearance of any path under a curvature limit."""

# Strategy: three facts about a curve of curvature at most k that stays in a ball of radius r < 1 / k.
# (1) It is no longer than (2 / k) asin(k r). From the point m nearest to the ball's centre c, where (m - c) . T >= 0 going
#     on, the tangent turns from T by at most k s, so that (x(s) - c) . T >= sin(k s) / k; this passes r at
#     s = asin(k r) / k, and likewise backwards.
# (2) So it is shorter than pi / k, and by Schur's comparison theorem a piece of it over a chord d is no longer than the arc
#     of curvature k over that chord, (2 / k) asin(k d / 2) (Chern 1967, Curves and surfaces in Euclidean space).
# (3) The chord of a piece of length l is at an angle of at most k l / 2 to the tangent T at its end. For let n be across the
#     chord in the plane of both, away from T, and the angle a: T(s) . n <= cos(a + pi / 2 - k s), whose integral
#     over the piece is negative if a > k l / 2; but it is that of the chord, 0. So the direction changes between
#     the chords p1 p2 and p2 p3 by at most k / 2 times the length from p1 to p3.
# Together: the angle at p2 is at most asin(k |p1 p3| / 2), that is, the circle through any three points of it has a
# radius of at least 1 / k. `gates` finds three cross-sections that a path must meet in this order while it stays in one ball.
# Where no triple of points of them, each at least as far from the wall as is asked, is as straight as that, there is no path:
# triples of cubes are excluded by their balls, or split. Whatever the cubes, a proof holds; only its sharpness depends on them.

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray, IntArray, frozen_array
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.tube.bend_row import row_bound
from tubeplan_viz.tube.cells import CORNERS, Cells, ball_bound, first_cells, measured
from tubeplan_viz.tube.gates import Gate, Passing, meets, passing

# The bound is closed to this share.
CLOSE = 0.003
# Lengths of the stretch looked at, in bend radii, and the distance between those tried.
LENGTHS = (0.6, 0.9, 1.2, 1.6, 2.0)
STEP = 0.1
# Stretches tried for one clearance, those first whose bend leaves most to be wished for.
TRIED = 4
# The centerline is not the best path: a bend that it makes look passable by less than this, rad, is tried.
PROMISING = -0.02
# Triples kept at most; more are not worth the time.
TRIPLES_MAX = 400_000
BLOCK = 2_000_000
# Cubes of this share of the clearance are split no more.
FINEST = 0.002


@dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """A cross-section that every path meets: a disc on a plane across the lumen, or a single point of radius 0, mm."""

    point: FloatArray
    normal: FloatArray
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen_array(self.point, (3,), "point"))
        object.__setattr__(self, "normal", frozen_array(self.normal, (3,), "normal"))


@dataclass(frozen=True, eq=False, kw_only=True)
class BendBound:
    """What the sharpest bend on the way leaves.

    Attributes
    ----------
    bound : float, mm
        No path from start to goal under the curvature limit keeps this clearance. Proved.
    sections : tuple of three or more Section
        That a path meets in order. No points of that clearance, one of each, lie on a curve within the limit.
    """

    bound: float
    sections: tuple[Section, ...]

    @property
    def place(self) -> FloatArray:
        """Middle of the bend on the centerline, (3,) mm."""
        return self.sections[len(self.sections) // 2].point


@dataclass(frozen=True, kw_only=True)
class Window:
    """Three places along a centerline, by their indices, and by how much the bend between them is too sharp, rad."""

    first: int
    middle: int
    last: int
    lack: float


def bend_bound(
    wall: WallDistance,
    centerline: Centerline,
    *,
    curvature: float,
    ceiling: float,
    limit: float,
    known: float = 0.0,
    several: bool = True,
) -> BendBound | None:
    """Bound the clearance of all paths that keep a curvature limit from above by the bends on the way.

    Parameters
    ----------
    wall : WallDistance
    centerline : Centerline
        From the start to the goal.
    curvature : float, 1/mm
        That the path may have.
    ceiling : float, mm
        Bound that is known already.
    limit : float, mm
        Clearance asked for: it is tried itself, between others.
    known : float, mm
        Clearance that some path is known to keep; nothing is tried below it.
    several : bool
        Whether bends in a row are looked at too, where each alone leaves more than the limit; this takes some seconds.

    Returns
    -------
    BendBound or None
        None where no bend is proved to leave less than the ceiling. A bound of 0 says that there is no path inside the lumen.
    """
    way = resampled(centerline, STEP / curvature)
    low = max(known, 0.0)
    best = one_bend(wall, way, curvature=curvature, low=low, ceiling=ceiling, limit=limit)
    least = ceiling if best is None else best.bound
    if not several or least <= limit:
        return best
    row = row_bound(wall, way, curvature=curvature, ceiling=least, limit=limit, known=low)
    if row is None:
        return best
    sections = tuple(Section(point=one.origin, normal=one.normal, radius=one.radius) for one in row[1])
    return BendBound(bound=row[0], sections=sections)


def one_bend(
    wall: WallDistance, way: Centerline, *, curvature: float, low: float, ceiling: float, limit: float
) -> BendBound | None:
    """The bound by three cross-sections of one bend, between `low` and `ceiling` mm."""
    high = ceiling
    if not promising_windows(way, curvature, ceiling):
        return None
    # Cubes that can keep the least that is tried serve all that is tried.
    cells = first_cells(wall, low)
    best = excluding_bend(cells, way, curvature, ceiling)
    if best is None:
        return None
    tried = limit if low < limit < high else 0.5 * (low + high)
    while high - low > CLOSE * ceiling:
        found = excluding_bend(cells, way, curvature, tried)
        if found is None:
            low = tried
        else:
            best, high = found, tried
        tried = 0.5 * (low + high)
    return best


def resampled(centerline: Centerline, spacing: float) -> Centerline:
    """The line with its points at most so far apart, mm."""
    s = centerline.arc_length
    even = np.linspace(0.0, s[-1], max(int(np.ceil(s[-1] / spacing)), 4) + 1)
    points = np.column_stack([np.interp(even, s, centerline.points[:, k]) for k in range(3)])
    return Centerline(points, np.interp(even, s, centerline.radii))


def excluding_bend(cells: Cells, way: Centerline, curvature: float, clearance: float) -> BendBound | None:
    """A bend that no path with this curvature and clearance passes; None when none is proved to be one.

    The cubes are of one size and cover the lumen where the clearance can reach `clearance`.
    """
    for window in promising_windows(way, curvature, clearance):
        bend = passing(cells, way, (window.first, window.middle, window.last), clearance=clearance, curvature=curvature)
        if bend is not None and excluded(cells.wall, bend, curvature, clearance):
            one, two, three = (Section(point=gate.origin, normal=gate.normal, radius=gate.radius) for gate in bend.gates)
            return BendBound(bound=clearance, sections=(one, two, three))
    return None


def promising_windows(way: Centerline, curvature: float, clearance: float) -> list[Window]:
    """The windows worth a try."""
    return [window for window in sharpest_windows(way, curvature, clearance) if window.lack > PROMISING][:TRIED]


def sharpest_windows(way: Centerline, curvature: float, clearance: float) -> list[Window]:
    """Windows in the order of how much too sharp their bend is, as far as the centerline and its radii tell."""
    points, count = way.points, len(way.points)
    room = np.maximum(way.radii - clearance, 0.0)
    room[[0, -1]] = 0.0
    found: list[Window] = []
    sizes = {min(round(length / STEP), count - 1) for length in LENGTHS} | {count - 1}
    for size in sorted(sizes):
        if size < 2:
            continue
        for share in (0.5, 0.4, 0.6):
            first = np.arange(count - size)
            middle, last = first + max(round(share * size), 1), first + size
            one, two = points[middle] - points[first], points[last] - points[middle]
            a, b = np.linalg.norm(one, axis=1), np.linalg.norm(two, axis=1)
            angle = np.arccos(np.clip(np.einsum("ki,ki->k", one, two) / (a * b), -1.0, 1.0))
            slack = (room[first] + room[middle]) / a + (room[middle] + room[last]) / b
            lack = angle - allowed_turn(np.linalg.norm(points[last] - points[first], axis=1), curvature) - slack
            best = int(np.argmax(lack))
            found.append(Window(first=int(first[best]), middle=int(middle[best]), last=int(last[best]), lack=float(lack[best])))
    return sorted(found, key=lambda window: -window.lack)


def allowed_turn(chord: FloatArray, curvature: float) -> FloatArray:
    """Largest angle between two chords in a row whose far ends are so far apart (fact 3), rad."""
    return np.asarray(np.arcsin(np.minimum(0.5 * curvature * chord, 1.0)))


def excluded(wall: WallDistance, bend: Passing, curvature: float, clearance: float) -> bool:
    """Whether no three points of the gates, all of the clearance asked for, lie on a curve that bends no more than allowed."""
    gates = list(bend.gates)
    if np.prod([float(len(gate.center)) for gate in gates]) > BLOCK:
        return False
    triples = np.stack(np.meshgrid(*(np.arange(len(gate.center)) for gate in gates), indexing="ij"), axis=-1).reshape(-1, 3)
    turn_limit = float(np.arcsin(curvature * bend.radius))
    while len(triples):
        triples = np.concatenate([t[possible(gates, t, curvature, turn_limit)] for t in blocks(triples)])
        if not len(triples):
            return True
        if len(triples) > TRIPLES_MAX or witnessed(wall, gates, triples, curvature, turn_limit, clearance):
            return False
        widest = int(np.argmax([gate.width for gate in gates]))
        if gates[widest].width < FINEST * clearance:
            return False
        used, place = np.unique(triples[:, widest], return_inverse=True)
        gates[widest], parent = split_gate(wall, gates[widest], used, clearance)
        order = np.argsort(parent, kind="stable")
        starts = np.searchsorted(parent[order], np.arange(len(used) + 1))
        number = np.diff(starts)[place]
        if not number.sum():
            return True
        triples = np.repeat(triples, number, axis=0)
        offset = np.arange(len(triples)) - np.repeat(np.cumsum(number) - number, number)
        triples[:, widest] = order[np.repeat(starts[place], number) + offset]
    return True


def blocks(triples: IntArray) -> Iterator[IntArray]:
    """The triples in parts that fit into memory; one part at least."""
    for begin in range(0, max(len(triples), 1), BLOCK):
        yield triples[begin : begin + BLOCK]


def possible(gates: list[Gate], triples: IntArray, curvature: float, turn_limit: float) -> IntArray:
    """Which triples of cubes may hold three points of a curve that bends no more than allowed."""
    p1, p2, p3 = (gate.center[triples[:, k]] for k, gate in enumerate(gates))
    r1, r2, r3 = (gate.reach for gate in gates)
    one, two = p2 - p1, p3 - p2
    a, b, d = (np.linalg.norm(v, axis=1) for v in (one, two, p3 - p1))
    turn = np.arccos(np.clip(np.einsum("ki,ki->k", one, two) / np.maximum(a * b, 1e-30), -1.0, 1.0))
    # A direction between two balls differs from that between their centres by at most the angle of the tangent cone.
    spread = sum(np.arcsin(np.minimum(r / np.maximum(v, 1e-30), 1.0)) for r, v in ((r1 + r2, a), (r2 + r3, b)))
    near = (a <= r1 + r2) | (b <= r2 + r3)
    allowed = np.minimum(allowed_turn(d + r1 + r3, curvature), turn_limit)
    return np.asarray(near | (turn - spread <= allowed + 1e-9))


def witnessed(
    wall: WallDistance, gates: list[Gate], triples: IntArray, curvature: float, turn_limit: float, clearance: float
) -> bool:
    """Whether the centres of some triple are as far from the wall and as straight as is asked: no proof is to be had."""
    sharp = [Gate(center=gate.center, width=0.0, origin=gate.origin, normal=gate.normal) for gate in gates]
    straight = triples[possible(sharp, triples, curvature, turn_limit)]
    if not len(straight):
        return False
    clear = [gate.width == 0.0 or wall.clearance(gate.center) >= clearance for gate in gates]
    return bool(
        np.all(
            [np.broadcast_to(c, len(g.center))[straight[:, k]] for k, (c, g) in enumerate(zip(clear, gates, strict=True))], axis=0
        ).any()
    )


def split_gate(wall: WallDistance, gate: Gate, used: IntArray, clearance: float) -> tuple[Gate, IntArray]:
    """Some cubes of a gate in eight, without those off its plane or too near to the wall, and the number of each one's parent."""
    half = 0.5 * gate.width
    center = (gate.center[used][:, None] + half * (CORNERS - 0.5)).reshape(-1, 3)
    parent = np.repeat(np.arange(len(used)), 8)
    on = meets(center, half, gate.origin, gate.normal)
    center, parent = center[on], parent[on]
    reach = np.full(len(center), 0.5 * np.sqrt(3.0) * half)
    distance, kept, foot = measured(wall, center, reach)
    kept &= distance + reach >= clearance
    dull = np.flatnonzero(kept & (distance - reach < clearance))
    if len(dull):
        kept[dull] = ball_bound(wall, center[dull], reach[dull], foot[dull]) >= clearance
    return Gate(center=center[kept], width=half, origin=gate.origin, normal=gate.normal), parent[kept]
