"""The case of a needle: the same names in the case file and on the command line, checked, defaults resolved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import brief, check_keys, located, number, point, seconds, seed, subtable, table_rows, text
from tubeplan_viz.cases.needle_rows import (
    HU_KEYS,
    MONTE_CARLO_KEYS,
    EventCase,
    ObstacleCase,
    event_case,
    monte_carlo_settings,
    obstacle_case,
    place,
)
from tubeplan_viz.cases.writing import case_file, in_unit_of, shown_path, without_unset, written
from tubeplan_viz.needle.monte_carlo import MonteCarloSettings
from tubeplan_viz.needle.planar import PlanarSettings
from tubeplan_viz.needle.spatial import NeedleSettings
from tubeplan_viz.needle.swarm import SwarmSettings

NEEDLES = {"needle2d": ("forms",), "needle3d": ("swarm", "printed", "rrt")}
# Key of the table [needle2d] -> attribute of PlanarSettings; degrees become radian.
PLANAR_KEYS = {
    "radius_mm": "radius",
    "safety_mm": "safety",
    "degree_max": "degree_max",
    "weight_length": "weight_length",
    "weight_danger": "weight_danger",
    "weight_degree": "weight_degree",
    "angle_max_deg": "angle_max",
    "piece_min_mm": "piece_min",
    "turn_max_deg": "turn_max",
}
# Key of the table [needle3d] -> settings and attribute.
SPACE_KEYS = {
    "kappa": ("needle", "kappa"),
    "safety_mm": ("needle", "safety"),
    "pieces": ("needle", "pieces"),
    "duty_cycle": ("needle", "duty_cycle"),
    "entry_radius_mm": ("needle", "entry_radius"),
    "cone_deg": ("needle", "cone"),
    "piece_min_mm": ("needle", "piece_min"),
    "weight_danger": ("needle", "weight_danger"),
    "particles": ("swarm", "particles"),
    "rounds": ("swarm", "rounds"),
    "restarts": ("swarm", "restarts"),
    "stop_error_mm": ("swarm", "stop_error"),
}
WHOLE = ("degree_max", "pieces", "particles", "rounds", "restarts")
LONGEST_MM = 1000.0  # no needle is that long; a target in metres or micrometres is told by it
PLACES = ("entry", "target", "direction")
INPUTS = ("case_id", "ct", "series", *HU_KEYS[:3])


@dataclass(frozen=True, kw_only=True)
class NeedleCase:
    """One needle case, complete: running it again gives the same plan.

    Places have two numbers (y, z) for needle2d and three for needle3d, mm. `frame` is "LPS" for patient
    coordinates, otherwise "mesh": the case's own axes. `ct` is what pictures and, with `skin`, the entry are taken from.
    """

    name: str
    method: str
    entry: tuple[float, ...]
    target: tuple[float, ...]
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    case_id: str | None = None
    frame: str = "mesh"
    rng_seed: int = 0
    time_budget: float | None = None
    obstacles: tuple[ObstacleCase, ...] = ()
    events: tuple[EventCase, ...] = ()
    ct: Path | None = None
    series: str | None = None
    skin: bool = False
    monte_carlo: MonteCarloSettings = field(default_factory=MonteCarloSettings)
    planar: PlanarSettings = field(default_factory=PlanarSettings)
    needle: NeedleSettings = field(default_factory=NeedleSettings)
    swarm: SwarmSettings = field(default_factory=SwarmSettings)

    @property
    def flat(self) -> bool:
        """Whether the path stays in the plane."""
        return self.name == "needle2d"

    @property
    def kappa(self) -> float:
        """Largest curvature, 1/mm."""
        return 1.0 / self.planar.radius if self.flat else self.needle.kappa

    @property
    def safety(self) -> float:
        """Least distance to any obstacle, mm."""
        return self.planar.safety if self.flat else self.needle.safety


def make_needle_case(table: Mapping[str, Any], *, folder: Path | None = None, name: str = "case") -> NeedleCase:
    """A needle's case from tables as in a case file.

    The needle's own keys stand in the table named after the planner; at the top of the file, in ``[planner]``, ``[input]`` or
    ``[limits]`` they are taken too. ``curvature_max`` and ``clearance_min`` of ``[limits]`` are kappa and safety_mm.
    ``ct`` of ``[input]`` with ``hu_min`` is an obstacle too: the CT's voxels from there on.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    planner = subtable(table, "planner", name)
    which = str(planner.pop("name", ""))
    if which not in NEEDLES:
        raise CaseError(f"{name} [planner]: there is no needle planner {brief(which)}, expected {' or '.join(NEEDLES)}")
    known = set(PLANAR_KEYS if which == "needle2d" else SPACE_KEYS) | {*PLACES, "kappa", "radius_mm", "safety_mm", "frame"}
    known |= {"skin"} if which == "needle3d" else set()
    own = gathered(table, planner, which, known, name)
    given = {key: own.pop(key) for key in INPUTS if key in own}
    check_keys(planner, ("method", "rng_seed", "time_budget"), f"{name} [planner]", "key")
    method = text(planner.get("method", NEEDLES[which][0]), f"{name} [planner] method")
    if method not in NEEDLES[which]:
        raise CaseError(f"{name} [planner] method: {which} has no method {brief(method)}, expected {' or '.join(NEEDLES[which])}")
    flat = which == "needle2d"
    places = {key: place(own.pop(key), 2 if flat else 3, f"{name} {key}") for key in PLACES if key in own}
    if "target" not in places:
        raise CaseError(f"{name}: no target was given; give target = {'[y, z]' if flat else '[x, y, z]'} in mm (--target)")
    if flat and "direction" in places:
        raise CaseError(f"{name}: needle2d finds its own insertion angle; leave direction out (angle_max_deg limits it)")
    bodies = [*table_rows(table, "obstacles", name), *grown_bodies(given, flat, name)]
    frame = text(own.pop("frame", "LPS" if "ct" in given else "mesh"), f"{name} frame")
    if frame not in ("LPS", "mesh"):
        raise CaseError(f"{name} frame: found {brief(frame)}, expected LPS (patient) or mesh (the case's own axes)")
    if flat and ("events" in table or "monte_carlo" in table):
        raise CaseError(f"{name}: events and the Monte Carlo are of needle3d; leave them out for needle2d")
    skin = flag(own.pop("skin", False), f"{name} skin")
    if skin and "ct" not in given:
        raise CaseError(f"{name} skin: there is no CT that shows the skin; name it as ct in [input] (--ct)")
    apart = float(np.linalg.norm(np.subtract(places["target"], places.get("entry", (0.0,) * (2 if flat else 3)))))
    if apart > LONGEST_MM:
        raise CaseError(f"{name} target: is {apart:g} mm from the entry, expected at most {LONGEST_MM:g} mm; check the unit")
    planar, spatial = settings_of(own, flat, name)
    return NeedleCase(
        name=which,
        method=method,
        entry=places.get("entry", (0.0,) * (2 if flat else 3)),
        target=places["target"],
        direction=point(places["direction"], f"{name} direction") if "direction" in places else (0.0, 0.0, 1.0),
        case_id=text(given["case_id"], f"{name} [input] case_id") if "case_id" in given else None,
        frame=frame,
        rng_seed=seed(planner.get("rng_seed", 0), f"{name} [planner] rng_seed"),
        time_budget=seconds(planner.get("time_budget"), f"{name} [planner] time_budget"),
        obstacles=tuple(obstacle_case(row, flat, folder, f"{name} [[obstacles]] {k + 1}") for k, row in enumerate(bodies)),
        events=tuple(event_case(row, f"{name} [[events]] {k + 1}") for k, row in enumerate(table_rows(table, "events", name))),
        ct=located(given["ct"], folder, f"{name} [input] ct") if "ct" in given else None,
        series=text(given["series"], f"{name} [input] series") if "series" in given else None,
        skin=skin,
        monte_carlo=monte_carlo_settings(table.get("monte_carlo", {"runs": 0}), f"{name} [monte_carlo]"),
        planar=planar,
        needle=NeedleSettings(**spatial["needle"]),
        swarm=SwarmSettings(**spatial["swarm"]),
    )


