"""One step of the optimal refinement: a second-order-cone programme around the current path."""

# Strategy: the path is a cubic B-spline on fixed knots; unknown are the moves of its inner
# control points. The distance to a wall face is convex in the point, so its tangent plane
# bounds it from below and a clearance kept in the programme is kept in truth. So is a
# curvature: |F' x F''| / |F'|^3 <= |F''| / |F'|^2, where F'' is linear in the unknowns and
# |F'|^2 has a tangent from below, which makes a second-order cone that lies within the true
# limit; at even speed, which the unknowns are free to take, nothing is lost by it. The move
# of each control point is held within a box, a share of the clearance about it.

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import clarabel
import numpy as np
from scipy.sparse import coo_matrix, csc_matrix

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.geometry import across
from tubeplan_viz.tube.basis import Basis
from tubeplan_viz.tube.nearby import WallRows

# The path's speed may not fall under this share of its mean: a near-cusp hides between samples.
SPEED_MIN = 0.4
# Rows for the mean of the clearance next to its least value keep the answer unique.
MEAN_SHARE = 0.02
CONE = 4


@dataclass(frozen=True, kw_only=True)
class Aim:
    """What a step is to reach.

    Attributes
    ----------
    goal : {"least", "mean", "length", "curvature"}
        Raise the least clearance, raise the mean clearance, shorten, or straighten.
    curvature : float, 1/mm
        Limit on the curvature; for "curvature" only the unit it is measured in.
    floor : (m,) float array or 0, mm
        Clearance that each sample is to keep, or to come back to.
    span : (first, last) parameter
        Stretch whose least clearance is raised; elsewhere the floor alone counts.
    straight : float, mm
        Mean clearance that is worth as much as a path that everywhere bends as much as it may, where that mean is the goal.
    """

    goal: str
    curvature: float
    floor: FloatArray | float = 0.0
    span: tuple[float, float] = (0.0, 1.0)
    straight: float = 0.0

    def inside(self, u: FloatArray) -> BoolArray:
        """Which parameters lie in the span."""
        return np.asarray((u >= self.span[0]) & (u <= self.span[1]))

    def on(self, before: FloatArray, after: FloatArray) -> Aim:
        """The same aim with its floor at other samples."""
        return replace(self, floor=np.interp(after, before, np.broadcast_to(self.floor, before.shape)))


