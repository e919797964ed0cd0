"""Samples of a path and the wall about them: what is remembered is what would be found, and no dip is missed between."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.bench.models import variant_2
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube import OptimalSettings, Passage
from tubeplan_viz.tube.nearby import wall_rows
from tubeplan_viz.tube.samples import DIP, WIDEST, Grid, first_spline, widest_gap


@pytest.fixture(scope="module")
def fitted() -> tuple[Grid, np.ndarray]:
    model = variant_2()
    passage = Passage(
        wall=WallDistance(model.surface), line=model.axis_points, limits=Limits(curvature_max=0.1, clearance_min=1.0)
    )
    return first_spline(passage, OptimalSettings())


def test_samples_as_far_apart_as_allowed_miss_no_more_than_the_dip() -> None:
    # A straight path among random wall points: the clearance is known in closed form everywhere.
    rng = np.random.default_rng(7)
    along = np.linspace(0.0, 60.0, 60_001)
    for _ in range(20):
        points = np.column_stack([rng.uniform(0.0, 60.0, 40), rng.uniform(0.4, 3.0, 40)])
        clearance = np.sqrt((along[:, None] - points[:, 0]) ** 2 + points[:, 1] ** 2).min(axis=1)
        for share in (1.0, 1.01, 1.1):
            least = share * float(clearance.min())
            picked = spread(along, clearance, least)
            # What is missed is a dip under the least clearance asked about, or under a sample that is itself below it: those
            # lie 0.01 mm apart or less, and d^2 + 0.005^2 at a sample hides 0.00003 mm at 0.4 mm.
            assert clearance.min() >= min((1.0 - DIP) * least, float(clearance[picked].min())) - 4e-5
            assert len(picked) < 2000


def spread(along: np.ndarray, clearance: np.ndarray, least: float) -> list[int]:
    """Samples each as far on as both it and the one before allow for this least clearance."""
    picked = [0]
    while picked[-1] < len(along) - 1:
        ahead = np.arange(picked[-1] + 1, min(picked[-1] + round(1000.0 * WIDEST) + 1, len(along)))
        allowed = [widest_gap(clearance[at], least) for at in (picked[-1:], ahead)]
        fits = ahead[along[ahead] - along[picked[-1]] <= np.minimum(*allowed)]
        picked.append(int(fits[-1]) if len(fits) else int(ahead[0]))
    return picked


def test_remembered_wall_is_as_near_as_wall_looked_for_anew(fitted: tuple[Grid, np.ndarray]) -> None:
    grid, control = fitted
    state = grid.measure(control, 0.1)
    rng = np.random.default_rng(3)
    for size in (0.02, 0.1, 0.4):
        moved = np.array(control)
        moved[1:-1] += rng.uniform(-size, size, moved[1:-1].shape)
        points, tangents = grid.clearance_basis.curve(moved), grid.clearance_basis.curve(moved, 1)
        known = wall_rows(points, tangents, grid.wall, known=state.rows)
        exact = grid.wall.distance(points)
        # Rows are distances to faces: never below the truth, up to rounding.
        assert (known.clearance >= exact - 1e-9).all()
        # The nearest face lies among six likely ones but where facets meet at a shallow angle.
        np.testing.assert_allclose(known.clearance, exact, atol=2e-3)


def test_samples_added_later_stand_where_they_would_have_from_the_start(fitted: tuple[Grid, np.ndarray]) -> None:
    grid, control = fitted
    state = grid.measure(control, 0.1)
    u = np.array([0.003, 0.5001, 0.5002, 0.9999])
    finer, seen = grid.with_samples(u, state)
    whole = finer.measure(control, 0.1)
    assert (np.diff(finer.clearance_u) > 0.0).all()
    assert set(u) <= set(finer.clearance_u)
    np.testing.assert_array_equal(seen.rows.clearance, whole.rows.clearance)
    np.testing.assert_allclose(seen.weight, whole.weight, rtol=1e-12)
    for share in (0.1, 0.8):
        ours, theirs = (
            sorted(zip(s.tolist(), d.round(9).tolist(), strict=True))
            for s, _, d in (seen.rows.telling(share), whole.rows.telling(share))
        )
        assert ours == theirs
    # Nothing is added twice.
    again, _ = finer.with_samples(u, seen)
    np.testing.assert_array_equal(again.clearance_u, finer.clearance_u)


def test_planes_left_out_are_never_the_nearest_within_reach(fitted: tuple[Grid, np.ndarray]) -> None:
    grid, control = fitted
    rows = grid.measure(control, 0.1).rows
    rng = np.random.default_rng(11)
    share = 0.2
    sample, normal, distance = rows.telling(share)
    assert len(sample) < len(rows.sample)
    for _ in range(20):
        move = rng.normal(size=(len(rows.clearance), 3))
        move *= (share * rows.clearance / np.linalg.norm(move, axis=1))[:, None]
        kept, every = np.full(len(move), np.inf), np.full(len(move), np.inf)
        np.minimum.at(kept, sample, distance + np.einsum("ij,ij->i", normal, move[sample]))
        np.minimum.at(every, rows.sample, rows.distance + np.einsum("ij,ij->i", rows.normal, move[rows.sample]))
        np.testing.assert_allclose(kept, every, atol=1e-9)
