"""The rising flood against one flood per limit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from segmentation.flooding import BLOCKED, flood


def by_labels(values: np.ndarray, seed: tuple[int, int, int], limit: int, connectivity: int) -> np.ndarray:
    """What is connected to the seed at one limit, by labelling the whole image."""
    structure = ndimage.generate_binary_structure(3, 1 if connectivity == 6 else 3)
    labels, _ = ndimage.label(values <= limit, structure)
    return (labels == labels[seed]) & (labels[seed] > 0)


@pytest.mark.parametrize("connectivity", [6, 26])
@given(number=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_every_limit_holds_what_a_flood_of_its_own_would(connectivity: int, number: int) -> None:
    rng = np.random.default_rng(number)
    values = rng.integers(0, 12, size=(6, 7, 8)).astype(np.int16)
    values[rng.random(values.shape) < 0.05] = BLOCKED
    seed = (3, 3, 4)
    values[seed] = 2
    limits = np.arange(1, 12)
    result = flood(values, seed, limits, connectivity=connectivity, voxels_max=values.size)
    held = np.zeros(values.size, dtype=bool)
    for limit, joined in zip(limits, result.joined, strict=True):
        assert not held[joined].any()
        held[joined] = True
        np.testing.assert_array_equal(held.reshape(values.shape), by_labels(values, seed, int(limit), connectivity))
    assert result.complete


def test_a_flood_over_the_allowance_stops_and_says_so() -> None:
    values = np.zeros((20, 20, 20), dtype=np.int16)
    result = flood(values, (10, 10, 10), np.array([0, 1]), connectivity=6, voxels_max=500)
    assert not result.complete
    assert len(result.joined) == 1
    assert 500 < result.counts[-1] < values.size
