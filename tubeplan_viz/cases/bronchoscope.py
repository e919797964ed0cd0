"""The case of the bronchoscope robot: the same names in the case file and on the command line, checked, defaults resolved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.errors import CaseError
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings
from tubeplan_viz.cases.fields import brief, check_keys, number, point, seconds, seed, subtable, text, whole
from tubeplan_viz.cases.inputs import InputCase, input_case, input_table
from tubeplan_viz.cases.writing import case_file, in_unit_of, written
from tubeplan_viz.plan import Limits

METHODS = ("kinematic", "dynamic")
# Curvature that the tip's track may have, 1/mm. The tip is swung by two sections on a moving base, so its track may bend more
# sharply than a section: by kinematics twice as sharply. A simulated tip slides and settles under contact and turns on
# the spot, so its track has no least radius: the largest value there is, which asks for nothing.
TRACK_CURVATURE_SHARE, NO_LIMIT = 2.0, 10.0
# Least distance of the tip's middle to the wall, in radii. A simulated robot leans on the wall and ends in a flat disc, which may
# look at a wall nearer than its radius; that its rim and its body keep clear is measured for themselves.
TIP_RADII = {"kinematic": 1.0, "dynamic": 0.25}
# Key of the table [bronchoscope] -> (part, attribute).
KEYS = {
    "diameter_mm": ("robot", "diameter"),
    "proximal_length_mm": ("robot", "proximal_length"),
    "distal_length_mm": ("robot", "distal_length"),
    "bend_max_deg": ("robot", "bend_max"),
    "links": ("robot", "links"),
    "push_speed_mm_per_s": ("robot", "push_speed"),
    "passive_length_mm": ("robot", "passive_length"),
    "robot": ("robot", "name"),
    "push_max_mm": ("settings", "push_max"),
    "push_min_mm": ("settings", "push_min"),
    "turn_max_deg": ("settings", "turn_max"),
    "goal_tolerance_mm": ("settings", "goal_tolerance"),
    "goal_error_max_mm": ("settings", "goal_error_max"),
    "samples_max": ("settings", "samples_max"),
    "patience": ("settings", "patience"),
}
WHOLE = ("links", "samples_max", "patience")
# Least and largest value of what a robot's shape is told by. Wide: they catch units, not unusual robots.
RANGES = {
    "diameter_mm": (0.1, 50.0),
    "proximal_length_mm": (1.0, 500.0),
    "distal_length_mm": (1.0, 500.0),
    "bend_max_deg": (1.0, 360.0),
}


@dataclass(frozen=True, kw_only=True)
class BronchoscopeCase:
    """One case of the bronchoscope robot, complete: running it again gives the same plan.

    Attributes
    ----------
    input : InputCase
    method : {"kinematic", "dynamic"}
    start : str
        Label of the end point where the robot goes in.
    goal : str or (3,) tuple of float or None
        A branch's name, an end point's label, or a place in the lumen, mm.
    lesion : (3,) tuple of float or None
        A place beside the airway, mm, that the tip should come as near to as it can.
    curvature_max, clearance_min : float
        Limits of the tip's track, 1/mm and mm.
    rng_seed : int
    time_budget : float, s, or None
    robot : Robot
    settings : PlannerSettings
    """

    input: InputCase
    method: str
    start: str = "E1"
    goal: str | tuple[float, float, float] | None = None
    lesion: tuple[float, float, float] | None = None
    curvature_max: float
    clearance_min: float
    rng_seed: int = 0
    time_budget: float | None = None
    robot: Robot = field(default_factory=Robot)
    settings: PlannerSettings = field(default_factory=PlannerSettings)

    def __post_init__(self) -> None:
        Limits(curvature_max=self.curvature_max, clearance_min=self.clearance_min)


def default_method() -> str:
    """``dynamic`` where MuJoCo is installed, else ``kinematic``."""
    return "dynamic" if find_spec("mujoco") is not None else "kinematic"


def make_bronchoscope_case(table: Mapping[str, Any], *, folder: Path | None = None, name: str = "case") -> BronchoscopeCase:
    """A case from the tables ``[input]``, ``[limits]``, ``[planner]`` and ``[bronchoscope]`` of a case file.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    check_keys(table, ("input", "limits", "planner", "bronchoscope"), name, "table")
    planner = subtable(table, "planner", name)
    known = ("name", "method", "start", "goal", "lesion", "rng_seed", "time_budget")
    check_keys(planner, known, f"{name} [planner]", "key")
    method = text(planner.get("method", default_method()), f"{name} [planner] method")
    if method not in METHODS:
        raise CaseError(f"{name} [planner] method: bronchoscope has no method {brief(method)}, expected {' or '.join(METHODS)}")
    goal, lesion = planner.get("goal"), planner.get("lesion")
    limits = subtable(table, "limits", name)
    check_keys(limits, ("curvature_max", "clearance_min"), f"{name} [limits]", "key")
    own = subtable(table, "bronchoscope", name)
    check_keys(own, list(KEYS), f"{name} [bronchoscope]", "key")
    parts: dict[str, dict[str, Any]] = {"robot": {}, "settings": {}}
    for key, value in own.items():
        part, attribute = KEYS[key]
        parts[part][attribute] = own_value(key, value, f"{name} [bronchoscope] {key}")
    robot = Robot(**parts["robot"])
    given = input_case(table, folder=folder, name=name)
    if given.ct is not None and given.anatomy is None and given.seed_point is None:
        given = replace(given, anatomy="airway")
    return BronchoscopeCase(
        input=given,
        method=method,
        start=text(planner.get("start", "E1"), f"{name} [planner] start").strip().upper(),
        goal=None if goal is None else goal_place(goal, f"{name} [planner] goal"),
        lesion=None if lesion is None else point(lesion, f"{name} [planner] lesion"),
        curvature_max=number(limits.get("curvature_max", track_curvature(method, robot)), f"{name} [limits] curvature_max"),
        clearance_min=number(limits.get("clearance_min", TIP_RADII[method] * robot.radius), f"{name} [limits] clearance_min"),
        rng_seed=seed(planner.get("rng_seed", 0), f"{name} [planner] rng_seed"),
        time_budget=seconds(planner.get("time_budget"), f"{name} [planner] time_budget"),
        robot=robot,
        settings=PlannerSettings(**parts["settings"]),
    )


