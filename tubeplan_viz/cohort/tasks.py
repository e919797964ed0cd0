"""What a worker is asked to do with one case, and what it answers: plain values that cross processes and machines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any


class CaseStatus(StrEnum):
    """How one case of a cohort ended; the first three are those of a run's result.json."""

    OK = "ok"
    FLAGGED = "flagged"
    INFEASIBLE = "infeasible"
    BAD_INPUT = "bad_input"
    TIME_LIMIT = "time_limit"
    DIED = "died"
    FAULT = "fault"


# Without a verdict, for a reason that another try may not meet.
FAILED = (CaseStatus.BAD_INPUT, CaseStatus.TIME_LIMIT, CaseStatus.DIED, CaseStatus.FAULT)


@dataclass(frozen=True, kw_only=True)
class Task:
    """One case to be planned, verified or both.

    Attributes
    ----------
    id : str
    target : str
        Its run folder, as an absolute path.
    case_text : str
        Its case.toml with every default resolved, paths relative to `target`.
    version : str
        Of the program that asks.
    plan, verify : bool
        What is to be done.
    replace : bool
        Whether an earlier run stands in the way.
    recording, report : bool
    time_limit : float or None
        Seconds after which the case is ended.
    alive : str or None
        A file that stands as long as the answer is wanted.
    """

    id: str
    target: str
    case_text: str
    version: str
    plan: bool = True
    verify: bool = False
    replace: bool = False
    recording: bool = True
    report: bool = True
    time_limit: float | None = None
    alive: str | None = None

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What a case took; None where nobody counted.

    `wall_s` and `cpu_s` are seconds of its process, `peak_memory_mb` its largest resident set in 2**20 bytes.
    """

    wall_s: float | None = None
    cpu_s: float | None = None
    peak_memory_mb: float | None = None


@dataclass(frozen=True, kw_only=True)
class Answer:
    """How a task ended.

    Attributes
    ----------
    id : str
    status : CaseStatus or None
        None where nothing was to be planned and nothing went wrong.
    reason : str or None
        None for a path that holds.
    verification : mapping or None
        ``holds``, ``checks`` (how many) and ``failed`` (name and sentence of each that does not hold).
    cost : Cost
    stopped : bool
        The answer was not wanted any more; nothing was kept.
    """

    id: str
    status: CaseStatus | None
    reason: str | None = None
    verification: Mapping[str, Any] | None = None
    cost: Cost = field(default_factory=Cost)
    stopped: bool = False
