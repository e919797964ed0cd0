"""Ranking formulas by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.rigid import GOALS, Weights, rank
from tubeplan_viz.rigid.ranking import epsilon_best, normalise, pareto_set

# brain, orbit, septum, turbinate, length, tissue; the septum is the same for all.
ROWS = np.array(
    [
        [8.0, 2.0, 3.0, 1.0, 100.0, 40.0],
        [4.0, 4.0, 3.0, 2.0, 80.0, 60.0],
        [6.0, 3.0, 3.0, 3.0, 90.0, 20.0],
    ]
)
# (max - d) / (max - min) for distances, (v - min) / (max - min) for length and tissue, 0 where all are equal.
BY_HAND = np.array(
    [
        [0.0, 1.0, 0.0, 1.0, 1.0, 0.5],
        [1.0, 0.0, 0.0, 0.5, 0.0, 1.0],
        [0.5, 0.5, 0.0, 0.0, 0.5, 0.0],
    ]
)


def test_goals_are_normalised_as_worked_by_hand() -> None:
    assert normalise(ROWS) == pytest.approx(BY_HAND, abs=1e-15)


def test_equal_goals_and_a_single_path_give_zero() -> None:
    assert normalise(ROWS[:1]).tolist() == [[0.0] * 6]
    assert normalise(np.repeat(ROWS[:1], 3, axis=0)).max() == 0.0


def test_the_weighted_sum_and_the_best_paths_follow() -> None:
    weights = Weights(brain=4.0, orbit=2.0, septum=1.0, turbinate=1.0, length=1.0, tissue=1.0)
    made = rank(ROWS, weights)
    # (4 * f_brain + 2 * f_orbit + f_septum + f_turbinate + f_length + f_tissue) / 10
    assert made.score == pytest.approx([(2.0 + 1.0 + 1.0 + 0.5) / 10, (4.0 + 0.5 + 1.0) / 10, (2.0 + 1.0 + 0.5) / 10])
    assert made.best == {"overall": 2, "brain": 0, "length": 1, "tissue": 2}
    assert made.pareto.all()


def test_bounds_of_the_main_goal_method_hold_and_ties_go_to_the_rest() -> None:
    weights = Weights()
    bounds = np.ones(6)
    bounds[GOALS.index("tissue")] = 0.4
    assert epsilon_best(BY_HAND, weights, main="brain", bounds=bounds) == 2
    tied = BY_HAND.copy()
    tied[:, 0] = 0.0
    rest = tied[:, 1:] @ weights.row[1:]
    assert epsilon_best(tied, weights, main="brain") == int(np.argmin(rest))
    with pytest.raises(CaseError, match="no path keeps the bounds"):
        epsilon_best(BY_HAND, weights, main="brain", bounds=np.full(6, -1.0))


def test_a_ranking_names_one_of_its_paths_for_every_goal() -> None:
    whole = rank(ROWS, Weights())
    for best in ({**whole.best, "tissue": len(ROWS)}, {"overall": 0}):
        with pytest.raises(ValueError, match="expected one of the 3 paths for each of overall, brain, length, tissue"):
            replace(whole, best=best)


@pytest.mark.parametrize("weight", [-0.1, np.nan, np.inf])
def test_weights_that_weigh_nothing_are_refused(weight: float) -> None:
    with pytest.raises(CaseError, match="expected finite numbers, none below 0 and one above"):
        Weights(orbit=weight)


def test_no_path_of_the_pareto_set_is_beaten() -> None:
    normal = np.random.default_rng(0).integers(0, 4, (60, 6)) / 3.0
    kept = pareto_set(normal)
    for i in range(60):
        beaten = any((normal[j] <= normal[i]).all() and (normal[j] < normal[i]).any() for j in range(60))
        assert kept[i] == (not beaten)
