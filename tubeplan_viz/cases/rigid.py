"""The case of a rigid instrument through the nose: the same names in the case file and on the command line, checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.anatomy.nasal.scene import SIDES, STRUCTURES
from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import brief, check_keys, coordinate, located, number, point, subtable, text, whole
from tubeplan_viz.cases.writing import case_file, in_unit_of, listed, shown_path, written
from tubeplan_viz.instruments.rigid_catalogue import coupled_instrument, read_rigid_catalogue, thinnest_pair
from tubeplan_viz.rigid import GOALS, CoupledInstrument, SearchSettings, Weights

METHODS = ("tangent",)
BROUGHT = (*STRUCTURES, *(f"entry_{side}" for side in SIDES))
Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class RigidCase:
    """One rigid case, complete: running it again gives the same plan. Lengths in mm, points LPS.

    Attributes
    ----------
    ct : Path
    side : str
        The patient's side.
    lesion : point or None
        Without it and without `lesion_mask` the medial wall of the side's optic canal is proposed.
    lesion_mask : Path or None
        A label volume on the CT's grid; its centroid is the goal.
    shrinkage : float
        0 to 1: how far the mucosa is shrunk before surgery.
    masks, seeds, boxes : mapping of structure or ``entry_left``, ``entry_right``
        What replaces or corrects the proposal of the front end.
    margin : float
        Least distance between instrument and structures.
    """

    ct: Path
    side: str
    lesion: Point | None = None
    lesion_mask: Path | None = None
    series: str | None = None
    case_id: str | None = None
    method: str = "tangent"
    shrinkage: float = 1.0
    margin: float = 0.0
    endoscope: str | None = None
    shaver: str | None = None
    catalogue: Path | None = None
    offset: float = 6.0
    masks: Mapping[str, Path] = field(default_factory=dict)
    seeds: Mapping[str, Point] = field(default_factory=dict)
    boxes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    search: SearchSettings = field(default_factory=SearchSettings)
    weights: Weights = field(default_factory=Weights)

    @property
    def instrument(self) -> tuple[CoupledInstrument, str, str]:
        """The coupled instrument and the names of endoscope and shaver."""
        return coupled_instrument(read_rigid_catalogue(self.catalogue), self.endoscope, self.shaver, offset=self.offset)

    @property
    def thinnest(self) -> CoupledInstrument:
        """The thinnest endoscope and shaver of the catalogue, as far apart as the case says."""
        return thinnest_pair(read_rigid_catalogue(self.catalogue), offset=self.offset)


OWN = (
    "side", "lesion", "lesion_mask", "shrinkage_percent", "endoscope", "shaver", "catalogue", "offset_mm", "roll_max_deg",
    "rolls", "nodes", "planes", "tangent_gap_mm", "masks", "seeds", "boxes", *(f"weight_{name}" for name in GOALS),
)  # fmt: skip


def make_rigid_case(table: Mapping[str, Any], *, folder: Path | None = None, name: str = "case") -> RigidCase:
    """A rigid case from tables as in a case file: ``[input]``, ``[limits]``, ``[planner]``, ``[rigid]``.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    check_keys(table, ("input", "limits", "planner", "rigid"), name, "table")
    inputs, limits = subtable(table, "input", name), subtable(table, "limits", name)
    planner, own = subtable(table, "planner", name), subtable(table, "rigid", name)
    check_keys(inputs, ("ct", "series", "case_id"), f"{name} [input]", "key")
    check_keys(limits, ("clearance_min",), f"{name} [limits]", "key")
    check_keys(planner, ("name", "method"), f"{name} [planner]", "key")
    check_keys(own, OWN, f"{name} [rigid]", "key")

    if "ct" not in inputs:
        raise CaseError(f"{name}: no CT was given; give a head CT (--ct, key ct in [input])")
    if "side" not in own:
        raise CaseError(f"{name}: no side was given; give --side left or --side right, the patient's")
    side = text(own["side"], f"{name} [rigid] side")
    if side not in SIDES:
        raise CaseError(f"{name} [rigid] side: found {brief(side)}, expected left or right, the patient's")
    if "lesion" in own and "lesion_mask" in own:
        raise CaseError(f"{name}: the lesion is given both as a point and as a mask; give one of them")
    method = text(planner.get("method", METHODS[0]), f"{name} [planner] method")
    if method not in METHODS:
        raise CaseError(f"{name} [planner] method: rigid has no method {brief(method)}, expected {' or '.join(METHODS)}")
    shrinkage = number(own.get("shrinkage_percent", 100.0), f"{name} [rigid] shrinkage_percent")
    if not 0.0 <= shrinkage <= 100.0:
        raise CaseError(f"{name} [rigid] shrinkage_percent: found {shrinkage:g}, expected 0 to 100")
    margin = number(limits.get("clearance_min", 0.0), f"{name} [limits] clearance_min")
    if not 0.0 <= margin <= 20.0:
        raise CaseError(f"{name} [limits] clearance_min: found {margin:g} mm, expected 0 to 20")
    defaults, weights = SearchSettings(), Weights()
    roll = number(own.get("roll_max_deg", float(np.degrees(defaults.roll_max))), f"{name} [rigid] roll_max_deg")
    return RigidCase(
        ct=located(inputs["ct"], folder, f"{name} [input] ct"),
        series=text(inputs["series"], f"{name} [input] series") if "series" in inputs else None,
        case_id=text(inputs["case_id"], f"{name} [input] case_id") if "case_id" in inputs else None,
        side=side,
        lesion=point(own["lesion"], f"{name} [rigid] lesion") if "lesion" in own else None,
        lesion_mask=located(own["lesion_mask"], folder, f"{name} [rigid] lesion_mask") if "lesion_mask" in own else None,
        method=method,
        shrinkage=shrinkage / 100.0,
        margin=margin,
        endoscope=text(own["endoscope"], f"{name} [rigid] endoscope") if "endoscope" in own else None,
        shaver=text(own["shaver"], f"{name} [rigid] shaver") if "shaver" in own else None,
        catalogue=located(own["catalogue"], folder, f"{name} [rigid] catalogue") if "catalogue" in own else None,
        offset=number(own.get("offset_mm", 6.0), f"{name} [rigid] offset_mm"),
        masks={k: located(v, folder, f"{name} [rigid] masks.{k}") for k, v in brought(own, "masks", name).items()},
        seeds={k: point(v, f"{name} [rigid] seeds.{k}") for k, v in brought(own, "seeds", name).items()},
        boxes={k: box(v, f"{name} [rigid] boxes.{k}") for k, v in brought(own, "boxes", name).items()},
        search=SearchSettings(
            roll_max=float(np.radians(roll)),
            rolls=whole(own.get("rolls", defaults.rolls), f"{name} [rigid] rolls"),
            planes=whole(own.get("planes", defaults.planes), f"{name} [rigid] planes"),
            nodes=whole(own.get("nodes", defaults.nodes), f"{name} [rigid] nodes"),
            tangent_gap=number(own.get("tangent_gap_mm", defaults.tangent_gap), f"{name} [rigid] tangent_gap_mm"),
        ),
        weights=Weights(**{k: number(own.get(f"weight_{k}", getattr(weights, k)), f"{name} [rigid] weight_{k}") for k in GOALS}),
    )


