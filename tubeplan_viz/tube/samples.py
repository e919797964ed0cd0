"""The spline that the optimal refinement works on: knots, samples, first fit and what is measured there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded
from scipy.sparse import csr_matrix

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.geometry import SplineCurve, WallDistance, curvature_upper_bound
from tubeplan_viz.plan import NoPathError
from tubeplan_viz.tube.basis import Basis
from tubeplan_viz.tube.nearby import WallRows, rows_of, wall_rows
from tubeplan_viz.tube.passage import OptimalSettings, Passage

CURVATURE_SAMPLES = 4
# Share of the least clearance by which it may be less between the samples than at them, and their longest distance, mm.
DIP, WIDEST = 0.003, 1.0
# What the bend of the path takes from the distance that samples may be apart.
BENT = 0.85
# Gaps between samples are halved when they have come to be this many times as long as they may be.
STRETCHED = 1.3


@dataclass(frozen=True, eq=False)
class State:
    """Control points with what was measured on them."""

    control: FloatArray
    rows: WallRows
    curvature: float
    weight: FloatArray

    @property
    def least(self) -> float:
        """Least sampled clearance, mm."""
        return float(self.rows.clearance.min())

    @property
    def mean(self) -> float:
        """Mean clearance along the path, mm: each sample counts with the length of path about it."""
        return float(self.weight @ self.rows.clearance)


@dataclass(frozen=True, eq=False)
class Grid:
    """Knots and the samples at which a path is held to its limits."""

    knots: FloatArray
    clearance_u: FloatArray
    wall: WallDistance
    clearance_basis: Basis = field(init=False)
    curvature_basis: Basis = field(init=False)

    def __post_init__(self) -> None:
        breaks = np.unique(self.knots)
        share = np.arange(CURVATURE_SAMPLES) / CURVATURE_SAMPLES
        u = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * share).ravel(), 1.0)
        object.__setattr__(self, "clearance_basis", Basis.at(self.knots, self.clearance_u))
        object.__setattr__(self, "curvature_basis", Basis.at(self.knots, u))

    def curve(self, control: FloatArray) -> SplineCurve:
        """The cubic with these control points."""
        return SplineCurve(3, self.knots, control)

    def measure(self, control: FloatArray, limit: float, *, known: State | None = None) -> State:
        """Clearances at the samples, with the faces found for a state near by too, and the proved curvature."""
        basis = self.clearance_basis
        rows = wall_rows(basis.curve(control), basis.curve(control, 1), self.wall, known=None if known is None else known.rows)
        bound = curvature_upper_bound(self.curve(control), limit=limit, tolerance=0.002).bound
        return State(control, rows, bound, self.weight(control))

    def weight(self, control: FloatArray) -> FloatArray:
        """Share of the path's length that each sample stands for, (m,)."""
        gaps = np.diff(self.clearance_u)
        weight = np.linalg.norm(self.clearance_basis.curve(control, 1), axis=1) * (np.append(gaps, 0.0) + np.append(0.0, gaps))
        return np.asarray(weight / weight.sum())

    def warned(self, state: State, refused: State) -> State:
        """A state that knows the faces found where a step from it was refused, too."""
        nearby = state.rows.nearby
        found = np.concatenate([nearby.faces, refused.rows.nearby.faces], axis=1)
        points = self.clearance_basis.curve(state.control)
        return replace(state, rows=rows_of(points, found, nearby, self.wall))

    def inside(self, control: FloatArray) -> bool:
        """Whether all samples but the ends, which may lie on caps, are in the lumen."""
        return bool(self.wall.inside(self.clearance_basis.curve(control)[1:-1]).all())

    def wide_gaps(self, state: State, times: float = 1.0) -> IntArray:
        """The gaps between samples that are more than so many `times` as long as the clearances of a state allow."""
        allowed = widest_gap(state.rows.clearance, state.least)
        gap = np.linalg.norm(np.diff(self.clearance_basis.curve(state.control), axis=0), axis=1)
        return np.flatnonzero(gap > times * np.minimum(allowed[:-1], allowed[1:]))

    def stretched(self, state: State) -> FloatArray:
        """Middles of the gaps between samples that have become too long for the clearances of a state."""
        long = self.wide_gaps(state, STRETCHED)
        return np.asarray(0.5 * (self.clearance_u[long] + self.clearance_u[long + 1]))

    def with_samples(self, u: FloatArray, state: State) -> tuple[Grid, State]:
        """The same with more samples for the clearance, and the state seen at them."""
        u = np.setdiff1d(u, self.clearance_u)
        place = np.searchsorted(self.clearance_u, u)
        grid = Grid(self.knots, np.insert(self.clearance_u, place, u), self.wall)
        basis = Basis.at(self.knots, u)
        added = wall_rows(basis.curve(state.control), basis.curve(state.control, 1), self.wall)
        rows = state.rows.with_samples(added, place)
        return grid, replace(state, rows=rows, weight=grid.weight(state.control))


def evened(grid: Grid, state: State) -> FloatArray:
    """Control points of nearly the same path at even speed, where the programme's curvature is the true one."""
    curve = grid.curve(state.control)
    count = len(state.control)
    u = np.linspace(0.0, 1.0, 4 * count)
    target = curve(curve.parameter(u * curve.length))
    return fit(Basis.at(grid.knots, u), target, state.control[[0, -1]], count, 1e-4)


