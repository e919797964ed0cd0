"""The widest way through a lumen: an upper bound on the clearance of any path, whatever its bends."""

# Strategy: the lumen is cut into cubes with a bound each (`cells`). A path from start to goal runs
# through a chain of cubes that share faces (a path through a mere edge or corner touches all cubes there, and so a chain of
# them), and keeps no more clearance than the least bound of the chain. The widest chain is the way between both
# ends in a maximum spanning tree; its least bound is the answer. Cubes about the narrow places of that chain are
# split, until the bound there is close to the clearance at a cube's centre.

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray, frozen_array
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.tube.cells import Cells, first_cells, split

# The bound is sharpened until it is within this share of the clearance of some way, as far as the cubes tell.
CLOSE = 0.01
ROUNDS = 60
# Share of a cube's ball in which the clearance is taken to fall from that at the centre.
INNER = 0.3
# Cubes within this many times its ball's radius of a cube that is split are split too, if they could take its place.
NEAR = 3.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Bottleneck:
    """The narrowest place on the widest way from start to goal.

    Attributes
    ----------
    bound : float, mm
        No path from start to goal keeps a larger clearance. Proved.
    place : (3,) float array, mm
        Where the widest way is narrowest.
    end : {"start", "goal"} or None
        When the start or goal itself is the narrowest place.
    """

    bound: float
    place: FloatArray
    end: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "place", frozen_array(self.place, (3,), "place"))


def widest_way(
    wall: WallDistance, start: FloatArray, goal: FloatArray, *, limit: float | None = None, known: float = 0.0
) -> Bottleneck:
    """Bound the least clearance of all paths from `start` to `goal` from above.

    Parameters
    ----------
    wall : WallDistance
    start, goal : (3,) float array, mm
        Inside the lumen.
    limit : float, mm, optional
        No way is looked at when an end alone is narrower.
    known : float, mm, optional
        Clearance that some path is known to keep; what is narrower need not be looked at. It makes the search faster
        and changes no bound, save that none is returned below it.

    Returns
    -------
    Bottleneck
    """
    ends = wall.distance(np.array([start, goal]))
    narrow = int(np.argmin(ends))
    best = Bottleneck(bound=float(ends[narrow]), place=(start, goal)[narrow], end=("start", "goal")[narrow])
    if limit is not None and best.bound < limit:
        return best
    known = min(known, best.bound)
    ceiling = best.bound
    cells = first_cells(wall, known)
    node = np.arange(len(cells.width))  # cubes known to be wide enough are joined into one node
    for _ in range(ROUNDS):
        upper = np.minimum(cells.upper, ceiling)
        chain = widest_chain(cells, node, upper, cells.holding(start), cells.holding(goal))
        if chain is None:
            # No chain keeps what is known: up to rounding it is the bound itself.
            return best if best.bound <= known else replace(best, bound=known)
        bound = float(upper[chain].min(initial=ceiling))
        reach = cells.reach
        if bound < best.bound:
            best = Bottleneck(bound=bound, place=cells.center(chain[[int(np.argmin(upper[chain]))]])[0])
        if best.bound - known < CLOSE * best.bound:
            break
        # Cubes of the chain in which it could be narrower than the bound by more than is asked.
        seeds = chain[cells.distance[chain] - INNER * reach[chain] < (1.0 - CLOSE) * bound]
        if not len(seeds):
            break
        wide = cells.alive & (cells.distance - reach >= bound)
        cells, node = joined(cells, node, wide, ceiling)
        chosen = np.union1d(seeds, around(cells, seeds, upper, bound))
        cells = split(cells, chosen, known=known, sharp=0.9 * bound)
        node = np.concatenate([node, np.arange(len(node), len(cells.width))])
    return best


def widest_chain(cells: Cells, node: IntArray, upper: FloatArray, first: int, last: int) -> IntArray | None:
    """Nodes of the chain between two cubes whose least bound is largest, last first; None when nothing joins them."""
    if first < 0 or last < 0:
        return None
    start, goal = int(node[first]), int(node[last])
    if start == goal:
        return np.array([start])
    ends = np.sort(node[cells.pairs], axis=1)
    width = upper[cells.pairs].min(axis=1)
    differ = ends[:, 0] != ends[:, 1]
    key, width = ends[differ] @ np.array([len(node), 1]), width[differ]
    order = np.argsort(key, kind="stable")
    key, width = key[order], width[order]
    fresh = np.flatnonzero(np.concatenate([[True], np.diff(key) != 0])[: len(key)])
    widest = np.maximum.reduceat(width, fresh) if len(fresh) else width
    # The minimum tree takes the least weights; they must be positive.
    weight = float(upper.max()) + 1.0 - widest
    graph = csr_matrix((weight, (key[fresh] // len(node), key[fresh] % len(node))), shape=(len(node), len(node)))
    previous = breadth_first_order(minimum_spanning_tree(graph), start, directed=False)[1]
    chain = [goal]
    while chain[-1] != start:
        if previous[chain[-1]] < 0:
            return None
        chain.append(int(previous[chain[-1]]))
    return np.array(chain)


def joined(cells: Cells, node: IntArray, wide: BoolArray, ceiling: float) -> tuple[Cells, IntArray]:
    """Neighbouring cubes in which no point is narrower than the bound found, made one node."""
    within = wide[cells.pairs].all(axis=1)
    ends = node[cells.pairs[within]]
    graph = csr_matrix((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(len(node), len(node)))
    label = connected_components(graph, directed=False)[1]
    _, first = np.unique(label, return_index=True)
    made = Cells(
        wall=cells.wall,
        origin=cells.origin,
        unit=cells.unit,
        corner=cells.corner,
        width=cells.width,
        distance=cells.distance,
        upper=np.where(wide, ceiling, cells.upper),
        alive=cells.alive,
        pairs=cells.pairs[~within],
    )
    return made, np.asarray(first[label[node]])


def around(cells: Cells, seeds: IntArray, upper: FloatArray, bound: float) -> IntArray:
    """Cubes about the seeds, no smaller than they, that could take their place in the next chain."""
    reach = cells.reach
    rival = np.flatnonzero(cells.alive & (upper >= 0.98 * bound) & (cells.distance - INNER * reach < (1.0 - CLOSE) * bound))
    if not len(rival):
        return np.empty(0, dtype=np.int64)
    gap, which = cKDTree(cells.center(seeds)).query(cells.center(rival))
    near = (gap <= NEAR * reach[seeds][which] + reach[rival]) & (reach[rival] >= 0.9 * reach[seeds][which])
    return np.asarray(rival[near])
