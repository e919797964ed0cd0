"""Three cross-sections that every path meets in order while it stays in one ball."""

# Strategy: the first and the last gate are the cubes about two places of the centerline that meet a plane across it, or the
# start or goal itself. Without them the other cubes fall into parts: one with the start, one with the goal, and those
# between. Consider the path from the last time in the part with the start, before the first time in the part with the goal,
# up to that time: it stays in the gates and the parts between, Z. If no other cube of Z meets a gate's plane, if the part
# with the start touches only the first gate, and that from behind its plane, and the part with the goal only the last gate,
# from beyond, and if either gate lies wholly on its side of the other's plane, then the path crosses the last plane
# in the last gate, before that for a last time the first plane in the first gate, and in between any plane that has all of
# the first gate behind and all of the last beyond it, in cubes of Z. All of this is checked; where it does not hold, there is
# no answer.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.tube.cells import Cells, both_ways, clear_cells

# Rounds of the search for a small ball about the cubes; each comes nearer to the smallest by less.
BALL_ROUNDS = 60


@dataclass(frozen=True, eq=False, kw_only=True)
class Gate:
    """Cubes of one size that meet a plane; a single point has width 0.

    Attributes
    ----------
    center : (n, 3) float array, mm
    width : float, mm
    origin, normal : (3,) float array
        The plane, its unit normal towards the goal.
    """

    center: FloatArray
    width: float
    origin: FloatArray
    normal: FloatArray

    @property
    def reach(self) -> float:
        """Radius of the ball about each cube, mm."""
        return 0.5 * float(np.sqrt(3.0)) * self.width

    @property
    def radius(self) -> float:
        """Of a disc about the plane's origin that holds the gate's part of the plane, mm."""
        return float(np.linalg.norm(self.center - self.origin, axis=1).max(initial=0.0)) + self.reach


@dataclass(frozen=True, eq=False, kw_only=True)
class Passing:
    """Three gates in order, and the radius in mm of a ball that the path stays in from the first to the last."""

    gates: tuple[Gate, Gate, Gate]
    radius: float


def meets(center: FloatArray, width: float, origin: FloatArray, normal: FloatArray) -> BoolArray:
    """Which cubes meet a plane, (n,)."""
    return np.asarray(np.abs((center - origin) @ normal) <= 0.5 * width * np.abs(normal).sum() + 1e-9)


def passing(cells: Cells, way: Centerline, at: tuple[int, int, int], *, clearance: float, curvature: float) -> Passing | None:
    """The gates at three points of a centerline.

    Parameters
    ----------
    cells : Cells
        Of one size, that cover the lumen where the clearance can reach `clearance`.
    way : Centerline
        From start to goal; its first and last point stand for themselves.
    at : three indices
    clearance : float, mm
    curvature : float, 1/mm
        The ball has to be smaller than its radius.

    Returns
    -------
    Passing or None
        None where the cubes there do not make such gates.
    """
    clear = clear_cells(cells, clearance, way.points[[0, -1]])
    center, width, pairs, ends = clear.center, clear.width, clear.pairs, clear.ends
    planes = [(way.points[i], across_at(way, i)) for i in at]
    first = None if at[0] == 0 else patch(center, width, pairs, *planes[0])
    last = None if at[2] == len(way.points) - 1 else patch(center, width, pairs, *planes[2])
    nothing = np.zeros(len(center), dtype=bool)
    gate_one, gate_three = (nothing if mask is None else mask for mask in (first, last))
    if (gate_one & gate_three).any():
        return None
    part = parts(pairs, gate_one | gate_three, len(center))
    if min(ends) < 0 or min(part[list(ends)]) < 0:
        return None
    between = zone(
        center, width, pairs, part, (int(part[ends[0]]), int(part[ends[1]])), (first, last), planes, way.points[[0, -1]]
    )
    if between is None:
        return None
    radius = ball_radius(center[between]) + clear.reach
    if curvature * radius >= 1.0:
        return None
    gates = []
    for mask, (origin, normal), end in ((first, planes[0], way.points[0]), (last, planes[2], way.points[-1])):
        points = end[None] if mask is None else center[mask]
        gates.append(Gate(center=points, width=0.0 if mask is None else width, origin=origin, normal=normal))
    origin, normal = planes[1]
    if side(gates[0], origin, normal) != -1 or side(gates[1], origin, normal) != 1:
        return None
    middle = between & meets(center, width, origin, normal)
    return Passing(
        gates=(gates[0], Gate(center=center[middle], width=width, origin=origin, normal=normal), gates[1]), radius=radius
    )


