"""What the insertions at random are drawn from."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tubeplan_viz.needle import monte_carlo as module
from tubeplan_viz.needle.monte_carlo import LATEST, MonteCarloSettings, monte_carlo


def test_curvature_depth_and_motion_are_drawn_as_the_settings_say(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[float, Any]] = []

    def noted(problem: Any, pose: Any, controls: Any, events: Any, watched: Any, *, rng: Any, true_kappa: float) -> None:
        (event,) = events
        drawn.append((true_kappa, event))
        assert watched.noise == 0.4
        assert watched.tolerance == 0.2  # half of the noise: what noise alone makes of the tip is not planned after

    monkeypatch.setattr(module, "insert", noted)
    runs, kappa, target = 4000, 0.02, np.array([1.0, 2.0, 90.0])
    pose: Any = SimpleNamespace()
    problem: Any = SimpleNamespace(settings=SimpleNamespace(kappa=kappa), target=target)
    controls: Any = SimpleNamespace(length=100.0)
    settings = MonteCarloSettings(runs=runs, curvature_error=0.1, noise=0.4, target_motion=3.0)
    monte_carlo(problem, pose, controls, settings, rng=np.random.default_rng(3))
    error = np.array([true for true, _ in drawn]) / kappa - 1.0
    # A normal distribution cut at three deviations loses 1.3 % of its deviation; 4000 draws tell it to 1.1 %, its mean to 0.0016.
    assert error.std() == pytest.approx(0.1, rel=0.05)
    assert abs(error.mean()) < 0.006
    assert np.abs(error).max() <= 0.3 + 1e-12
    depth = np.array([event.at for _, event in drawn])
    # Even from the entry to the latest depth: its mean is known to 0.29 / sqrt(4000) of that way.
    assert depth.max() <= LATEST * 100.0
    assert depth.mean() == pytest.approx(0.5 * LATEST * 100.0, abs=4.0 * 0.29 * LATEST * 100.0 / np.sqrt(runs))
    away = np.array([event.target for _, event in drawn]) - target
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 3.0, rtol=1e-12)
    # No direction is preferred: each component of a unit vector has variance 1/3.
    assert np.abs(away.mean(axis=0)).max() < 4.0 * 3.0 / np.sqrt(3.0 * runs)
