"""Table ``[input]`` of a case file: what is read, and how the lumen is found in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import brief, check_keys, located, number, point, subtable, text, whole
from tubeplan_viz.cases.writing import shown_path

HuLimit = float | str | None

# What only one kind of input has; the other would leave it aside without a word.
OF_A_CT = ("series", "seed_point", "hu_min", "hu_max", "smoothing_mm")
OF_A_MESH = ("mesh_unit", "part")
ANATOMIES = ("airway", "urinary", "vessel", "generic")


@dataclass(frozen=True, kw_only=True)
class InputCase:
    """Table ``[input]``: what is read and how the lumen is found in it.

    Exactly one of `ct` and `mesh` is given. Points are LPS mm for a CT, the mesh's own
    axes in mm for a mesh.
    """

    ct: Path | None = None
    mesh: Path | None = None
    series: str | None = None
    mesh_unit: str | None = None
    part: str | None = None
    case_id: str | None = None
    anatomy: str | None = None
    seed_point: tuple[float, float, float] | None = None
    hu_min: HuLimit = None
    hu_max: HuLimit = None
    connectivity: int = 6
    smoothing_mm: float | None = None

    def __post_init__(self) -> None:
        if (self.ct is None) == (self.mesh is None):
            raise CaseError(
                "give either a CT (--ct, key ct in [input]) or a mesh (--mesh, key mesh in [input]), exactly one of them"
            )
        if self.anatomy is not None and self.anatomy not in ANATOMIES:
            raise CaseError(f"anatomy is {brief(self.anatomy)}, expected one of {', '.join(ANATOMIES)}")
        if self.connectivity not in (6, 26):
            raise CaseError(f"connectivity is {self.connectivity}, expected 6 or 26")
        if self.smoothing_mm is not None and not 0 <= self.smoothing_mm <= 10:
            raise CaseError(f"smoothing_mm is {self.smoothing_mm:g}, expected 0 to 10")
        given, foreign = ("CT", OF_A_MESH) if self.mesh is None else ("mesh", OF_A_CT)
        idle = next((name for name in foreign if getattr(self, name) is not None), None)
        if idle is not None:
            raise CaseError(f"{idle} was given, which says nothing about a {given}; leave it out")


def input_case(table: Mapping[str, Any], *, folder: Path | None, name: str) -> InputCase:
    """The table ``[input]`` of a case file, checked; relative paths start from `folder`.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    inputs = subtable(table, "input", name)
    check_keys(inputs, [f.name for f in fields(InputCase)], f"{name} [input]", "key")
    for key in ("ct", "mesh"):
        if inputs.get(key) is not None:
            inputs[key] = located(inputs[key], folder, f"{name} [input] {key}")
    if inputs.get("seed_point") is not None:
        inputs["seed_point"] = point(inputs["seed_point"], f"{name} [input] seed_point")
    for key in ("hu_min", "hu_max"):
        if inputs.get(key) is not None and inputs[key] != "auto":
            inputs[key] = number(inputs[key], f"{name} [input] {key}", 'a number in HU or "auto"')
    for key in ("series", "mesh_unit", "part", "case_id", "anatomy"):
        if inputs.get(key) is not None:
            inputs[key] = text(inputs[key], f"{name} [input] {key}")
    if "connectivity" in inputs:
        inputs["connectivity"] = whole(inputs["connectivity"], f"{name} [input] connectivity")
    if inputs.get("smoothing_mm") is not None:
        inputs["smoothing_mm"] = number(inputs["smoothing_mm"], f"{name} [input] smoothing_mm")
    return InputCase(**inputs)


def input_table(case: InputCase, *, folder: Path | None) -> dict[str, Any]:
    """The table again; input paths relative to `folder`, or names only without one."""
    table: dict[str, Any] = {f.name: getattr(case, f.name) for f in fields(InputCase)}
    for key in ("ct", "mesh"):
        if table[key] is not None:
            table[key] = shown_path(table[key], folder)
    return table
