"""The study of the bounds: its sampling is what it says, and it would see a bound that does not hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tubeplan_viz.bench.certificate import largest_curvature, least_clearance, trial
from tubeplan_viz.bench.random_tubes import random_path, random_tube
from tubeplan_viz.geometry import WallDistance

SAMPLES = 20_001


@pytest.mark.parametrize("seed", range(4))
def test_the_search_finds_the_worst_of_all_samples_as_asking_each_of_them_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tube = random_tube(rng)
    wall = WallDistance(tube.surface)
    curve = random_path(tube, rng, sway=0.6 if seed % 2 else 1.6)
    u = np.linspace(0.0, 1.0, SAMPLES)
    least, queries = least_clearance(curve, wall, SAMPLES)
    # Parameters as quotients of integers and those of linspace differ in the last digit.
    assert least == pytest.approx(float(wall.clearance(curve(u)).min()), abs=1e-9)
    assert queries < SAMPLES / 4
    # The same number of samples between each two knots, by derivatives of its own: the peak is met within a sample's width.
    assert largest_curvature(curve, 200_000) == pytest.approx(float(curve.curvature(u).max()), rel=1e-3)


def test_bounds_hold_and_are_tight_on_random_splines_in_random_tubes() -> None:
    for seed in np.random.SeedSequence(7).spawn(12):
        found = trial(np.random.default_rng(seed), samples=200_000)
        assert not found.violated
        assert found.curvature.bound <= 1.01 * max(found.sharpest, found.curvature.sampled)
        # The least of 200,000 samples lies above the least of all points by less than a micrometre.
        assert found.tightest - found.clearance.bound <= 0.01 + 1e-3


def test_a_bound_that_a_sample_breaks_is_seen() -> None:
    found = trial(np.random.default_rng(np.random.SeedSequence(1)), samples=50_000)
    low = replace(found.curvature, bound=found.sharpest * (1.0 - 1e-9))
    high = replace(found.clearance, bound=found.tightest + 1e-9)
    assert replace(found, curvature=low).violated
    assert replace(found, clearance=high).violated
