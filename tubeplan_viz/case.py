"""The case file: the same names as the command line's options, checked, with every default resolved."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import tomli_w

from segmentation.errors import CaseError
from tubeplan_viz.centerline import CenterlineSettings
from tubeplan_viz.plan import Limits
from tubeplan_viz.tolerance import ToleranceSettings
from tubeplan_viz.tube import FeatureSettings, OptimalSettings, RefineSettings, TubeSettings

Place = tuple[float, float, float] | str
HuLimit = float | str | None

# Table 1 of Dai et al. (2024): least bend radius 8 mm, section radius 1.2 mm of a flexible ureteroscope.
DEFAULT_CURVATURE_MAX = 0.125
DEFAULT_CLEARANCE_MIN = 1.2

PLANNERS = ("tube",)
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
            raise CaseError(f"anatomy is {self.anatomy!r}, expected one of {', '.join(ANATOMIES)}")
        if self.connectivity not in (6, 26):
            raise CaseError(f"connectivity is {self.connectivity}, expected 6 or 26")
        if self.smoothing_mm is not None and not 0 <= self.smoothing_mm <= 10:
            raise CaseError(f"smoothing_mm is {self.smoothing_mm:g}, expected 0 to 10")


@dataclass(frozen=True, kw_only=True)
class PlannerCase:
    """Table ``[planner]``: which planner, from where to where, and what governs its run."""

    name: str = "tube"
    method: str = "feature_iteration"
    start: Place | None = None
    goal: Place | None = None
    rng_seed: int = 0
    time_budget: float | None = None
    tolerance: tuple[float, float] | None = None
    closed_ends: bool = False

    def __post_init__(self) -> None:
        if self.name not in PLANNERS:
            raise CaseError(f"there is no planner {self.name!r} yet, expected {' or '.join(PLANNERS)}")
        if self.time_budget is not None and not self.time_budget > 0:
            raise CaseError(f"time_budget is {self.time_budget:g} s, expected more than 0")
        if self.tolerance is not None:
            ToleranceSettings(translation=self.tolerance[0], rotation=self.tolerance[1])


@dataclass(frozen=True, kw_only=True)
class Case:
    """One case, complete: running it again gives the same plan."""

    input: InputCase
    limits: Limits
    planner: PlannerCase = field(default_factory=PlannerCase)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    refine: RefineSettings = field(default_factory=RefineSettings)
    optimal: OptimalSettings = field(default_factory=OptimalSettings)
    centerline: CenterlineSettings = field(default_factory=CenterlineSettings)

    @property
    def tube_settings(self) -> TubeSettings:
        """Settings of the tube planner."""
        return TubeSettings(
            method=self.planner.method,
            closed_ends=self.planner.closed_ends,
            centerline=self.centerline,
            features=self.features,
            refine=self.refine,
            optimal=self.optimal,
        )


# Keys of the table [tube] and where each goes. The names carry their units where they have one.
TUBE_KEYS: dict[str, tuple[str, str]] = {
    "scans": ("features", "scans"),
    "neighbourhood": ("features", "neighbourhood"),
    **{f"t{k}": ("features", f"t{k}") for k in range(1, 8)},
    "sigma": ("refine", "sigma"),
    "sigma_extremum": ("refine", "sigma_extremum"),
    "sigma_growth": ("refine", "sigma_growth"),
    "sample_spacing_mm": ("refine", "sample_spacing"),
    "short_run_mm": ("refine", "short_run"),
    "slice_again_mm": ("refine", "slice_again"),
    "slice_pairs": ("refine", "slice_pairs"),
    "unchanged_rounds": ("refine", "unchanged_rounds"),
    "max_rounds": ("refine", "max_rounds"),
    "aim": ("refine", "aim"),
    "objective": ("optimal", "objective"),
    "control_spacing_mm": ("optimal", "control_spacing"),
    "keep": ("optimal", "keep"),
    "start_direction": ("optimal", "start_direction"),
    "goal_direction": ("optimal", "goal_direction"),
    "centerline_step_mm": ("centerline", "step"),
    "centerline_smoothing_mm": ("centerline", "smoothing"),
    "centerline_omega": ("centerline", "omega"),
}


def make_case(table: Mapping[str, Any], *, folder: Path | None = None, name: str = "case") -> Case:
    """A case from nested tables as in a case file.

    Parameters
    ----------
    table : mapping
        Tables ``input``, ``limits``, ``planner``, ``tube``.
    folder : Path, optional
        Where relative paths start from.
    name : str
        Named in error messages.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    check_keys(table, ("input", "limits", "planner", "tube"), name, "table")
    inputs = subtable(table, "input", name)
    check_keys(inputs, [f.name for f in fields(InputCase)], f"{name} [input]", "key")
    for key in ("ct", "mesh"):
        if inputs.get(key) is not None:
            path = Path(text(inputs[key], f"{name} [input] {key}")).expanduser()
            inputs[key] = path if folder is None or path.is_absolute() else Path(os.path.normpath(folder / path))
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
    planner = subtable(table, "planner", name)
    check_keys(planner, [f.name for f in fields(PlannerCase)], f"{name} [planner]", "key")
    for key in ("start", "goal"):
        if planner.get(key) is not None:
            planner[key] = end_place(planner[key], f"{name} [planner] {key}")
    for key in ("name", "method"):
        if key in planner:
            planner[key] = text(planner[key], f"{name} [planner] {key}")
    if "rng_seed" in planner:
        planner["rng_seed"] = whole(planner["rng_seed"], f"{name} [planner] rng_seed")
    if not isinstance(planner.get("closed_ends", False), bool):
        raise CaseError(f"{name} [planner] closed_ends: found {planner['closed_ends']!r}, expected true or false")
    if planner.get("time_budget") is not None:
        planner["time_budget"] = number(planner["time_budget"], f"{name} [planner] time_budget")
    if planner.get("tolerance") is not None:
        planner["tolerance"] = error_of_pose(planner["tolerance"], f"{name} [planner] tolerance")
    limits = subtable(table, "limits", name)
    check_keys(limits, ("curvature_max", "clearance_min"), f"{name} [limits]", "key")
    tube = subtable(table, "tube", name)
    check_keys(tube, list(TUBE_KEYS), f"{name} [tube]", "key")
    parts: dict[str, dict[str, Any]] = {"features": {}, "refine": {}, "optimal": {}, "centerline": {}}
    for key, value in tube.items():
        part, attribute = TUBE_KEYS[key]
        parts[part][attribute] = tube_value(key, value, f"{name} [tube] {key}")
    return Case(
        input=InputCase(**inputs),
        limits=Limits(
            curvature_max=number(limits.get("curvature_max", DEFAULT_CURVATURE_MAX), f"{name} [limits] curvature_max"),
            clearance_min=number(limits.get("clearance_min", DEFAULT_CLEARANCE_MIN), f"{name} [limits] clearance_min"),
        ),
        planner=PlannerCase(**planner),
        features=FeatureSettings(**parts["features"]),
        refine=RefineSettings(**parts["refine"]),
        optimal=OptimalSettings(**parts["optimal"]),
        centerline=CenterlineSettings(**parts["centerline"]),
    )


