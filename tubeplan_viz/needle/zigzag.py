"""Starts for the polish: short paths of a needle that always bends.

# Strategy: write the direction of the tip as a small vector h across the straight way. Every piece moves h along a line at the
# rate kappa, so a path of n pieces is a polyline in the plane of h whose whole length is kappa times the way;
# where the path ends is the mean of h, and how much longer it is than the straight way is half the mean of
# |h|^2. The shortest paths therefore zigzag about the mean that leads to the target. Two means in turn, one
# for each half of the way, lead around something in the middle.
"""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.needle.spatial import SpatialProblem

AZIMUTHS = 8
DETOURS = (0.12, 0.3)  # radian
ROUNDS = 8
STEP = 1e-6


def zigzags(problem: SpatialProblem) -> FloatArray:
    """Unknowns of zigzag paths, (k, d), closed on the target as far as a few Gauss-Newton steps do."""
    frame, s, n = problem.pose.frame, problem.settings, problem.settings.pieces
    across = frame[:, :2].T @ (problem.target - problem.pose.position)
    ahead = float(frame[:, 2] @ (problem.target - problem.pose.position))
    angle = float(np.arctan2(np.linalg.norm(across), ahead))
    mean = angle * across / max(float(np.linalg.norm(across)), 1e-12)
    walk = s.kappa * problem.distance * (1.0 + 0.1 * angle**2)
    circle = np.linspace(0.0, 2.0 * np.pi, AZIMUTHS, endpoint=False)
    ways = np.column_stack([np.cos(circle), np.sin(circle)])
    means, along = [], []
    for aside in [np.zeros(2), *(size * way for size in DETOURS for way in ways)]:
        for way in ways:
            means.append(np.where(np.arange(n)[:, None] < n // 2, mean + aside, mean - aside))
            along.append(way)
    x = unknowns(problem, np.array(means), np.array(along), walk)
    return close_all(problem, np.vstack([x, single_arc(problem, across, ahead)]) if problem.free[0] else x)


def single_arc(problem: SpatialProblem, across: FloatArray, ahead: float) -> FloatArray:
    """Unknowns, (d,), of the one arc to the target, its curvature held by spinning; of the fullest bend where that is less.

    `across` (2,) and `ahead`, mm, are the target in the pose's frame.
    """
    n, s = problem.settings.pieces, problem.settings
    aside = float(np.linalg.norm(across))
    curvature = 2.0 * aside / problem.distance**2
    length = problem.distance if aside == 0.0 else 2.0 * float(np.arctan2(aside, ahead)) / curvature
    low, high = problem.bounds
    x = np.zeros(len(low))
    # The normal of the pose is -y of the frame, as in `unknowns`.
    x[0] = np.mod(np.arctan2(across[1], across[0]) + 1.5 * np.pi, 2.0 * np.pi) - np.pi
    x[n : 2 * n] = length / n
    x[2 * n : 3 * n] = min(curvature, s.kappa)
    return np.clip(x, low, high)


def unknowns(problem: SpatialProblem, means: FloatArray, ways: FloatArray, walk: float) -> FloatArray:
    """Unknowns, (k, d), of paths whose directions zigzag along `ways`, (k, 2), about `means`, (k, n, 2), `walk` radian in all."""
    count, n = means.shape[:2]
    signs = np.where(np.arange(n) % 2 == 0, 1.0, -1.0)[:, None]
    low, high = np.zeros(count), np.full(count, walk)
    moves = means
    for _ in range(20):  # bisection of the zigzags' widths
        width = 0.5 * (low + high)
        corners = means + signs * (width[:, None] * ways)[:, None]
        moves = np.diff(np.concatenate([np.zeros((count, 1, 2)), corners], axis=1), axis=1)
        short = np.linalg.norm(moves, axis=2).sum(axis=1) < walk
        low, high = np.where(short, width, low), np.where(short, high, width)
    # The normal of the pose is -y of the frame: azimuth -90 degrees in the frame's x and y.
    azimuth = np.concatenate([np.full((count, 1), -0.5 * np.pi), np.arctan2(moves[..., 1], moves[..., 0])], axis=1)
    low_x, high_x = problem.bounds
    x = np.zeros((count, len(low_x)))
    x[:, :n] = np.mod(np.diff(azimuth, axis=1) + np.pi, 2.0 * np.pi) - np.pi
    x[:, n : 2 * n] = np.linalg.norm(moves, axis=2) / problem.settings.kappa
    if problem.free[0]:
        x[:, 2 * n : 3 * n] = problem.settings.kappa
    return np.clip(x, low_x, high_x)


def close_all(problem: SpatialProblem, x: FloatArray) -> FloatArray:
    """Gauss-Newton steps of least size for all paths at once; turns may leave their range, which means the same."""
    low, high = problem.bounds
    n, d = problem.settings.pieces, x.shape[1]
    low, high = low.copy(), high.copy()
    low[:n], high[:n] = -np.inf, np.inf
    scale = np.ones(d)
    scale[n : 2 * n] = problem.distance / n  # a radian of turn against a piece of usual length
    steps = STEP * np.eye(d)
    for _ in range(ROUNDS):
        rows = problem.arcs((x[:, None] + np.vstack([np.zeros(d), steps])).reshape(-1, d)).tips.reshape(len(x), d + 1, 3)
        off = rows[:, 0] - problem.target
        slopes = ((rows[:, 1:] - rows[:, :1]) / STEP).transpose(0, 2, 1) * scale  # (k, 3, d)
        normal = slopes @ slopes.transpose(0, 2, 1) + 1e-6 * np.eye(3)
        move = -(slopes.transpose(0, 2, 1) @ np.linalg.solve(normal, off[..., None]))[..., 0] * scale
        x = np.clip(x + move, low, high)
    return x


def best_starts(problem: SpatialProblem, count: int) -> list[FloatArray]:
    """The cheapest zigzags that end on the target, keep their distance and differ."""
    x = zigzags(problem)
    arcs = problem.arcs(x)
    near = np.linalg.norm(arcs.tips - problem.target, axis=-1) < 0.05
    cost = arcs.lengths.sum(axis=-1)
    if len(problem.scene):
        gaps = problem.scene.piece_distances(arcs).min(axis=-2)
        short = np.maximum(problem.settings.safety - gaps, 0.0).sum(axis=-1)
        floor = np.maximum(gaps, max(0.5 * problem.settings.safety, 1e-3))
        # A little too near can be mended by the polish; far too near cannot.
        cost = cost + problem.settings.weight_danger * (problem.settings.safety / floor).sum(axis=-1) + 3.0 * short
    cost = np.where(near, cost, np.inf)
    kept: list[int] = []
    for row in np.argsort(cost, kind="stable"):
        if not np.isfinite(cost[row]) or len(kept) == count:
            break
        if all(np.linalg.norm(arcs.ends[row] - arcs.ends[other], axis=-1).max() > 1.0 for other in kept):
            kept.append(int(row))
    return [x[row] for row in kept]
