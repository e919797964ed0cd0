"""The tubeplan command: one module per command."""

from tubeplan_viz.cli.app import main

__all__ = ["main"]
