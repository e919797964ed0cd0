"""The recorded examples, run again and compared column by column."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tubeplan_viz.bench.examples import EXAMPLES, KEPT, write_example_mesh
from tubeplan_viz.cases.tube import read_case
from tubeplan_viz.pipeline import RunOptions, run_tube
from tubeplan_viz.recording import read_recording
from tubeplan_viz.recording.readback import RecordedRun

RECORDED = Path(__file__).parents[2] / "datasets" / "recorded"
LARGEST = 500_000
# Everything is computed in double precision by fixed steps, so another machine differs by rounding alone: other
# instruction sets sum in another order (1e-16 each), the Voronoi vertices of nearly cospherical points amplify that
# to about 1e-9, and the iteration to about 1e-8. A thousand times that is still far below a micrometre.
TOLERANCE_MM = 1e-5
TOLERANCE_PER_MM = 1e-6

pytestmark = pytest.mark.parametrize("name", sorted(EXAMPLES))


@dataclass(frozen=True, eq=False)
class Pair:
    """An example as it was recorded and as it comes out now."""

    old: dict[str, Any]
    new: dict[str, Any]
    old_recording: RecordedRun
    new_recording: RecordedRun


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Pair]:
    """An example by name, run once from its recorded case file."""

    @cache
    def run(name: str) -> Pair:
        folder = tmp_path_factory.mktemp(name)
        write_example_mesh(name, folder)
        (folder / name).mkdir()
        shutil.copyfile(RECORDED / name / "case.toml", folder / name / "case.toml")
        run_tube(read_case(folder / name / "case.toml"), folder / "again", RunOptions(report=False, light=True))
        results = [json.loads((place / "result.json").read_text()) for place in (RECORDED / name, folder / "again")]
        recordings = [read_recording(place / "recording.rrd") for place in (RECORDED / name, folder / "again")]
        # Settings may be added later; those that were recorded stay as they are.
        old, new = (tomllib.loads((place / "case.toml").read_text()) for place in (RECORDED / name, folder / "again"))
        for table, values in old.items():
            assert {key: new[table].get(key) for key in values} == values
        return Pair(*results, *recordings)

    return run


def test_an_example_has_its_three_files_and_a_small_recording(name: str) -> None:
    assert sorted(file.name for file in (RECORDED / name).iterdir()) == sorted(KEPT)
    assert (RECORDED / name / "recording.rrd").stat().st_size < LARGEST


def test_status_reason_and_counts_are_the_same(name: str, pair: Callable[[str], Pair]) -> None:
    old, new = pair(name).old, pair(name).new
    for key in ("status", "reason", "planner", "frame", "limits"):
        assert new[key] == old[key], key
    assert len(new["iterations"]) == len(old["iterations"])
    for before, after in zip(old["iterations"], new["iterations"], strict=True):
        for key in ("index", "feature_count", "moved", "added"):
            assert after[key] == before[key], (before["index"], key)
        assert after["curvature_max_per_mm"] == pytest.approx(before["curvature_max_per_mm"], abs=TOLERANCE_PER_MM)
        assert after["clearance_min_mm"] == pytest.approx(before["clearance_min_mm"], abs=TOLERANCE_MM)


def test_path_curvature_and_clearance_are_the_same(name: str, pair: Callable[[str], Pair]) -> None:
    old, new = pair(name).old["path"], pair(name).new["path"]
    for key, tolerance in (
        ("s_mm", TOLERANCE_MM),
        ("points_mm", TOLERANCE_MM),
        ("clearance_mm", TOLERANCE_MM),
        ("curvature_per_mm", TOLERANCE_PER_MM),
    ):
        np.testing.assert_allclose(new[key], old[key], rtol=0.0, atol=tolerance, err_msg=key)


def test_centerline_features_and_spline_are_the_same(name: str, pair: Callable[[str], Pair]) -> None:
    old, new = pair(name).old, pair(name).new
    for key in ("points_mm", "radius_mm"):
        np.testing.assert_allclose(new["centerline"][key], old["centerline"][key], rtol=0.0, atol=TOLERANCE_MM)
    assert [f["kind"] for f in new["feature_points"]] == [f["kind"] for f in old["feature_points"]]
    for key in ("point_mm", "s_mm"):
        found, expected = ([f[key] for f in result["feature_points"]] for result in (new, old))
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=TOLERANCE_MM)
    np.testing.assert_allclose(new["spline"]["knots"], old["spline"]["knots"], rtol=0.0, atol=1e-7)
    found, expected = (result["spline"]["control_points_mm"] for result in (new, old))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=TOLERANCE_MM)


def test_flagged_intervals_are_the_same(name: str, pair: Callable[[str], Pair]) -> None:
    old, new = pair(name).old["flagged_intervals"], pair(name).new["flagged_intervals"]
    assert [flag["kind"] for flag in new] == [flag["kind"] for flag in old]
    for before, after in zip(old, new, strict=True):
        # An end moves by the change of clearance over its slope, which is 0.1 or more where a limit is crossed.
        for key in ("from_mm", "to_mm"):
            assert after[key] == pytest.approx(before[key], abs=10.0 * TOLERANCE_MM)
        assert after["worst"] == pytest.approx(before["worst"], abs=TOLERANCE_MM)
        # Where the clearance is flat the place of its least value is loose: compared to the spacing of the samples.
        assert after["worst_at_mm"] == pytest.approx(before["worst_at_mm"], abs=0.05)


def test_metrics_and_certificate_are_the_same(name: str, pair: Callable[[str], Pair]) -> None:
    old, new = pair(name).old, pair(name).new
    assert new["metrics"].keys() == old["metrics"].keys()
    for key, value in old["metrics"].items():
        assert new["metrics"][key] == pytest.approx(value, abs=TOLERANCE_MM), key
    assert new["certificate"]["holds"] == old["certificate"]["holds"]
    # Bounds are subdivided until they are within 0.5 % and 0.01 mm; rounding may end that one level earlier.
    for key, tolerance in (("curvature_upper_bound_per_mm", 5e-4), ("clearance_lower_bound_mm", 0.01)):
        assert new["certificate"][key] == pytest.approx(old["certificate"][key], abs=tolerance)


def test_the_recording_has_the_same_entities_timelines_and_iterations(name: str, pair: Callable[[str], Pair]) -> None:
    old, new = pair(name).old_recording, pair(name).new_recording
    assert new.entities == old.entities
    assert new.timelines == old.timelines
    assert new.case == old.case
    assert [step.index for step in new.iterations] == [step.index for step in old.iterations]
    for before, after in zip(old.iterations, new.iterations, strict=True):
        assert [f.kind for f in after.features] == [f.kind for f in before.features]
        np.testing.assert_allclose([f.point for f in after.features], [f.point for f in before.features], atol=TOLERANCE_MM)
        np.testing.assert_allclose(after.arc_length, before.arc_length, rtol=0.0, atol=TOLERANCE_MM)
        np.testing.assert_allclose(after.curvature, before.curvature, rtol=0.0, atol=TOLERANCE_PER_MM)
        np.testing.assert_allclose(after.clearance, before.clearance, rtol=0.0, atol=TOLERANCE_MM)
        np.testing.assert_allclose(after.curve.control_points, before.curve.control_points, rtol=0.0, atol=TOLERANCE_MM)
        assert [flag.kind for flag in after.flagged] == [flag.kind for flag in before.flagged]


def test_the_recording_agrees_with_its_own_result(name: str) -> None:
    result = json.loads((RECORDED / name / "result.json").read_text())
    recording = read_recording(RECORDED / name / "recording.rrd")
    assert [step.index for step in recording.iterations] == [step["index"] for step in result["iterations"]]
    for step, written in zip(recording.iterations, result["iterations"], strict=True):
        assert step.facts["features"] == written["feature_count"]
        assert step.facts["curvature_max_per_mm"] == written["curvature_max_per_mm"]
        assert step.facts["clearance_min_mm"] == written["clearance_min_mm"]
    np.testing.assert_array_equal(recording.iterations[-1].curve.control_points, result["spline"]["control_points_mm"])
