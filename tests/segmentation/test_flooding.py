"""The rising flood against one flood per limit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from segmentation.flooding import BLOCKED, flood, flood_once, without_voids
from segmentation.smoothing import GrowingVoxels
from segmentation.volume import Volume


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


@pytest.mark.parametrize("connectivity", [6, 26])
@given(number=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_a_flood_at_one_limit_holds_what_labels_hold_wherever_its_box_begins(connectivity: int, number: int) -> None:
    rng = np.random.default_rng(number)
    # Larger than the first box around a seed, and porous enough that the guess on every fourth voxel misses parts.
    values = (rng.random((30, 34, 38)) > rng.uniform(0.3, 0.9)).astype(np.int16)
    seed = tuple(int(rng.integers(n)) for n in values.shape)
    seed = (seed[0], seed[1], seed[2])
    values[seed] = 0
    mask, lower, complete = flood_once(
        lambda box: values[box] <= 0, seed, values.shape, connectivity=connectivity, voxels_max=values.size
    )
    whole = np.zeros(values.shape, dtype=bool)
    whole[tuple(slice(lo, lo + n) for lo, n in zip(lower, mask.shape, strict=True))] = mask
    np.testing.assert_array_equal(whole, by_labels(values, seed, 0, connectivity))
    assert complete


def test_a_flood_at_one_limit_over_the_allowance_says_so() -> None:
    values = np.zeros((20, 20, 20), dtype=np.int16)
    *_, complete = flood_once(lambda box: values[box] <= 0, (10, 10, 10), values.shape, connectivity=6, voxels_max=500)
    assert not complete


@given(number=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_voids_are_those_that_scipy_fills(number: int) -> None:
    rng = np.random.default_rng(number)
    mask = rng.random((7, 8, 9)) < rng.uniform(0.2, 0.9)
    np.testing.assert_array_equal(without_voids(mask), ndimage.binary_fill_holes(mask))


@pytest.mark.parametrize("smoothing", [0.0, 0.9])
@pytest.mark.parametrize("bright", [False, True])
def test_growing_voxels_are_the_same_in_any_box_and_so_is_the_flood(smoothing: float, bright: bool) -> None:
    rng = np.random.default_rng(5)
    # More than one block of the flood along every axis.
    hu = np.clip(rng.normal(0.0, 400.0, size=(20, 40, 70)), -2000, 3500).astype(np.int16)
    volume = Volume(hu, np.diag([1.0, 0.7, 0.7, 1.0]))
    values = GrowingVoxels(volume=volume, smoothing=smoothing, bright=bright, bound=300.0 if bright else -300.0)
    whole = values[slice(0, 20), slice(0, 40), slice(0, 70)]
    np.testing.assert_array_equal(values[slice(3, 17), slice(0, 9), slice(31, 70)], whole[3:17, 0:9, 31:70])
    assert (whole == BLOCKED).any()
    seed = tuple(int(i) for i in np.unravel_index(int(np.argmin(whole)), whole.shape))
    limits = np.arange(int(whole.min()), int(whole.min()) + 4000, 100)
    by_block = flood(values, (seed[0], seed[1], seed[2]), limits, connectivity=6, voxels_max=hu.size)
    at_once = flood(whole, (seed[0], seed[1], seed[2]), limits, connectivity=6, voxels_max=hu.size)
    assert by_block.counts[-1] > 1000
    for one, other, grey in zip(by_block.joined, at_once.joined, by_block.values, strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(grey, whole.ravel()[one])
