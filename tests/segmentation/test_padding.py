"""Voxels outside the scan: where they are, and when they matter."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from segmentation.padding import Padding, packed_planes, together
from segmentation.region_growing import Region


def padding_of(mask: np.ndarray) -> Padding:
    return Padding(packed_planes(mask), *mask.shape[1:])


def region_of(whole: np.ndarray) -> Region:
    """A region as growing gives it: its box with one voxel of margin where the image has one."""
    index = np.argwhere(whole)
    lower, upper = np.maximum(index.min(axis=0) - 1, 0), np.minimum(index.max(axis=0) + 2, whole.shape)
    mask = whole[tuple(slice(a, b) for a, b in zip(lower, upper, strict=True))]
    first = (int(lower[0]), int(lower[1]), int(lower[2]))
    return Region(mask=mask, lower=first, seed=first, hu_min=-1024.0, hu_max=-900.0, volume_ml=1.0, border={})


@given(number=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_padding_touches_a_region_where_it_lies_in_it_or_beside_it(number: int) -> None:
    rng = np.random.default_rng(number)
    padded = rng.random((5, 7, 9)) < rng.uniform(0.0, 0.3)
    whole = rng.random(padded.shape) < 0.1
    whole[2, 3, 4] = True
    padding = padding_of(padded)
    assert padding.count == padded.sum()
    near = ndimage.binary_dilation(whole)
    assert padding.touching(region_of(whole)) == np.count_nonzero(near & padded)
    assert padding.count_within((slice(1, 4), slice(0, 3), slice(2, 9))) == padded[1:4, 0:3, 2:9].sum()


def test_two_kinds_of_padding_are_one() -> None:
    one, other = np.zeros((2, 4, 4, 4), dtype=bool)
    one[0, 0], other[0, 1], other[2, 2] = True, True, True
    both = together(padding_of(one), padding_of(other))
    assert [both.plane(k).tolist() for k in range(4)] == (one | other).tolist()
