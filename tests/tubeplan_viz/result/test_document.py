"""result.json: its shape, its numbers, its schema."""

from __future__ import annotations

import copy
import getpass
import json
import platform
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from tubeplan_viz.plan import FlagKind, Limits, Plan, PlanStatus
from tubeplan_viz.result import Provenance, ResultError, build_result, plain, result_schema, result_text, validate_result

SPEC_KEYS = [  # in the order that programs and readers find them in
    "schema_version",
    "status",
    "reason",
    "planner",
    "frame",
    "limits",
    "path",
    "spline",
    "centerline",
    "feature_points",
    "metrics",
    "certificate",
    "flagged_intervals",
    "iterations",
    "details",
    "timings_s",
    "provenance",
]


@pytest.fixture(scope="module")
def plan(bent_tube: Any) -> Plan:
    flagged: Plan = bent_tube.plan(Limits(curvature_max=0.0665, clearance_min=2.75))
    return flagged


@pytest.fixture(scope="module")
def built(plan: Plan) -> dict[str, Any]:
    return build(plan)


def build(plan: Plan, **changes: Any) -> dict[str, Any]:
    arguments: dict[str, Any] = {
        "frame": "LPS",
        "timings_s": {"plan": 1.25},
        "provenance": Provenance(
            inputs=(("DICOM series, 100 files", "ab" * 32),), rng_seed=7, settings={"start": (1.0, 2.0, 3.0)}
        ),
    }
    return build_result(plan, **(arguments | changes))


def test_keys_are_those_of_the_product_page_in_its_order(built: dict[str, Any]) -> None:
    assert list(built) == SPEC_KEYS
    assert list(built["path"]) == ["s_mm", "points_mm", "curvature_per_mm", "clearance_mm"]
    assert list(built["certificate"]) == ["holds", "curvature_upper_bound_per_mm", "clearance_lower_bound_mm", "method"]
    assert list(built["iterations"][0]) == [
        "index",
        "feature_count",
        "curvature_max_per_mm",
        "clearance_min_mm",
        "moved",
        "added",
    ]
    assert list(built["metrics"])[:7] == list(result_schema()["properties"]["metrics"]["required"])


def test_numbers_are_those_of_the_plan(plan: Plan, built: dict[str, Any]) -> None:
    assert built["path"]["points_mm"] == plan.profile.points.tolist()
    assert built["spline"]["control_points_mm"] == plan.curve.control_points.tolist()
    assert [flag["kind"] for flag in built["flagged_intervals"]] == [str(flag.kind) for flag in plan.flagged]
    assert [flag["to_mm"] for flag in built["flagged_intervals"]] == [flag.end for flag in plan.flagged]
    assert [feature["kind"] for feature in built["feature_points"]] == ["start", "node", "goal"]
    assert built["feature_points"][-1]["s_mm"] == pytest.approx(plan.profile.length, abs=1e-9)
    assert built["iterations"][0]["clearance_min_mm"] == plan.profile.clearance.min()


def test_text_reads_back_to_the_same_numbers(built: dict[str, Any]) -> None:
    text = result_text(built)
    assert json.loads(text) == built
    assert result_text(json.loads(text)) == text
    assert max(map(len, text.splitlines())) < 20_000


NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
LEAVES = st.none() | st.booleans() | st.integers() | NUMBERS | st.text(max_size=5)


@given(
    st.recursive(
        LEAVES, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4), max_leaves=12
    )
)
@settings(max_examples=50, deadline=None)
def test_layout_is_json_for_any_content(value: Any) -> None:
    assert json.loads(result_text({"key": value})) == {"key": value}


def test_metrics_that_do_not_apply_are_null(plan: Plan) -> None:
    metrics = {name: value for name, value in plan.metrics.items() if name != "tip_error_mm"}
    assert build(replace(plan, metrics=metrics | {"swept_ml": 0.5}))["metrics"] == {
        **metrics,
        "tip_error_mm": None,
        "swept_ml": 0.5,
    }


def test_provenance_names_no_machine_and_no_user(built: dict[str, Any]) -> None:
    provenance = built["provenance"]
    text = json.dumps(provenance)
    assert platform.node() not in text
    assert getpass.getuser() not in provenance["platform"].split()
    assert provenance["platform"].startswith(platform.system())
    assert provenance["inputs"] == [{"name": "DICOM series, 100 files", "sha256": "ab" * 32}]
    assert provenance["settings"] == {"start": [1.0, 2.0, 3.0]}


