"""Commands that are read when they are called: a list of all of them, or a wrong name, costs none of what they import."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from tubeplan_viz.cli.usage import NamingCommand, with_command

PLAIN: dict[str, Any] = {"rich_markup_mode": None, "pretty_exceptions_enable": False, "add_completion": False}


class LateCommand(TyperCommand):
    """A command known by name, place and first line until it is called.

    Parameters
    ----------
    name : str
    place : str
        ``module:function`` below `tubeplan_viz.cli`.
    summary : str
        The first line of the function's docstring.
    """

    def __init__(self, name: str, place: str, summary: str) -> None:
        super().__init__(name, help=summary, rich_markup_mode=None)
        self.place = place

    def get_short_help_str(self, limit: int = 0) -> str:
        """The whole first line: a list wraps it, where a cut sentence would leave out what tells commands apart."""
        return self.help or ""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """The context of the command itself, which the group then invokes."""
        module, _, function = self.place.partition(":")
        single = typer.Typer(**PLAIN)
        single.command(self.name, cls=NamingCommand)(getattr(import_module(f"tubeplan_viz.cli.{module}"), function))
        command = cast(NamingCommand, typer.main.get_command(single))  # of one command, which is no group
        try:
            return command.make_context(info_name, args, parent, **extra)
        except TyperException as fault:
            with_command(fault, command, info_name, parent)
            raise


def add_late(group: TyperGroup, commands: Mapping[str, tuple[str, str]]) -> None:
    """Put commands, by name with place and first line, into a group."""
    for name, (place, summary) in commands.items():
        group.add_command(LateCommand(name, place, summary))
