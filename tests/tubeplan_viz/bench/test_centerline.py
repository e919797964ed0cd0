"""The centerline benchmark: what it measures with is right, and peers that are missing are named."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from tubeplan_viz.bench.centerline import (
    Timed,
    Trial,
    between_ends,
    method_rows,
    off_axis,
    open_row,
    radius_rows,
    timed_rows,
    trials,
)
from tubeplan_viz.bench.centerline_methods import voxelized
from tubeplan_viz.bench.models import bent_cylinder_1
from tubeplan_viz.bench.peers import VMTK_RUNS_ON
from tubeplan_viz.bench.trees import renal_tree
from tubeplan_viz.geometry import WallDistance


@pytest.fixture(scope="module")
def quick() -> list[Trial]:
    """Cylinder 1 and the renal tree."""
    return trials(quick=True)


def test_voxels_are_those_whose_middle_lies_inside() -> None:
    model = bent_cylinder_1()
    filled, lower = voxelized(model.surface, 0.7)
    # The bends lie in one plane of the lattice, whose sections through a circle of 6 mm miss its area by up to 2 %.
    assert filled.sum() * 0.7**3 == pytest.approx(model.surface.volume_ml * 1000.0, rel=0.02)
    index = np.random.default_rng(1).integers(0, filled.shape, (4000, 3))
    inside = WallDistance(model.surface).inside(lower + 0.7 * index)
    np.testing.assert_array_equal(filled[tuple(index.T)], inside)


def test_distance_to_the_axes_of_a_tree_is_that_of_planted_offsets() -> None:
    model = renal_tree(voxel=1.0)
    branch = model.branches[0]
    s = np.linspace(20.0, 120.0, 50)
    points, frames = branch.axis.at(s)
    found = model.off_axis(points + 0.25 * frames[:, :, 2], end_length=5.0, junction_radii=2.5)
    np.testing.assert_allclose(found, 0.25, atol=1e-4)
    # At the very ends nothing counts.
    assert len(model.off_axis(branch.axis.at(np.array([1.0, 139.0]))[0], end_length=5.0, junction_radii=2.5)) == 0


def test_a_tree_is_one_closed_surface_with_a_cap_at_every_tip() -> None:
    model = renal_tree(voxel=1.0)
    faces = model.surface.faces
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    assert len(model.surface.vertices) - len(edges) + len(faces) == 2
    assert len(model.surface.caps) == 1 + len(model.targets)
    assert WallDistance(model.surface).inside(model.targets).all()


def test_ends_do_not_count_towards_the_error() -> None:
    model = bent_cylinder_1()
    counted = between_ends(model.axis_points, model)
    assert not counted[:40].any()
    assert counted[60:-60].all()
    assert off_axis(model.axis_points[60:-60] + np.array([0.0, 0.0, 0.1]), model)[0] == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize("number", [0, 1], ids=["cylinder 1", "renal tree"])
def test_ours_holds_its_targets_in_a_process_of_its_own(number: int, quick: list[Trial]) -> None:
    rows = {row.figure: row for row in method_rows(quick[number], "tubeplan")}
    assert rows["points inside %"].holds
    assert rows["interior error mm, mean"].holds
    assert rows["interior error mm, largest"].holds
    assert rows["peak memory MB"].holds
    assert rows["warm, mesh file to lines, CPU s"].ours > 0.0


def test_line_and_radius_hold_on_another_meshing_and_on_an_open_mesh() -> None:
    rows = [*radius_rows("", bent_cylinder_1(meshing="structured")), open_row("", bent_cylinder_1(meshing="structured"))]
    assert [row.figure for row in rows if not row.holds] == []


def test_a_peer_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch, quick: list[Trial]) -> None:
    module = sys.modules[method_rows.__module__]
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    monkeypatch.setattr(module, "vmtk_python", lambda: None)
    trial = quick[0]
    for method, said in (("kimimaro", "not installed: kimimaro"), ("VMTK", f"not installed: {VMTK_RUNS_ON}")):
        (row,) = method_rows(trial, method)
        assert row.figure.startswith("installed")
        assert row.ours == 0.0
        assert row.source == said


def test_a_method_that_fails_says_why(quick: list[Trial]) -> None:
    trial = quick[0]
    outside = replace(trial, ends=trial.ends + 500.0)
    (row,) = method_rows(outside, "tubeplan")
    assert row.figure == "failed (exit status)"
    assert "lies in no inscribed sphere" in row.source


def test_a_line_that_breaks_off_near_an_end_is_shown_without_an_error_of_its_own(quick: list[Trial]) -> None:
    trial = quick[0]
    broken = Timed(points=trial.ends[:1] + np.array([[0.0, 1.0, 0.0]]), cold=1.0, warm=1.0, whole=2.0, peak=100.0)
    rows = {row.figure: row for row in timed_rows("peer", trial, broken, aimed=False)}
    assert rows["points away from ends and junctions"].ours == 0
    assert not any("interior error" in figure for figure in rows)
    # Of ours that would be a failure.
    assert timed_rows("ours", trial, broken, aimed=True)[0].holds is False