def test_schema_is_a_schema_and_describes_each_table() -> None:
    Draft202012Validator.check_schema(result_schema())
    for key, table in result_schema()["properties"].items():
        assert "description" in table or key in {"planner", "limits", "provenance"}, key


def test_numbers_that_are_not_finite_are_refused_with_their_key(plan: Plan) -> None:
    with pytest.raises(ResultError, match=r"details\.growth\.1 is nan"):
        build(plan, details={"growth": [1.0, np.nan]})
    with pytest.raises(ResultError, match=r"metrics\.length_mm is inf"):
        build(replace(plan, metrics={**plan.metrics, "length_mm": float("inf")}))
    with pytest.raises(ResultError, match=r"details\.what is of type object"):
        build(plan, details={"what": object()})


def test_details_of_planner_and_pipeline_do_not_overwrite_each_other(plan: Plan) -> None:
    assert build(plan, details={"image": {"kVp": 120}})["details"] == {"closed_ends": False, "image": {"kVp": 120}}
    with pytest.raises(ResultError, match="closed_ends"):
        build(plan, details={"closed_ends": True})


def test_plain_turns_arrays_scalars_and_enumerations_into_json() -> None:
    value = {
        "a": np.arange(3),
        "b": np.float64(0.1),
        "c": (FlagKind.CLEARANCE, np.bool_(True)),
        "d": np.array([[1.5, 2.5]]),
        5: None,
    }
    assert plain(value) == {"a": [0, 1, 2], "b": 0.1, "c": ["clearance", True], "d": [[1.5, 2.5]], "5": None}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: r.pop("iterations"), "iterations"),
        (lambda r: r.update(extra=1), "extra"),
        (lambda r: r.update(status="fine"), "at status"),
        (lambda r: r.update(status="ok"), "at (reason|flagged_intervals)"),
        (lambda r: r.update(reason=None), "at reason"),
        (lambda r: r.update(flagged_intervals=[]), "at flagged_intervals"),
        (lambda r: r.update(frame="RAS"), "at frame"),
        (lambda r: r["limits"].update(clearance_min_mm="1.2"), r"at limits\.clearance_min_mm"),
        (lambda r: r["path"]["points_mm"][4].pop(), r"at path\.points_mm\.4"),
        (lambda r: r["path"]["clearance_mm"].pop(), "one length"),
        (lambda r: r["path"]["s_mm"].__setitem__(0, 0.1), "start at 0"),
        (lambda r: [values.pop(7) for values in r["path"].values()], "at most 0.25 mm"),
        (lambda r: r["spline"]["knots"].pop(), "knots for"),
        (lambda r: r["spline"]["knots"].__setitem__(0, 0.1), "not clamped"),
        (lambda r: r["spline"]["knots"].__setitem__(5, 0.01), "not clamped"),
        (lambda r: r["centerline"]["radius_mm"].pop(), "radii"),
        (lambda r: r["flagged_intervals"][0].update(to_mm=900.0), "runs from"),
        (lambda r: r["certificate"].pop("method"), "at certificate"),
        (lambda r: r.update(spline=None), "at spline"),
        (lambda r: r["provenance"]["inputs"][0].update(name="/data/ct/a.nii"), r"at provenance\.inputs\.0\.name"),
    ],
)
def test_results_that_are_not_valid(built: dict[str, Any], change: Callable[[dict[str, Any]], object], words: str) -> None:
    broken = copy.deepcopy(built)
    change(broken)
    with pytest.raises(ResultError, match=words):
        validate_result(broken)


def test_outcome_without_any_path_is_valid(built: dict[str, Any]) -> None:
    nothing = built | {
        "status": "infeasible",
        "reason": "the lumen is narrower than the limit everywhere",
        "path": None,
        "spline": None,
        "centerline": None,
        "feature_points": None,
        "certificate": None,
        "iterations": None,
        "flagged_intervals": [],
        "metrics": dict.fromkeys(built["metrics"]),
    }
    validate_result(nothing)
    with pytest.raises(ResultError, match="at path"):
        validate_result(nothing | {"status": "flagged", "flagged_intervals": built["flagged_intervals"]})


def test_status_is_the_plans(plan: Plan, built: dict[str, Any]) -> None:
    assert built["status"] == "flagged"
    assert build(replace(plan, status=PlanStatus.INFEASIBLE))["status"] == "infeasible"
