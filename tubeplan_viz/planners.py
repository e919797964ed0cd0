"""Which planner a case is for: each brings how its case is read and the way through for it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tubeplan_viz import case as tube_case
from tubeplan_viz import pipeline
from tubeplan_viz.needle_case import NEEDLES, NeedleCase, make_needle_case
from tubeplan_viz.needle_run import run_needle
from tubeplan_viz.pipeline import Notify, silent

AnyCase = tube_case.Case | NeedleCase


def make_case(table: Mapping[str, Any], *, folder: Path | None = None, name: str = "case") -> AnyCase:
    """A case from the tables of a case file, by the name in its table ``[planner]``.

    Raises
    ------
    CaseError
        Naming the file, the table and the key.
    """
    planner = table.get("planner", {})
    which = planner.get("name") if isinstance(planner, Mapping) else None
    make = make_needle_case if which in NEEDLES else tube_case.make_case
    return make(table, folder=folder, name=name)


def run_case(
    case: AnyCase,
    target: Path,
    *,
    force: bool = False,
    recording: bool = True,
    report: bool = True,
    light: bool = False,
    connect: str | None = None,
    notify: Notify = silent,
) -> dict[str, Any]:
    """Plan one case of any planner and write its run folder; parameters as `tubeplan_viz.pipeline.run_case`."""
    options: dict[str, Any] = {"recording": recording, "report": report, "light": light, "connect": connect, "notify": notify}
    if isinstance(case, NeedleCase):
        return run_needle(case, target, force=force, **options)
    return pipeline.run_case(case, target, force=force, **options)
