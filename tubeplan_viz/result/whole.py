"""Single files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def write_whole(path: Path, content: bytes, *, replace: bool = True) -> None:
    """Write a file beside its place, flush it to the disk and rename it, mode 0600; nothing is left of one that fails.

    Parameters
    ----------
    path : Path
    content : bytes
    replace : bool
        Take the place of an earlier file; without it none is lost, not even one that has come meanwhile.

    Raises
    ------
    FileExistsError
        If there is one and it is not to be replaced.
    OSError
        If it cannot be written.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.partial-", dir=path.parent)
    partial = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if not replace:
            # Claims the name, on file systems without hard links too.
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
