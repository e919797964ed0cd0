"""The tubeplan command: one module per command."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from tubeplan_viz.cli.streams import flushed, open_streams
from tubeplan_viz.interrupts import ending_like_ctrl_c, no_more_interrupts

__all__ = ["main"]

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with the status that the README lists."""
    with ending_like_ctrl_c():
        open_streams()
        try:
            # Imported here: each process that a command starts reads this module again, and needs none of the commands.
            from tubeplan_viz.cli.app import status_of

            status = status_of(arguments)
        except KeyboardInterrupt:  # while the commands were read, or after the end of one
            sys.stderr.write("tubeplan: interrupted\n")
            status = INTERRUPTED
        no_more_interrupts()
        if not flushed():
            status = 2
        if status == INTERRUPTED:
            # Where a library's import was interrupted, Python would end the process by the signal itself, and not by this status.
            sys.stderr.flush()
            os._exit(status)
        sys.exit(status)
