"""Cross-sections that a path meets one after another, with a proof that it is short between each and the next."""

# Strategy: a chain of cross-sections g1 ... gn, the last one may be the goal itself. Each is the part of a plane in a patch of
# cubes that keeps apart the cubes behind it, with the start among them, from those beyond, with the goal among them; the
# next lies beyond the one before. Let tn be the first time on gn and t(i) the last time on g(i) before t(i+1); all exist.
# Between t(i) and t(i+1) the path lies beyond g(i). Its pieces beyond g(i+1) begin and end there: excursions.
# (1) Excursions beyond gn do not occur before tn. If those beyond g(i+1) are shorter than half a circle, they keep to the
#     spindles over their chords (Schur), that is, within the height of an arc over the width of g(i+1) of its hull.
#     So whatever begins on g(i) and stays beyond it until it returns there or comes to g(i+1) for good lies in the cubes
#     between both and in that margin about g(i+1). Where all of this fits in a ball of radius r < 1 / k, it is no longer than
#     (2 / k) asin(k r) (`bend`, fact 1), and so shorter than half a circle, and an excursion beyond g(i) is one of these.
#     By induction from the last section to the first this holds for all.
# (2) Dead ends between two sections need not fit in that ball: what enters one by its opening and comes back is short by the
#     same argument, with a ball about the opening and the dead ends beyond it, down to those that fit in a ball as they
#     are; and so it strays from the opening's hull no farther than the height of an arc over its width.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import WallDistance, across
from tubeplan_viz.tube.cells import Cells, ball_bound, both_ways, clear_cells, measured, renumbered
from tubeplan_viz.tube.gates import across_at, ball_about, ball_radius, parts, patch

QUARTERS = 0.5 * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
ROUNDING = 1e-9
# Edge of the squares begun with, in bend radii.
FIRST_WIDTH = 0.03
# Balls tried about two neighbouring sections.
SIZES = 8
# Steps into a dead end, in bend radii, for the middle of a ball that holds its opening.
AHEAD = (0.0, 0.3, 0.45)
# Dead ends that share so much of their cubes are taken for the same where it was not shown to be blind.
ALIKE = 0.9


@dataclass(frozen=True, eq=False, kw_only=True)
class Station:
    """A cross-section of a chain, covered by squares of its plane; a single point has width 0.

    Attributes
    ----------
    origin, normal : (3,) float array, mm
        The plane, its unit normal towards the goal.
    axes : (2, 3) float array
        Unit vectors along the squares' sides.
    place : (n, 2) float array, mm
        Centres of the squares along the axes, from the origin.
    width : float, mm
    clear : (n,) bool array
        Whether the centre itself has the clearance asked for.
    """

    origin: FloatArray
    normal: FloatArray
    axes: FloatArray
    place: FloatArray
    width: float
    clear: BoolArray

    @property
    def center(self) -> FloatArray:
        """Centres of the squares, (n, 3) mm."""
        return np.asarray(self.origin + self.place @ self.axes)

    @property
    def reach(self) -> float:
        """Radius of the circle about each square, mm."""
        return self.width / float(np.sqrt(2.0))

    @property
    def radius(self) -> float:
        """Of a disc about the origin that holds the section, mm."""
        return float(np.linalg.norm(self.place, axis=1).max(initial=0.0)) + self.reach