@dataclass(frozen=True, eq=False)
class StepProblem:
    """The path at hand and where it is held to its limits.

    Attributes
    ----------
    control : (n, 3) float array, mm
    clearance_u : (m,) float array
    weight : (m,) float array
        Share of the path's length that each clearance sample stands for.
    clearance_basis, curvature_basis : Basis
        At the samples for each limit.
    rows : WallRows
        Of the clearance samples.
    fixed_directions : (start, goal) of bool
        Whether the path keeps its direction there.
    """

    control: FloatArray
    clearance_u: FloatArray
    weight: FloatArray
    clearance_basis: Basis
    curvature_basis: Basis
    rows: WallRows
    fixed_directions: tuple[bool, bool]

    @cached_property
    def _unknowns(self) -> int:
        return 3 * (len(self.control) - 2)

    def solve(self, aim: Aim, trust: float, penalty: float) -> tuple[FloatArray, float] | None:
        """Control points after the best step within the boxes, and the cost it promises.

        Parameters
        ----------
        aim : Aim
        trust : float
            Half the edge of each control point's box, as a share of the least clearance that it moves.
        penalty : float
            Cost of curvature beyond its limit, per unit of its share.

        Returns
        -------
        ((n, 3) array, float) or None
            None when the solver finds no step: the trust region is to be shrunk.
        """
        samples = len(self.rows.clearance)
        unknowns, least, excess = self._unknowns, self._unknowns + samples, self._unknowns + samples + 1
        width = unknowns + samples + 2
        # Blocks of A x + s = b with s in the cones: (rows, columns, values, b).
        linear = [
            self._wall_block(unknowns, trust),
            self._floor_block(aim, unknowns, least),
            self._speed_block(),
            self._box_block(trust),
            (np.array([0]), np.array([excess]), np.array([-1.0]), np.array([0.0])),
        ]
        equal = self._direction_blocks()
        cones_block = self._curvature_block(aim, excess)
        blocks = [*equal, *linear, cones_block]
        counts = [len(block[3]) for block in blocks]
        offsets = np.concatenate([[0], np.cumsum(counts)[:-1]])
        rows = np.concatenate([block[0] + offset for block, offset in zip(blocks, offsets, strict=True)])
        columns = np.concatenate([block[1] for block in blocks])
        values = np.concatenate([block[2] for block in blocks])
        matrix = csc_matrix(coo_matrix((values, (rows, columns)), shape=(sum(counts), width)))
        right = np.concatenate([block[3] for block in blocks])
        zero = sum(len(block[3]) for block in equal)
        cones = [clarabel.ZeroConeT(zero)] if zero else []
        cones += [clarabel.NonnegativeConeT(sum(len(block[3]) for block in linear))]
        cones += [clarabel.SecondOrderConeT(CONE)] * (counts[-1] // CONE)
        quadratic, cost, base = self._cost(aim, width, unknowns, least, excess, penalty)
        solution = clarabel.DefaultSolver(quadratic, cost, matrix, right, cones, solver_settings()).solve()
        if str(solution.status) not in ("Solved", "AlmostSolved"):
            return None
        x = np.asarray(solution.x)
        control = np.array(self.control)
        control[1:-1] += x[:unknowns].reshape(-1, 3)
        return control, float(solution.obj_val) + base

    def _cost(
        self, aim: Aim, width: int, unknowns: int, least: int, excess: int, penalty: float
    ) -> tuple[csc_matrix, FloatArray, float]:
        """Quadratic and linear cost, and what the cost lacks of `optimal.merit`.

        Where the least clearance is not the goal, its column is what the clearances lack of their floors, negative.
        """
        cost = np.zeros(width)
        cost[excess] = penalty
        cost[least] = -penalty
        empty = csc_matrix((width, width))
        if aim.goal == "least":
            cost[least] = -1.0
            cost[unknowns:least] = -MEAN_SHARE * self.weight
            return empty, cost, 0.0
        if aim.goal == "mean":
            cost[unknowns:least] = -self.weight
            # |F''| / |F'|^2 is the curvature at even speed; the speed at hand stands for that of the step.
            second = self.curvature_basis.curve(self.control, 2)
            share = aim.straight * bend_unit(self.curvature_basis, self.control, aim.curvature)
            gradient, hessian = self._energy(2)
            cost[:unknowns] = share * gradient
            return upper_quadratic(hessian, share, width), cost, share * float((second**2).sum(axis=1).mean())
        if aim.goal == "curvature":
            cost[excess] = 1.0
            return empty, cost, 0.0
        # The integral of |F'|^2 over u is least for the shortest path at even speed, and then its square.
        speed = self.curvature_basis.curve(self.control, 1)
        gradient, hessian = self._energy(1)
        length = float(np.sqrt((speed**2).sum(axis=1).mean()))
        cost[:unknowns] = gradient / (2.0 * length)
        return upper_quadratic(hessian, 1.0 / (2.0 * length), width), cost, length

    def _energy(self, order: int) -> tuple[FloatArray, coo_matrix]:
        """Gradient and upper half of the Hessian of the mean square of a derivative of the path in the moves."""
        basis = self.curvature_basis
        k, n = len(basis.first), len(self.control)
        rows = np.repeat(np.arange(k), 4)
        columns = (basis.first[:, None] + np.arange(4)).ravel()
        derivative = coo_matrix((basis.values[order].ravel(), (rows, columns)), shape=(k, n)).tocsr()
        gram = (derivative.T @ derivative)[1:-1] * (2.0 / k)
        gradient = np.asarray(gram @ self.control).ravel()
        inner = coo_matrix(gram[:, 1:-1])
        inner.sum_duplicates()
        axis = np.repeat(np.arange(3), len(inner.data))
        row, column = 3 * np.tile(inner.row, 3) + axis, 3 * np.tile(inner.col, 3) + axis
        upper = row <= column
        return gradient, coo_matrix((np.tile(inner.data, 3)[upper], (row[upper], column[upper])))

    def _moves(self, row: IntArray, basis_row: IntArray, basis: Basis, weights: list[tuple[int, FloatArray]]) -> _Entries:
        """Entries of rows that are linear in the path and its derivatives.

        `weights` holds (order of derivative, (r, 3) gradient with respect to it).
        """
        values = np.zeros((len(row), 4, 3))
        for order, gradient in weights:
            values += basis.values[order][basis_row][:, :, None] * gradient[:, None, :]
        control = basis.first[basis_row][:, None] + np.arange(4)
        free = (control >= 1) & (control <= len(self.control) - 2)
        columns = 3 * (control - 1)[:, :, None] + np.arange(3)
        rows = np.broadcast_to(row[:, None, None], columns.shape)
        keep = np.broadcast_to(free[:, :, None], columns.shape)
        return rows[keep], columns[keep], values[keep]

    def _wall_block(self, unknowns: int, trust: float) -> _Block:
        """s_i <= distance to each tangent plane of the wall: s_i - n . dF_i <= d."""
        sample, normal, distance = self.rows.telling(np.sqrt(3.0) * trust)
        row = np.arange(len(sample))
        r, c, v = self._moves(row, sample, self.clearance_basis, [(0, -normal)])
        return np.concatenate([r, row]), np.concatenate([c, unknowns + sample]), np.concatenate([v, np.ones(len(row))]), distance

    def _floor_block(self, aim: Aim, unknowns: int, least: int) -> _Block:
        """Where the least clearance t is the goal, s_i >= t in its span, and no s_i falls under its floor, or farther under it.
        Elsewhere s_i >= its floor + t with t <= 0: what is under its floor rises.
        """
        clearance = self.rows.clearance
        m = len(clearance)
        every = np.arange(m)
        if aim.goal != "least":
            rows = np.concatenate([every, every, [m]])
            columns = np.concatenate([unknowns + every, np.full(m + 1, least)])
            values = np.concatenate([-np.ones(m), np.ones(m + 1)])
            return rows, columns, values, np.append(-np.broadcast_to(aim.floor, m), 0.0)
        counted = np.flatnonzero(aim.inside(self.clearance_u))
        k = len(counted)
        rows = np.concatenate([every, m + np.arange(k), m + np.arange(k)])
        columns = np.concatenate([unknowns + every, unknowns + counted, np.full(k, least)])
        values = np.concatenate([-np.ones(m + k), np.ones(k)])
        return rows, columns, values, np.concatenate([-np.minimum(aim.floor, clearance), np.zeros(k)])

    def _speed_block(self) -> _Block:
        """T . F' stays above a share of the mean speed: no cusp, no turning back."""
        first = self.curvature_basis.curve(self.control, 1)
        speed = np.linalg.norm(first, axis=1)
        tangent = first / np.maximum(speed, 1e-12)[:, None]
        row = np.arange(len(first))
        r, c, v = self._moves(row, row, self.curvature_basis, [(1, -tangent)])
        # In units of the mean speed, like the other rows of order one.
        mean = float(speed.mean())
        return r, c, v / mean, (speed - np.minimum(SPEED_MIN * mean, 0.9 * speed)) / mean

    def _box_block(self, trust: float) -> _Block:
        """|move| <= trust times the clearance, for every coordinate."""
        clearance = self.rows.clearance
        radius = np.full(len(self.control), np.inf)
        for j in range(4):
            np.minimum.at(radius, self.clearance_basis.first + j, trust * clearance)
        radius = np.where(np.isfinite(radius), radius, trust * clearance.min())
        column = np.arange(self._unknowns)
        bound = np.repeat(radius[1:-1], 3)
        ones = np.ones(self._unknowns)
        return (
            np.arange(2 * self._unknowns),
            np.concatenate([column, column]),
            np.concatenate([ones, -ones]),
            np.concatenate([bound, bound]),
        )

    def _direction_blocks(self) -> list[_Block]:
        """The second and last but one control points move along the path's end tangents alone."""
        blocks: list[_Block] = []
        for fixed, end, inner in ((self.fixed_directions[0], 0, 1), (self.fixed_directions[1], -1, len(self.control) - 2)):
            if not fixed:
                continue
            sides = across((self.control[inner] - self.control[end])[None])
            columns = 3 * (inner - 1) + np.arange(3)
            blocks.append((np.repeat([0, 1], 3), np.tile(columns, 2), np.concatenate([sides[0][0], sides[1][0]]), np.zeros(2)))
        return blocks

    def _curvature_block(self, aim: Aim, excess: int) -> _Block:
        """Cones |F''| <= limit (1 + excess) |F'|^2 with the square's tangent, in units of limit times square."""
        basis = self.curvature_basis
        first = basis.curve(self.control, 1)
        second = basis.curve(self.control, 2)
        speed = np.maximum(np.linalg.norm(first, axis=1), 1e-9)[:, None]
        unit = aim.curvature * speed**2
        k = len(first)
        heads = CONE * np.arange(k)
        right = np.zeros(CONE * k)
        # |F'|^2 >= (T . F')^2 >= |F0'|^2 + 2 F0' . dF'
        scale = 1.0 if aim.goal != "curvature" else self.acceleration_share(aim.curvature)
        right[heads] = 0.0 if aim.goal == "curvature" else 1.0
        r, c, v = self._moves(heads, np.arange(k), basis, [(1, -2.0 * scale * first / speed**2)])
        rows, columns, values = [heads, r], [np.full(k, excess), c], [-np.ones(k), v]
        for axis in range(3):
            gradient = np.zeros((k, 3))
            gradient[:, axis] = -1.0
            r, c, v = self._moves(heads + 1 + axis, np.arange(k), basis, [(2, gradient / unit)])
            rows.append(r)
            columns.append(c)
            values.append(v)
            right[heads + 1 + axis] = second[:, axis] / unit[:, 0]
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(values), right

    def acceleration_share(self, limit: float) -> float:
        """Largest |F''| / |F'|^2 of the samples over `limit`; no less than the curvature's share."""
        first, second = self.curvature_basis.curve(self.control, 1), self.curvature_basis.curve(self.control, 2)
        return float((np.linalg.norm(second, axis=1) / np.einsum("ka,ka->k", first, first)).max() / limit)


def bend_unit(basis: Basis, control: FloatArray, limit: float) -> float:
    """What the mean of |F''|^2 is multiplied with to be that of the squared curvature as a share of its limit."""
    square = float((basis.curve(control, 1) ** 2).sum(axis=1).mean())
    return 1.0 / (square * limit) ** 2


def upper_quadratic(hessian: coo_matrix, share: float, width: int) -> csc_matrix:
    """A share of the upper half of a Hessian in the first unknowns, as wide as all of them."""
    return csc_matrix(coo_matrix((share * hessian.data, (hessian.row, hessian.col)), shape=(width, width)))


_Entries = tuple[IntArray, IntArray, FloatArray]
_Block = tuple[IntArray, IntArray, FloatArray, FloatArray]


def solver_settings() -> clarabel.DefaultSettings:
    """Clarabel, silent, to the precision that a step needs, on one thread so that results repeat."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = 1e-4
    settings.tol_feas = 1e-5
    settings.max_iter = 60
    # A step is measured before it is taken, so that the last digits of each linear solve are not worth a third of the time.
    settings.iterative_refinement_enable = False
    return settings
