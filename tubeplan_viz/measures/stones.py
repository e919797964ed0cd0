"""Measures of stones, in which calyx each lies, and what the scores ask of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.stone import Stone
from tubeplan_viz.measures.lines import Lumen
from tubeplan_viz.measures.measure import Measure, lacking
from tubeplan_viz.measures.scores import StoneFacts
from tubeplan_viz.measures.urinary import UrinaryMeasures

KEYS = ("stone_volume_mm3", "stone_diameter_mm", "stone_hu_mean", "stone_hu_max")
NEAR_MM = 8.0  # a stone whose centre is farther from every middle line than its radius and this lies in no calyx


@dataclass(frozen=True, kw_only=True)
class StonePlace:
    """Where a stone lies: the infundibulum's name and the calyx's label, empty in pelvis or ureter."""

    infundibulum: str
    calyx: str
    target: int | None


def stone_measures(number: int, stone: Stone | str) -> list[Measure]:
    """Volume, size and density of one stone, or why there are none (`stone` is then the reason)."""
    of = f"stone {number}"
    if isinstance(stone, str):
        return lacking(stone, *KEYS, of=of)
    values = (stone.volume_mm3, stone.diameter, stone.hu_mean, stone.hu_max)
    return [Measure(key=key, of=of, value=value) for key, value in zip(KEYS, values, strict=True)]


def stone_place(stone: Stone, lumen: Lumen, urinary: UrinaryMeasures) -> StonePlace | None:
    """Calyx whose way passes nearest to a stone beyond the pelvis; None where no way is near."""
    best: tuple[float, StonePlace] | None = None
    for target in range(len(lumen.labels)):
        line = lumen.tree.path(target)
        if line is None:
            continue
        away = np.linalg.norm(line.points - stone.center, axis=1)
        k = int(away.argmin())
        home = next((one for one in urinary.infundibula if target in one.targets), None)
        beyond = home is not None and line.arc_length[k] > home.lip
        found = (
            StonePlace(infundibulum=home.name, calyx=lumen.labels[target], target=target)
            if home is not None and beyond
            else StonePlace(infundibulum="", calyx="", target=None)
        )
        if best is None or away[k] < best[0]:
            best = (float(away[k]), found)
    if best is None or best[0] > 0.5 * stone.diameter + NEAR_MM:
        return None
    return best[1]


def stone_facts(
    stones: Sequence[Stone | str], lumen: Lumen | None, urinary: UrinaryMeasures | None, *, abnormal: bool | None
) -> StoneFacts:
    """What the scores ask, as far as it is known.

    Parameters
    ----------
    stones : sequence of Stone or str
        Each as found, or the reason why it was not; one unknown stone leaves all but `abnormal` unknown.
    lumen, urinary : Lumen and UrinaryMeasures, or None
        The collecting system, which tells in which calyx a stone lies.
    abnormal : bool or None
        Whether the kidney's anatomy is abnormal; None where the case does not say.
    """
    known = [stone for stone in stones if isinstance(stone, Stone)]
    if not known or len(known) < len(stones):
        return StoneFacts(abnormal=abnormal)
    burden = sum(stone.diameter for stone in known)
    density = max(stone.hu_mean for stone in known)
    if lumen is None or urinary is None:
        return StoneFacts(burden=burden, density=density, abnormal=abnormal)
    places = [stone_place(stone, lumen, urinary) for stone in known]
    if any(place is None for place in places):
        return StoneFacts(burden=burden, density=density, abnormal=abnormal)
    found = [place for place in places if place is not None]
    named = lumen.frame == "LPS" and len(urinary.infundibula) > 1
    lengths = [
        measure.value
        for measure in urinary.measures
        if measure.key == "infundibular_length_mm"
        and measure.value is not None
        and any(measure.of.startswith(f"calyx {place.calyx},") for place in found if place.calyx)
    ]
    angles = [
        measure.value
        for measure in urinary.measures
        if measure.key == "infundibulopelvic_angle_coronal_deg" and measure.of == "lower infundibulum"
    ]
    return StoneFacts(
        burden=burden,
        density=density,
        calyces=len({place.calyx for place in found if place.calyx}),
        lower_pole=any(place.infundibulum == "lower" for place in found) if named else None,
        angle=angles[0] if angles else None,
        length=max(lengths) if lengths else None,
        abnormal=abnormal,
    )
