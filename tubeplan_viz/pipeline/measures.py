"""The clinical measures of a run: what they need is read here, what they found goes into result.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import RegionError
from segmentation.label_file import read_mask_file
from segmentation.stone import Stone, grow_stone, masked_stone
from segmentation.volume import Volume
from segmentation.volume_files import read_volume_file
from tubeplan_viz.cases.measures import MeasureCase
from tubeplan_viz.measures import (
    DEFINITIONS,
    Drawing,
    Lumen,
    Measure,
    Part,
    UrinaryMeasures,
    UrinarySettings,
    airway_measures,
    lacking,
    path_measures,
    rirs,
    russ,
    stone_facts,
    stone_measures,
    structure_measures,
    urinary_measures,
)
from tubeplan_viz.pipeline.parts import airway_lumen, airway_parts, lumen_parts, urinary_lumen
from tubeplan_viz.pipeline.tree import Tree

URINARY = ("infundibulopelvic_angle_deg", "infundibular_length_mm", "infundibular_width_mm", "ureter_diameter_mean_mm")
AIRWAY = ("trachea_diameter_mm", "carinal_angle_deg", "branch_diameter_mm", "branch_angle_deg")


@dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """What the measures add to a run: `details` for result.json, the files that were read, as (name, sha256), and the
    anatomy's parts by name, none where they are not known."""

    details: Mapping[str, Any]
    inputs: tuple[tuple[str, str], ...]
    parts: tuple[Part, ...] = ()


def measure_run(
    case: MeasureCase,
    *,
    anatomy: str | None,
    tree: Tree,
    volume: Volume | None,
    path: Mapping[str, FloatArray],
    curvature_max: float,
    sharpest_at: float,
) -> Measured:
    """Measure a planned case.

    Parameters
    ----------
    case : MeasureCase
    anatomy : str or None
        What the lumen is, which says what can be measured in it.
    tree : Tree
        The lumen with its end points.
    volume : Volume or None
        The CT, which stones are grown in.
    path : mapping
        ``s_mm``, ``points_mm`` and ``curvature_per_mm`` as result.json holds them.
    curvature_max : float, 1/mm
    sharpest_at : float, mm
        Where the path has it, between the samples too.

    Raises
    ------
    TubeplanError
        If a mask cannot be read; a measure that cannot be computed is no error but has a reason.
    """
    s, points = np.asarray(path["s_mm"]), np.asarray(path["points_mm"])
    measures = path_measures(s, points, np.asarray(path["curvature_per_mm"]), curvature_max, sharpest_at=sharpest_at)
    lumen, urinary, drawing = None, None, None
    parts: tuple[Part, ...] = ()
    if anatomy == "urinary":
        lumen, urinary = measured_urinary(tree, case, volume)
        measures += lacking("the lumen has no branches", *URINARY) if urinary is None else urinary.measures
        if urinary is not None:
            drawing, parts = urinary.drawing, urinary.parts
    elif anatomy == "airway":
        found, drawing, parts = measured_airway(tree, volume)
        measures += lacking("the lumen has no branches", *AIRWAY) if drawing is None else found
    inputs: list[tuple[str, str]] = []
    stones = read_stones(case, volume, inputs)
    for number, stone in enumerate(stones, start=1):
        measures += stone_measures(number, stone)
    for name, file in case.structures:
        mask = read_volume_file(file, labels=True)
        inputs.extend(mask.inputs)
        measures += structure_measures(name, Volume(mask.voxels, mask.index_to_lps), s, points)
    scores = []
    if anatomy == "urinary" and stones:
        facts = stone_facts(stones, lumen, urinary, abnormal=case.abnormal_anatomy)
        scores = [score(facts).details() for score in (russ, rirs)]
    return Measured(details=details_of(measures, scores, drawing), inputs=tuple(inputs), parts=parts)


def details_of(measures: list[Measure], scores: list[dict[str, Any]], drawing: Drawing | None) -> dict[str, Any]:
    """``details.measures`` of result.json: every item with its definition."""
    used = dict.fromkeys(measure.key for measure in measures)
    return {
        "definitions": {
            key: {"name": DEFINITIONS[key].name, "text": DEFINITIONS[key].text, "source": DEFINITIONS[key].source} for key in used
        },
        "items": [measure.details() for measure in measures],
        "scores": scores,
        "drawing": None if drawing is None else drawing.details(),
    }


def measured_urinary(tree: Tree, case: MeasureCase, volume: Volume | None) -> tuple[Lumen | None, UrinaryMeasures | None]:
    """The collecting system measured from the ureter's end; None for a lumen with fewer than three tips."""
    if len(tree.endpoints) < 3:
        return None, None
    lumen = urinary_lumen(tree, volume)
    return lumen, urinary_measures(lumen, UrinarySettings(ureter_level=case.ureter_level_mm))


def measured_airway(tree: Tree, volume: Volume | None) -> tuple[tuple[Measure, ...], Drawing | None, tuple[Part, ...]]:
    """The airway measured from its first end point, the trachea's; no measures and no drawing without a branching."""
    if len(tree.endpoints) < 3:
        return (), None, lumen_parts("airway", tree, volume)
    lumen = airway_lumen(tree, volume)
    return *airway_measures(lumen), airway_parts(lumen)


def read_stones(case: MeasureCase, volume: Volume | None, inputs: list[tuple[str, str]]) -> list[Stone | str]:
    """Stones of the case, each as found or as the reason why it was not."""
    if volume is None:
        return ["the case has no CT"] * (len(case.stones) + len(case.stone_masks))
    found: list[Stone | str] = []
    for point in case.stones:
        try:
            found.append(grow_stone(volume, point))
        except RegionError as fault:
            found.append(str(fault))
    for file in case.stone_masks:
        mask, files = read_mask_file(file, volume)
        inputs.extend(files)
        found.append(masked_stone(volume, mask))
    return found
