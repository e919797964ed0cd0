"""The run folder: whole or not there.

Everything is written into a hidden neighbour ``.NAME.partial-XXXX``, flushed to the
disk and renamed at the end. An error, Ctrl-C or a request to terminate removes the
neighbour; a killed process leaves it under its hidden name.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tubeplan_viz.interrupts import check_interrupted, ending_like_ctrl_c
from tubeplan_viz.result.document import SOFTWARE, plain, result_text
from tubeplan_viz.result.errors import RunFolderError
from tubeplan_viz.result.schema import validate_result

RESULT = "result.json"
# What a run leaves (README); a folder that holds anything else is never replaced.
FILES = (
    RESULT,
    "case.toml",
    "report.html",
    "recording.rrd",
    "path.csv",
    "path.mrk.json",
    "mesh.ply",
    "actuation.csv",
    "states.csv",
)
# Folders of other commands, by the file that tells them.
OTHERS = {
    "matrix.json": "tubeplan matrix",
    "reach.json": "tubeplan reach",
    "compare.json": "tubeplan compare",
    "cohort.json": "tubeplan batch",
    "export.json": "tubeplan export",
    "segmentation.json": "tubeplan segment",
}
FULL = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "a file would exceed the size limit",
}


class RunFolder:
    """Context manager in which a run's files are written; `finish` makes the folder appear.

    Leaving the block without `finish` discards what was written. Folders are made
    with mode 0700 and files 0600, since even a derived surface may show a face.

    Parameters
    ----------
    target : Path
        The folder to appear; its parent must exist.
    force : bool
        Replace an earlier run of that name. The old one is removed after the new
        one is in its place.
    files : sequence of str
        Names that the folder may hold; a JSON file first, by whose ``provenance.software`` an
        earlier folder of this kind is known.

    Attributes
    ----------
    name : str
        Name of the folder to appear.

    Raises
    ------
    RunFolderError
        On entering, if the target exists (without `force`), is no tubeplan run (with
        `force`), or cannot be made there; on leaving, if the disk is full.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as place, RunFolder(Path(place) / "case-1") as run:
    ...     run.write_text("path.csv", "s_mm")
    ...     run.path("path.csv").exists(), (Path(place) / "case-1").exists()
    (True, False)
    """

    def __init__(self, target: Path, *, force: bool = False, files: Sequence[str] = FILES) -> None:
        self._target = Path(os.path.abspath(target))
        self._force = force
        self._files = tuple(files)
        self._partial: Path | None = None
        self._finished = False
        self._signals = ExitStack()

    @property
    def name(self) -> str:
        """Name of the folder that will appear."""
        return self._target.name

    def __enter__(self) -> Self:
        self._check_target()
        parent = self._target.parent
        if not parent.is_dir():
            raise RunFolderError(f"{self.name}: its parent folder does not exist; make it first or choose another place")
        # Python leaves at once on SIGTERM; as a KeyboardInterrupt it passes through __exit__ like Ctrl-C.
        self._signals.enter_context(ending_like_ctrl_c())
        try:
            self._partial = Path(tempfile.mkdtemp(prefix=f".{self.name}.partial-", dir=parent))
        except OSError as fault:
            self._signals.close()
            reason = FULL.get(fault.errno or 0) or (fault.strerror or "the system refuses").lower()
            raise RunFolderError(
                f"{self.name}: no folder can be made there ({reason}); choose a place you may write to"
            ) from fault
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if not self._finished and self._partial is not None:
                shutil.rmtree(self._partial, ignore_errors=True)
        finally:
            self._signals.close()
        if isinstance(fault, OSError) and fault.errno in FULL:
            raise RunFolderError(
                f"{self.name}: {FULL[fault.errno]}, nothing was kept; make room or choose another place"
            ) from fault

    def path(self, name: str) -> Path:
        """Where to write the file `name` while the run is unfinished."""
        if self._partial is None or self._finished:
            raise RunFolderError(f"{name}: the run folder is not open, expected between entering and finish")
        if name not in self._files:
            raise RunFolderError(f"{name} is no file of a run folder, expected one of {', '.join(self._files)}")
        return self._partial / name

    def write_bytes(self, name: str, content: bytes) -> None:
        """Write one file, mode 0600, and flush it to the disk."""
        descriptor = os.open(self.path(name), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    def write_text(self, name: str, text: str) -> None:
        """Write one UTF-8 text file with the line ends it has, mode 0600."""
        self.write_bytes(name, text.encode("utf-8"))

    def write_json(self, name: str, document: Any) -> None:
        """Write one JSON file; numbers read back as the same doubles, none may be infinite or NaN."""
        self.write_text(name, json.dumps(plain(document), allow_nan=False, indent=1) + "\n")

    def finish(self, result: Mapping[str, Any]) -> dict[str, Any]:
        """Write result.json with the digest of every other file, and let the folder appear.

        Parameters
        ----------
        result : mapping
            From `build_result`; not changed.

        Returns
        -------
        dict
            What result.json holds: `result` with ``provenance.outputs``.

        Raises
        ------
        ResultError
            If the result does not follow its schema.
        RunFolderError
            If the folder cannot appear under its name.
        """
        partial = self.path(RESULT).parent
        names = self._names(partial)
        document: dict[str, Any] = plain(result)
        document["provenance"]["outputs"] = [{"name": name, "sha256": file_sha256(partial / name)} for name in names]
        validate_result(document)
        self.write_text(RESULT, result_text(document))
        self.appear()
        return document

    def appear(self) -> None:
        """Flush every file and let the folder appear under its name, as it is.

        Raises
        ------
        RunFolderError
            If a file does not belong into it, or it cannot appear.
        """
        check_interrupted()
        marker = self.path(self._files[0])
        partial = marker.parent
        if not marker.exists():
            raise RunFolderError(f"{self.name}: {marker.name} was not written, expected it before the folder appears")
        for name in [*self._names(partial), self._files[0]]:
            os.chmod(partial / name, 0o600)
            _flush(partial / name)
        _flush(partial)
        self._replace(partial)
        _flush(self._target.parent)

    def _names(self, partial: Path) -> list[str]:
        """Files written so far, but for the first of `files`."""
        names = sorted(entry.name for entry in partial.iterdir() if entry.name != self._files[0])
        foreign = [name for name in names if name not in self._files]
        if foreign:
            expected = ", ".join(self._files)
            raise RunFolderError(f"{self.name}: {', '.join(foreign)} was left in the folder, expected only {expected}")
        return names

    def _replace(self, partial: Path) -> None:
        self._check_target()
        old: Path | None = None
        try:
            if os.path.lexists(self._target):
                old = Path(tempfile.mkdtemp(prefix=f".{self.name}.replaced-", dir=self._target.parent))
                os.rename(self._target, old)
            os.rename(partial, self._target)
            self._finished = True
        except OSError as fault:
            raise RunFolderError(
                f"{self.name}: the finished run cannot take that name ({(fault.strerror or 'the system refuses').lower()}); "
                "choose another name"
            ) from fault
        finally:
            if old is not None and self._finished:
                shutil.rmtree(old, ignore_errors=True)
            elif old is not None and not os.path.lexists(self._target):
                os.rename(old, self._target)

    def _check_target(self) -> None:
        if not self.name:
            raise RunFolderError("the root of the file system cannot be a run folder; name a folder to be made")
        if any("\ud800" <= letter <= "\udfff" for letter in self.name):  # bytes that are no UTF-8: no comparison could name it
            raise RunFolderError(f"{self.name!a} is no name in UTF-8; choose another name, for instance one in ASCII")
        if not os.path.lexists(self._target):
            return
        if self._target.is_symlink() or not self._target.is_dir():
            raise RunFolderError(f"{self.name} exists and is no folder; choose another name")
        here, home = Path.cwd(), Path.home()
        if here.is_relative_to(self._target.resolve()) or home.is_relative_to(self._target.resolve()):
            raise RunFolderError(
                f"{self.name} is the home folder, the current folder or one that holds it; name a folder to be made"
            )
        if not self._force:
            raise RunFolderError(f"{self.name} exists already; choose another name, or replace that run with --force")
        present = sorted(entry.name for entry in self._target.iterdir())
        foreign = [name for name in present if name not in self._files]
        if foreign:
            raise RunFolderError(
                f"{self.name} holds {foreign[0]}, which is no part of a run, and is not replaced; choose another name"
            )
        if present and not is_run(self._target, self._files[0]):
            raise RunFolderError(
                f"{self.name} is no tubeplan run (no {self._files[0]} of one) and is not replaced; choose another name"
            )


def is_run(folder: Path, marker: str = RESULT) -> bool:
    """Whether the folder's result.json (or another marker) says that tubeplan wrote it."""
    try:
        document = json.loads((folder / marker).read_text(encoding="utf-8"))
        return bool(document["provenance"]["software"] == SOFTWARE)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def not_a_run(folder: Path) -> RunFolderError:
    """What to say of a folder that is no run: whose it is, where another command made it."""
    name = folder.resolve().name
    command = next((command for marker, command in OTHERS.items() if is_run(folder, marker)), None)
    if command is not None:
        return RunFolderError(f"{name} was made by `{command}` and is no run; name a folder that `tubeplan plan` or `run` made")
    return RunFolderError(f"{name} is no tubeplan run (no result.json of one); name the folder that `tubeplan plan` made")


def read_result(folder: Path) -> dict[str, Any]:
    """The content of a run's result.json, checked.

    Raises
    ------
    RunFolderError
        If there is no run in the folder.
    ResultError
        If its result.json does not follow the schema.
    """
    if not is_run(folder):
        raise not_a_run(folder)
    document: dict[str, Any] = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    validate_result(document)
    return document


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, lower-case hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