def grown_bodies(given: Mapping[str, Any], flat: bool, name: str) -> list[dict[str, Any]]:
    """The obstacle that the keys of ``[input]`` ask for, as a row: the CT's voxels of the given HU; none without HU."""
    asked = sorted(set(given) - {"case_id"})
    if flat and asked:
        raise CaseError(f"{name} [input]: needle2d takes no CT; its obstacles are circles and polygons of the plane")
    if asked and "ct" not in given:
        raise CaseError(f"{name} [input]: {', '.join(asked)} without ct; name the CT (--ct)")
    if not any(key in given for key in ("hu_min", "hu_max", "seed_point")):
        return []
    return [{"kind": "mask", "file": given["ct"], **{key: given[key] for key in HU_KEYS if key in given}}]


def gathered(table: Mapping[str, Any], planner: dict[str, Any], which: str, known: set[str], name: str) -> dict[str, Any]:
    """The needle's own keys from wherever they stand; one in two places is refused, an unknown one too."""
    own = subtable(table, which, name)
    check_keys(own, sorted(known), f"{name} [{which}]", "key")
    inputs, limits = subtable(table, "input", name), subtable(table, "limits", name)
    renamed = {"curvature_max": "kappa", "clearance_min": "safety_mm"}
    limits = {renamed.get(key, key): value for key, value in limits.items()}
    top = {key: value for key, value in table.items() if not isinstance(value, Mapping) and key not in ("obstacles", "events")}
    for where, rows in (("the top", top), ("[planner]", planner), ("[input]", inputs), ("[limits]", limits)):
        for key in [key for key in rows if key in known]:
            if key in own:
                raise CaseError(f"{name}: {key} stands twice, in {where} and elsewhere; expected once")
            own[key] = rows.pop(key)
    check_keys(inputs, INPUTS, f"{name} [input]", "key")
    check_keys(limits, (), f"{name} [limits]", "key") if limits else None
    check_keys(
        {key: value for key, value in table.items() if key not in known},
        ("input", "limits", "planner", which, "obstacles", "events", "monte_carlo"),
        name,
        "table",
    )
    if "kappa" in own and "radius_mm" in own:
        raise CaseError(f"{name}: kappa and radius_mm are both given; one is the reciprocal of the other, give one")
    return own | inputs


