"""Measured paths: flags end where the limit is met, metrics are means over the path."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.plan import FlagKind, Limits, PathProfile
from tubeplan_viz.profile import flag_stretches, measure_path, path_metrics, sharpest_place, with_peaks

LIMITS = Limits(curvature_max=0.1, clearance_min=2.0)


def profile(clearance: list[float], curvature: list[float] | None = None) -> PathProfile:
    n = len(clearance)
    s = np.arange(n, dtype=float)
    points = np.column_stack([s, 0.0 * s, 0.0 * s])
    return PathProfile(
        arc_length=s,
        points=points,
        tangents=np.tile([1.0, 0.0, 0.0], (n, 1)),
        curvature=np.array(curvature or [0.0] * n),
        torsion=np.zeros(n),
        clearance=np.array(clearance),
    )


def test_a_flag_ends_where_the_line_between_samples_meets_the_limit() -> None:
    # 3 -> 1 meets 2 half way; 1.5 -> 3.5 meets it after a quarter.
    (flag,) = flag_stretches(profile([3.0, 3.0, 1.0, 1.5, 3.5]), LIMITS)
    assert flag.kind is FlagKind.CLEARANCE
    assert (flag.start, flag.end) == (1.5, 3.25)
    assert (flag.worst, flag.worst_at) == (1.0, 2.0)


def test_flags_reach_the_ends_of_the_path() -> None:
    first, last = flag_stretches(profile([1.0, 3.0, 3.0, 0.5]), LIMITS)
    assert (first.start, first.end) == (0.0, 0.5)
    assert last.start == pytest.approx(2.4)
    assert last.end == 3.0


def test_both_kinds_are_flagged_in_order_along_the_path() -> None:
    flags = flag_stretches(profile([3, 3, 3, 3, 1, 3], [0, 0.3, 0, 0, 0, 0]), LIMITS)
    assert [flag.kind for flag in flags] == [FlagKind.CURVATURE, FlagKind.CLEARANCE]
    assert (flags[0].start, flags[0].end) == pytest.approx((1 / 3, 5 / 3))


def test_a_value_at_its_limit_is_no_breach() -> None:
    assert flag_stretches(profile([2.0, 2.0, 2.0], [0.1, 0.1, 0.1]), LIMITS) == ()


def test_leaving_the_lumen_is_a_breach_even_at_a_clearance_limit_of_zero() -> None:
    (flag,) = flag_stretches(profile([1.0, -1.0, 1.0]), Limits(curvature_max=0.1, clearance_min=0.0))
    assert (flag.start, flag.end) == (0.5, 1.5)


def test_a_measured_path_is_even_and_exact(bent_tube: Any) -> None:
    wall = WallDistance(bent_tube.surface)
    measured = measure_path(bent_tube.curve, wall)
    steps = np.diff(measured.arc_length)
    assert steps.max() <= 0.25 + 1e-6
    assert np.ptp(steps) < 1e-5
    np.testing.assert_allclose(measured.clearance, wall.clearance(measured.points), atol=0.0)
    np.testing.assert_allclose(np.linalg.norm(measured.tangents, axis=1), 1.0, atol=1e-12)
    assert measured.length == pytest.approx(bent_tube.curve.length)


def test_metrics_are_extremes_and_means_of_the_profile(bent_tube: Any) -> None:
    measured = measure_path(bent_tube.curve, WallDistance(bent_tube.surface))
    metrics = path_metrics(measured, bent_tube.centerline)
    assert metrics["clearance_min_mm"] == measured.clearance.min()
    assert metrics["clearance_mean_mm"] == pytest.approx(measured.clearance.mean())
    assert metrics["curvature_max_per_mm"] == measured.curvature.max()
    # The curve lies 0.4 sin^2 mm above the axis, which is 0.2 mm on average.
    assert metrics["centerline_distance_mean_mm"] == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize(
    ("curvature", "clearance", "message"),
    [
        (0.0, 1.0, "curvature_max is 0 1/mm, expected 0.0001 to 10"),
        (float("nan"), 1.0, "curvature_max is nan"),
        (0.1, -0.5, "clearance_min is -0.5 mm, expected 0 to 100"),
        (0.1, 1e6, r"clearance_min is 1e\+06 mm"),
    ],
)
def test_limits_that_no_instrument_has_are_refused(curvature: float, clearance: float, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        Limits(curvature_max=curvature, clearance_min=clearance)


def test_the_worst_value_of_a_flag_is_the_curves_and_not_a_samples(bent_tube: Any) -> None:
    wall = WallDistance(bent_tube.surface)
    limits = Limits(curvature_max=0.0665, clearance_min=2.75)
    coarse = flag_stretches(measure_path(bent_tube.curve, wall, spacing=0.05), limits)
    peaks = with_peaks(coarse, bent_tube.curve, wall)
    assert {flag.kind for flag in peaks} == set(FlagKind)
    for before, flag in zip(coarse, peaks, strict=True):
        u = bent_tube.curve.parameter(np.linspace(flag.start, flag.end, 20_001))
        if flag.kind is FlagKind.CURVATURE:
            assert flag.worst >= before.worst
            assert flag.worst == pytest.approx(bent_tube.curve.curvature(u).max(), rel=1e-4)
        else:
            assert flag.worst <= before.worst
            assert flag.worst == pytest.approx(wall.clearance(bent_tube.curve(u)).min(), abs=1e-5)


def test_the_sharpest_place_is_the_curves_between_the_samples_too(bent_tube: Any) -> None:
    curve = bent_tube.curve
    dense = curve.curvature(curve.parameter(np.linspace(0.0, curve.length, 200_001)))
    found = float(curve.curvature(curve.parameter(np.array([sharpest_place(curve)])))[0])
    # Beside a kink the curvature changes by a few percent per 0.05 mm; the last samples are 0.0017 mm apart.
    assert found == pytest.approx(dense.max(), rel=1e-3)
