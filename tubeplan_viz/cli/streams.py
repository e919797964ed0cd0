"""Standard input and output as they may be: closed, a pipe that nobody reads any more, a disk that is full."""

from __future__ import annotations

import io
import os
import sys
from typing import Any

from segmentation.errors import TubeplanError


class OutputError(TubeplanError):
    """Standard output that takes nothing any more."""


class Unread(io.FileIO):
    """A file whose reader may go, as `head` does: what nobody reads is no fault, and the work goes on to its own end."""

    gone = False

    def write(self, content: Any) -> int:
        """Write bytes; all of them count as written once the reader has gone.

        Raises
        ------
        OutputError
            Where the file takes no more; once, since what is printed after that is lost too.
        """
        if self.gone:
            return memoryview(content).nbytes
        try:
            return int(super().write(content) or 0)
        except BrokenPipeError:
            self.gone = True
            return memoryview(content).nbytes
        except OSError as fault:
            self.gone = True
            reason = (fault.strerror or "the system refuses").lower()
            raise OutputError(f"standard output cannot be written ({reason}); make room or send it elsewhere") from None


def open_streams() -> None:
    """Make standard streams that can be relied on.

    A closed one becomes the null device: otherwise the next file to be opened would be taken for it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    sys.stdout, sys.stderr = (readable_by_some(stream, number) for number, stream in ((1, sys.stdout), (2, sys.stderr)))


def readable_by_some(stream: Any, number: int) -> Any:
    """A stream that bears the loss of its reader: the one at hand, where it is a terminal or none of the system's."""
    try:
        if stream is not None and (stream.isatty() or stream.fileno() != number):
            return stream
    except (OSError, ValueError):  # one that somebody else has put there
        return stream
    encoding, errors = ("utf-8", "replace") if stream is None else (stream.encoding, stream.errors)
    raw = io.BufferedWriter(Unread(number, "wb", closefd=False))
    return io.TextIOWrapper(raw, encoding=encoding, errors=errors, line_buffering=number == 2)


def flushed() -> bool:
    """Whether all that was printed is written; what is not is said on standard error."""
    try:
        sys.stdout.flush()
    except OutputError as fault:
        sys.stderr.write(f"tubeplan: {fault}\n")
        return False
    return True