def tube_value(key: str, value: Any, where: str) -> Any:
    """A value of the table [tube] in the type of its setting."""
    if key == "scans":
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise CaseError(f"{where}: found {value!r}, expected a list of scan names")
        return tuple(text(scan, where) for scan in value)
    if key == "objective":
        return text(value, where)
    if key in ("start_direction", "goal_direction"):
        return point(value, where)
    counts = ("slice_pairs", "unchanged_rounds", "max_rounds", "neighbourhood", "t5", "t6", "t7")
    return whole(value, where) if key in counts else number(value, where)


def read_case(path: Path) -> Case:
    """Read a case file; relative paths in it start from its folder."""
    return make_case(read_table(path), folder=path.resolve().parent, name=path.name)


def read_table(path: Path) -> dict[str, Any]:
    """The tables of a case file as they stand."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CaseError(f"{path.name}: no such case file") from None
    except (OSError, UnicodeDecodeError) as fault:
        raise CaseError(f"{path.name}: cannot be read as text ({fault.__class__.__name__}); expected a TOML case file") from None
    except tomllib.TOMLDecodeError as fault:
        raise CaseError(f"{path.name}: not valid TOML: {fault}") from None


def case_table(case: Case, *, folder: Path | None = None) -> dict[str, Any]:
    """The case as nested tables without keys that are unset; input paths relative to `folder`, or names only.

    With `folder` the table is what case.toml holds; without it, what result.json may
    show: no path of the machine it ran on.
    """

    def shown(path: Path) -> str:
        return path.name if folder is None else Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()

    inputs: dict[str, Any] = {f.name: getattr(case.input, f.name) for f in fields(InputCase)}
    for key in ("ct", "mesh"):
        if inputs[key] is not None:
            inputs[key] = shown(inputs[key])
    planner = {f.name: getattr(case.planner, f.name) for f in fields(PlannerCase)}
    tube = {key: getattr(getattr(case, part), attribute) for key, (part, attribute) in TUBE_KEYS.items()}
    tables = {
        "input": inputs,
        "limits": {"curvature_max": case.limits.curvature_max, "clearance_min": case.limits.clearance_min},
        "planner": planner,
        "tube": tube,
    }
    return {name: {key: listed(value) for key, value in table.items() if value is not None} for name, table in tables.items()}


def case_text(case: Case, folder: Path) -> str:
    """case.toml: every default resolved, input path relative to the run folder."""
    head = "# tubeplan case, every default resolved. Research use, not for clinical decisions.\n"
    units = "# Points and lengths in mm (LPS for a CT), curvature in 1/mm, HU limits in HU, times in s.\n\n"
    return head + units + tomli_w.dumps(case_table(case, folder=folder))


def listed(value: Any) -> Any:
    """Tuples as lists, for TOML and JSON."""
    return [listed(v) for v in value] if isinstance(value, tuple) else value


def check_keys(table: Mapping[str, Any], known: Sequence[str], where: str, what: str) -> None:
    """Refuse a key that nobody reads: a typing error must not pass as a default."""
    if not isinstance(table, Mapping):
        raise CaseError(f"{where}: found {type(table).__name__}, expected a table")
    for key in table:
        if key not in known:
            raise CaseError(f"{where}: unknown {what} {key!r}; expected one of {', '.join(known)}")


def subtable(table: Mapping[str, Any], key: str, name: str) -> dict[str, Any]:
    """One table of the case, as a copy; empty when it is not there."""
    found = table.get(key, {})
    if not isinstance(found, Mapping):
        raise CaseError(f"{name}: {key} is {found!r}, expected a table [{key}]")
    return dict(found)


def text(value: Any, where: str) -> str:
    """A value that must be text."""
    if not isinstance(value, str | os.PathLike):
        raise CaseError(f"{where}: found {value!r}, expected text")
    return os.fspath(value)


def number(value: Any, where: str, wanted: str = "a finite number") -> float:
    """A value that must be a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CaseError(f"{where}: found {value!r}, expected {wanted}")
    return float(value)


