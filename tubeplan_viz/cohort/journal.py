"""The journal of a cohort: one line of JSON when a case begins and one when it has ended, only ever added to.

A line is on the disk before what follows it is done. A machine that is switched off leaves at most one torn line at the
end, which is passed over. Whoever holds the journal holds the cohort: a second process is refused.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tubeplan_viz import __version__
from tubeplan_viz.cohort.errors import CohortError

JOURNAL = "journal.jsonl"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What the journal last said of one case; empty mappings where it said nothing."""

    begun: Mapping[str, Any] = field(default_factory=dict)
    ended: Mapping[str, Any] = field(default_factory=dict)


class Journal:
    """Context manager that holds a cohort's journal open, and alone.

    Parameters
    ----------
    folder : Path
        The cohort's folder; made if there is none.

    Raises
    ------
    CohortError
        On entering: if the folder holds something else, cannot be written to, or another process has its journal.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._descriptor = -1
        self._entries: dict[str, Entry] = {}

    def __enter__(self) -> Self:
        name, path = self._folder.resolve().name, self._folder / JOURNAL
        try:
            if not self._folder.exists():
                self._folder.mkdir(mode=0o700)
            elif not path.exists() and any(self._folder.iterdir()):
                raise CohortError(f"{name} is not empty and holds no cohort (no {JOURNAL}); choose another folder")
            self._descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o600)
        except OSError as fault:
            reason = (fault.strerror or "the system refuses").lower()
            raise CohortError(f"{name}: no cohort can be kept there ({reason}); choose a place you may write to") from None
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._descriptor)
            raise CohortError(
                f"{name}: another `tubeplan batch` is at work in it; wait for it, or choose another folder"
            ) from None
        self._read(path.read_bytes())
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None) -> None:
        os.close(self._descriptor)  # the lock goes with it

    def _read(self, content: bytes) -> None:
        for line in content.splitlines():
            try:
                said = json.loads(line)
                event, name = said["event"], said["id"]
            except (ValueError, TypeError, KeyError):
                continue  # torn by a machine that stopped, or of a kind that says nothing of a case
            if event in ("begun", "ended"):
                self._take(event, name, said)
        if content and not content.endswith(b"\n"):
            self._append(b"\n")  # what follows a torn line stands on a line of its own

    def of(self, case_id: str) -> Entry:
        """What was last said of a case."""
        return self._entries.get(case_id, Entry())

    def add(self, event: str, case_id: str, **values: Any) -> dict[str, Any]:
        """Write one line, ``begun`` or ``ended``, on the disk when this returns; gives what it says."""
        utc = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        said = {"event": event, "id": case_id, **values, "utc": utc, "version": __version__}
        self._append(json.dumps(said, allow_nan=False).encode("utf-8") + b"\n")
        self._take(event, case_id, said)
        return said

    def _take(self, event: str, case_id: str, said: Mapping[str, Any]) -> None:
        before = self.of(case_id)
        if event == "ended":
            self._entries[case_id] = Entry(begun=before.begun, ended=said)
        else:  # a case that begins again as it was has not ended any more
            again = before.ended.get("key") == said.get("key")
            self._entries[case_id] = Entry(begun=said, ended={} if again else before.ended)

    def _append(self, line: bytes) -> None:
        # One write of a file opened to append: a line stands there whole or is the torn end.
        try:
            whole = os.write(self._descriptor, line) == len(line)
            os.fsync(self._descriptor)
        except OSError as fault:
            raise CohortError(
                f"{JOURNAL} cannot be written ({(fault.strerror or 'unknown reason').lower()}); make room"
            ) from None
        if not whole:
            raise CohortError(f"{JOURNAL} cannot be written whole, the disk is full; make room and run the same command again")
