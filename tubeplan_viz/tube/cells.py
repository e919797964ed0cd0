"""A lumen cut into cubes, each with a proved upper bound on the clearance of every point in it."""

# Strategy: cubes of one size cover the lumen; some of them are split in eight again and again. A
# cube's bound is that of the ball about it: the distance to the wall at its centre plus the ball's radius,
# since the distance is 1-Lipschitz; or, with several wall points q and weights that add up to one,
# min |x - q| <= sqrt(sum w |x - q|^2), which falls short by a term of second order only
# where the centre lies between the wall points. Cubes that lie outside are left out.

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.geometry import WallDistance

# Units of length per edge of a first cube: an edge can be halved twenty times.
UNITS = 1 << 20
# The first cubes are as many as cover a tube of the lumen's volume and surface.
COUNT = 12_000
CULLING_LEVELS = 3
CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
# Pairs of the eight children of a cube that share a face.
SIBLINGS = np.array([(p, q) for p, q in combinations(range(8), 2) if np.abs(CORNERS[p] - CORNERS[q]).sum() == 1])
PROBES = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass(frozen=True, eq=False, kw_only=True)
class Cells:
    """Cubes and which of them share a face.

    Attributes
    ----------
    wall : WallDistance
    origin : (3,) float array, mm
    unit : float, mm
        Of `corner` and `width`.
    corner : (n, 3) int array
        Least corner of each cube, from the origin.
    width : (n,) int array
    distance, upper : (n,) float array, mm
        At the centre, and the bound for the whole cube.
    alive : (n,) bool array
        Neither split nor left out.
    pairs : (k, 2) int array
        Living cubes that share a face.
    """

    wall: WallDistance
    origin: FloatArray
    unit: float
    corner: IntArray
    width: IntArray
    distance: FloatArray
    upper: FloatArray
    alive: BoolArray
    pairs: IntArray

    @property
    def reach(self) -> FloatArray:
        """Radius of the ball about each cube, mm, (n,)."""
        return np.asarray(0.5 * np.sqrt(3.0) * self.width * self.unit)

    def center(self, index: IntArray) -> FloatArray:
        """Centres of cubes, (k, 3) mm."""
        return np.asarray(self.origin + self.unit * (self.corner[index] + 0.5 * self.width[index][:, None]))

    def holding(self, point: FloatArray) -> int:
        """A living cube that holds a point, or -1."""
        place = (point - self.origin) / self.unit
        held = self.alive & np.all((self.corner <= place) & (place <= self.corner + self.width[:, None]), axis=1)
        return int(np.argmax(held)) if held.any() else -1


@dataclass(frozen=True, eq=False, kw_only=True)
class Clear:
    """Of cubes of one size those where the clearance can reach what is asked for.

    Attributes
    ----------
    center : (n, 3) float array, mm
    width : float, mm
    pairs : (k, 2) int array
        Which of them share a face.
    ends : tuple of int
        Which of them hold the points given; -1 for none.
    """

    center: FloatArray
    width: float
    pairs: IntArray
    ends: tuple[int, ...]

    @property
    def reach(self) -> float:
        """Radius of the ball about each cube, mm."""
        return 0.5 * float(np.sqrt(3.0)) * self.width


def clear_cells(cells: Cells, clearance: float, points: FloatArray) -> Clear:
    """The cubes where the clearance can reach so many mm, and those of them that hold some points, (m, 3) mm."""
    alive = np.flatnonzero(cells.alive & (cells.upper >= clearance))
    held = [cells.holding(point) for point in points]
    number = np.full(len(cells.width), -1)
    number[alive] = np.arange(len(alive))
    return Clear(
        center=cells.center(alive),
        width=float(cells.width[0]) * cells.unit,
        pairs=renumbered(cells.pairs, number),
        ends=tuple(int(number[index]) if index >= 0 else -1 for index in held),
    )


def renumbered(pairs: IntArray, number: IntArray) -> IntArray:
    """Pairs by other numbers, without those of which one has none, -1."""
    found = number[pairs]
    return np.asarray(found[(found >= 0).all(axis=1)])


def both_ways(pairs: IntArray) -> IntArray:
    """Each pair, and each turned round, (2 k, 2)."""
    return np.concatenate([pairs, pairs[:, ::-1]])


def first_cells(wall: WallDistance, known: float, *, count: int = COUNT) -> Cells:
    """Cubes of one size that cover all of the lumen where the clearance can reach `known` mm."""
    surface = wall.surface
    corners = surface.vertices[surface.faces]
    area = 0.5 * float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum())
    roots = np.roots([count, 0.0, -1.5 * area, -1000.0 * surface.volume_ml])
    edge = float(roots[np.isreal(roots)].real.max())
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    # No round share of an edge: faces of the lumen on a round coordinate stay off the cubes' faces.
    origin = low - 0.0137 * edge
    span = np.ceil((high - origin) / (edge * 2**CULLING_LEVELS)).astype(int)
    place = np.stack(np.meshgrid(*(np.arange(n) for n in span), indexing="ij"), axis=-1).reshape(-1, 3)
    for level in range(CULLING_LEVELS, -1, -1):
        size = edge * 2**level
        distance, kept = measured(wall, origin + (place + 0.5) * size, np.full(len(place), 0.5 * np.sqrt(3.0) * size))[:2]
        place, distance = place[kept], distance[kept]
        if level:
            place = (2 * place[:, None] + CORNERS).reshape(-1, 3)
    upper = distance + 0.5 * np.sqrt(3.0) * edge
    alive = upper >= known
    return Cells(
        wall=wall,
        origin=origin,
        unit=edge / UNITS,
        corner=place.astype(np.int64) * UNITS,
        width=np.full(len(place), UNITS, dtype=np.int64),
        distance=distance,
        upper=upper,
        alive=alive,
        pairs=grid_pairs(place, alive),
    )