def first_spline(passage: Passage, settings: OptimalSettings) -> tuple[Grid, FloatArray]:
    """Spline fitted to the line, as smooth as it can be without losing more than half of the line's least clearance."""
    line, wall = passage.line, passage.wall
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    wanted = 0.5 * float(wall.distance(line).min())
    for refinement in (1.0, 2.0, 4.0):
        count = max(int(np.ceil(s[-1] * refinement / settings.control_spacing)), 8) + 3
        knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, count - 2), np.ones(3)])
        u = np.linspace(0.0, 1.0, 4 * count)
        target = np.column_stack([np.interp(u * s[-1], s, line[:, k]) for k in range(3)])
        basis = Basis.at(knots, u)
        for smoothing in (3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 1e-3):
            control = fit(basis, target, line[[0, -1]], count, smoothing)
            control = turn_ends(control, settings)
            grid = Grid(knots, u, wall)
            points = basis.curve(control)
            if wall.inside(points[1:-1]).all() and wall.distance(points).min() >= min(
                wanted, 0.9 * wall.distance(line[[0, -1]]).min()
            ):
                return Grid(knots, sample_parameters(grid.curve(control), wall), wall), control
    raise NoPathError(
        f"no spline with a control point every {settings.control_spacing / 4.0:.2g} mm follows the centerline inside the lumen; "
        "check the segmentation for folds, or give a smaller control_spacing"
    )


def fit(basis: Basis, target: FloatArray, ends: FloatArray, count: int, smoothing: float) -> FloatArray:
    """Least-squares control points through fixed ends, with a cost on their third differences."""
    samples = len(target)
    first = np.concatenate([basis.first, np.arange(count - 3)])
    values = np.concatenate([basis.values[0], np.tile(np.sqrt(smoothing) * np.array([-1.0, 3.0, -3.0, 1.0]), (count - 3, 1))])
    rows = np.repeat(np.arange(samples + count - 3), 4)
    matrix = csr_matrix((values.ravel(), (rows, (first[:, None] + np.arange(4)).ravel())))
    right = matrix.T @ (np.concatenate([target, np.zeros((count - 3, 3))]) - matrix[:, [0, count - 1]] @ ends)
    # Four control points act on a row, so the normal equations have three diagonals above the main one.
    normal = (matrix.T @ matrix)[1:-1, 1:-1]
    bands = np.zeros((4, count - 2))
    for k in range(4):
        bands[3 - k, k:] = normal.diagonal(k)
    return np.concatenate([ends[:1], solveh_banded(bands, right[1:-1]), ends[1:]])


def turn_ends(control: FloatArray, settings: OptimalSettings) -> FloatArray:
    """Second and last but one control point moved onto the directions asked for at the ends."""
    control = np.array(control)
    for direction, end, inner, sign in ((settings.start_direction, 0, 1, 1.0), (settings.goal_direction, -1, -2, -1.0)):
        if direction is not None:
            unit = sign * np.asarray(direction) / np.linalg.norm(direction)
            control[inner] = control[end] + np.linalg.norm(control[inner] - control[end]) * unit
    return control


def sample_parameters(curve: SplineCurve, wall: WallDistance) -> FloatArray:
    """Parameters of a path as far apart as `widest_gap` allows."""
    u = curve.uniform_parameters(0.25)
    clearance = wall.distance(curve(u))
    spacing = widest_gap(clearance, float(clearance.min()))
    s = curve.arc_length(u)
    # As many samples as the integral of their density.
    density = np.concatenate([[0.0], np.cumsum(np.diff(s) / np.minimum(spacing[1:], spacing[:-1]))])
    count = int(np.ceil(density[-1])) + 1
    picked = np.interp(np.linspace(0.0, density[-1], count + 1), density, u)
    picked[0], picked[-1] = 0.0, 1.0
    return np.unique(picked)


def widest_gap(clearance: FloatArray, least: float) -> FloatArray:
    """How far apart in mm samples with these clearances may lie, so that little less than `least` is missed between them.

    A wall point at distance d from a point of a straight path is at most sqrt(d^2 + g^2 / 4) away from the nearer end of
    the gap g about it. So samples with clearance c keep sqrt(c^2 - g^2 / 4) between them: where c is large the least
    clearance cannot be missed, and few samples do.
    """
    kept = (1.0 - DIP) * least
    return np.clip(BENT * 2.0 * np.sqrt(np.maximum(clearance**2 - kept**2, 0.0)), 0.01, WIDEST)


def warm_start(passage: Passage, warm: SplineCurve) -> tuple[Grid, FloatArray]:
    """The grid of an earlier answer."""
    return Grid(warm.knots, sample_parameters(warm, passage.wall), passage.wall), np.array(warm.control_points)


def with_knots(curve: SplineCurve, spacing: float) -> SplineCurve:
    """The same curve with knots added until none of its spans is longer than `spacing` mm."""
    borders = curve.arc_length(np.unique(curve.knots))
    spline = BSpline(curve.knots, curve.control_points, curve.degree)
    for low, high in pairwise(borders):
        for u in curve.parameter(np.linspace(low, high, int(np.ceil((high - low) / spacing)) + 1)[1:-1]):
            spline = spline.insert_knot(u)
    return SplineCurve(curve.degree, spline.t, spline.c)
