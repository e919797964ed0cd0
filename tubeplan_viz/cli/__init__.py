"""The tubeplan command: one module per command."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with the status that the README lists."""
    # Imported here: each process that a command starts reads this module again, and needs none of the commands.
    from tubeplan_viz.cli.app import main as run

    run(arguments)
