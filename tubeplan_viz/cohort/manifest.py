"""The manifest of a cohort: which cases, each with its id, from one TOML or CSV file.

Everything that can be known without reading an image is checked here, for all cases, before any of them runs.
"""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError, TubeplanError
from tubeplan_viz.cases.fields import located, read_table
from tubeplan_viz.cases.tube import Case as TubeCase
from tubeplan_viz.cohort.columns import takes_seed
from tubeplan_viz.cohort.errors import ManifestError
from tubeplan_viz.cohort.inputs import input_paths
from tubeplan_viz.cohort.rows import Row, planner_of, read_rows
from tubeplan_viz.cohort.seeds import case_seed
from tubeplan_viz.cohort.tables import for_planner, layered, rebased
from tubeplan_viz.planners import PLANNERS, make_case

# What a folder may be called on every system, and never one of the cohort's own files.
ID = re.compile(r"\w(?:[\w.-]{0,98}\w)?")
ID_RULE = "1 to 100 letters, digits, points, dashes and underscores, a letter or digit first and last"
# So many faults of a manifest are told one by one.
MOST_FAULTS = 30
RESERVED = ("cohort.json", "cohort.csv", "index.html", "journal.jsonl")


@dataclass(frozen=True, eq=False, kw_only=True)
class CohortCase:
    """One case of a cohort.

    Attributes
    ----------
    id : str
        Name of its run folder.
    planner : str
        Key of `tubeplan_viz.planners.PLANNERS`.
    case : any case that a planner makes
    """

    id: str
    planner: str
    case: Any

    def text(self, target: Path) -> str:
        """What case.toml of the run folder `target` holds."""
        return PLANNERS[self.planner].text(self.case, target)

    @property
    def planner_table(self) -> dict[str, Any]:
        """Its table ``[planner]`` with every default resolved."""
        table: dict[str, Any] = tomllib.loads(self.text(Path(self.id)))["planner"]
        return table


@dataclass(frozen=True, eq=False, kw_only=True)
class Manifest:
    """A checked manifest.

    Attributes
    ----------
    name, sha256 : str
        File name and digest of the file.
    cases : tuple of CohortCase
        In the order of the file.
    rng_seed : int or None
        What the seeds of the cases were drawn from.
    """

    name: str
    sha256: str
    cases: tuple[CohortCase, ...]
    rng_seed: int | None = None


def read_manifest(path: Path, *, rng_seed: int | None = None) -> Manifest:
    """Read a manifest and check every case of it.

    Parameters
    ----------
    path : Path
        ``.csv`` for a table, otherwise TOML: ``[defaults]``, and ``[[cases]]`` each with ``id`` and a case file as ``case``, or
        the tables of one, or both. Relative paths start from the file in which they stand.
    rng_seed : int, optional
        Gives each case without a seed of its own one that hangs on its id alone.

    Raises
    ------
    ManifestError
        Naming all that is wrong: the line, the case, what was found and what was expected.
    """
    if rng_seed is not None and rng_seed < 0:
        raise ManifestError(f"--rng-seed is {rng_seed}, expected 0 or more")
    try:
        content = path.read_bytes()
    except OSError as fault:
        reason = (fault.strerror or "unknown reason").lower()
        raise ManifestError(f"{path.name}: cannot be read ({reason}); name a TOML or CSV file") from None
    defaults, rows = read_rows(content, path)
    if not rows:
        raise ManifestError(f"{path.name}: it has no case; expected [[cases]] each with id and case, or a row for each case")
    cases: list[CohortCase] = []
    faults: list[str] = []
    for row in rows:
        try:
            made = _case(row, defaults, path.resolve().parent, rng_seed)
        except TubeplanError as fault:
            faults.append(f"{row.label}: {fault}")
            continue
        faults += [f"{row.label}: {what}" for what in _missing(made)]
        cases.append(made)
    faults += _doubled(rows)
    if len(faults) == 1:
        raise ManifestError(f"{path.name}, {faults[0]}")
    if faults:
        more = [f"and {len(faults) - MOST_FAULTS} more"] if len(faults) > MOST_FAULTS else []
        told = "\n  ".join([*faults[:MOST_FAULTS], *more])
        raise ManifestError(f"{path.name}: {len(faults)} faults, nothing was run:\n  {told}")
    return Manifest(name=path.name, sha256=hashlib.sha256(content).hexdigest(), cases=tuple(cases), rng_seed=rng_seed)


def _case(row: Row, defaults: Mapping[str, Any], folder: Path, rng_seed: int | None) -> CohortCase:
    """The case of one row: the defaults, over them its case file, over that what the row says itself."""
    if not isinstance(row.id, str) or not ID.fullmatch(row.id):
        raise CaseError(f"id is {row.id!r}, expected {ID_RULE}; it names the run folder, so no patient's name")
    if row.id.casefold() in RESERVED:
        raise CaseError(f"id is {row.id!r}, the name of a file of the cohort; choose another")
    filed = _file_tables(row.case, folder)
    which = row.planner or planner_of(filed) or planner_of(defaults) or "tube"
    if which not in PLANNERS:
        raise CaseError(f"there is no planner {which!r}, expected one of {', '.join(PLANNERS)}")
    given = layered(filed, rebased(row.tables(which), folder))
    tables = layered(for_planner(rebased(defaults, folder), which), given)
    for name in ("input", "planner"):
        if not isinstance(tables.get(name, {}), Mapping):
            raise CaseError(f"{name} is {tables[name]!r}, expected a table as [cases.{name}]")
    tables["input"] = {"case_id": row.id, **tables.get("input", {})}
    tables["planner"] = {**tables.get("planner", {}), "name": which}
    if rng_seed is not None and takes_seed(which) and "rng_seed" not in given.get("planner", {}):
        tables["planner"]["rng_seed"] = case_seed(rng_seed, row.id)
    made = CohortCase(id=row.id, planner=which, case=make_case(tables, name="case"))
    _settle(made)
    return made


def _settle(case: CohortCase) -> None:
    """Ask for what a case otherwise works out when its run begins: names in a catalogue, the planner's method."""
    case.text(Path(case.id))
    if isinstance(case.case, TubeCase):
        _ = case.case.tube_settings


def _file_tables(value: Any, folder: Path) -> dict[str, Any]:
    """The tables of the case file that a row names, its relative paths made absolute; none without one."""
    if value is None:
        return {}
    path = located(value, folder, "case")
    return rebased(read_table(path), path.resolve().parent)


def _missing(case: CohortCase) -> Iterator[str]:
    for path in input_paths(case.case):
        if not path.exists():
            yield f"{path.name}: there is no such file or folder; check the path"


def _doubled(rows: list[Row]) -> list[str]:
    """Ids that stand more than once; two that differ in case alone would be one folder on some systems."""
    places: dict[str, list[Row]] = {}
    for row in rows:
        if isinstance(row.id, str):
            places.setdefault(row.id.casefold(), []).append(row)
    return [
        f"{' and '.join(row.where for row in same)}: the id {same[0].id!r} stands {len(same)} times; expected each once"
        for same in places.values()
        if len(same) > 1
    ]
