"""Does the instrument touch an obstacle, which one, where, and how far away is it: cylinder envelope with a kd-tree, then exact.

# Strategy: the text walks along the axis of a cylinder and asks the kd-tree for the nearest surface point. Here the length
# of each stride is what that distance allows: the ball around an axis point up to its nearest cell is free of cells, so the
# cylinder needs no look within w of it, w^2 = (d - cover)^2 - r^2. Where the ball is too small, all cells near that place
# are put to the formula of the cylinder (text 2.6). Nothing slips through, and what the envelope refuses has the centre of
# a cell within `cover`; those few are decided by the distance between the cylinder and the cells' rectangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.rigid.instrument import Bodies
from tubeplan_viz.rigid.obstacles import Frame, Obstacles

STRIDE_MM = 0.7  # the least stride along an axis; ahead of a flat end the balls are too small for the cylinder
LOOK_MM = 1.0  # where the field's lower bound allows less than this stride, the kd-tree is asked
TOUCH_MM = 1e-4  # closer than this is touching
SETTLED_MM = 1e-3  # distances are known this well
PIECES_ASKED = 40  # pieces of an axis whose nearest cell is looked up, the most promising first
SURE_STEPS, SURE_STEP_MM = 12, 0.5  # a hit that is no graze shows within a few millimetres
PROJECTIONS = 300
CELLS_ASKED = 32  # whose centres are nearest to a place on the axis: 16 leave distances up to 0.02 mm too large, 32 under 0.001
FIRST_PIECE_MM, LAST_PIECE_MM = 16.0, 1.0  # pieces of an axis between which distances are bounded


@dataclass(frozen=True, eq=False)
class Hits:
    """Verdicts on n bodies.

    Attributes
    ----------
    label : (n,) int array
        Index of the structure that is touched, -1 for a free body.
    place : (n, 3) float array, mm
        A place of that structure in the image frame, the foremost along the body within a stride; not a number for a
        free body.
    """

    label: IntArray
    place: FloatArray

    @property
    def free(self) -> BoolArray:
        """Bodies that touch nothing, (n,)."""
        return np.asarray(self.label < 0)


def to_frame(bodies: Bodies, frame: Frame) -> Bodies:
    """Bodies given in LPS, in the image frame."""
    return Bodies(frame.to_frame(bodies.tail), frame.to_frame(bodies.front), bodies.radius, bodies.round_front)


def collide(obstacles: Obstacles, bodies: Bodies, *, exact: bool = True, pairs: bool = False) -> Hits:
    """Which bodies, in the image frame, touch an obstacle.

    Parameters
    ----------
    obstacles : Obstacles
    bodies : Bodies
    exact : bool
        Decide what the envelope refuses by the distance between the body and the rectangles; without, the envelope's
        verdict stands, which refuses up to `obstacles.cover` too early and never passes what touches.
    pairs : bool
        Of every two bodies, where the first touches something, the second is not looked at any further: its verdict may
        then be -1 whatever it touches.
    """
    n = len(bodies)
    hits = Hits(np.full(n, -1, dtype=np.int64), np.full((n, 3), np.nan))
    if n == 0 or not len(obstacles.cells):
        return hits
    at = _march(obstacles, bodies, np.arange(n), bodies.length, hits, exact=False, pairs=pairs)
    if exact:
        refused = np.flatnonzero(hits.label >= 0)
        doubtful = refused[~_surely_touched(obstacles, bodies, refused, at[refused], hits)]
        hits.label[doubtful] = -1
        _march(obstacles, bodies, doubtful, at[doubtful], hits, exact=True, pairs=False)
    # A body that meets no surface lies wholly outside, or wholly inside one structure.
    rest = np.flatnonzero(hits.label < 0)
    hits.place[rest] = np.nan
    held = obstacles.holds(bodies.front[rest])
    hits.label[rest] = held
    hits.place[rest[held >= 0]] = bodies.front[rest[held >= 0]]
    return hits


def _march(
    obstacles: Obstacles, bodies: Bodies, rows: IntArray, start: FloatArray, hits: Hits, *, exact: bool, pairs: bool
) -> FloatArray:
    """Walk along some axes from `start` mm ahead of their tails backwards, to the first hit or the tail; where each ended."""
    axis, ended = bodies.axis, np.zeros(len(bodies))
    live, at = rows, start.copy()
    while len(live):
        centre = bodies.tail[live] + at[:, None] * axis[live]
        radius = bodies.radius[live]
        stride = _stride(obstacles.field.bounds(centre)[0], radius, obstacles.cover)
        near = np.flatnonzero(stride < LOOK_MM)
        if len(near):
            found, cell = obstacles.tree.query(centre[near])
            stride[near] = _stride(found, radius[near], obstacles.cover)
            touched = bodies.take(live[near]).gap(obstacles.cells[cell]) <= (0.0 if exact else obstacles.cover)
            _note(obstacles, hits, live[near[touched]], cell[touched])
            near = near[(stride[near] < STRIDE_MM) & ~touched]
            _test_cells(obstacles, bodies, live[near], centre[near], hits, exact=exact)
            stride[near] = STRIDE_MM
        ended[live] = at
        at = at - stride
        going = (at > 0.0) & (hits.label[live] < 0)
        if pairs:
            going &= (live % 2 == 0) | (hits.label[live - live % 2] < 0)
        live, at = live[going], at[going]
    return ended


def _surely_touched(obstacles: Obstacles, bodies: Bodies, rows: IntArray, start: FloatArray, hits: Hits) -> BoolArray:
    """Of bodies that the envelope refused: which hold the centre of a cell, looked for from the place of refusal backwards."""
    sure = np.zeros(len(rows), dtype=bool)
    for step in range(SURE_STEPS):
        live = np.flatnonzero(~sure)
        at = start[live] - step * SURE_STEP_MM
        live, at = live[at >= 0.0], at[at >= 0.0]
        some = bodies.take(rows[live])
        _, cell = obstacles.tree.query(some.tail + at[:, None] * some.axis)
        held = some.gap(obstacles.cells[cell]) <= 0.0
        sure[live[held]] = True
        _note(obstacles, hits, rows[live[held]], cell[held])
    return sure


def _stride(distance: FloatArray, radius: FloatArray, cover: float) -> FloatArray:
    """How far along its axis a cylinder is free, both ways, around a place with a known distance to the nearest cell."""
    free = np.maximum(distance - cover, 0.0)
    return np.asarray(np.sqrt(np.maximum(free**2 - radius**2, 0.0)))


def _test_cells(obstacles: Obstacles, bodies: Bodies, rows: IntArray, centres: FloatArray, hits: Hits, *, exact: bool) -> None:
    """Put the cells near places on the axes of some bodies to the test, and note what is touched."""
    reach = np.sqrt(bodies.radius[rows] ** 2 + STRIDE_MM**2) + obstacles.cover
    if not len(rows):
        return
    lists = obstacles.tree.query_ball_point(centres, reach, return_sorted=False)
    counts = np.array([len(found) for found in lists])
    if not counts.sum():
        return
    cells = np.concatenate([np.asarray(found, dtype=np.int64) for found in lists if found])
    owner = np.repeat(rows, counts)
    gap = bodies.take(owner).gap(obstacles.cells[cells])
    close = gap <= obstacles.cover
    cells, owner, gap = cells[close], owner[close], gap[close]
    sure = gap <= 0.0 if exact else np.ones(len(cells), dtype=bool)
    _note(obstacles, hits, owner[sure], cells[sure])
    open_ = (~sure) & (hits.label[owner] < 0)
    cells, owner = cells[open_], owner[open_]
    if len(cells):
        near, _ = rectangle_gap(bodies.take(owner), obstacles.cells[cells], obstacles.half[cells], enough=TOUCH_MM)
        touching = near <= TOUCH_MM
        _note(obstacles, hits, owner[touching], cells[touching])


def _note(obstacles: Obstacles, hits: Hits, owner: IntArray, cells: IntArray) -> None:
    """Write down the first of the cells that each body touches."""
    first, where = np.unique(owner, return_index=True)
    hits.label[first] = obstacles.label[cells[where]]
    hits.place[first] = obstacles.cells[cells[where]]


def rectangle_gap(
    bodies: Bodies, centres: FloatArray, half: FloatArray, *, enough: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Distance of each body to the rectangle of the same row: upper and lower bound, (n,) mm each.

    Points of the two are projected onto each other in turn, which leads to the nearest pair of two convex bodies [1]_; the
    plane across their connection bounds the distance from below.

    Parameters
    ----------
    bodies : Bodies
    centres, half : (n, 3) float array, mm
        Rectangles (or boxes) along the image axes.
    enough : float, optional
        Stop where the distance is proved to be more than this, or found to be no more; otherwise when the bounds are
        `SETTLED_MM` apart. What `PROJECTIONS` rounds do not settle keeps its lower bound as its distance.

    References
    ----------
    .. [1] Cheney, W. and Goldstein, A. A. (1959). Proximity maps for convex sets. Proc. Amer. Math. Soc. 10, 448-450.
    """
    n = len(bodies)
    upper, lower = np.full(n, np.inf), np.zeros(n)
    live, spot = np.arange(n), centres.copy()
    low, high = centres - half, centres + half
    for _ in range(PROJECTIONS):
        some = bodies.take(live)
        mine = some.nearest(spot[live])
        spot[live] = np.clip(mine, low[live], high[live])
        way = spot[live] - mine
        gap = np.linalg.norm(way, axis=1)
        upper[live] = np.minimum(upper[live], gap)
        normal = way / np.maximum(gap, 1e-300)[:, None]
        plane = np.minimum(normal * low[live], normal * high[live]).sum(axis=1) - some.support(normal)
        lower[live] = np.maximum(lower[live], np.where(gap > 1e-12, plane, 0.0))
        settled = upper[live] - lower[live] < SETTLED_MM
        done = settled if enough is None else (upper[live] <= enough) | (lower[live] > enough)
        live = live[~done]
        if not len(live):
            break
    upper[live] = lower[live]
    return upper, lower


