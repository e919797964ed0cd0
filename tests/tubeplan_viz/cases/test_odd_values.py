"""Every key of a case of every planner under every odd value: a case or one short sentence, and nothing else."""

from __future__ import annotations

import copy
import datetime
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from segmentation.errors import CaseError, TubeplanError
from tubeplan_viz.cases.tube import case_table
from tubeplan_viz.planners import make_case

MESH = {"input": {"mesh": "tube.stl", "case_id": "a", "part": "x", "mesh_unit": "mm"}}
SPACE = {"planner": {"name": "needle3d", "rng_seed": 1, "time_budget": 9.0}, "needle3d": {"target": [0.0, 0.0, 90.0]}}
CASES: dict[str, dict[str, Any]] = {
    "tube": {
        **case_table(make_case({**MESH, "planner": {"start": "E1", "goal": [1.0, 2.0, 3.0], "tolerance": [2.0, 2.0]}})),
        "measures": {
            "ureter_level_mm": 20.0,
            "abnormal_anatomy": True,
            "stones": [[1, 2, 3]],
            "stone_masks": ["a.nii"],
            "structures": [{"name": "a", "file": "b.nii"}],
        },
    },
    "ct": {
        "input": {"ct": "x", "anatomy": "airway", "seed_point": [1, 2, 3], "hu_min": -900, "hu_max": "auto", "smoothing_mm": 1.0},
        "planner": {"start": "E1", "goal": "E2"},
    },
    "needle2d": {
        "planner": {"name": "needle2d"},
        "needle2d": {"entry": [0, 0], "target": [0, 90.0], "radius_mm": 50.0, "degree_max": 3, "safety_mm": 1.0},
        "obstacles": [
            {"kind": "circle", "center": [0, 40], "radius_mm": 5.0},
            {"kind": "polygon", "points": [[9, 30], [14, 30], [9, 40]]},
        ],
    },
    "needle3d": {
        **SPACE,
        "obstacles": [
            {"kind": "sphere", "center": [0, 5, 40], "radius_mm": 5.0},
            {"kind": "capsule", "points": [[9, 0, 0], [9, 2, 3]], "radius_mm": 2.0},
            {"kind": "mesh", "file": "a.stl"},
            {"kind": "mask", "file": "a.nii", "hu_min": 2, "hu_max": 5, "seed_point": [1, 2, 3], "series": "s"},
        ],
        "events": [{"at_mm": 20.0, "obstacle": 1, "center": [0, 6, 40]}, {"at_mm": 40.0, "kappa": 0.015}],
        "monte_carlo": {"runs": 10, "curvature_error": 0.05, "tip_noise_mm": 0.1, "target_motion_mm": 0.5},
    },
    "rigid": {
        "planner": {"name": "rigid"},
        "input": {"ct": "x"},
        "rigid": {
            "side": "left",
            "lesion": [1, 2, 3],
            "masks": {"septum": "a.nii"},
            "seeds": {"septum": [1, 2, 3]},
            "boxes": {"brain": [0, 0, 0, 1, 1, 1]},
            "rolls": 3,
        },
    },
    "bronchoscope": {
        "planner": {"name": "bronchoscope", "goal": "RB1", "method": "kinematic"},
        "input": {"mesh": "x.stl"},
        "limits": {"curvature_max": 0.2, "clearance_min": 1.0},
        "bronchoscope": {"diameter_mm": 3.0, "links": 12, "push_max_mm": 8.0},
    },
}
ODD = (
    *(True, "", "abc", "nan", "\0", "1e5 mm", "é" * 300, 0, -1, 1.5, 1e308, float("nan"), float("inf"), 10**400),
    *([], [1, 2], [1, 2, 3, 4], [[1, 2, 3]], [True] * 3, [float("nan"), 0, 0], {}, {"a": 1}, [{}]),
    datetime.date(2020, 1, 1),
)


def places(node: Any, above: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Every table, row and value by the way to it."""
    if above:
        yield above
    pairs = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in pairs:
        yield from places(value, (*above, key))


@pytest.mark.parametrize("name", list(CASES))
def test_an_odd_value_makes_a_case_or_one_short_sentence(name: str, tmp_path: Path) -> None:
    make_case(CASES[name])
    said = []
    for way in places(CASES[name]):
        for value in ODD:
            table = copy.deepcopy(CASES[name])
            node: Any = table
            for key in way[:-1]:
                node = node[key]
            node[way[-1]] = value
            try:
                make_case(table, folder=tmp_path, name="case.toml")
            except TubeplanError as fault:
                said.append(str(fault))
    assert len(said) > 100
    assert all(0 < len(sentence) < 400 and "\n" not in sentence for sentence in said)


@pytest.mark.parametrize("name", list(CASES))
def test_a_key_with_a_typing_error_is_named_with_the_one_that_was_meant(name: str) -> None:
    for table in [table for table, keys in CASES[name].items() if isinstance(keys, dict)]:
        for key in CASES[name][table]:
            wrong = copy.deepcopy(CASES[name])
            if table == "planner" and key == "name":
                continue  # without it the case is a tube's
            wrong[table][key + "_"] = wrong[table].pop(key)
            with pytest.raises(CaseError, match=rf"unknown \w+ '{key}_'; expected one of .*; did you mean {key}\?|needs|no side"):
                make_case(wrong)


@pytest.mark.parametrize(
    ("name", "way", "value", "words"),
    [
        ("tube", ("planner", "goal"), [1e308, 0.0, 0.0], "at most 1e\\+06 mm from the origin; check the unit"),
        ("needle3d", ("needle3d", "target"), [0.0, 0.0, 9e4], "is 90000 mm from the entry, expected at most 1000 mm"),
        ("needle3d", ("obstacles", 1, "points"), [], "points: found none, expected the corners or the line of a capsule"),
        ("needle2d", ("obstacles", 1, "points"), [], "points: found none, expected the corners or the line of a polygon"),
        # Sums with such a weight lose their digits: every form would seem to be out of reach.
        ("needle2d", ("needle2d", "weight_length"), 1e308, "expected 0 to 1e\\+06, that of the length more than 0"),
        # An arc of 1 mm with a radius of 50 mm turns by 0.02 rad.
        ("needle2d", ("needle2d", "turn_max_deg"), 0.5, "no arc is possible, expected 1.15 degrees or more"),
        ("bronchoscope", ("limits", "clearance_min"), -1.0, "clearance_min is -1 mm, expected 0 to 100"),
        ("tube", ("input", "mesh"), "", "found '', expected the path of a file or folder"),
    ],
)
def test_what_no_planner_can_compute_with_is_refused_by_name(name: str, way: tuple[Any, ...], value: Any, words: str) -> None:
    table = copy.deepcopy(CASES[name])
    node: Any = table
    for key in way[:-1]:
        node = node[key]
    node[way[-1]] = value
    with pytest.raises(CaseError, match=words):
        make_case(table)
