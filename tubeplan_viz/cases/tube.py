"""The case file: the same names as the command line's options, checked, with every default resolved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import (
    Place,
    brief,
    check_keys,
    end_place,
    error_of_pose,
    number,
    point,
    read_table,
    seconds,
    seed,
    subtable,
    text,
    whole,
)
from tubeplan_viz.cases.inputs import InputCase, input_case, input_table
from tubeplan_viz.cases.measures import MeasureCase, measure_case, measure_table
from tubeplan_viz.cases.writing import case_file, written
from tubeplan_viz.centerline import CenterlineSettings
from tubeplan_viz.plan import Limits
from tubeplan_viz.tolerance import ToleranceSettings
from tubeplan_viz.tube import FeatureSettings, OptimalSettings, RefineSettings, TubeSettings

# Table 1 of Dai et al. (2024): least bend radius 8 mm, section radius 1.2 mm of a flexible ureteroscope.
DEFAULT_CURVATURE_MAX = 0.125
DEFAULT_CLEARANCE_MIN = 1.2

PLANNERS = ("tube",)


@dataclass(frozen=True, kw_only=True)
class PlannerCase:
    """Table ``[planner]``: which planner, from where to where, and what governs its run."""

    name: str = "tube"
    method: str = "optimal"
    start: Place | None = None
    goal: Place | None = None
    rng_seed: int = 0
    time_budget: float | None = None
    tolerance: tuple[float, float] | str | None = None
    closed_ends: bool = False

    def __post_init__(self) -> None:
        if self.name not in PLANNERS:
            raise CaseError(f"there is no planner {brief(self.name)} yet, expected {' or '.join(PLANNERS)}")
        if isinstance(self.tolerance, tuple):
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
    measures: MeasureCase = field(default_factory=MeasureCase)

    def __post_init__(self) -> None:
        settings, aim = self.tube_settings, self.optimal.objective
        if settings.method != "optimal" and aim != OptimalSettings().objective:
            raise CaseError(f"objective is {brief(aim)}, which is for --method optimal; {settings.method} has none, leave it out")

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
        Tables ``input``, ``limits``, ``planner``, ``tube``, ``measures``.
    folder : Path, optional
        Where relative paths start from.
    name : str
        Named in error messages.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    check_keys(table, ("input", "limits", "planner", "tube", "measures"), name, "table")
    planner = subtable(table, "planner", name)
    check_keys(planner, [f.name for f in fields(PlannerCase)], f"{name} [planner]", "key")
    for key in ("start", "goal"):
        if planner.get(key) is not None:
            planner[key] = end_place(planner[key], f"{name} [planner] {key}")
    for key in ("name", "method"):
        if key in planner:
            planner[key] = text(planner[key], f"{name} [planner] {key}")
    if "rng_seed" in planner:
        planner["rng_seed"] = seed(planner["rng_seed"], f"{name} [planner] rng_seed")
    if not isinstance(planner.get("closed_ends", False), bool):
        raise CaseError(f"{name} [planner] closed_ends: found {brief(planner['closed_ends'])}, expected true or false")
    planner["time_budget"] = seconds(planner.get("time_budget"), f"{name} [planner] time_budget")
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
        input=input_case(table, folder=folder, name=name),
        limits=Limits(
            curvature_max=number(limits.get("curvature_max", DEFAULT_CURVATURE_MAX), f"{name} [limits] curvature_max"),
            clearance_min=number(limits.get("clearance_min", DEFAULT_CLEARANCE_MIN), f"{name} [limits] clearance_min"),
        ),
        planner=PlannerCase(**planner),
        features=FeatureSettings(**parts["features"]),
        refine=RefineSettings(**parts["refine"]),
        optimal=OptimalSettings(**parts["optimal"]),
        centerline=CenterlineSettings(**parts["centerline"]),
        measures=measure_case(table, folder=folder, name=name),
    )


def tube_value(key: str, value: Any, where: str) -> Any:
    """A value of the table [tube] in the type of its setting."""
    if key == "scans":
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise CaseError(f"{where}: found {brief(value)}, expected a list of scan names")
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


def case_table(case: Case, *, folder: Path | None = None) -> dict[str, Any]:
    """The case as nested tables without keys that are unset; input paths relative to `folder`, or names only.

    With `folder` the table is what case.toml holds; without it, what result.json may
    show: no path of the machine it ran on.
    """

    planner = {f.name: getattr(case.planner, f.name) for f in fields(PlannerCase)}
    tube = {key: getattr(getattr(case, part), attribute) for key, (part, attribute) in TUBE_KEYS.items()}
    tables = {
        "input": input_table(case.input, folder=folder),
        "limits": {"curvature_max": case.limits.curvature_max, "clearance_min": case.limits.clearance_min},
        "planner": planner,
        "tube": tube,
        "measures": measure_table(case.measures, folder=folder),
    }
    return written(tables)


def case_text(case: Case, folder: Path) -> str:
    """case.toml: every default resolved, input path relative to the run folder."""
    units = "Points and lengths in mm (LPS for a CT), curvature in 1/mm, HU limits in HU, times in s."
    return case_file("case", units, case_table(case, folder=folder))
