"""Explosions of growth curves."""

from __future__ import annotations

import numpy as np

from segmentation.leak import LeakRule, leak_index, leak_voxel, noise_end

RULE = LeakRule(volume_min=3.0, volume_max=150.0, jump=10.0)


def test_a_sharp_step_is_the_leak() -> None:
    volumes = np.concatenate([np.linspace(20.0, 30.0, 50), [400.0]])
    assert leak_index(volumes, RULE) == 50


def test_a_step_spread_over_a_few_limits_is_dated_to_its_largest_part() -> None:
    volumes = np.concatenate([np.full(40, 20.0), [24.0, 33.0, 36.0], np.full(20, 37.0)])
    # 20 to 33 ml within 5 HU is over 10 ml and 1.5 times; 24 to 33 is its largest part.
    assert leak_index(volumes, RULE) == 41


def test_the_seed_pocket_joining_its_lumen_is_no_leak() -> None:
    volumes = np.concatenate([np.full(10, 0.02), np.linspace(25.0, 30.0, 60)])
    assert leak_index(volumes, RULE) is None


def test_steady_growth_within_the_plausible_is_no_leak() -> None:
    assert leak_index(np.linspace(5.0, 60.0, 300), RULE) is None


def test_a_slow_leak_is_dated_to_where_the_volume_begins_to_run_away() -> None:
    # 0.2 % per HU for 60 HU, then 6 % per HU: 1.06**5 = 1.34 trips the onset, never the sharp rule (1.5).
    volumes = 10.0 * np.cumprod(np.concatenate([np.full(60, 1.002), np.full(60, 1.06)]))
    leak = leak_index(volumes, LeakRule(volume_min=3.0, volume_max=150.0, jump=1000.0))
    assert leak is not None
    # The window of 5 HU must be filled by the faster growth before it shows: at most 5 late.
    assert 60 <= leak <= 65


def test_the_leak_voxel_is_the_lowest_gate_of_the_largest_new_part() -> None:
    shape = (5, 9, 9)
    index = np.arange(np.prod(shape)).reshape(shape)
    held = index[:, :4, :].ravel()
    big = np.concatenate([index[2, 4, 4:6], index[:, 5:, :].ravel()])
    lone = index[0, 4, 0:1]  # touches the region too, but leads nowhere of its own
    big = big[~np.isin(big, index[0, 5, :3])]
    joined = np.concatenate([big, lone])
    values = np.full(len(joined), 5, dtype=np.int16)
    values[joined == index[2, 4, 5]] = 3
    values[joined == lone[0]] = 1
    assert leak_voxel(joined, held, values, shape, connectivity=6) == (2, 4, 5)


def test_a_lumen_has_joined_three_standard_deviations_above_its_median() -> None:
    limits = np.arange(-950, -850, 10)
    # A thousand voxels of the lumen at -950 HU, then one at each limit: the median stays where it is.
    values = [np.full(1000, -950, dtype=np.int16), *(np.array([limit], dtype=np.int16) for limit in limits[1:])]
    for noise, expected in ((0.0, -950), (10.0, -920), (11.0, -910)):  # -950 + 3 noise, rounded up to a limit
        assert limits[noise_end(values, limits, noise)] == expected
    assert noise_end(values, limits, 100.0) == len(values)  # never reached
