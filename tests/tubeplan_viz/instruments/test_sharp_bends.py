"""Bends that keep instruments out: near the truth where it is known, never beyond it, and proved once for all they keep out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tubeplan_viz.bench.infeasible import BEND, TUBE, clearance_at_bend
from tubeplan_viz.bench.models import Model, torus_piece
from tubeplan_viz.centerline import Endpoint, voronoi_graph
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.instruments import Instrument, Matrix, ReachSettings, Verdict, find_targets, instrument_matrix
from tubeplan_viz.tube.bend import bend_bound
from tubeplan_viz.tube.explain import bend_details
from tubeplan_viz.verify.no_path import max_circle, room
from tubeplan_viz.verify.wall import Lumen, Triangles

START = np.array([0.0, 0.0, 2.0])  # of the fork in conftest, mm
# Of instruments in a quarter bend of 8 mm.
BENDS = (9.0, 10.0, 13.0)
# The facets of the quarter bend lie within its walls by up to a thousandth of its radius, and a search ends near its best.
BELOW = 0.985
# How far above the truth the bound of a bend may lie there: 0.3 % to which it is closed, and the cross-sections' cubes.
ABOVE = 1.012


def scope(name: str, radius: float, bend: float, tip: float = 0.0) -> Instrument:
    return Instrument(name=name, kind="test", outer_diameter_mm=2.0 * radius, bend_radius_min_mm=bend, rigid_tip_mm=tip)


def fork_matrix(fork: Any, instruments: list[Instrument], targets: int = 2) -> Matrix:
    return instrument_matrix(fork.wall, START, fork.targets[:targets], instruments, ReachSettings(), jobs=1)


@pytest.fixture(scope="module")
def model() -> Model:
    return torus_piece(bend_radius=BEND, radius=TUBE)


@pytest.fixture(scope="module")
def quarter(model: Model) -> Matrix:
    """Through the bend to its far end: of each bend radius an instrument below the truth, and one above."""
    wall, settings = WallDistance(model.surface), ReachSettings()
    goal = Endpoint(label="E2", point=model.goal, radius=TUBE, branch_length=10.0, confidence=1.0, cap=None)
    targets = find_targets(wall, voronoi_graph(model.surface, wall), model.start, (goal,), settings)
    thin = [scope(f"thin {bend}", BELOW * clearance_at_bend(bend), bend) for bend in BENDS]
    thick = [scope(f"thick {bend}", ABOVE * clearance_at_bend(bend), bend) for bend in BENDS]
    return instrument_matrix(wall, model.start, targets, (*thin, *thick), settings, jobs=1)


def test_in_a_quarter_bend_what_the_closed_form_allows_holds_and_what_it_does_not_is_proved_impossible(quarter: Matrix) -> None:
    assert [row[0].verdict for row in quarter.cells[:3]] == [Verdict.FEASIBLE] * 3
    for (cell,), bend in zip(quarter.cells[3:], BENDS, strict=True):
        assert cell.verdict is Verdict.IMPOSSIBLE
        assert cell.margin_of == "bend"
        assert cell.bend is not None
        sharp = quarter.bends[0][cell.bend]
        assert sharp.limits.curvature_max == 1.0 / bend
        assert 0.999 * clearance_at_bend(bend) <= sharp.bound.bound <= ABOVE * clearance_at_bend(bend)
        # The middle of the quarter, where the arc comes nearest to the wall.
        middle = BEND * np.array([-(1.0 - np.sqrt(0.5)), np.sqrt(0.5), 0.0])
        assert np.linalg.norm(np.array(cell.margin_point) - middle) < 1.5


def test_every_bend_stated_is_seen_to_be_too_sharp_by_the_verifier(quarter: Matrix, model: Model) -> None:
    corners, cap = model.surface.vertices[model.surface.faces], model.surface.face_cap >= 0
    lumen = Lumen(Triangles(corners[~cap]), Triangles(corners[cap]))
    assert len(quarter.bends[0]) == len(BENDS)
    for sharp in quarter.bends[0]:
        stated = bend_details(sharp.bound, sharp.limits)
        assert stated["proves_impossible"]
        rooms = [room(section, lumen, sharp.bound.bound) for section in stated["sections"]]
        # The bound is closed to a few thousandths of the clearance, the circle to as many of its radius.
        assert max_circle(rooms) <= 1.001 / sharp.limits.curvature_max


def test_what_one_proof_keeps_out_needs_no_other(fork: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[float, float]] = []
    real = bend_bound

    def counted(*arguments: Any, **keys: Any) -> Any:
        asked.append((keys["curvature"], keys["limit"]))
        return real(*arguments, **keys)

    monkeypatch.setattr("tubeplan_viz.instruments.proof.bend_bound", counted)
    # Both branches bend by 12 mm, so that 40 mm is far too stiff; the last two are thicker or stiffer than the first.
    hard = [scope("first", 0.9, 40.0), scope("thicker", 1.0, 40.0), scope("stiffer", 0.9, 80.0)]
    matrix = fork_matrix(fork, [scope("easy", 0.6, 6.0), *hard])
    assert asked == [(1.0 / 40.0, 0.9)] * len(matrix.targets)
    assert [cell.verdict for cell in matrix.cells[0]] == [Verdict.FEASIBLE] * 2
    for row in matrix.cells[1:]:
        assert [(cell.verdict, cell.bend) for cell in row] == [(Verdict.IMPOSSIBLE, 0)] * 2


def test_between_what_is_found_and_what_is_proved_a_cell_stays_flagged(fork: Any) -> None:
    stiff = 14.0
    found = fork_matrix(fork, [scope("thin", 0.4, stiff), scope("thick", 1.9, stiff)], targets=1)
    kept = max(path.clearance_bound for path in found.paths[0] if path.curvature_bound <= 1.0 / stiff)
    proved = found.bends[0][0].bound.bound
    assert [row[0].verdict for row in found.cells] == [Verdict.FEASIBLE, Verdict.IMPOSSIBLE]
    assert kept < proved
    between = fork_matrix(fork, [scope("thin", 0.4, stiff), scope("between", 0.5 * (kept + proved), stiff)], targets=1).cells[1][
        0
    ]
    assert between.verdict is Verdict.FLAGGED
    assert between.bend is None
    assert "clearance falls to" in between.reason or "bend radius falls to" in between.reason


def test_a_rigid_tip_that_does_not_pass_is_no_proof_about_bends(fork: Any) -> None:
    matrix = fork_matrix(fork, [scope("rod", 0.5, 6.0, tip=18.0)], targets=1)
    assert matrix.cells[0][0].verdict is Verdict.FLAGGED
    assert matrix.bends == ((),)


def test_no_path_found_keeps_what_a_bend_is_proved_to_forbid(fork: Any) -> None:
    rng = np.random.default_rng(7)
    drawn = rng.uniform([0.3, 9.0], [1.9, 40.0], (8, 2))
    matrix = fork_matrix(fork, [scope(f"i{k}", float(radius), float(bend)) for k, (radius, bend) in enumerate(drawn)])
    pairs = 0
    for paths, bends in zip(matrix.paths, matrix.bends, strict=True):
        for sharp in bends:
            assert sharp.bound.bound <= sharp.limits.clearance_min
            for path in paths:
                pairs += 1
                assert path.curvature_bound > sharp.limits.curvature_max or path.clearance_bound < sharp.bound.bound
    assert pairs > 4
