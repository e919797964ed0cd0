"""The search for the smallest change of a limit: few solves, and a value that is needed to within a percent."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.tube.relax import FLEXIBLE, RATIO, between, bracket

GIVEN = 0.1


class Lumen:
    """A clearance that rises with the curvature limit, from where a path exists at all; counts how often it is asked."""

    def __init__(self, wanted: float, *, exists: float = GIVEN, ceiling: float = 3.0, rise: float = 2.0) -> None:
        self.wanted, self.exists, self.ceiling, self.rise = wanted, exists, ceiling, rise
        self.found: dict[float, float] = {}
        self.solves = 0

    def clearance(self, curvature: float) -> float:
        # Concave, as the best clearance of the bent models is, and flat once the ends bind.
        return min(self.ceiling, 2.0 + self.rise * (1.0 - self.exists / curvature))

    def reaches(self, curvature: float) -> bool:
        self.solves += 1
        if curvature < self.exists:
            return False
        self.found[curvature] = self.clearance(curvature)
        return self.found[curvature] >= self.wanted


def least(lumen: Lumen) -> float:
    """The limit at which the wanted clearance is kept, in closed form."""
    return lumen.exists / (1.0 - (lumen.wanted - 2.0) / lumen.rise)


@pytest.mark.parametrize("exists", [GIVEN, 1.7 * GIVEN])
@pytest.mark.parametrize("wanted", [2.02, 2.3, 2.7, 2.99])
def test_bracket_closes_on_the_least_limit_within_its_ratio(wanted: float, exists: float) -> None:
    lumen = Lumen(wanted, exists=exists)
    assert not lumen.reaches(GIVEN)
    high = bracket(lumen.reaches, lumen.found, GIVEN, wanted)
    assert high is not None
    # Kept at the limit named, and not at one that is smaller by more than the ratio.
    assert least(lumen) <= high <= RATIO * least(lumen) * (1.0 + 1e-12)
    # Halving a bracket of 1.3 takes six solves more than widening does; where the clearance is known below, guesses save some.
    widened = int(np.ceil(np.log(least(lumen) / GIVEN) / np.log(1.3)))
    assert lumen.solves <= 1 + widened + (5 if exists == GIVEN else 6)


def test_a_clearance_that_rises_evenly_is_bracketed_in_three_guesses() -> None:
    lumen = Lumen(2.3)
    assert not lumen.reaches(GIVEN)
    assert bracket(lumen.reaches, lumen.found, GIVEN, 2.3) is not None
    assert lumen.solves <= 5


def test_no_limit_is_named_beyond_another_instrument() -> None:
    lumen = Lumen(2.5, exists=2.0 * FLEXIBLE * GIVEN)
    assert bracket(lumen.reaches, lumen.found, GIVEN, 2.5) is None
    # Widened by 1.3 up to six times: six solves.
    assert lumen.solves == int(np.log(FLEXIBLE) / np.log(1.3))


def test_line_of_trades_leaves_out_what_is_known_near_by() -> None:
    inner = between(0.1, 0.2, [])
    np.testing.assert_allclose(inner, 0.1 * 2.0 ** np.array([0.25, 0.5, 0.75]))
    assert between(0.1, 0.2, [0.1 * 2.0**0.5]) == [inner[0], inner[2]]
