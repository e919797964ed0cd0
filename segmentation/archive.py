"""Data sets that come as tar archives."""

from __future__ import annotations

import tarfile
from pathlib import Path


def unpack(archive: Path, folder: Path) -> None:
    """Unpack a tar archive into a folder; nothing may land outside it.

    Raises
    ------
    tarfile.TarError
        If it is none, or a member would leave the folder.
    """
    with tarfile.open(archive) as content:
        if hasattr(tarfile, "data_filter"):
            content.extractall(folder, filter="data")
            return
        # Python 3.11 before 3.11.4 has no filters.
        root = folder.resolve()
        for member in content.getmembers():
            if not (member.isfile() or member.isdir()) or not (root / member.name).resolve().is_relative_to(root):
                raise tarfile.TarError(f"{archive.name}: {member.name} is no file below the folder")
        content.extractall(folder)