def flag(value: Any, where: str) -> bool:
    """A value that must be true or false."""
    if not isinstance(value, bool):
        raise CaseError(f"{where}: found {brief(value)}, expected true or false")
    return value


def settings_of(own: dict[str, Any], flat: bool, name: str) -> tuple[PlanarSettings, dict[str, dict[str, Any]]]:
    """Settings from the needle's keys in the units of the file."""
    if flat and "kappa" in own:
        own["radius_mm"] = reciprocal(own.pop("kappa"), f"{name} kappa")
    if not flat and "radius_mm" in own:
        own["kappa"] = reciprocal(own.pop("radius_mm"), f"{name} radius_mm")
    planar: dict[str, Any] = {}
    spatial: dict[str, dict[str, Any]] = {"needle": {}, "swarm": {}}
    for key, value in own.items():
        if key == "duty_cycle":
            found: Any = flag(value, f"{name} duty_cycle")
        else:
            found = number(value, f"{name} {key}")
            if key in WHOLE and found != int(found):
                raise CaseError(f"{name} {key}: found {brief(value)}, expected a whole number")
            found = int(found) if key in WHOLE else float(np.radians(found)) if key.endswith("_deg") else found
        if flat:
            planar[PLANAR_KEYS[key]] = found
        else:
            part, attribute = SPACE_KEYS[key]
            spatial[part][attribute] = found
    return PlanarSettings(**planar), spatial


def reciprocal(value: Any, where: str) -> float:
    """1 / value of a number above 0."""
    found = number(value, where)
    if found <= 0.0:
        raise CaseError(f"{where}: found {found:g}, expected more than 0")
    return 1.0 / found


def needle_case_table(case: NeedleCase, *, folder: Path | None = None) -> dict[str, Any]:
    """The case as tables without keys that are unset; files relative to `folder`, or names only."""

    own: dict[str, Any] = {"entry": list(case.entry), "target": list(case.target), "frame": case.frame}
    if case.flat:
        own |= {key: in_unit_of(key, getattr(case.planar, attribute)) for key, attribute in PLANAR_KEYS.items()}
    else:
        own |= {"direction": list(case.direction), "skin": case.skin}
        own |= {key: in_unit_of(key, getattr(getattr(case, part), attribute)) for key, (part, attribute) in SPACE_KEYS.items()}
    planner = {"name": case.name, "method": case.method, "rng_seed": case.rng_seed, "time_budget": case.time_budget}
    tables: dict[str, Any] = {
        "input": {"case_id": case.case_id, "ct": None if case.ct is None else shown_path(case.ct, folder), "series": case.series},
        "planner": planner,
        case.name: own,
    }
    made: dict[str, Any] = written(tables)
    if case.monte_carlo.runs:
        made["monte_carlo"] = {key: getattr(case.monte_carlo, attribute) for key, attribute in MONTE_CARLO_KEYS.items()}
    rows = [{f.name: getattr(body, f.name) for f in fields(ObstacleCase)} for body in case.obstacles]
    for row in rows:
        row["file"] = None if row["file"] is None else shown_path(row["file"], folder)
    events = [{f.name: getattr(event, f.name) for f in fields(EventCase)} for event in case.events]
    for name, items in (("obstacles", rows), ("events", events)):
        if items:
            made[name] = [without_unset(item) for item in items]
    return made


def needle_case_text(case: NeedleCase, folder: Path) -> str:
    """case.toml: every default resolved, files relative to the run folder."""
    units = "Points and lengths in mm, curvature in 1/mm, HU limits in HU, times in s."
    return case_file("needle case", units, needle_case_table(case, folder=folder))
