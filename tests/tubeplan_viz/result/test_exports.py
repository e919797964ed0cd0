"""path.csv and path.mrk.json."""

from __future__ import annotations

import csv
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tubeplan_viz.plan import Limits, Plan
from tubeplan_viz.result import CSV_COLUMNS, Provenance, build_result, path_csv, slicer_markups
from tubeplan_viz.result.exports import CHORD_ERROR_MM, CONTROL_SPACING_MM, curve_controls


@pytest.fixture(scope="module")
def plan(bent_tube: Any) -> Plan:
    made: Plan = bent_tube.plan(Limits(curvature_max=0.09, clearance_min=2.2))
    return made


@pytest.fixture(scope="module", params=["LPS", "mesh"])
def result(plan: Plan, request: pytest.FixtureRequest) -> dict[str, Any]:
    return build_result(plan, frame=request.param, timings_s={}, provenance=Provenance(inputs=(), rng_seed=None))


def test_table_reads_back_to_the_last_digit(plan: Plan) -> None:
    header, *rows = csv.reader(path_csv(plan.profile).splitlines())
    assert tuple(header) == CSV_COLUMNS
    table = np.array(rows, dtype=float)
    profile = plan.profile
    for columns, expected in [
        (table[:, 0], profile.arc_length),
        (table[:, 1:4], profile.points),
        (table[:, 4:7], profile.tangents),
        (table[:, 7], profile.curvature),
        (table[:, 8], profile.torsion),
        (table[:, 9], profile.clearance),
    ]:
        assert columns.tolist() == expected.tolist()


def test_markups_are_an_lps_curve_in_mm_and_its_features(result: dict[str, Any]) -> None:
    document = slicer_markups(result)
    curve, features = document["markups"]
    assert document["@schema"].endswith("markups-schema-v1.0.3.json#")
    assert (curve["type"], features["type"]) == ("Curve", "Fiducial")
    assert {markup["coordinateSystem"] for markup in document["markups"]} == {"LPS"}
    assert {markup["coordinateUnits"] for markup in document["markups"]} == {"mm"}
    assert all(("mesh frame" in markup["name"]) == (result["frame"] == "mesh") for markup in document["markups"])
    assert [point["position"] for point in features["controlPoints"]] == [point["point_mm"] for point in result["feature_points"]]
    assert [point["label"].split()[0] for point in features["controlPoints"]] == ["start", "node", "goal"]
    ids = [point["id"] for point in curve["controlPoints"]]
    assert len(set(ids)) == len(ids)


def test_thinned_curve_keeps_to_the_path(result: dict[str, Any]) -> None:
    points = np.array(result["path"]["points_mm"])
    kept = curve_controls(points)
    assert kept[0] == 0
    assert kept[-1] == len(points) - 1
    assert len(kept) < len(points) / 4
    for first, last in pairwise(kept):
        chord = points[last] - points[first]
        inside = points[first : last + 1] - points[first]
        off = np.linalg.norm(inside - np.outer(inside @ chord / (chord @ chord), chord), axis=1)
        assert off.max() <= CHORD_ERROR_MM
        assert np.linalg.norm(np.diff(points[first : last + 1], axis=0), axis=1).sum() <= CONTROL_SPACING_MM + 0.25


def test_straight_path_is_thinned_by_spacing_alone() -> None:
    points = np.linspace([0.0, 0.0, 0.0], [100.0, 0.0, 0.0], 401)
    kept = curve_controls(points)
    # Halving 100 mm until no stretch is over 5 mm leaves 32 stretches of 3.125 mm.
    assert len(kept) == 33
    assert np.diff(points[kept, 0]).max() <= 5.0


def test_two_points_are_both_kept() -> None:
    assert curve_controls(np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])).tolist() == [0, 1]