def across_at(way: Centerline, index: int) -> FloatArray:
    """Direction of the line at one of its points, (3,)."""
    low, high = max(index - 1, 0), min(index + 1, len(way.points) - 1)
    chord = way.points[high] - way.points[low]
    return np.asarray(chord / np.linalg.norm(chord))


def patch(center: FloatArray, width: float, pairs: IntArray, origin: FloatArray, normal: FloatArray) -> BoolArray:
    """Cubes on a plane that hang together with the one nearest to its origin, (n,)."""
    on = meets(center, width, origin, normal)
    label = parts(pairs, ~on, len(center))
    gap = np.where(on, np.linalg.norm(center - origin, axis=1), np.inf)
    return np.asarray(on & (label == label[int(np.argmin(gap))]))


def parts(pairs: IntArray, without: BoolArray, count: int) -> IntArray:
    """Number of the part that each cube belongs to when some are left out; -1 for those, (n,)."""
    kept = pairs[~without[pairs].any(axis=1)]
    graph = csr_matrix((np.ones(len(kept), dtype=np.int8), (kept[:, 0], kept[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    return np.asarray(np.where(without, -1, label))


def side(gate: Gate, origin: FloatArray, normal: FloatArray) -> int:
    """-1 when all of a gate's cubes lie behind a plane, 1 when all lie beyond it, else 0."""
    return side_of(gate.center, gate.width, origin, normal)


def side_of(center: FloatArray, width: float, origin: FloatArray, normal: FloatArray) -> int:
    """-1 when all cubes lie behind a plane, 1 when all lie beyond it, else 0."""
    height, half = (center - origin) @ normal, 0.5 * width * np.abs(normal).sum() + 1e-9
    return -1 if np.all(height < -half) else 1 if np.all(height > half) else 0


def zone(
    center: FloatArray,
    width: float,
    pairs: IntArray,
    part: IntArray,
    ends: tuple[int, int],
    masks: tuple[BoolArray | None, BoolArray | None],
    planes: list[tuple[FloatArray, FloatArray]],
    tips: FloatArray,
) -> BoolArray | None:
    """Gates and parts between them, Z of the strategy; None where one of its conditions does not hold."""
    both = both_ways(pairs)
    between = np.zeros(len(center), dtype=bool)
    touched: list[IntArray] = []
    for mask in masks:
        touched.append(np.empty(0, dtype=np.int64) if mask is None else np.unique(part[both[mask[both[:, 0]], 1]]))
        if mask is not None:
            between |= mask
    outer = [end for end, mask in zip(ends, masks, strict=True) if mask is not None]
    inner = [end for end, mask in zip(ends, masks, strict=True) if mask is None]
    if set(outer) & set(inner) or len(set(outer)) < len(outer):
        return None
    labels = (set(np.concatenate(touched).tolist()) | set(inner)) - set(outer) - {-1}
    between |= np.isin(part, list(labels))
    for k, (mask, (origin, normal), sign) in enumerate(zip(masks, (planes[0], planes[2]), (-1, 1), strict=True)):
        if mask is None:
            continue
        # The part at this end touches this gate alone, and from outside; nothing else between meets its plane.
        if ends[k] in touched[1 - k]:
            return None
        rim = both[mask[both[:, 0]] & (part[both[:, 1]] == ends[k]), 1]
        if side_of(center[rim], width, origin, normal) != sign:
            return None
        if meets(center[between & ~mask], width, origin, normal).any():
            return None
        other = masks[1 - k]
        far, size = (tips[1 - k : 2 - k], 0.0) if other is None else (center[other], width)
        if side_of(far, size, origin, normal) != -sign:
            return None
    return between


def ball_radius(points: FloatArray) -> float:
    """Radius of a ball about all points, little larger than the smallest."""
    return ball_about(points)[1]


def ball_about(points: FloatArray) -> tuple[FloatArray, float]:
    """Middle and radius of a ball about all points, little larger than the smallest (Badoiu and Clarkson 2003)."""
    middle = best = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = np.inf
    for k in range(1, BALL_ROUNDS + 1):
        gap = np.linalg.norm(points - middle, axis=1)
        far = int(np.argmax(gap))
        if gap[far] < radius:
            best, radius = middle, float(gap[far])
        middle = middle + (points[far] - middle) / (k + 1.0)
    return best, radius