@dataclass(frozen=True, eq=False)
class Gaps:
    """Distances of n bodies to every structure.

    Attributes
    ----------
    distance : (n, structures) float array, mm
        To the nearest rectangle found; 0 where it is touched, infinity where a structure has no surface within reach.
    place : (n, structures, 3) float array, mm
        Centre of that rectangle, in the image frame.
    """

    distance: FloatArray
    place: FloatArray


def structure_gaps(
    obstacles: Obstacles, bodies: Bodies, structures: Sequence[int] | None = None, *, cells: int = CELLS_ASKED
) -> Gaps:
    """Distance of bodies, in the image frame, to each structure; for bodies that hold no structure's surface.

    `cells` are looked at around each place on an axis that may be the nearest.

    The axis is halved where a piece could still hold the nearest place: with d the distance of a piece's middle to the
    nearest cell, no point of it is nearer to a surface than d - half its length - cover.
    """
    shape = (len(bodies), len(obstacles.names))
    gaps = Gaps(np.full(shape, np.inf), np.full((*shape, 3), np.nan))
    for k in range(len(obstacles.names)) if structures is None else structures:
        _gap_to(obstacles, bodies, k, gaps, cells)
    return gaps


def _gap_to(obstacles: Obstacles, bodies: Bodies, k: int, gaps: Gaps, asked_cells: int) -> None:
    """Fill one structure's column."""
    tree, rows, field = obstacles.trees[k], obstacles.rows[k], obstacles.fields[k]
    axis, length = bodies.axis, bodies.length
    count = np.maximum(np.ceil(length / FIRST_PIECE_MM).astype(int), 1)
    owner = np.repeat(np.arange(len(bodies)), count)
    piece = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    half = 0.5 * length[owner] / count[owner]
    middle = (2 * piece + 1) * half
    ceiling = np.full(len(bodies), np.inf)  # what the distance cannot be more than
    while True:
        known, most = field.bounds(bodies.tail[owner] + middle[:, None] * axis[owner])
        known -= bodies.radius[owner] + obstacles.cover
        np.minimum.at(ceiling, owner, most - bodies.radius[owner] + obstacles.cover)
        going = known - half < ceiling[owner]
        # A piece that is left alone is no nearer than its bound, and that is not below what was found elsewhere.
        owner, middle, half, known = owner[going], middle[going], half[going], known[going]
        if not len(owner) or half.max() <= 0.5 * LAST_PIECE_MM:
            break
        owner, middle, half = (np.repeat(a, 2) for a in (owner, middle, half))
        half = 0.5 * half
        middle = middle + np.tile([-1.0, 1.0], len(middle) // 2) * half
    best = np.full(len(bodies), np.inf)
    seen_owner, seen_cell, seen_low = [], [], []
    order = np.lexsort((known, owner))
    owner, middle, half, known = (a[order] for a in (owner, middle, half, known))
    rank = np.arange(len(owner)) - np.searchsorted(owner, owner)
    for turn in range(PIECES_ASKED):
        asked = np.flatnonzero((rank == turn) & (known - half < best[owner]))
        if not len(asked):
            continue
        _, cell = tree.query(
            bodies.tail[owner[asked]] + middle[asked, None] * axis[owner[asked]], k=np.arange(1, asked_cells + 1)
        )
        there = cell < len(rows)  # a structure may have fewer cells than are asked for
        of, cell = np.repeat(owner[asked], there.sum(axis=1)), rows[cell[there]]
        low, gap = _cell_bounds(bodies.take(of), obstacles.cells[cell], obstacles.half[cell])
        np.minimum.at(best, of, gap)
        seen_owner.append(of)
        seen_cell.append(cell)
        seen_low.append(low)
    if not seen_owner:
        return
    owners, cells, low = (np.concatenate(part) for part in (seen_owner, seen_cell, seen_low))
    pair = np.unique(np.column_stack([owners, cells])[low <= best[owners]], axis=0)
    if not len(pair):
        return
    upper, _ = rectangle_gap(bodies.take(pair[:, 0]), obstacles.cells[pair[:, 1]], obstacles.half[pair[:, 1]])
    order = np.lexsort((upper, pair[:, 0]))
    first, where = np.unique(pair[order, 0], return_index=True)
    nearest = order[where]
    gaps.distance[first, k] = upper[nearest]
    gaps.place[first, k] = obstacles.cells[pair[nearest, 1]]


def _cell_bounds(bodies: Bodies, cells: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the distance of each body to the cell of the same row cannot be less and not be more than, (n,) mm.

    The distance to a convex body is a convex function of the place, so that it lies above its tangent plane at the cell's
    centre.
    """
    way = cells - bodies.nearest(cells)
    gap = np.linalg.norm(way, axis=1)
    slope = np.abs(way) / np.maximum(gap, 1e-300)[:, None]
    return np.maximum(gap - (slope * half).sum(axis=1), 0.0), gap
