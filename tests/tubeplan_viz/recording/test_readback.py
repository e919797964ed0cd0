"""A recording read back equals what was put in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tubeplan_viz.plan import FlagKind, Limits, broken
from tubeplan_viz.recording import RecordedRun, read_recording


def test_every_iteration_is_there_once_and_in_order(run: Any, recorded: RecordedRun) -> None:
    assert [iteration.index for iteration in recorded.iterations] == [step.index for step in run.steps]


def test_splines_and_profiles_read_back_bit_for_bit(run: Any, recorded: RecordedRun) -> None:
    for step, read in zip(run.steps, recorded.iterations, strict=True):
        assert read.curve.degree == step.curve.degree
        np.testing.assert_array_equal(read.curve.knots, step.curve.knots)
        np.testing.assert_array_equal(read.curve.control_points, step.curve.control_points)
        np.testing.assert_array_equal(read.arc_length, step.profile.arc_length)
        np.testing.assert_array_equal(read.curvature, step.profile.curvature)
        np.testing.assert_array_equal(read.clearance, step.profile.clearance)


def test_features_flags_and_facts_read_back_exactly(run: Any, recorded: RecordedRun) -> None:
    for step, read in zip(run.steps, recorded.iterations, strict=True):
        assert [(f.kind, f.u, f.moved, f.point.tolist()) for f in read.features] == [
            (f.kind, f.u, f.moved, f.point.tolist()) for f in step.features
        ]
        assert sorted(read.flagged, key=lambda flag: (flag.kind, flag.start)) == sorted(
            step.flagged, key=lambda flag: (flag.kind, flag.start)
        )
        assert read.facts == {
            "curvature_max_per_mm": step.profile.curvature.max(),
            "clearance_min_mm": step.profile.clearance.min(),
            "length_mm": step.profile.length,
            "features": len(step.features),
            "moved": step.moved,
            "added": step.added,
        }


def test_the_planned_path_reads_back_as_result_json_has_it(run: Any, recorded: RecordedRun) -> None:
    planned, path = recorded.planned, run.result["path"]
    assert planned is not None
    assert planned.arc_length.tolist() == path["s_mm"]
    assert planned.curvature.tolist() == path["curvature_per_mm"]
    assert planned.clearance.tolist() == path["clearance_mm"]
    assert [feature.point.tolist() for feature in planned.features] == [
        feature["point_mm"] for feature in run.result["feature_points"]
    ]
    assert planned.flagged == ()


def test_the_run_flags_both_limits_first_and_none_at_last(run: Any) -> None:
    # Else the tests around it would compare empty lists.
    assert {flag.kind for flag in run.steps[0].flagged} == set(FlagKind)
    assert run.steps[-1].flagged == ()


def test_samples_drawn_as_flagged_are_those_that_break_a_limit(run: Any, recorded: RecordedRun, limits: Limits) -> None:
    for step, read in zip(run.steps, recorded.iterations, strict=True):
        bent, close = broken(step.profile, limits)
        np.testing.assert_array_equal(read.flagged_samples[FlagKind.CURVATURE], bent)
        np.testing.assert_array_equal(read.flagged_samples[FlagKind.CLEARANCE], close)


def test_convergence_curves_are_the_extremes_over_their_limits(run: Any, recorded: RecordedRun, limits: Limits) -> None:
    for step, read in zip(run.steps, recorded.iterations, strict=True):
        assert read.convergence == {
            "curvature": step.profile.curvature.max() / limits.curvature_max,
            "clearance": step.profile.clearance.min() / limits.clearance_min,
            "limit": 1.0,
        }


def test_the_drawn_curve_lies_on_the_spline_from_end_to_end(run: Any, recorded: RecordedRun) -> None:
    for step, read in zip(run.steps, recorded.iterations, strict=True):
        near = np.linalg.norm(read.curve_points[:, None] - step.profile.points[None], axis=2)
        # Single precision of coordinates near 100 mm: half of 2^-17 mm an axis.
        assert near.min(axis=1).max() < 1e-5
        assert near[0].argmin() == 0
        assert near[-1].argmin() == len(step.profile.points) - 1


def test_entities_and_timelines_are_those_of_the_specification(recorded: RecordedRun) -> None:
    assert recorded.timelines == ("arc_length", "iteration")
    entities = set(recorded.entities)
    assert {entity for entity in entities if not entity.startswith("/case")} == {"/__properties", "/__properties/case"}
    named = {
        "/case/anatomy/wall",
        "/case/anatomy/caps",
        "/case/centerline",
        "/case/ct/volume",
        "/case/ct/mask",
        "/case/decisions",
        "/case/summary",
        "/case/path/curve",
        "/case/path/flagged/curvature",
        "/case/path/flagged/clearance",
        "/case/features/start",
        "/case/features/goal",
        "/case/features/node",
        "/case/features/extremum",
        "/case/convergence/curvature",
        "/case/convergence/clearance",
        "/case/growth/1_chosen",
        "/case/growth/2_leak",
        "/case/walk/instrument",
        "/case/walk/camera",
        *(f"/case/profile/{kind}/{part}" for kind in FlagKind for part in ("0_limit", "1_ok", "2_flagged", "3_here")),
        *(f"/case/ct/{plane}/{part}" for plane in ("axial", "coronal", "sagittal") for part in ("0_image", "2_path")),
    }
    assert named <= entities
    assert "/case/features/inflection" not in entities


def test_the_log_tells_every_decision_at_its_iteration(run: Any, recorded: RecordedRun) -> None:
    for step in run.steps:
        assert (step.index, "INFO", f"decision {step.index}") in recorded.decisions
    levels = {index: level for index, level, text in recorded.decisions if text.startswith("iteration ")}
    assert levels == {step.index: "WARN" if step.flagged else "INFO" for step in run.steps}


def test_the_summary_ends_with_the_research_notice(recorded: RecordedRun) -> None:
    assert recorded.summary.startswith("## Every limit holds")
    assert recorded.summary.endswith("*Research use, not for clinical decisions.*")
    assert recorded.case["notice"] == "Research use, not for clinical decisions."
    assert recorded.case["planner"] == "tube"


def test_the_walk_follows_the_planned_path_in_tenths_of_a_millimetre(run: Any, recorded: RecordedRun) -> None:
    profile = run.steps[-1].profile
    assert recorded.walk_ticks[0] == 0
    assert profile.length - recorded.walk_ticks[-1] / 10.0 < 0.1
    expected = run.steps[-1].curve(run.steps[-1].curve.parameter(recorded.walk_ticks / 10.0))
    # Chords of 0.25 mm on bends wider than 10 mm stray 0.25^2 / 8 / 10 mm from the curve; then single precision.
    np.testing.assert_allclose(recorded.walk_points, expected, atol=1e-3)


def test_a_light_recording_keeps_the_exact_curves_and_the_extremes(run: Any, light_file: Path, recorded_file: Path) -> None:
    light = read_recording(light_file)
    assert not any(entity.startswith("/case/ct") for entity in light.entities)
    for step, read in zip(run.steps, light.iterations, strict=True):
        np.testing.assert_array_equal(read.curve.control_points, step.curve.control_points)
        # Plots are in single precision there: a relative error of 2^-24.
        assert read.curvature.max() == pytest.approx(step.profile.curvature.max(), rel=1e-7)
        assert read.clearance.min() == pytest.approx(step.profile.clearance.min(), rel=1e-7)
        assert 3 * len(read.arc_length) < len(step.profile.arc_length)
    assert light_file.stat().st_size < min(500_000, 0.7 * recorded_file.stat().st_size)
