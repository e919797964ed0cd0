"""The case file: every wrong key and value is named, and a resolved case reads back as itself."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from segmentation.errors import CaseError
from tubeplan_viz.cases.tube import case_table, case_text, make_case, read_case

MESH: dict[str, Any] = {"mesh": "lumen.stl"}
law = settings(deadline=None, max_examples=40, derandomize=True)


def test_a_case_needs_only_an_input() -> None:
    case = make_case({"input": MESH})
    assert case.planner.name == "tube"
    # The flexible ureteroscope of table 1: bend radius 8 mm, section radius 1.2 mm.
    assert (case.limits.curvature_max, case.limits.clearance_min) == (0.125, 1.2)
    assert case.tube_settings.features.scans == ("nodes",)


WRONG: list[tuple[dict[str, Any], str]] = [
    ({}, "give either a CT .* or a mesh .*, exactly one of them"),
    ({"input": {"ct": "a", "mesh": "b"}}, "exactly one of them"),
    ({"input": MESH, "limit": {}}, r"case\.toml: unknown table 'limit'; expected one of input, limits, planner, tube"),
    ({"input": "lumen.stl"}, r"case\.toml: input is 'lumen\.stl', expected a table \[input\]"),
    ({"input": {"mesh": 5}}, r"case\.toml \[input\] mesh: found 5, expected text"),
    ({"input": {**MESH, "meshes": 1}}, r"case\.toml \[input\]: unknown key 'meshes'"),
    ({"input": {**MESH, "series": 7}}, r"\[input\] series: found 7, expected text"),
    ({"input": {**MESH, "anatomy": "femur"}}, "anatomy is 'femur', expected one of airway, urinary, vessel, generic"),
    ({"input": {**MESH, "anatomy": ["airway"]}}, r"\[input\] anatomy: found \['airway'\], expected text"),
    ({"input": {**MESH, "connectivity": 8}}, "connectivity is 8, expected 6 or 26"),
    ({"input": {**MESH, "connectivity": "6"}}, r"\[input\] connectivity: found '6', expected a whole number"),
    ({"input": {**MESH, "smoothing_mm": -1}}, "smoothing_mm is -1, expected 0 to 10"),
    ({"input": {**MESH, "seed_point": [1, 2, 3]}}, "seed_point was given, which says nothing about a mesh; leave it out"),
    ({"input": {**MESH, "hu_max": "auto"}}, "hu_max was given, which says nothing about a mesh"),
    ({"input": {"ct": "chest", "mesh_unit": "cm"}}, "mesh_unit was given, which says nothing about a CT"),
    ({"input": {**MESH, "smoothing_mm": "much"}}, r"\[input\] smoothing_mm: found 'much', expected a finite number"),
    ({"input": {**MESH, "hu_min": "low"}}, r"\[input\] hu_min: found 'low', expected a number in HU or \"auto\""),
    ({"input": {**MESH, "hu_max": True}}, r"\[input\] hu_max: found True, expected a number"),
    ({"input": {**MESH, "seed_point": [1, 2]}}, r"\[input\] seed_point: found \[1, 2\], expected three numbers in mm"),
    (
        {"input": MESH, "limits": {"curvature": 1}},
        r"\[limits\]: unknown key 'curvature'; expected one of curvature_max, clearance_min",
    ),
    ({"input": MESH, "limits": {"curvature_max": "sharp"}}, r"\[limits\] curvature_max: found 'sharp', expected a finite number"),
    ({"input": MESH, "limits": {"clearance_min": float("nan")}}, r"\[limits\] clearance_min: found nan"),
    ({"input": MESH, "limits": {"curvature_max": 0}}, "curvature_max is 0 1/mm, expected 0.0001 to 10"),
    ({"input": MESH, "limits": []}, r"limits is \[\], expected a table"),
    ({"input": MESH, "planner": {"name": "laser"}}, "there is no planner 'laser' yet"),
    ({"input": MESH, "planner": {"name": 3}}, r"\[planner\] name: found 3, expected text"),
    ({"input": MESH, "planner": {"start": "1 2 3"}}, r"\[planner\] start: found '1 2 3', expected X,Y,Z in mm, or a label"),
    ({"input": MESH, "planner": {"start": "1,2"}}, r"\[planner\] start: found \[1\.0, 2\.0\], expected three numbers"),
    ({"input": MESH, "planner": {"goal": "1,2,x"}}, r"\[planner\] goal: found '1,2,x', expected X,Y,Z in mm"),
    ({"input": MESH, "planner": {"goal": [1, 2, float("inf")]}}, r"\[planner\] goal: found inf, expected a finite number"),
    ({"input": MESH, "planner": {"time_budget": 0}}, "time_budget: found 0 s, expected more than 0"),
    ({"input": MESH, "planner": {"rng_seed": 1.5}}, r"\[planner\] rng_seed: found 1\.5, expected a whole number"),
    ({"input": MESH, "planner": {"rng_seed": -1}}, r"\[planner\] rng_seed: found -1, expected 0 or more"),
    ({"input": MESH, "planner": {"method": "magic"}}, "no method 'magic'"),
    (
        {"input": MESH, "planner": {"method": "feature_iteration"}, "tube": {"objective": "length"}},
        "objective is 'length', which is for --method optimal; feature_iteration has none",
    ),
    ({"input": MESH, "planner": {"closed_ends": "yes"}}, r"\[planner\] closed_ends: found 'yes', expected true or false"),
    ({"input": MESH, "tube": {"sigma": "slow"}}, r"\[tube\] sigma: found 'slow', expected a finite number"),
    ({"input": MESH, "tube": {"sigma": 2}}, "sigma is 2"),
    ({"input": MESH, "tube": {"t5": 2.5}}, r"\[tube\] t5: found 2\.5, expected a whole number"),
    ({"input": MESH, "tube": {"scans": "nodes"}}, r"\[tube\] scans: found 'nodes', expected a list of scan names"),
    ({"input": MESH, "tube": {"scans": ["peaks"]}}, "unknown feature scan 'peaks'"),
    ({"input": MESH, "tube": {"max_rounds": -1}}, "max_rounds is -1, expected 0 or more"),
    ({"input": MESH, "tube": {"sample_spacing_mm": 0}}, "sample_spacing is 0 mm, expected 0.01 to 10"),
    ({"input": MESH, "tube": {"slice_pairs": 0}}, "slice_pairs is 0"),
    ({"input": MESH, "tube": {"aim": 1.2}}, "aim is 1.2, expected 0.5 to 1"),
    ({"input": MESH, "tube": {"short_run_mm": -1}}, "short_run is -1 mm"),
    ({"input": MESH, "tube": {"centerline_step_mm": 0}}, "centerline's step is 0 mm, expected 0.01 to 100"),
    ({"input": MESH, "tube": {"centerline_smoothing_mm": -2}}, "centerline's smoothing is -2 mm"),
    ({"input": MESH, "tube": {"centerline_omega": -2}}, "centerline's omega is -2 1/mm"),
    ({"input": MESH, "tube": {"Sigma": 0.1}}, r"\[tube\]: unknown key 'Sigma'"),
]


@pytest.mark.parametrize(("table", "message"), WRONG)
def test_what_cannot_be_is_refused_by_name(table: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        make_case(table, name="case.toml")


@pytest.mark.parametrize("given", ["e3", " E3 "])
def test_labels_are_read_in_any_case(given: str) -> None:
    assert make_case({"input": MESH, "planner": {"start": given}}).planner.start == "E3"


NUMBER = st.floats(-1e3, 1e3, allow_nan=False)
POINT = st.tuples(NUMBER, NUMBER, NUMBER)


@law
@given(
    start=st.one_of(POINT, st.integers(1, 99).map("E{}".format)),
    goal=POINT,
    seed_point=st.none() | POINT,
    hu=st.none() | st.just("auto") | st.floats(-1024, 3071),
    curvature=st.floats(1e-3, 5.0),
    clearance=st.floats(0.0, 50.0),
    sigma=st.floats(1e-5, 0.5),
    scans=st.lists(st.sampled_from(["extrema", "segments", "nodes"]), unique=True),
    rounds=st.integers(0, 10_000),
)
def test_a_resolved_case_reads_back_as_itself(
    start: Any,
    goal: Any,
    seed_point: Any,
    hu: Any,
    curvature: float,
    clearance: float,
    sigma: float,
    scans: Any,
    rounds: int,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    folder = tmp_path_factory.getbasetemp()
    table = {
        "input": {"ct": "series", "anatomy": "airway", "seed_point": seed_point, "hu_max": hu},
        "limits": {"curvature_max": curvature, "clearance_min": clearance},
        "planner": {"start": start, "goal": goal},
        "tube": {"sigma": sigma, "scans": scans, "max_rounds": rounds},
    }
    case = make_case(table, folder=folder)
    again = make_case(tomllib.loads(case_text(case, folder)), folder=folder)
    assert again == case


def test_every_default_stands_in_the_resolved_case(tmp_path: Path) -> None:
    table = tomllib.loads(case_text(make_case({"input": MESH}), tmp_path))
    assert table["limits"] == {"curvature_max": 0.125, "clearance_min": 1.2}
    assert table["tube"]["sigma"] == 0.001
    assert table["tube"]["centerline_step_mm"] == 1.0
    assert table["planner"]["method"] == "optimal"


def test_paths_are_relative_to_the_case_file_wherever_it_stands(tmp_path: Path) -> None:
    (tmp_path / "cases").mkdir()
    file = tmp_path / "cases" / "one.toml"
    file.write_text('[input]\nmesh = "../meshes/lumen.stl"\n')
    case = read_case(file)
    assert case.input.mesh == (tmp_path / "meshes" / "lumen.stl").resolve()
    assert case_table(case, folder=tmp_path / "run")["input"]["mesh"] == "../meshes/lumen.stl"
    # Without a folder the table may be shown: no path of this machine.
    assert case_table(case)["input"]["mesh"] == "lumen.stl"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[input\n", r"case\.toml: not valid TOML"),
        (b"[input]\nmesh = 'a'\nmesh = 'b'\n", r"case\.toml: not valid TOML"),
        (b"\xff\xfe\x00", r"case\.toml: cannot be read \(no utf-8 text\); expected a case file in TOML"),
        (None, r"case\.toml: no such case file"),
    ],
)
def test_a_file_that_is_no_case_is_refused(content: bytes | None, message: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "case.toml").write_bytes(content)
    with pytest.raises(CaseError, match=message):
        read_case(tmp_path / "case.toml")


def test_a_folder_is_no_case_file(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="cannot be read"):
        read_case(tmp_path)