def brought(own: Mapping[str, Any], key: str, name: str) -> dict[str, Any]:
    """One of the tables of masks, seeds and boxes."""
    found = subtable(own, key, f"{name} [rigid]")
    check_keys(found, BROUGHT, f"{name} [rigid.{key}]", "structure")
    return found


def box(value: Any, where: str) -> tuple[float, ...]:
    """Two opposite corners as six numbers, from a list or from text ``X,Y,Z,X,Y,Z``."""
    if isinstance(value, str):
        value = value.split(",")
        try:
            value = [float(part) for part in value]
        except ValueError:
            value = []
    if not isinstance(value, list | tuple) or len(value) != 6:
        raise CaseError(f"{where}: found {brief(value)}, expected two opposite corners, X,Y,Z,X,Y,Z in LPS mm")
    return tuple(coordinate(part, where) for part in value)


def rigid_case_table(case: RigidCase, *, folder: Path | None = None) -> dict[str, Any]:
    """The case as tables without keys that are unset; files relative to `folder`, or names only."""

    def shown(path: Path | None) -> str | None:
        return None if path is None else shown_path(path, folder)

    _, endoscope, shaver = case.instrument
    own: dict[str, Any] = {
        "side": case.side,
        "lesion": case.lesion,
        "lesion_mask": shown(case.lesion_mask),
        "shrinkage_percent": 100.0 * case.shrinkage,
        "endoscope": endoscope,
        "shaver": shaver,
        "catalogue": shown(case.catalogue),
        "offset_mm": case.offset,
        "roll_max_deg": in_unit_of("roll_max_deg", case.search.roll_max),
        "rolls": case.search.rolls,
        "planes": case.search.planes,
        "nodes": case.search.nodes,
        "tangent_gap_mm": case.search.tangent_gap,
        **{f"weight_{name}": getattr(case.weights, name) for name in GOALS},
    }
    for key, rows in (("masks", {k: shown(v) for k, v in case.masks.items()}), ("seeds", case.seeds), ("boxes", case.boxes)):
        if rows:
            own[key] = {name: listed(value) for name, value in rows.items()}
    tables: dict[str, dict[str, Any]] = {
        "input": {"ct": shown(case.ct), "series": case.series, "case_id": case.case_id},
        "limits": {"clearance_min": case.margin},
        "planner": {"name": "rigid", "method": case.method},
        "rigid": own,
    }
    return written(tables)


def rigid_case_text(case: RigidCase, folder: Path) -> str:
    """case.toml: every default resolved, files relative to the run folder."""
    units = "Points (LPS) and lengths in mm; clearance_min is the least distance between instrument and structures."
    return case_file("case of a rigid instrument", units, rigid_case_table(case, folder=folder))
