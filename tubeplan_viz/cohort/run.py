"""A cohort from its manifest to run folders and a summary: only what is not done yet, whatever ends in between."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from tubeplan_viz import __version__
from tubeplan_viz.cohort.cluster import call_back, run_there
from tubeplan_viz.cohort.errors import CohortInterrupted
from tubeplan_viz.cohort.here import run_here, usable_processors
from tubeplan_viz.cohort.inputs import Digests
from tubeplan_viz.cohort.journal import Journal
from tubeplan_viz.cohort.manifest import CohortCase, Manifest
from tubeplan_viz.cohort.state import Wanted, case_key, forget, result_digest, standing, sweep
from tubeplan_viz.cohort.summary import SUMMARY_FILES, cohort_document, row_of, write_summary
from tubeplan_viz.cohort.tasks import Answer, CaseStatus, Cost, Task
from tubeplan_viz.cohort.words import without_paths
from tubeplan_viz.interrupts import ending_like_ctrl_c
from tubeplan_viz.result import RESULT


@dataclass(frozen=True, kw_only=True)
class CohortSettings:
    """How a cohort is run; none of it changes a number of a plan but `time_limit`, which may leave one out.

    Attributes
    ----------
    jobs : int or None
        Cases at a time on this machine; None for as many as processors that this process may use.
    scheduler : str or None
        Address of a Dask scheduler that takes the cases instead.
    time_limit : float or None, s
        After which a case is ended.
    retry_failed : bool
        Run again what had bad input, died, hit the time limit or met a fault.
    verify : bool
        Verify each run.
    recording, report : bool
    """

    jobs: int | None = None
    scheduler: str | None = None
    time_limit: float | None = None
    retry_failed: bool = False
    verify: bool = False
    recording: bool = True
    report: bool = True

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise CaseError(f"--jobs is {self.jobs}, expected 1 or more")
        if self.time_limit is not None and not self.time_limit > 0.0:
            raise CaseError(f"--time-limit is {self.time_limit:g} s, expected more than 0")
        if self.scheduler is not None and self.jobs is not None:
            raise CaseError(
                "--jobs is for this machine and --scheduler for a cluster, which has its own number; give one of them"
            )


@dataclass(frozen=True, kw_only=True)
class CohortEvent:
    """What a watcher is told: a case begins a stage, or it is settled (`status` is set)."""

    id: str
    done: int
    total: int
    stage: str = ""
    status: CaseStatus | None = None
    reason: str | None = None
    kept: bool = False
    wall_s: float | None = None


Watch = Callable[[CohortEvent], None]


def nobody(event: CohortEvent) -> None:
    """Events for nobody."""


def run_cohort(manifest: Manifest, folder: Path, settings: CohortSettings, *, watch: Watch = nobody) -> dict[str, Any]:
    """Run what of a cohort is not done, and write its summary.

    Parameters
    ----------
    manifest : Manifest
    folder : Path
        The cohort's folder: new, empty, or that of an earlier call, of which is kept what still is the answer: same resolved
        case, same content of its inputs, same version of the software, and no file missing.
    settings : CohortSettings
    watch : callable, optional
        Told how it goes on, also from other threads.

    Returns
    -------
    dict
        The content of cohort.json.

    Raises
    ------
    CohortError
        If the folder cannot be used, or no cluster is there.
    CohortInterrupted
        On Ctrl-C and on requests to terminate: finished cases are whole, of others nothing is left.
    """
    begun = time.monotonic()
    with Journal(folder) as journal, ending_like_ctrl_c():
        for name in SUMMARY_FILES:  # a summary that is there tells of the whole cohort
            (folder / name).unlink(missing_ok=True)
        call_back(folder)
        here = Pass(manifest=manifest, folder=folder.resolve(), settings=settings, journal=journal, watch=watch)
        try:
            here.run()
        except KeyboardInterrupt:
            raise CohortInterrupted(
                f"interrupted; {here.done} of {len(manifest.cases)} cases are done and kept, the same command goes on from there"
            ) from None
        rows = [row_of(case, folder, journal.of(case.id).ended) for case in manifest.cases]
        others = sorted(place.parent.name for place in folder.glob(f"[!.]*/{RESULT}"))
        document = cohort_document(
            manifest,
            rows,
            kept=here.kept,
            seconds=time.monotonic() - begun,
            others=[name for name in others if name not in {case.id for case in manifest.cases}],
            scheduler=settings.scheduler is not None,
        )
        write_summary(document, folder)
    return document


@dataclass(kw_only=True)
class Pass:
    """One pass over the cases: which are kept, which are tasks, and what came of them."""

    manifest: Manifest
    folder: Path
    settings: CohortSettings
    journal: Journal
    watch: Watch
    done: int = 0
    kept: int = 0
    _digests: Digests = field(default_factory=Digests)
    _tasks: dict[str, Task] = field(default_factory=dict)
    _keys: dict[str, str] = field(default_factory=dict)

    def run(self) -> None:
        """Go through all cases."""
        settings = self.settings
        if settings.scheduler is not None:
            answers = run_there(self.tasks(), settings.scheduler, self.folder)
        else:
            jobs = settings.jobs or usable_processors()
            answers = run_here(self.tasks(), min(jobs, len(self.manifest.cases)), stage=self._stage)
        try:
            for answer in answers:
                self.take(answer)
        finally:
            answers.close()

    def tasks(self) -> Iterator[Task]:
        """What is to be done, case by case; what stands is counted on the way."""
        settings = self.settings
        wanted = Wanted(recording=settings.recording, report=settings.report, retry_failed=settings.retry_failed)
        for case in self.manifest.cases:
            target = self.folder / case.id
            sweep(target)
            try:
                key = case_key(case, target, self._digests)
            except CaseError as fault:  # gone or locked since the manifest was read
                self._settled(case.id, self._ended(case.id, "", CaseStatus.BAD_INPUT, without_paths(str(fault))))
                continue
            self._keys[case.id] = key
            said = standing(case, target, key, self.journal.of(case.id), wanted)
            digest = result_digest(target)
            if said is not None and not said:
                result = json.loads((target / RESULT).read_text(encoding="utf-8"))
                said = self._ended(case.id, key, CaseStatus(result["status"]), result["reason"], digest=digest)
            if said is None:
                self.journal.add("begun", case.id, key=key, replaces=digest)
                yield self._task(case, target, plan=True, verify=settings.verify)
            elif settings.verify and said["result_sha256"] is not None and said["verification"] is None:
                yield self._task(case, target, plan=False, verify=True)
            else:
                self.kept += 1
                self._settled(case.id, said, kept=True)

    def _task(self, case: CohortCase, target: Path, *, plan: bool, verify: bool) -> Task:
        settings = self.settings
        self._tasks[case.id] = task = Task(
            id=case.id,
            target=str(target),
            case_text=case.text(target),
            version=__version__,
            plan=plan,
            verify=verify,
            replace=target.exists(),
            recording=settings.recording,
            report=settings.report,
            time_limit=settings.time_limit,
        )
        return task

    def take(self, answer: Answer) -> None:
        """Write down how a task ended."""
        if answer.stopped:
            return
        task, target, entry = self._tasks[answer.id], self.folder / answer.id, self.journal.of(answer.id)
        key, digest = self._keys[answer.id], result_digest(target)
        verification, status, reason, cost = answer.verification, answer.status, answer.reason, answer.cost
        if task.plan and (digest is None or digest == entry.begun["replaces"]):
            if digest is not None:
                forget(target)
            assert status is not None
            self._settled(answer.id, self._ended(answer.id, key, status, reason, cost=cost))
            return
        if task.verify and verification is None:  # the run is whole; what came after it was not done
            verification = {"holds": False, "checks": 0, "failed": [{"name": "verify", "sentence": str(reason)}]}
        if task.plan:
            result = json.loads((target / RESULT).read_text(encoding="utf-8"))
            status, reason = CaseStatus(result["status"]), result["reason"]
        else:
            said = entry.ended
            status, reason = CaseStatus(said["status"]), said["reason"]
            cost = Cost(wall_s=said["wall_s"], cpu_s=said["cpu_s"], peak_memory_mb=said["peak_memory_mb"])
        said = self._ended(answer.id, key, status, reason, digest=digest, verification=verification, cost=cost)
        self._settled(answer.id, said)

    def _ended(
        self,
        case_id: str,
        key: str,
        status: CaseStatus,
        reason: str | None,
        *,
        digest: str | None = None,
        verification: Mapping[str, Any] | None = None,
        cost: Cost | None = None,
    ) -> Mapping[str, Any]:
        """Write down the end of a case; what was not said is null."""
        told = {"key": key, "status": str(status), "reason": reason, "result_sha256": digest, "verification": verification}
        return self.journal.add("ended", case_id, **told, **asdict(cost or Cost()))

    def _settled(self, case_id: str, said: Mapping[str, Any], *, kept: bool = False) -> None:
        self.done += 1
        self.watch(
            CohortEvent(
                id=case_id,
                done=self.done,
                total=len(self.manifest.cases),
                status=CaseStatus(said["status"]),
                reason=said["reason"],
                kept=kept,
                wall_s=said["wall_s"],
            )
        )

    def _stage(self, case_id: str, stage: str) -> None:
        self.watch(CohortEvent(id=case_id, done=self.done, total=len(self.manifest.cases), stage=stage))
