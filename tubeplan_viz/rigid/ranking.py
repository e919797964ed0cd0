"""Goals of every feasible path, normalised, and the choices made by them: weights, one main goal, Pareto set (text 4)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import CaseError

GOALS = ("brain", "orbit", "septum", "turbinate", "length", "tissue")
LARGER_IS_BETTER = ("brain", "orbit", "septum", "turbinate")
BEST = {
    "overall": "overall best",
    "brain": "farthest from the brain",
    "length": "shortest",
    "tissue": "least tissue",
}


@dataclass(frozen=True, kw_only=True)
class Weights:
    """How much each goal counts.

    The text gives an order and no numbers: brain most; orbit and tissue next; septum, turbinate and length least. The
    defaults keep that order and add up to 1.
    """

    brain: float = 0.35
    orbit: float = 0.20
    septum: float = 0.083
    turbinate: float = 0.083
    length: float = 0.084
    tissue: float = 0.20

    def __post_init__(self) -> None:
        values = [getattr(self, f.name) for f in fields(self)]
        if not np.isfinite(values).all() or min(values) < 0.0 or sum(values) <= 0.0:
            raise CaseError(f"the weights are {values}, expected finite numbers, none below 0 and one above")

    @property
    def row(self) -> FloatArray:
        """In the order of `GOALS`, adding up to 1."""
        values = np.array([getattr(self, name) for name in GOALS])
        return np.asarray(values / values.sum())


@dataclass(frozen=True, eq=False)
class Ranking:
    """What the goals say of n paths.

    Attributes
    ----------
    normalised : (n, 6) float array
        Columns as in `GOALS`; 0 is the best of all paths, 1 the worst.
    score : (n,) float array
        Weighted sum F; smaller is better.
    pareto : (n,) bool array
        Paths that no other beats in one goal without losing in another.
    best : mapping of a key of `BEST` to an index
    """

    normalised: FloatArray
    score: FloatArray
    pareto: BoolArray
    best: dict[str, int]

    def __post_init__(self) -> None:
        count = len(self.score)
        if set(self.best) != set(BEST) or not all(0 <= index < count for index in self.best.values()):
            raise ValueError(f"the best paths are {self.best}, expected one of the {count} paths for each of {', '.join(BEST)}")


def normalise(goals: FloatArray) -> FloatArray:
    """Goals of n paths on [0, 1], smaller is better; where all paths are equal, or nothing is near, 0.

    Parameters
    ----------
    goals : (n, 6) float array
        Columns as in `GOALS`: distances in mm, length in mm, voxels of tissue. A distance may be infinite where the
        structure is absent or out of reach; it counts as the largest finite one.

    Examples
    --------
    >>> rows = np.array([[4.0, 1, 1, 1, 80, 10], [6.0, 1, 1, 1, 100, 30], [5.0, 1, 1, 1, 90, 30]])
    >>> normalise(rows)[:, [0, 1, 4, 5]].tolist()
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0], [0.5, 0.0, 0.5, 1.0]]
    """
    made = np.zeros_like(goals, dtype=float)
    for k, name in enumerate(GOALS):
        column = goals[:, k]
        finite = np.isfinite(column)
        if not finite.any():
            continue
        low, high = column[finite].min(), column[finite].max()
        if high > low:
            share = (np.where(finite, column, high) - low) / (high - low)
            made[:, k] = 1.0 - share if name in LARGER_IS_BETTER else share
    return made


def rank(goals: FloatArray, weights: Weights) -> Ranking:
    """Rank paths by their goals; parameters as `normalise`.

    The best for one goal is found as in the main-goal method with the others bounded by their worst values, which bounds
    nothing: `epsilon_best` takes other bounds. Ties are settled by the weighted sum of the rest.
    """
    normal = normalise(goals)
    score = normal @ weights.row
    best = {"overall": int(np.argmin(score))}
    for name in ("brain", "length", "tissue"):
        best[name] = epsilon_best(normal, weights, main=name)
    return Ranking(normal, score, pareto_set(normal), best)


def epsilon_best(normal: FloatArray, weights: Weights, *, main: str, bounds: FloatArray | None = None) -> int:
    """The path that is best in one goal while all others keep their bounds (main-goal, or epsilon-constraint, method).

    Parameters
    ----------
    normal : (n, 6) float array
        From `normalise`.
    main : str
        One of `GOALS`.
    bounds : (6,) float array, optional
        Largest normalised value of each goal; by default 1, their upper ends.

    Raises
    ------
    CaseError
        If no path keeps the bounds.
    """
    column = GOALS.index(main)
    keeps: BoolArray = np.ones(len(normal), dtype=bool)
    if bounds is not None:
        others = [k for k in range(len(GOALS)) if k != column]
        keeps = np.asarray((normal[:, others] <= bounds[others]).all(axis=1))
    if not keeps.any():
        raise CaseError(f"no path keeps the bounds set beside the goal {main}; raise them")
    rest = weights.row.copy()
    rest[column] = 0.0
    rows = np.flatnonzero(keeps)
    order = np.lexsort((normal[rows] @ rest, normal[rows, column]))
    return int(rows[order[0]])


def pareto_set(normal: FloatArray) -> BoolArray:
    """Rows that no other row beats: no worse in every column and better in one, (n,).

    Examples
    --------
    >>> pareto_set(np.array([[0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])).tolist()
    [True, True, False, True]
    """
    kept: IntArray = np.arange(len(normal))
    good = np.ones(len(normal), dtype=bool)
    for i in kept:
        if good[i]:
            beaten = (normal >= normal[i]).all(axis=1) & (normal > normal[i]).any(axis=1)
            good[beaten] = False
    return good