@dataclass(frozen=True, eq=False, kw_only=True)
class Chain:
    """Cross-sections in order, and for each neighbouring two the radius in mm of a ball that the path stays in between them."""

    stations: tuple[Station, ...]
    radii: tuple[float, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Divide:
    """A patch of cubes across the lumen: which cubes it is made of and which lie beyond it, (n,) bool arrays."""

    patch: BoolArray
    beyond: BoolArray


@dataclass(frozen=True, eq=False, kw_only=True)
class DeadEnd:
    """Cubes that only some others give way to, and those on either side of the opening, by their numbers."""

    region: IntArray
    opening: IntArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Known:
    """A dead end looked at: its cubes, how many, and the ball about its opening, or None where it is not known to be blind."""

    holds: BoolArray
    size: int
    ball: tuple[FloatArray, float] | None


class ChainMaker:
    """Chains of cross-sections at places of one centerline, for one clearance.

    Parameters
    ----------
    cells : Cells
        Of one size, that cover the lumen where the clearance can reach `clearance`.
    way : Centerline
        From start to goal; its last point stands for itself.
    clearance : float, mm
    curvature : float, 1/mm
    """

    def __init__(self, cells: Cells, way: Centerline, *, clearance: float, curvature: float) -> None:
        clear = clear_cells(cells, clearance, way.points[[0, -1]])
        self._center, self._width, self._reach = clear.center, clear.width, clear.reach
        self._pairs, self._ends = clear.pairs, clear.ends
        self._wall, self._way, self._tips = cells.wall, way, (0, len(way.points) - 1)
        self._clearance, self._curvature = clearance, curvature
        self._divides: dict[int, Divide | None] = {}
        self._stations: dict[int, Station] = {}
        self._known: list[Known] = []
        self._radii: dict[tuple[int, int, bool], float | None] = {}

    def width(self, index: int) -> float:
        """Radius of a ball about the cross-section at a point of the centerline, mm; infinite where none parts the lumen."""
        divide = self._divide(index) if min(self._ends) >= 0 else None
        return float("inf") if divide is None else ball_radius(self._center[divide.patch])

    def chain(self, at: Sequence[int]) -> Chain | None:
        """The chain at some points of the centerline in order; None where the cubes there do not make one."""
        if min(self._ends) < 0:
            return None
        radii = []
        for place, index in pairwise(at):
            step = (place, index, index == at[-1])
            if step not in self._radii:
                self._radii[step] = self._confined(*step)
            radius = self._radii[step]
            if radius is None:
                return None
            radii.append(radius)
        return Chain(stations=tuple(self._station(index) for index in at), radii=tuple(radii))

    def _confined(self, place: int, index: int, last: bool) -> float | None:
        """Radius of a ball that holds the path between two sections, mm; None where none of less than a bend radius is found."""
        near, far = self._divide(place), self._divide(index)
        if near is None or far is None or (near.patch & far.beyond).any() or not near.beyond[far.patch].all():
            return None
        reach, most = self._reach, 1.0 / self._curvature
        between = np.flatnonzero(near.patch | far.patch | (near.beyond & ~far.beyond))
        patches = self._center[near.patch | far.patch]
        middle = ball_about(np.concatenate([patches, self._way.points[place : index + 1]]))[0]
        gap = np.linalg.norm(self._center[between] - middle, axis=1)
        least = float(np.linalg.norm(patches - middle, axis=1).max())
        margin = 0.0 if last else self._height(np.flatnonzero(far.patch))
        for size in np.linspace(least + ROUNDING, max(least, most - reach - margin), SIZES):
            around = self._dead_ends(between, gap <= size)
            radius = size + reach + max([margin, *(self._height(end.opening) for end in around)])
            if radius < most:
                return float(radius) if all(self._blind(end) for end in around) else None
        return None

    def _dead_ends(self, region: IntArray, core: BoolArray) -> list[DeadEnd]:
        """What a core leaves of a region that only it gives way to, part by part."""
        if core.all():
            return []
        number = np.full(len(self._center), -1)
        number[region] = np.arange(len(region))
        pairs = renumbered(self._pairs, number)
        part = parts(pairs, core, len(region))
        both = both_ways(pairs)
        mouth = both[core[both[:, 0]] & ~core[both[:, 1]]]
        label = part[mouth[:, 1]]
        return [DeadEnd(region=region[part == k], opening=region[np.unique(mouth[label == k])]) for k in np.unique(label)]

    def _blind(self, end: DeadEnd) -> bool:
        """Whether whatever enters a dead end by its opening and comes back is shorter than half a circle.

        By the argument between two sections: it keeps to a ball about the opening, but for what strays into the dead ends
        beyond that ball, of which the same holds. So it does from anywhere in that ball, and in any part of the dead end.
        """
        reach, most = self._reach, 1.0 / self._curvature
        cubes, opening = self._center[end.region], self._center[end.opening]
        if ball_radius(cubes) + reach < most:
            return True
        for known in self._known:
            inside = known.holds[end.region]
            if known.ball is None:
                # As good as the same dead end: not known to be blind either.
                if inside.mean() > ALIKE and len(end.region) > ALIKE * known.size:
                    return False
            elif inside.all() and (np.linalg.norm(opening - known.ball[0], axis=1) <= known.ball[1]).all():
                return True
        ball, around = self._first_ball(end, most - reach)
        found = ball is not None and all(self._blind(part) for part in around)
        holds = np.zeros(len(self._center), dtype=bool)
        holds[end.region] = True
        self._known.append(Known(holds=holds, size=len(end.region), ball=ball if found else None))
        return found

    def _first_ball(self, end: DeadEnd, most: float) -> tuple[tuple[FloatArray, float] | None, list[DeadEnd]]:
        """A ball about an opening that leaves least of its dead end, by openings narrow enough, and what it leaves."""
        cubes, opening = self._center[end.region], self._center[end.opening]
        middle = ball_about(opening)[0]
        ahead = cubes[np.linalg.norm(cubes - middle, axis=1) < most].mean(axis=0) - middle
        ahead /= max(float(np.linalg.norm(ahead)), 1e-12)
        ball: tuple[FloatArray, float] | None = None
        best: list[DeadEnd] = []
        left = len(end.region)
        for step in AHEAD:
            center = middle + step * most * ahead
            gap, least = np.linalg.norm(cubes - center, axis=1), float(np.linalg.norm(opening - center, axis=1).max())
            for size in np.linspace(most, least, SIZES)[1:] if least < most else ():
                if np.count_nonzero(gap > size) >= left:
                    continue
                around = self._dead_ends(end.region, gap <= size)
                if size + max((self._height(part.opening) for part in around), default=0.0) < most:
                    ball, best, left = (center, float(size)), around, sum(len(part.region) for part in around)
        return ball, best

    def _height(self, cubes: IntArray) -> float:
        """How far a curve that is shorter than half a circle strays from the hull of the cubes that both its ends lie in, mm."""
        share = self._curvature * (ball_radius(self._center[cubes]) + self._width)
        return float("inf") if share >= 1.0 else float(1.0 - np.sqrt(1.0 - share**2)) / self._curvature

    def _divide(self, index: int) -> Divide | None:
        if index not in self._divides:
            self._divides[index] = self._divided(index)
        return self._divides[index]

    def _divided(self, index: int) -> Divide | None:
        """The patch at one point of the centerline, where it parts the cubes as a cross-section has to."""
        count = len(self._center)
        if index in self._tips:
            tip = np.arange(count) == self._ends[self._tips.index(index)]
            return Divide(patch=tip, beyond=~tip if index == 0 else np.zeros(count, dtype=bool))
        origin, normal = self._way.points[index], across_at(self._way, index)
        on = patch(self._center, self._width, self._pairs, origin, normal)
        part = parts(self._pairs, on, count)
        start, goal_part = (int(part[end]) for end in self._ends)
        if min(start, goal_part) < 0 or start == goal_part:
            return None
        both = both_ways(self._pairs)
        rim = np.unique(both[on[both[:, 0]] & ~on[both[:, 1]], 1])
        # Cubes at the patch's rim do not meet its plane: each lies on one side.
        ahead = (self._center[rim] - origin) @ normal > 0.0
        further, behind = np.unique(part[rim[ahead]]), np.unique(part[rim[~ahead]])
        if np.intersect1d(further, behind).size or start not in behind or goal_part not in further:
            return None
        return Divide(patch=on, beyond=np.isin(part, further))

    def _station(self, index: int) -> Station:
        if index not in self._stations:
            self._stations[index] = self._covered(index)
        return self._stations[index]

    def _covered(self, index: int) -> Station:
        """The squares of one section that may hold points of the clearance asked for."""
        origin, normal = self._way.points[index], across_at(self._way, index)
        axes = np.concatenate(across(normal[None]))
        if index in self._tips:
            return Station(
                origin=origin, normal=normal, axes=axes, place=np.zeros((1, 2)), width=0.0, clear=np.ones(1, dtype=bool)
            )
        divide = self._divide(index)
        if divide is None:
            raise ValueError(f"point {index} of the centerline has no cross-section that parts the lumen")
        cubes = self._center[divide.patch]
        width = FIRST_WIDTH / self._curvature
        flat = (cubes - origin) @ axes.T
        low, high = np.floor(flat.min(axis=0) / width).astype(int) - 2, np.ceil(flat.max(axis=0) / width).astype(int) + 2
        grid = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij")
        place = np.stack(grid, axis=-1).reshape(-1, 2) * width
        near = cKDTree(cubes).query(origin + place @ axes)[0] <= self._reach + width / np.sqrt(2.0)
        whole = Station(
            origin=origin, normal=normal, axes=axes, place=place[near], width=width, clear=np.zeros(near.sum(), dtype=bool)
        )
        return cleared(self._wall, whole, self._clearance)[0]


def cleared(wall: WallDistance, station: Station, clearance: float) -> tuple[Station, IntArray]:
    """A section without the squares that hold no point of the clearance asked for, and which are left."""
    center, reach = station.center, np.full(len(station.place), station.reach)
    distance, kept, foot = measured(wall, center, reach)
    clear = kept & (distance >= clearance)
    clear[clear] = wall.inside(center[clear])
    kept &= distance + reach >= clearance
    dull = np.flatnonzero(kept & ~clear & (distance - reach < clearance))
    if len(dull) and clearance > 0.0:
        kept[dull] = ball_bound(wall, center[dull], reach[dull], foot[dull]) >= clearance
    return replace(station, place=station.place[kept], clear=clear[kept]), np.flatnonzero(kept)


def quartered(wall: WallDistance, station: Station, clearance: float) -> tuple[Station, IntArray]:
    """Each square in four, without those too near to the wall, and the number of each one's parent."""
    half = 0.5 * station.width
    place = (station.place[:, None] + half * QUARTERS).reshape(-1, 2)
    whole = replace(station, place=place, width=half, clear=np.zeros(len(place), dtype=bool))
    found, kept = cleared(wall, whole, clearance)
    return found, kept // 4
