"""The files that a case reads: whether they are there, and what is in them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from tubeplan_viz.result import file_sha256

# Headers whose voxels lie in a file beside them, of the same name but for its ending.
HEADERS = (".mhd",)


def input_paths(case: Any) -> list[Path]:
    """Every file or folder that a case names, in the order of its fields, each once.

    A case holds its files as `Path` in its fields and nothing else as one, for whatever planner.
    """
    return list(dict.fromkeys(_paths(case)))


def _paths(value: Any) -> Iterator[Path]:
    if isinstance(value, Path):
        yield value
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from _paths(getattr(value, field.name))
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _paths(item)
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for item in value:
            yield from _paths(item)


class Digests:
    """Digests of files and folders, each read once as long as it stays as it is."""

    def __init__(self) -> None:
        self._known: dict[tuple[Path, int, int], str] = {}

    def of(self, path: Path) -> str:
        """SHA-256 of a file's bytes, or of the names and bytes of all files below a folder.

        Raises
        ------
        CaseError
            If it cannot be read.
        """
        try:
            listed = [("", path), *self._beside(path)] if path.is_file() else self._below(path)
            rows = [(name, self._file(file)) for name, file in listed]
        except OSError as fault:
            reason = (fault.strerror or "unknown reason").lower()
            raise CaseError(f"{path.name}: cannot be read ({reason}); check the path and its permissions") from None
        if len(rows) == 1 and not rows[0][0]:
            return rows[0][1]
        return hashlib.sha256("".join(f"{digest} {name}\n" for name, digest in rows).encode()).hexdigest()

    @staticmethod
    def _below(folder: Path) -> list[tuple[str, Path]]:
        found = sorted(path for path in folder.rglob("*") if path.is_file())
        return [(path.relative_to(folder).as_posix(), path) for path in found]

    @staticmethod
    def _beside(path: Path) -> list[tuple[str, Path]]:
        if path.suffix.lower() not in HEADERS:
            return []
        return [(other.name, other) for other in sorted(path.parent.glob(f"{path.stem}.*")) if other != path]

    def _file(self, path: Path) -> str:
        state = path.stat()
        key = (path.resolve(), state.st_size, state.st_mtime_ns)
        if key not in self._known:
            self._known[key] = file_sha256(path)
        return self._known[key]
