"""How far from its target a needle's tip may end, told by the verifier: paths whose end is known in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tubeplan_viz.verify.needle import check_tip
from tubeplan_viz.verify.needle_motion import integrated
from tubeplan_viz.verify.verification import Check

KAPPA, LENGTH = 0.02, 60.0
# One arc from the origin along +z that bends towards -y: the chord's two parts.
TIP = np.array([0.0, -(1.0 - np.cos(KAPPA * LENGTH)) / KAPPA, np.sin(KAPPA * LENGTH) / KAPPA])
ENTRY = {"entry_mm": [0.0, 0.0, 0.0], "entry_frame": np.eye(3).tolist()}
ARC = [{"turn_rad": 0.0, "length_mm": LENGTH, "curvature_per_mm": KAPPA}]
# What the planners promise: the plane's forms and the polished swarm and tree end on the target, the printed swarm within 0.1 mm.
ALLOWED_MM = {"forms": 1e-6, "swarm": 1e-3, "rrt": 1e-3, "printed": 0.1}


def judged(method: str, miss: float, *, stated: float | None = None) -> Check:
    """The verdict on an arc that ends `miss` mm beside its target, and says so unless it states another error."""
    way = np.array([0.48, -0.6, 0.64])
    result: dict[str, Any] = {
        "planner": {"method": method},
        "metrics": {"tip_error_mm": miss if stated is None else stated},
    }
    _, points = integrated(ENTRY, ARC)
    (check,) = check_tip({"target": (TIP + miss * way).tolist()}, result, points)
    return check


def test_the_integrated_arc_ends_where_its_chord_says() -> None:
    _, points = integrated(ENTRY, ARC)
    # A Runge-Kutta method of order 8 with a relative tolerance of 1e-12 keeps ten digits over 60 mm.
    assert np.abs(points[-1] - TIP).max() < 1e-9


@pytest.mark.parametrize("method", ALLOWED_MM)
def test_a_tip_within_what_its_method_promises_passes_and_one_beyond_it_fails(method: str) -> None:
    allowed = ALLOWED_MM[method]
    # The integration is known to 1e-9 mm, a thousandth of the least tolerance.
    assert judged(method, 0.99 * allowed).ok
    assert not judged(method, 1.01 * allowed).ok


def test_the_printed_swarm_fails_at_a_tenth_of_a_millimetre_and_a_polished_path_long_before() -> None:
    assert judged("printed", 0.0999).ok
    beyond = judged("printed", 0.1001)
    assert not beyond.ok
    assert beyond.found == "0.1 mm, stated 0.1 mm"
    assert beyond.expected == "at most 0.1 mm, as stated"
    for method in ("swarm", "rrt", "forms"):
        assert not judged(method, 0.0999).ok


def test_a_method_that_promises_nothing_is_allowed_nothing() -> None:
    assert not judged("guess", 1e-4).ok


def test_an_error_stated_better_or_worse_than_it_is_fails() -> None:
    assert judged("printed", 0.05, stated=0.05 + 9e-7).ok
    for wrong in (0.05 - 2e-6, 0.05 + 2e-6, 0.0):
        assert not judged("printed", 0.05, stated=wrong).ok