def track_curvature(method: str, robot: Robot) -> float:
    """Default limit of the tip's track, 1/mm."""
    return NO_LIMIT if method == "dynamic" else round(TRACK_CURVATURE_SHARE * robot.curvature_max, 4)


def own_value(key: str, value: Any, where: str) -> Any:
    """A value of the table [bronchoscope] in the unit of its setting."""
    if key == "robot":
        return text(value, where)
    if key in WHOLE:
        return whole(value, where)
    found = number(value, where)
    low, high = RANGES.get(key, (found, found))
    if not low <= found <= high:
        raise CaseError(f"{where}: found {found:g}, expected {low:g} to {high:g}")
    return float(np.radians(found)) if key.endswith("_deg") else found


def goal_place(value: Any, where: str) -> str | tuple[float, float, float]:
    """A branch's name or label, or coordinates."""
    if isinstance(value, str) and "," not in value:
        return value.strip()
    return point(value, where)


def bronchoscope_case_table(case: BronchoscopeCase, *, folder: Path | None = None) -> dict[str, Any]:
    """The case as tables without keys that are unset; input paths relative to `folder`, or names only."""
    own: dict[str, Any] = {}
    for key, (part, attribute) in KEYS.items():
        value = getattr(getattr(case, part), attribute)
        own[key] = in_unit_of(key, value)
    planner = {
        "name": "bronchoscope",
        "method": case.method,
        "start": case.start,
        "goal": case.goal,
        "lesion": case.lesion,
        "rng_seed": case.rng_seed,
        "time_budget": case.time_budget,
    }
    tables = {
        "input": input_table(case.input, folder=folder),
        "limits": {"curvature_max": case.curvature_max, "clearance_min": case.clearance_min},
        "planner": planner,
        "bronchoscope": own,
    }
    return written(tables)


def bronchoscope_case_text(case: BronchoscopeCase, folder: Path) -> str:
    """case.toml: every default resolved, input path relative to the run folder."""
    units = "Points and lengths in mm (LPS for a CT), curvature in 1/mm, angles in degrees, times in s."
    return case_file("bronchoscope case", units, bronchoscope_case_table(case, folder=folder))
