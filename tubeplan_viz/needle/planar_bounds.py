"""Cells of free lengths: what no path of a cell can be better than.

# Strategy: a cell is a box of free lengths around a middle path. Over the box, length and clearance differ from the middle by
# their derivatives times the half widths, and by what the derivatives themselves change: every place moves on a circle about
# some earlier place, so the second-order part is at most the angle turned times the way moved. The nearest place of the middle
# path to a body is a place of every path in the cell, so that its distance bounds their clearance from above, with the exact
# distance after a step along and across the normal. Where the last piece meets the target at a right angle to the direction
# from the entry, the last length has no bounded derivative; there only bounds that need none are used and the cell is split.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.needle.planar_bodies import ComplexArray, FlatScene, Nearest
from tubeplan_viz.needle.planar_motion import Posed, along, contacts, last_is_line, motions, posed
from tubeplan_viz.needle.planar_shapes import PlanarProblem, PlanarSettings

SECOND = 1.0  # times angle turned times way moved: the second-order part
LONGEST = 2.0  # times the distance of the target: no longer path is looked for
ROUNDING = 1e-9  # mm and radian by which a middle may break a limit of its form


@dataclass(frozen=True, eq=False)
class Cells:
    """Boxes of free lengths of one form, all of one size.

    Attributes
    ----------
    middles : (k, n - 1) array, mm
    half : (n - 1,) array, mm
        Half widths.
    sides : (k, n) array of 0, 1, -1
    roots : (k,) array of 1, -1
        Which of the two last pieces that reach the target.
    """

    middles: FloatArray
    half: FloatArray
    sides: FloatArray
    roots: FloatArray

    def __len__(self) -> int:
        return len(self.middles)

    def take(self, chosen: IntArray) -> Cells:
        """Some of them."""
        return Cells(self.middles[chosen], self.half, self.sides[chosen], self.roots[chosen])

    def split(self) -> Cells:
        """Each in equal boxes of half its widths."""
        free = len(self.half)
        corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * free, indexing="ij"), axis=-1).reshape(-1, free)
        middles = (self.middles[:, None, :] + corners * self.half).reshape(-1, free)
        return Cells(middles, 0.5 * self.half, *(np.repeat(v, len(corners), axis=0) for v in (self.sides, self.roots)))


@dataclass(frozen=True, eq=False)
class Appraisal:
    """Cells that may hold a path better than a given one; k of them.

    Attributes
    ----------
    cells : Cells
    costs : (k,) array
        Of the middle paths; infinite where one breaks a limit.
    least : (k,) array
        No path of the cell costs less.
    lengths : (k,) array, mm
        Of the middle paths.
    lacking : (k,) array, mm
        By how much a middle path breaks its limits; infinite where there is none.
    blind : (k,) bool array
        Whether the cell is too large for bounds by derivatives, or always will be.
    closest : Cells
        Of all cells asked, the one whose middle reaches the target and comes least near to a body; none if no middle does.
    short : float, mm
        By how much that one breaks the safety distance.
    """

    cells: Cells
    costs: FloatArray
    least: FloatArray
    lengths: FloatArray
    lacking: FloatArray
    blind: BoolArray
    closest: Cells
    short: float


def appraise(problem: PlanarProblem, scene: FlatScene, cells: Cells, below: float) -> Appraisal:
    """The cells that may hold a path that keeps all limits and costs less than `below`."""
    s = problem.settings
    paths = posed(problem, cells.middles, cells.sides, cells.roots)
    alive, spread = closing(problem, paths, cells)
    low = s.weight_length * spread.shortest
    rows = np.flatnonzero(alive & (low < below))
    cells, paths, spread, low = cells.take(rows), paths.take(rows), spread.take(rows), low[rows]
    exists = paths.room >= 0.0
    broken = broken_limits(s, paths)
    closest, short = cells.take(rows[:0]), np.inf
    lengths = paths.lengths.sum(axis=1)
    costs = s.weight_length * lengths
    if len(scene):
        near = contacts(scene, paths)
        gaps = near.gap.reshape(len(low), len(paths.ends) - 1, len(scene))
        nearest, bodies = gaps.argmin(axis=1), np.arange(len(scene))
        least = gaps[np.arange(len(low))[:, None], nearest, bodies]
        lacks = s.safety - least.min(axis=1)
        whole = np.flatnonzero(exists & (broken <= ROUNDING))
        if len(whole):
            closest = cells.take(whole[[lacks[whole].argmin()]])
            short = float(lacks[whole].min())
        broken = np.maximum(broken, lacks)
        costs = costs + s.weight_danger * risk(s, least)
        if s.weight_danger == 0.0:  # only the worst body can exclude a cell
            bodies = least.argmin(axis=1)[:, None]
            nearest = np.take_along_axis(nearest, bodies, axis=1)
        worst = near.columns(nearest * len(scene) + bodies)
        radii = scene.radii[np.broadcast_to(bodies, nearest.shape)]
        highest = highest_clearance(motions(paths, worst, nearest), worst, radii, cells, spread)
        highest = np.where(exists[:, None], highest, np.inf)
        low = low + s.weight_danger * risk(s, highest)
        rows = np.flatnonzero((highest.min(axis=1) >= s.safety) & (low < below))
    else:
        rows = np.arange(len(low))
    costs = np.where(exists & (broken <= ROUNDING), costs, np.inf)
    lacking = np.where(exists, np.maximum(broken, 0.0), np.inf)
    blind = ~np.isfinite(spread.shifted)
    return Appraisal(cells.take(rows), costs[rows], low[rows], lengths[rows], lacking[rows], blind[rows], closest, short)


def risk(settings: PlanarSettings, clearances: FloatArray) -> FloatArray:
    """Danger of clearances, (k, m), without refusing those that are too small: (k,)."""
    held = np.maximum(clearances, max(settings.safety, 1e-6))
    return np.asarray((settings.safety / held).sum(axis=1))


def broken_limits(settings: PlanarSettings, paths: Posed) -> FloatArray:
    """By how much each path breaks the limits of its last piece and of the insertion angle, mm and radian: 0 or less if not."""
    final = paths.lengths[:, -1]
    broken = np.maximum(settings.piece_min - final, np.abs(paths.angle) - settings.angle_max)
    if not last_is_line(paths.curvatures):
        broken = np.maximum(broken, final - settings.turn_max * settings.radius)
    return np.asarray(broken)


@dataclass(frozen=True, eq=False)
class Spread:
    """How far the paths of each of k cells differ from its middle, all (k,).

    Attributes
    ----------
    shortest : array, mm
        No path of the cell is shorter.
    turned : array, radian
        How far any part of a path turns at most.
    shifted : array, mm per mm from the entry
        Second-order part of the turn about the entry.
    """

    shortest: FloatArray
    turned: FloatArray
    shifted: FloatArray

    def take(self, chosen: IntArray) -> Spread:
        """Some of them."""
        return Spread(self.shortest[chosen], self.turned[chosen], self.shifted[chosen])


def closing(problem: PlanarProblem, paths: Posed, cells: Cells) -> tuple[BoolArray, Spread]:
    """Whether a cell may hold a path of its form at all, (k,), and how far its paths differ."""
    s, reach, half = problem.settings, problem.distance, cells.half
    exists = paths.room >= 0.0
    bends = np.abs(paths.curvatures)
    swing = (paths.speeds @ half) * (1.0 + bends[:, :-1] @ half)
    turned = np.maximum(np.abs(paths.turning), np.abs(paths.turning + paths.curvatures[:, :-1])) @ half
    longer = np.abs(paths.lengthening) @ half
    turned_end = turned + bends[:, -1] * longer
    moved = 2.0 * longer + reach * (np.abs(paths.turning) @ half)
    # The derivative of the last length goes with the reciprocal of the cosine at the target: at its least within the cell.
    grazing = np.abs(paths.grazing) - turned_end
    second = np.where(exists & (grazing > 0.0), 0.5 * SECOND * turned_end * moved / np.maximum(grazing, 1e-9), np.inf)
    lowest = (cells.middles - half).sum(axis=1)
    total = paths.lengths.sum(axis=1)
    with np.errstate(invalid="ignore"):
        first = np.where(np.isfinite(second), total - np.abs(1.0 + paths.lengthening) @ half - second, -np.inf)
    straight = lowest + np.abs(reach - np.abs(paths.ends[-2])) - swing
    shortest = np.maximum(np.maximum(lowest + s.piece_min, reach), np.maximum(first, straight))
    final, angle = paths.lengths[:, -1], np.abs(paths.angle)
    alive = (paths.room + swing >= 0.0) & (shortest <= LONGEST * reach)
    alive &= ~exists | (final + longer + second >= s.piece_min)
    alive &= ~exists | (angle - np.abs(paths.turning) @ half - second / reach <= s.angle_max)
    if not last_is_line(paths.curvatures):
        alive &= ~exists | (final - longer - second <= s.turn_max * s.radius)
    return alive, Spread(shortest, turned, second / reach)


def highest_clearance(motion: ComplexArray, near: Nearest, radii: FloatArray, cells: Cells, spread: Spread) -> FloatArray:
    """No path of a cell is farther from the bodies of given places, (k, j) mm; infinite where there is no bound."""
    moved = np.abs(motion) @ cells.half
    with np.errstate(invalid="ignore"):
        second = 0.5 * SECOND * spread.turned[:, None] * moved + np.abs(near.place) * spread.shifted[:, None]
    second = np.where(np.isnan(second), np.inf, second)
    away = np.abs(along(motion, near.normal)) @ cells.half + second
    outside = np.hypot(np.maximum(near.gap + radii + away, 0.0), moved) - radii
    inside = near.gap + moved + second
    # A place within a circle may be bounded either way, one within a polygon only by how far it moves.
    return np.where(near.gap <= 0.0, np.where(radii > 0.0, np.minimum(inside, outside), inside), outside)