def whole(value: Any, where: str) -> int:
    """A value that must be a whole number."""
    found = number(value, where, "a whole number")
    if found != round(found):
        raise CaseError(f"{where}: found {value!r}, expected a whole number")
    return int(found)


def point(value: Any, where: str) -> tuple[float, float, float]:
    """Three finite numbers, from a list or from text ``X,Y,Z``."""
    if isinstance(value, str):
        try:
            value = [float(v) for v in value.split(",")]
        except ValueError:
            raise CaseError(f"{where}: found {value!r}, expected X,Y,Z in mm") from None
    if not isinstance(value, Sequence) or len(value) != 3:
        raise CaseError(f"{where}: found {value!r}, expected three numbers in mm")
    x, y, z = (number(v, where) for v in value)
    return (x, y, z)


def error_of_pose(value: Any, where: str) -> tuple[float, float]:
    """Shift in mm and turn in degrees, from a list or from text ``MM,DEG``."""
    wanted = "a shift in mm and a turn in degrees, e.g. 2,2"
    if isinstance(value, str):
        try:
            value = [float(v) for v in value.split(",")]
        except ValueError:
            raise CaseError(f"{where}: found {value!r}, expected {wanted}") from None
    if not isinstance(value, Sequence) or len(value) != 2:
        raise CaseError(f"{where}: found {value!r}, expected {wanted}")
    return (number(value[0], where), number(value[1], where))


def end_place(value: Any, where: str) -> Place:
    """A start or goal: coordinates, or a label like E2 from ``tubeplan endpoints``."""
    if isinstance(value, str):
        label = value.strip().upper()
        if label[:1] == "E" and label[1:].isdigit():
            return label
        if "," not in value:
            raise CaseError(f"{where}: found {value!r}, expected X,Y,Z in mm or a label like E2 from `tubeplan endpoints`")
    return point(value, where)
