"""What of a cohort is done already: from the run folders themselves and the journal."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tubeplan_viz import __version__
from tubeplan_viz.cohort.inputs import Digests, input_paths
from tubeplan_viz.cohort.journal import Entry
from tubeplan_viz.cohort.manifest import CohortCase
from tubeplan_viz.cohort.tasks import FAILED
from tubeplan_viz.result import RESULT, file_sha256, is_run
from tubeplan_viz.result.folder import FILES


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What a run folder must hold to be kept."""

    recording: bool = True
    report: bool = True
    retry_failed: bool = False

    @property
    def files(self) -> tuple[str, ...]:
        """The files that may be left out on demand and were not."""
        asked = (("recording.rrd", self.recording), ("report.html", self.report))
        return tuple(name for name, wanted in asked if wanted)


def case_key(case: CohortCase, target: Path, digests: Digests) -> str:
    """What a run is the result of: resolved case, content of every input, version of the software.

    Raises
    ------
    CaseError
        If an input cannot be read.
    """
    inputs = [digests.of(path) for path in input_paths(case.case)]
    return hashlib.sha256("\n".join([__version__, *inputs, case.text(target)]).encode("utf-8")).hexdigest()


def standing(case: CohortCase, target: Path, key: str, entry: Entry, wanted: Wanted) -> Mapping[str, Any] | None:
    """What the journal says of the end of a case that need not run again; empty when it ended after the journal's last
    word; None when it has to run.

    Parameters
    ----------
    case : CohortCase
    target : Path
        Its run folder.
    key : str
        From `case_key`.
    entry : Entry
        The journal's last word on it.
    wanted : Wanted
    """
    ended = entry.ended if entry.ended.get("key") == key else {}
    if ended and ended.get("result_sha256") is None:
        return None if ended["status"] in FAILED and wanted.retry_failed else ended
    digest = result_digest(target)
    if digest is None or not _whole(case, target, wanted):
        return None
    if ended.get("result_sha256") == digest:
        return ended
    # The machine stopped between the folder's appearance and the journal's next line.
    fresh = entry.begun.get("key") == key and entry.begun.get("replaces") != digest
    return {} if fresh else None


def result_digest(target: Path) -> str | None:
    """SHA-256 of a run's result.json; None where there is no run."""
    return file_sha256(target / RESULT) if is_run(target) else None


def _whole(case: CohortCase, target: Path, wanted: Wanted) -> bool:
    """Whether a run is that of the case, and none of its files is missing."""
    stated = json.loads((target / RESULT).read_text(encoding="utf-8"))["provenance"].get("outputs", [])
    names = (*(entry["name"] for entry in stated), *wanted.files, "case.toml")
    if any(not (target / name).is_file() for name in names):
        return False
    return (target / "case.toml").read_text(encoding="utf-8") == case.text(target)


def forget(target: Path) -> None:
    """Remove the run of an earlier form of a case that now has none; a folder that holds anything else stays."""
    if is_run(target) and {entry.name for entry in target.iterdir()} <= set(FILES):
        shutil.rmtree(target)


def sweep(target: Path) -> None:
    """Remove what a killed run left beside its folder under hidden names."""
    for pattern in (f".{target.name}.partial-*", f".{target.name}.replaced-*"):
        for rest in target.parent.glob(pattern):
            shutil.rmtree(rest, ignore_errors=True)
