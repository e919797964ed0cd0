"""Start and goal by label and by the name of their part."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import end_place
from tubeplan_viz.centerline import Endpoint
from tubeplan_viz.pipeline import resolve_end

NAMES = {"E1": "trachea", "E2": "left lower lobe", "E3": "right lower lobe", "E4": "right upper lobe"}
ENDS = tuple(
    Endpoint(label=label, point=np.array([float(k), 0.0, 0.0]), radius=2.0, branch_length=30.0, confidence=1.0, cap=None)
    for k, label in enumerate(NAMES)
)


@pytest.mark.parametrize(
    ("given", "x"),
    [
        ("e3", 2.0),
        (" Right  Lower Lobe ", 2.0),
        ("trachea", 0.0),
        ("upper", 3.0),
        ("left", 1.0),
        ([7, 8, 9], 7.0),
        ("4,5,6", 4.0),
    ],
)
def test_an_end_is_meant_by_label_name_piece_of_a_name_or_coordinates(given: object, x: float) -> None:
    assert resolve_end("goal", end_place(given, "goal"), ENDS, NAMES)[0] == x


def test_a_name_is_taken_before_longer_ones_that_hold_it() -> None:
    names = {**NAMES, "E4": "right lower lobe, part 2"}
    assert resolve_end("goal", end_place("right lower lobe", "goal"), ENDS, names)[0] == 2.0


@pytest.mark.parametrize(
    ("given", "names", "said"),
    [
        ("lower", NAMES, r"the goal 'lower' fits 2 end points, E2 left lower lobe \(1\.0, 0\.0, 0\.0\); E3 right lower lobe"),
        ("lingula", NAMES, r"no end point in a part named 'lingula'; it has E1 trachea \(0\.0"),
        ("trachea", {}, r"no end point in a part named 'trachea'; it has E1 \(0\.0.*names of parts are known with --anatomy"),
        ("E9", NAMES, r"the lumen has no end point E9; it has E1 trachea"),
        (None, NAMES, r"no goal was given; give --goal X,Y,Z in mm or one of .*E4 right upper lobe"),
    ],
)
def test_an_end_that_is_not_one_is_refused_with_those_there_are(given: str | None, names: dict[str, str], said: str) -> None:
    with pytest.raises(CaseError, match=said):
        resolve_end("goal", None if given is None else end_place(given, "goal"), ENDS, names)