def measured(wall: WallDistance, centers: FloatArray, reach: FloatArray) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Distance to the wall, whether the ball about the centre meets the lumen, and the nearest wall point."""
    distance, _, foot = wall.nearest(centers)
    clear = np.minimum(distance, wall.cap_distance(centers)) > reach
    kept = np.ones(len(centers), dtype=bool)
    if clear.any():
        kept[clear] = wall.inside(centers[clear])
    return distance, kept, foot


def grid_pairs(place: IntArray, alive: BoolArray) -> IntArray:
    """Pairs of living cubes of one grid that share a face, (k, 2)."""
    stride = np.array([1 << 40, 1 << 20, 1])
    key = place @ stride
    order = np.argsort(key)
    ordered = key[order]
    found = []
    for step in stride:
        at = np.minimum(np.searchsorted(ordered, key + step), len(key) - 1)
        hit = np.flatnonzero(ordered[at] == key + step)
        found.append(np.column_stack([hit, order[at[hit]]]))
    pairs = np.concatenate(found)
    return np.asarray(pairs[alive[pairs].all(axis=1)])


def split(cells: Cells, chosen: IntArray, *, known: float, sharp: float) -> Cells:
    """The same with some cubes split in eight, their bounds above `sharp` mm sharpened by several wall points."""
    first, count = len(cells.width), len(chosen)
    width = np.repeat(cells.width[chosen] // 2, 8)
    corner = np.asarray(cells.corner[chosen][:, None] + CORNERS * (cells.width[chosen] // 2)[:, None, None], dtype=np.int64)
    corner = corner.reshape(-1, 3)
    centers = cells.origin + cells.unit * (corner + 0.5 * width[:, None])
    reach = 0.5 * np.sqrt(3.0) * width * cells.unit
    distance, kept, foot = measured(cells.wall, centers, reach)
    upper = np.minimum(distance + reach, np.repeat(cells.upper[chosen], 8))
    dull = np.flatnonzero(kept & (upper > sharp) & (distance - reach < sharp))
    if len(dull):
        upper[dull] = np.minimum(upper[dull], ball_bound(cells.wall, centers[dull], reach[dull], foot[dull]))
    alive = np.concatenate([cells.alive, kept & (upper >= known)])
    alive[chosen] = False
    child = np.full(len(alive), -1)
    child[chosen] = first + 8 * np.arange(count)
    corner, width = np.concatenate([cells.corner, corner]), np.concatenate([cells.width, width])
    touched = (child[cells.pairs] >= 0).any(axis=1)
    outer = cells.pairs[touched]
    for _ in range(2):
        outer = with_children(outer, child, corner, width, alive)[:, ::-1]
    inner = (first + 8 * np.arange(count)[:, None, None] + SIBLINGS).reshape(-1, 2)
    made = np.concatenate([outer, inner])
    return Cells(
        wall=cells.wall,
        origin=cells.origin,
        unit=cells.unit,
        corner=corner,
        width=width,
        distance=np.concatenate([cells.distance, distance]),
        upper=np.concatenate([cells.upper, upper]),
        alive=alive,
        pairs=np.concatenate([cells.pairs[~touched], made[alive[made].all(axis=1)]]),
    )


def with_children(pairs: IntArray, child: IntArray, corner: IntArray, width: IntArray, alive: BoolArray) -> IntArray:
    """Pairs whose first cube is replaced by those of its living children that share a face with the second."""
    has = child[pairs[:, 0]] >= 0
    one = np.concatenate([pairs[~has, 0], (child[pairs[has, 0]][:, None] + np.arange(8)).ravel()])
    two = np.concatenate([pairs[~has, 1], np.repeat(pairs[has, 1], 8)])
    low = np.maximum(corner[one], corner[two])
    high = np.minimum(corner[one] + width[one][:, None], corner[two] + width[two][:, None])
    overlap = high - low
    shared = np.all(overlap >= 0, axis=1) & (np.count_nonzero(overlap > 0, axis=1) >= 2) & alive[one]
    return np.column_stack([one[shared], two[shared]])


def ball_bound(wall: WallDistance, centers: FloatArray, reach: FloatArray, foot: FloatArray) -> FloatArray:
    """Largest distance to the wall in each ball, bounded from above by pairs of wall points, (k,) mm.

    The wall points are the feet of the centre and of six points of the ball. For two of them and weights
    w and 1 - w, and any x of the ball, min |x - q|^2 is at most the weighted mean of both squares, which is that
    of the centre plus 2 (x - c) . (c - m) + |x - c|^2 with m the weighted mean of the points. The weight
    is that of the point m nearest to the centre.
    """
    probes = (centers[:, None] + reach[:, None, None] * PROBES).reshape(-1, 3)
    points = np.concatenate([foot[:, None], wall.nearest(probes)[2].reshape(-1, len(PROBES), 3)], axis=1) - centers[:, None]
    square = np.einsum("kpi,kpi->kp", points, points)
    bound = np.sqrt(square.min(axis=1)) + reach
    for a, b in combinations(range(points.shape[1]), 2):
        across = points[:, b] - points[:, a]
        length = np.maximum(np.einsum("ki,ki->k", across, across), 1e-30)
        weight = np.clip(-np.einsum("ki,ki->k", points[:, a], across) / length, 0.0, 1.0)
        off = np.linalg.norm(points[:, a] + weight[:, None] * across, axis=1)
        mean = (1.0 - weight) * square[:, a] + weight * square[:, b]
        bound = np.minimum(bound, np.sqrt(mean + 2.0 * reach * off + reach**2))
    return np.asarray(bound)
