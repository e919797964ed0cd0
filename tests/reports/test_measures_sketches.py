"""Each definition of a measure has its drawing, with the value of the case on it."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from reports.measures import value_of
from reports.measures_sketches import SUBJECTS, Sketch, sketches
from reports.numbers import Source
from tubeplan_viz.measures import DEFINITIONS, Measure

# What the drawings must show: the definitions of kidney, airway and path.
SHOWN = {
    "infundibulopelvic_angle_deg",
    "infundibular_length_mm",
    "infundibular_width_mm",
    "calyx_diameter_mm",
    "ureter_diameter_mean_mm",
    "branch_angle_deg",
    "tortuosity",
    "total_bending_deg",
    "bend_radius_min_mm",
}


def drawn(*measures: Measure) -> tuple[Sketch, ...]:
    items = [measure.details() for measure in measures]
    result: dict[str, Any] = {"details": {"measures": {"items": items}}}
    return sketches(items, lambda k: value_of(Source(result), k, items[k], unit=True))


def test_every_definition_that_is_asked_for_has_a_drawing() -> None:
    keys = [subject.key for subject in SUBJECTS]
    assert len(set(keys)) == len(keys)
    assert SHOWN <= set(keys) <= DEFINITIONS.keys()
    made = drawn(*(Measure(key=key, of="", value=12.5) for key in keys))
    assert [one.drawing.title for one in made] == [DEFINITIONS[key].name for key in keys]
    assert len({str(one.drawing.drawing) for one in made}) == len(keys)


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.key)
def test_a_drawing_tells_its_value_to_those_who_see_it_and_those_who_do_not(subject: Any) -> None:
    (one,) = drawn(Measure(key=subject.key, of="a part", value=31.0))
    label = re.search(r'aria-label="([^"]*)"', str(one.drawing.drawing))
    assert label is not None
    assert 'role="img"' in str(one.drawing.drawing)
    assert str(one.value) in label[1]
    assert subject.says in label[1].replace("&#39;", "'")
    assert "a part" in label[1]
    if subject.key != "generation":  # its drawing counts
        assert f">{one.value}</text>" in str(one.drawing.drawing)


@pytest.mark.parametrize("angle", [35.0, 90.0, 150.0])
def test_the_angle_is_drawn_as_wide_as_it_was_measured(angle: float) -> None:
    (one,) = drawn(Measure(key="infundibulopelvic_angle_deg", of="lower infundibulum", value=angle))
    axes = re.findall(r'class="measure-axis" d="M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)"', str(one.drawing.drawing))
    (ax, ay, bx, by), (cx, cy, dx, dy) = (tuple(map(float, axis)) for axis in axes)
    assert (ax, ay) == (cx, cy)
    between = math.atan2(dx - cx, dy - cy) - math.atan2(bx - ax, by - ay)
    assert math.degrees(between) == pytest.approx(angle, abs=0.2)  # a tenth of a unit in 78


def test_the_lower_pole_stands_for_all_infundibula() -> None:
    parts = [
        Measure(key="infundibular_width_mm", of=f"{name} infundibulum", value=k + 1.0)
        for k, name in enumerate(("upper", "lower"))
    ]
    (one,) = drawn(*parts)
    assert "2.00" in str(one.value)


def test_what_could_not_be_measured_says_which_input_lacks() -> None:
    reason = "the ureter in the image ends less than 40 mm from the centre of the pelvis"
    (one,) = drawn(Measure(key="infundibulopelvic_angle_deg", of="lower infundibulum", reason=reason))
    assert str(one.value) == f"not computable: {reason}"
    assert reason in str(one.drawing.drawing)
