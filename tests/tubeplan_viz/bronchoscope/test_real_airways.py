"""Real airways: every branch is reached, or its refusal is proved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.cases.bronchoscope import make_bronchoscope_case
from tubeplan_viz.reach import run_reach

DATA = Path(__file__).parents[4] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="the shared data folder is not beside the repository")

# Case, branches, and those that are reached at least.
AIRWAYS: list[tuple[str, dict[str, Any], int, set[str]]] = [
    (
        "elastix_right_lung",
        {"ct": str(DATA / "elastix_right_lung" / "3DCT_lung.mha")},
        9,
        {"right upper lobe", "right middle lobe", "bronchus intermedius", "left main bronchus"},
    ),
    (
        "hubmap_airway_female",
        {"mesh": str(DATA / "hubmap_airway_female" / "fused_airway_F_mm.stl")},
        3,
        {"main bronchus a", "main bronchus b"},  # as wide, as long and as straight as each other: no side is told
    ),
]


@needs_data
@pytest.mark.parametrize(("name", "given", "count", "reached"), AIRWAYS, ids=[case[0] for case in AIRWAYS])
def test_every_branch_is_reached_or_proved_too_narrow(
    name: str, given: dict[str, Any], count: int, reached: set[str], tmp_path: Path
) -> None:
    case = make_bronchoscope_case({"input": given, "planner": {"method": "kinematic"}})
    document = run_reach(case, tmp_path / "reach", report=False, recording=False)
    assert len(document["branches"]) == count
    assert all(row["proved"] for row in document["branches"])
    assert reached <= {row["name"] for row in document["branches"] if row["verdict"] == "reached"}
    for row in document["branches"]:
        if row["leaf"]:  # tips stand where the branch itself narrows: measured with the trachea, 15 mm were cut off
            assert row["least_diameter_mm"] < 5.0 or name == "hubmap_airway_female"
        if row["verdict"] == "diameter":
            assert 2.0 * row["clearance_bound_mm"] < document["robot"]["diameter_mm"]
        if row["tip_error_mm"] is not None:
            assert row["tip_error_mm"] < 2.0
    assert (tmp_path / "reach" / "reach.csv").read_text().count("\n") == count + 1
