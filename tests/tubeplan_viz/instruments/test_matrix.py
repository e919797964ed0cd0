"""Which instrument reaches which target: monotone, proved where it says so, and the same on any number of processes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.geometry import clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.instruments import Instrument, Matrix, ReachSettings, Verdict, find_targets, instrument_matrix, tip_clearance

BEND, WIDE, NARROW = 12.0, 2.0, 1.2  # of the fork in conftest, mm
START = np.array([0.0, 0.0, 2.0])


def scope(name: str, diameter: float, bend: float, tip: float = 0.0, reach: float = 600.0) -> Instrument:
    return Instrument(
        name=name, kind="test", outer_diameter_mm=diameter, bend_radius_min_mm=bend, rigid_tip_mm=tip, working_length_mm=reach
    )


def judged(fork: Any, instruments: list[Instrument], **settings: Any) -> Matrix:
    return instrument_matrix(fork.wall, START, fork.targets, instruments, ReachSettings(**settings), jobs=1)


def test_an_instrument_that_fits_holds_and_one_thicker_than_a_branch_is_proved_impossible(fork: Any) -> None:
    matrix = judged(fork, [scope("thin", 1.6, 8.0), scope("thick", 3.0, 8.0)])
    assert [cell.verdict for cell in matrix.cells[0]] == [Verdict.FEASIBLE, Verdict.FEASIBLE]
    assert [cell.verdict for cell in matrix.cells[1]] == [Verdict.FEASIBLE, Verdict.IMPOSSIBLE]
    # The narrow branch has a radius of 1.2 mm; its mesh of 0.6 mm voxels lies up to 0.1 mm inside it.
    assert matrix.targets[1].ceiling.bound == pytest.approx(NARROW, abs=0.1)
    assert matrix.cells[1][1].margin == pytest.approx(NARROW - 1.5, abs=0.1)


def test_every_yes_is_true_of_its_path(fork: Any) -> None:
    instruments = [scope("a", 1.2, 6.0, tip=5.0), scope("b", 1.9, 11.0), scope("c", 3.0, 9.0, tip=6.0, reach=75.0)]
    matrix = judged(fork, instruments)
    seen = 0
    for row, one in zip(matrix.cells, instruments, strict=True):
        for j, cell in enumerate(row):
            if cell.verdict is not Verdict.FEASIBLE or cell.inferred_from is not None:
                continue
            seen += 1
            assert cell.path is not None
            curve = matrix.paths[j][cell.path].curve
            assert np.allclose(curve([0.0, 1.0]), [START, matrix.targets[j].point], atol=1e-6)
            assert clearance_lower_bound(curve, fork.wall, limit=one.radius, tolerance=0.002).bound >= one.radius
            assert curvature_upper_bound(curve, limit=one.limits.curvature_max).bound <= one.limits.curvature_max
            assert curve.length <= one.working_length_mm
            if one.rigid_tip_mm:
                assert tip_clearance(curve, fork.wall, one.rigid_tip_mm).bound >= one.radius
    assert seen >= 3


@pytest.mark.parametrize("seed", [1])
def test_thinner_or_more_flexible_never_turns_a_yes_into_a_no_nor_an_open_question_into_one(fork: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    instruments = [scope(f"i{k}", *rng.uniform([0.6, 4.0, 0.0, 50.0], [4.2, 28.0, 8.0, 120.0]).tolist()) for k in range(8)]
    # Neighbours of each that differ in one value only.
    instruments += [
        scope(f"thinner{k}", 0.9 * a.outer_diameter_mm, a.bend_radius_min_mm, a.rigid_tip_mm, a.working_length_mm)
        for k, a in enumerate(instruments[:4])
    ]
    instruments += [
        scope(f"softer{k}", a.outer_diameter_mm, 0.8 * a.bend_radius_min_mm, a.rigid_tip_mm, a.working_length_mm)
        for k, a in enumerate(instruments[:8])
    ]
    instruments += [
        scope(f"shorter tip{k}", a.outer_diameter_mm, a.bend_radius_min_mm, 0.5 * a.rigid_tip_mm, a.working_length_mm)
        for k, a in enumerate(instruments[:4])
    ]
    matrix = judged(fork, instruments)
    pairs = 0
    for i, easy in enumerate(instruments):
        for k, hard in enumerate(instruments):
            if i == k or not easy.is_no_harder_than(hard):
                continue
            for j in range(len(matrix.targets)):
                pairs += 1
                easier, harder = matrix.cells[i][j].verdict, matrix.cells[k][j].verdict
                assert not (harder is Verdict.FEASIBLE and easier is not Verdict.FEASIBLE), (easy, hard)
                assert not (easier is Verdict.IMPOSSIBLE and harder is not Verdict.IMPOSSIBLE), (easy, hard)
    assert pairs > 8
    assert matrix.count(Verdict.FEASIBLE) > 0
    assert sum(cell.bend is not None for row in matrix.cells for cell in row) > 2
    assert any(cell.margin_of == "ceiling" for row in matrix.cells for cell in row)


def test_a_long_rigid_tip_is_stopped_where_a_point_would_pass(fork: Any) -> None:
    # At a bend of 12 mm a chord of 18 mm cuts the corner by 12 - sqrt(144 - 81) = 4.06 mm: more than the lumen has.
    matrix = judged(fork, [scope("point", 1.0, 6.0), scope("rod", 1.0, 6.0, tip=18.0)])
    assert [row[0].verdict for row in matrix.cells] == [Verdict.FEASIBLE, Verdict.FLAGGED]
    assert "rigid tip of 18 mm" in matrix.cells[1][0].reason
    assert matrix.cells[1][0].margin_of == "tip"


def test_working_length_counts_what_is_used_up_before_the_start(fork: Any) -> None:
    length = judged(fork, [scope("long", 1.0, 8.0)]).cells[0][0].length
    assert length is not None
    near = [scope("enough", 1.0, 8.0, reach=length + 101.0), scope("short", 1.0, 8.0, reach=length + 98.0)]
    verdicts = [row[0].verdict for row in judged(fork, near, before_start_mm=100.0).cells]
    assert verdicts == [Verdict.FEASIBLE, Verdict.FLAGGED]
    straight = float(np.linalg.norm(fork.targets[0].point - START))
    never = judged(fork, [scope("never", 1.0, 8.0, reach=straight + 99.0)], before_start_mm=100.0).cells[0][0]
    assert never.verdict is Verdict.IMPOSSIBLE
    assert "in a straight line" in never.reason


def test_the_feature_iteration_serves_too(fork: Any) -> None:
    matrix = judged(fork, [scope("thin", 1.0, 6.0), scope("thick", 3.0, 6.0)], method="feature_iteration")
    assert matrix.cells[0][0].verdict is Verdict.FEASIBLE
    # The thick one does not fit the narrow branch, where its search is spared; no path of another method tells how far it comes.
    assert matrix.cells[1][1].verdict is Verdict.IMPOSSIBLE
    assert len(matrix.paths[1]) == 1
    assert matrix.cells[1][1].advance is not None
    assert matrix.cells[1][1].advance.path == 0


def test_targets_in_another_part_have_no_line_and_are_not_called_impossible_without_proof(fork: Any) -> None:
    # A target with no centerline, as find_targets gives for a part that no chain of spheres joins.
    lost = replace(fork.targets[0], centerline=None)
    cell = instrument_matrix(fork.wall, START, [lost], [scope("thin", 1.0, 6.0)], ReachSettings(), jobs=1).cells[0][0]
    assert cell.verdict is Verdict.FLAGGED
    assert cell.path is None
    assert cell.reason.startswith("no path was found")


def test_ceilings_bound_the_clearance_of_every_path_found(fork: Any) -> None:
    matrix = judged(fork, [scope("a", 1.0, 6.0), scope("b", 1.0, 14.0)])
    for target, paths in zip(matrix.targets, matrix.paths, strict=True):
        assert paths
        assert all(path.clearance <= target.ceiling.bound + 1e-9 for path in paths)


def test_processes_change_nothing(fork: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    instruments = [scope("thin", 1.2, 6.0, tip=4.0), scope("thick", 3.0, 9.0)]
    alone = judged(fork, instruments)
    monkeypatch.setattr("tubeplan_viz.instruments.matrix.FEW_TARGETS", 1)
    shared = instrument_matrix(fork.wall, START, fork.targets, instruments, ReachSettings(), jobs=2)
    for one, other in zip(alone.cells, shared.cells, strict=True):
        assert [(c.verdict, c.margin, c.reason) for c in one] == [(c.verdict, c.margin, c.reason) for c in other]


def test_an_empty_side_and_an_unknown_method_are_refused(fork: Any) -> None:
    with pytest.raises(CaseError, match="0 instruments and 2 targets"):
        judged(fork, [])
    with pytest.raises(CaseError, match="no method 'best'"):
        ReachSettings(method="best")
    assert find_targets(fork.wall, fork.graph, START, (), ReachSettings()) == ()
