"""Search over place and direction: a line through a stretch that is too sharp for the local refinement."""

# Strategy: states are a point and a direction of travel. From each, short arcs lead on: straight, or bent as sharply as is
# allowed towards one of eight sides; their end points and middles must keep the clearance asked for. States that share a small
# cube and a small range of directions are taken for one, the one whose way was widest so far, which keeps the number
# of states bounded (a state lattice, Pivtoraiko, Knepper and Kelly 2009; the continuous states kept in the cells are those of
# hybrid A*, Dolgov et al. 2010). The search goes in layers of equal length from one end of the stretch, and ends
# at the first layer that meets the line beyond it in the line's direction. Coarse as it is, it needs 10 to 20 % more
# curvature than the best path: it is asked at falling curvatures, and the refinement goes on from the least that gets through.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray, frozen_array
from tubeplan_viz.geometry import WallDistance, across

# Lengths as shares of the scale, the bend radius or less: an arc, the edge of a cube, the edge of a voxel of the clearance.
ARC, CELL, VOXEL = 0.075, 0.05, 0.03
SIDES = 8
# Ranges of directions along each edge of the six faces of a cube of directions: 6.4 degrees.
RANGES = 14
DIRECTIONS = 400
# A chain meets the line within this share of the local clearance, at least a cube's edge, and within this angle.
MEET_SHARE, MEET_COSINE = 0.7, 0.95
# Share of the way gone that must be progress along the line, and how many bend radii may be lost at first.
PROGRESS, DETOUR = 0.6, 0.4
# States that a layer is thinned to, by taking ever larger cubes and ranges for one.
BEAM = 2_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Stretch:
    """Where to search: from the first point of a line on, until the line is met beyond some place.

    Attributes
    ----------
    line : (n, 3) float array, mm
        From the end that the search begins at; smooth, evenly spaced.
    free : bool
        Whether the path may leave the first point in any direction, and not only in the line's.
    leave : int
        Index of the point from which on the line may be met.
    """

    line: FloatArray
    free: bool
    leave: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "line", frozen_array(self.line, (None, 3), "line"))


class ClearanceGrid:
    """Clearance about the places asked for, to first order from the middle of each voxel; made where it is needed.

    Parameters
    ----------
    wall : WallDistance
    voxel : float, mm
        Edge. The value is exact in the middle; elsewhere it is off by at most 3/8 of the square of the edge over the least
        radius of the surface of equal clearance there.
    """

    def __init__(self, wall: WallDistance, voxel: float) -> None:
        self._wall, self._voxel = wall, voxel
        self._origin = wall.surface.vertices.min(axis=0) - 4.0 * voxel
        self._keys = np.empty(0, dtype=np.int64)
        self._values = np.empty((0, 4))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Clearance, mm (k,), negative outside the lumen."""
        place = np.floor((points - self._origin) / self._voxel).astype(np.int64)
        key = (place[:, 0] << 40) | (place[:, 1] << 20) | place[:, 2]
        fresh = np.setdiff1d(key, self._keys)
        if len(fresh):
            middle = self._middle(np.column_stack([fresh >> 40, (fresh >> 20) & 0xFFFFF, fresh & 0xFFFFF]))
            distance, _, foot = self._wall.nearest(middle)
            sign = np.where(self._wall.inside(middle), 1.0, -1.0)
            away = (middle - foot) * (sign / np.maximum(distance, 1e-9))[:, None]
            keys = np.concatenate([self._keys, fresh])
            order = np.argsort(keys)
            self._keys = keys[order]
            self._values = np.concatenate([self._values, np.column_stack([sign * distance, away])])[order]
        value = self._values[np.searchsorted(self._keys, key)]
        return np.asarray(value[:, 0] + np.einsum("ki,ki->k", points - self._middle(place), value[:, 1:]))

    def _middle(self, place: IntArray) -> FloatArray:
        return np.asarray(self._origin + (place + 0.5) * self._voxel)


@dataclass(frozen=True, eq=False)
class Layer:
    """States at one distance from the start: places, directions, which state of the layer before, widest so far."""

    points: FloatArray
    directions: FloatArray
    parent: IntArray
    widest: FloatArray


def way_through(stretch: Stretch, grid: ClearanceGrid, *, curvature: float, clearance: float, scale: float) -> FloatArray | None:
    """A chain of arcs from the stretch's first point to the line beyond it.

    Parameters
    ----------
    stretch : Stretch
    grid : ClearanceGrid
    curvature : float, 1/mm
        Of the arcs.
    clearance : float, mm
        That end points and middles of the arcs keep.
    scale : float, mm
        Length that all those of the search are shares of; the bend radius, or less in a narrow lumen.

    Returns
    -------
    (n, 3) float array, mm, or None
        End points of the arcs and then the rest of the line; None where the lattice holds no such chain.
    """
    line = stretch.line
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    tree = cKDTree(line)
    room = np.maximum(MEET_SHARE * grid(line), CELL * scale)
    arc, cell = ARC * scale, CELL * scale
    directions = first_directions(tangent[0], free=stretch.free)
    here = np.repeat(line[:1], len(directions), axis=0)
    layers = [Layer(here, directions, np.full(len(here), -1), np.full(len(here), np.inf))]
    seen = np.empty(0, dtype=np.int64)
    for number in range(1, int(np.ceil((s[-1] / PROGRESS + DETOUR * scale) / arc))):
        points, middles, directions, parent = arcs(layers[-1], curvature, arc)
        kept = np.flatnonzero(grid(points) >= clearance)
        kept = kept[grid(middles[kept]) >= clearance]
        gap, nearest = tree.query(points[kept])
        forward = s[nearest] > PROGRESS * number * arc - DETOUR * scale
        kept, gap, nearest = kept[forward], gap[forward], nearest[forward]
        widest = np.minimum(np.minimum(grid(points[kept]), grid(middles[kept])), layers[-1].widest[parent[kept]])
        key = state_key(points[kept], directions[kept], line[0], cell, RANGES)
        first = widest_of_each(key, widest)
        first = first[~np.isin(key[first], seen, assume_unique=True)]
        if not len(first):
            return None
        coarser = 1.0
        while len(first) > BEAM:
            coarser *= 1.25
            place = state_key(points[kept[first]], directions[kept[first]], line[0], cell * coarser, int(RANGES / coarser))
            first = first[widest_of_each(place, widest[first])]
        seen = np.union1d(seen, key[first])
        kept, gap, nearest, widest = kept[first], gap[first], nearest[first], widest[first]
        layers.append(Layer(points[kept], directions[kept], parent[kept], widest))
        met = np.flatnonzero(
            (nearest >= stretch.leave)
            & (gap <= room[nearest])
            & (np.einsum("ki,ki->k", directions[kept], tangent[nearest]) > MEET_COSINE)
        )
        if len(met):
            best = int(met[np.argmax(widest[met])])
            # Some of the line behind the meeting is left out, more of it the farther off it was met, so that the join is smooth.
            rest = np.searchsorted(s, s[nearest[best]] + max(4.0 * gap[best], 2.0 * arc))
            return np.concatenate([chain(layers, best), line[min(int(rest), len(line) - 1) :]])
    return None


def widest_of_each(key: IntArray, widest: FloatArray) -> IntArray:
    """Of each key the state whose way was widest so far."""
    order = np.lexsort((-widest, key))
    return np.asarray(order[np.unique(key[order], return_index=True)[1]])


def first_directions(tangent: FloatArray, *, free: bool) -> FloatArray:
    """Directions evenly over the half of the sphere about the line's, or in a narrow cone about it, (k, 3)."""
    k = np.arange(DIRECTIONS) + 0.5
    height = 1.0 - 2.0 * k / DIRECTIONS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - height**2)
    spread = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    near = spread @ tangent > (0.0 if free else MEET_COSINE)
    return np.concatenate([tangent[None], spread[near]])


