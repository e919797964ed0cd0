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
# (2) Dead ends between two sections need not fit in that ball, if each fits in one of its own: what enters one and comes back
#     is short by the same fact, and so strays from its opening's hull no farther than the height of an arc over its width.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import WallDistance, across
from tubeplan_viz.tube.cells import Cells, ball_bound, measured
from tubeplan_viz.tube.gates import across_at, ball_about, ball_radius, parts, patch

QUARTERS = 0.5 * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
ROUNDING = 1e-9
# Balls tried about two neighbouring sections.
SIZES = 8


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
        alive = np.flatnonzero(cells.alive & (cells.upper >= clearance))
        number = np.full(len(cells.width), -1)
        number[alive] = np.arange(len(alive))
        pairs = number[cells.pairs]
        self._pairs: IntArray = pairs[(pairs >= 0).all(axis=1)]
        self._center, self._width = cells.center(alive), float(cells.width[0]) * cells.unit
        self._ends = [number[cells.holding(point)] for point in way.points[[0, -1]]]
        self._wall, self._way, self._tips = cells.wall, way, (0, len(way.points) - 1)
        self._clearance, self._curvature = clearance, curvature
        self._divides: dict[int, Divide | None] = {}
        self._stations: dict[int, Station] = {}
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
        reach, most = 0.5 * float(np.sqrt(3.0)) * self._width, 1.0 / self._curvature
        between = np.flatnonzero(near.patch | far.patch | (near.beyond & ~far.beyond))
        patches = self._center[near.patch | far.patch]
        middle = ball_about(np.concatenate([patches, self._way.points[place : index + 1]]))[0]
        gap = np.linalg.norm(self._center[between] - middle, axis=1)
        least = float(np.linalg.norm(patches - middle, axis=1).max())
        margin = 0.0 if last else self._height(np.flatnonzero(far.patch))
        for size in np.linspace(least + ROUNDING, max(least, most - reach - margin), SIZES):
            around = self._dead_ends(between, gap <= size)
            radius = size + reach + max([margin, *(self._height(end.opening) for end in around)])
            if radius < most and all(ball_radius(self._center[end.region]) + reach < most for end in around):
                return float(radius)
        return None

    def _dead_ends(self, region: IntArray, core: BoolArray) -> list[DeadEnd]:
        """What a core leaves of a region that only it gives way to, part by part."""
        if core.all():
            return []
        number = np.full(len(self._center), -1)
        number[region] = np.arange(len(region))
        pairs = number[self._pairs]
        pairs = pairs[(pairs >= 0).all(axis=1)]
        part = parts(pairs, core, len(region))
        both = np.concatenate([pairs, pairs[:, ::-1]])
        mouth = both[core[both[:, 0]] & ~core[both[:, 1]]]
        label = part[mouth[:, 1]]
        return [DeadEnd(region=region[part == k], opening=region[np.unique(mouth[label == k])]) for k in np.unique(label)]

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
        both = np.concatenate([self._pairs, self._pairs[:, ::-1]])
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
        divide = self._divide(index)
        if divide is None or index in self._tips:
            return Station(
                origin=origin, normal=normal, axes=axes, place=np.zeros((1, 2)), width=0.0, clear=np.ones(1, dtype=bool)
            )
        cubes = self._center[divide.patch]
        width = 0.5 * self._width
        flat = (cubes - origin) @ axes.T
        low, high = np.floor(flat.min(axis=0) / width).astype(int) - 2, np.ceil(flat.max(axis=0) / width).astype(int) + 2
        grid = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij")
        place = np.stack(grid, axis=-1).reshape(-1, 2) * width
        near = cKDTree(cubes).query(origin + place @ axes)[0] <= 0.5 * np.sqrt(3.0) * self._width + width / np.sqrt(2.0)
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
