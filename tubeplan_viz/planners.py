"""Which planner a case is for: each brings how its case is read and the way through for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from tubeplan_viz.cases import bronchoscope, needle, rigid, tube
from tubeplan_viz.cases.fields import brief
from tubeplan_viz.pipeline import RunOptions, run_bronchoscope, run_needle, run_rigid, run_tube


@dataclass(frozen=True, kw_only=True)
class Planner:
    """One planner's way in.

    Attributes
    ----------
    make : callable
        ``make(table, folder=..., name=...)`` gives the case of a case file's tables.
    case : type
        What `make` gives.
    text : callable
        ``text(case, target)`` is what case.toml of the run folder `target` holds.
    run : callable
        ``run(case, target, options)`` plans the case, writes the run folder `target` and returns the content of result.json.
    """

    make: Callable[..., Any]
    case: type
    text: Callable[[Any, Path], str]
    run: Callable[[Any, Path, RunOptions], dict[str, Any]]


_NEEDLE = Planner(make=needle.make_needle_case, case=needle.NeedleCase, text=needle.needle_case_text, run=run_needle)
PLANNERS: dict[str, Planner] = {
    "tube": Planner(make=tube.make_case, case=tube.Case, text=tube.case_text, run=run_tube),
    "needle2d": _NEEDLE,
    "needle3d": _NEEDLE,
    "rigid": Planner(make=rigid.make_rigid_case, case=rigid.RigidCase, text=rigid.rigid_case_text, run=run_rigid),
    "bronchoscope": Planner(
        make=bronchoscope.make_bronchoscope_case,
        case=bronchoscope.BronchoscopeCase,
        text=bronchoscope.bronchoscope_case_text,
        run=run_bronchoscope,
    ),
}


def make_case(table: Mapping[str, Any], *, folder: Path | None = None, name: str = "case") -> Any:
    """A case from the tables of a case file, by the name in its table ``[planner]``, ``tube`` when it has none.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    planner = table.get("planner", {})
    which = planner.get("name", "tube") if isinstance(planner, Mapping) else "tube"
    if not isinstance(which, str) or which not in PLANNERS:
        raise CaseError(f"{name} [planner] name: there is no planner {brief(which)}, expected one of {', '.join(PLANNERS)}")
    return PLANNERS[which].make(table, folder=folder, name=name)


def run_case(case: Any, target: Path, options: RunOptions | None = None) -> dict[str, Any]:
    """Plan one case of any planner and write its run folder.

    Parameters
    ----------
    case : any case that `make_case` gives
    target : Path
        The run folder; refused if it exists, unless `options.force` is set.
    options : RunOptions, optional

    Returns
    -------
    dict
        The content of result.json; status "infeasible" with a reason where there is no path.

    Raises
    ------
    TubeplanError
        If the input is bad or no path can be begun; then no folder is left.
    """
    run = next(planner.run for planner in PLANNERS.values() if isinstance(case, planner.case))
    return run(case, target, options or RunOptions())