def arcs(layer: Layer, curvature: float, arc: float) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """End points, middles and end directions of the arcs that leave a layer's states, and which state each leaves."""
    points, directions = layer.points, layer.directions
    side, up = across(directions)
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    normal = np.cos(angle)[:, None, None] * side + np.sin(angle)[:, None, None] * up  # (sides, n, 3)

    def along(length: float) -> FloatArray:
        turn = curvature * length
        bent = points + (np.sin(turn) * directions + (1.0 - np.cos(turn)) * normal) / curvature
        return np.concatenate([points + length * directions, bent.reshape(-1, 3)])

    turn = curvature * arc
    turned = (np.cos(turn) * directions + np.sin(turn) * normal).reshape(-1, 3)
    return along(arc), along(0.5 * arc), np.concatenate([directions, turned]), np.tile(np.arange(len(points)), SIDES + 1)


def state_key(points: FloatArray, directions: FloatArray, origin: FloatArray, cell: float, ranges: int) -> IntArray:
    """One number for the cube and the range of directions of each state, (k,)."""
    place = np.floor((points - origin) / cell).astype(np.int64) + (1 << 13)
    axis = np.abs(directions).argmax(axis=1)
    row = np.arange(len(directions))
    main = directions[row, axis]
    # Equal angles, not equal tangents, along the edges of the cube of directions.
    across_face = np.column_stack([directions[row, (axis + 1) % 3], directions[row, (axis + 2) % 3]]) / np.abs(main)[:, None]
    share = np.floor((np.arctan(across_face) / (0.5 * np.pi) + 0.5) * ranges).astype(np.int64).clip(0, ranges - 1)
    key = (place[:, 0] << 28) | (place[:, 1] << 14) | place[:, 2]
    return np.asarray(((key * 6 + 2 * axis + (main > 0)) * ranges + share[:, 0]) * ranges + share[:, 1])


def chain(layers: list[Layer], last: int) -> FloatArray:
    """Places from the first layer to a state of the last one, (k, 3)."""
    places = []
    for layer in reversed(layers):
        places.append(layer.points[last])
        last = int(layer.parent[last])
    return np.array(places[::-1])
