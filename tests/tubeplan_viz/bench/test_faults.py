"""Planted faults are what they say, the verifier names each, and it refuses no valid plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tubeplan_viz.bench.certificate import largest_curvature, least_clearance
from tubeplan_viz.bench.faults import BREACH, EXCESS, NAMED, SPARE, Claimed, Fault, planted, valid_plan
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.verify import verify_run


def made(seed: int, kind: Fault) -> tuple[Claimed, Claimed]:
    rng = np.random.default_rng(seed)
    valid = valid_plan(rng)
    return valid, planted(valid, kind, rng)


def worst(one: Claimed) -> tuple[float, float]:
    """Least clearance, mm, and largest curvature, 1/mm, of 100,000 samples or more."""
    curve = one.plan.curve
    return least_clearance(curve, WallDistance(one.surface), 100_000)[0], largest_curvature(curve, 100_000)


@pytest.mark.parametrize("kind", ["breach", "bend"])
@pytest.mark.parametrize("seed", [1])
def test_a_fault_lies_between_the_samples_and_is_as_large_as_it_says(seed: int, kind: Fault) -> None:
    valid, bad = made(seed, kind)
    limits = valid.plan.limits
    assert worst(valid)[0] >= limits.clearance_min + SPARE
    assert worst(valid)[1] <= limits.curvature_max
    clearance, curvature = worst(bad)
    if kind == "breach":
        # The wall may be nearer beside the middle of the bump than at it: a little more than asked for.
        assert limits.clearance_min - BREACH - 0.05 < clearance < limits.clearance_min - BREACH + 1e-3
    else:
        assert curvature == pytest.approx((1.0 + EXCESS) * limits.curvature_max, rel=1e-3)
        assert clearance >= limits.clearance_min
    # What the file samples keeps both limits all the same.
    assert bad.plan.profile.clearance.min() >= limits.clearance_min
    if kind == "bend":
        assert bad.plan.profile.curvature.max() <= limits.curvature_max


@pytest.mark.parametrize("seed", range(3, 7))
def test_the_verifier_names_the_limit_that_is_broken_and_refuses_no_valid_plan(seed: int) -> None:
    kind: Fault = "breach" if seed % 2 else "bend"
    valid, bad = made(seed, kind)
    assert valid.refused_by() == []
    names = {check.name for check in bad.refused_by()}
    assert {"status", NAMED[kind], "certificate: bounds"} <= names
    if kind == "bend":
        assert "flagged intervals: clearance" not in names


def test_whole_folders_are_judged_alike(tmp_path: Path) -> None:
    valid, bad = made(11, "bend")
    valid.write(tmp_path / "valid")
    bad.write(tmp_path / "bad")
    assert verify_run(tmp_path / "valid").faults == ()
    assert "status" in {check.name for check in verify_run(tmp_path / "bad").faults}
