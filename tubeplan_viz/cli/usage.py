"""Bad values of options: what was found and expected, by the name that the option has on the command line.

The readers of a case know keys of a table and not who gave the value; whatever command has an option for the key says so here.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Mapping, Sequence
from typing import Any

import typer
from typer.core import TyperCommand
from typer.exceptions import TyperException

from segmentation.errors import CaseError
from tubeplan_viz.interrupts import check_interrupted

# Kinds of pydantic's complaints, which typer has its values checked by, and what they ask for.
WANTED = {
    "int_parsing": "a whole number",
    "int_parsing_size": "a whole number of fewer digits",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "greater_than_equal": "{ge} or more",
    "less_than_equal": "{le} or less",
}
# Options of keys that have another name or stand for more than one.
KEYS = {
    "stone": ("stones",),
    "stone_mask": ("stone_masks",),
    "structure": ("structures",),
    "monte_carlo": ("runs",),
    "section": ("proximal_length", "distal_length"),
}
UNIT = re.compile(r"_(mm|deg|percent)$")
# ``options [table] key: ...`` and ``NAME.toml [table] key: ...`` of the readers, ``key is ...`` of settings.
READER = re.compile(r"(?P<where>options|\S+\.toml)(?: \[\w+\]| \[\[\w+\]\] \d+)? (?P<key>\w+): (?P<rest>.*)", re.DOTALL)
SETTING = re.compile(r"(?P<key>\w+) (?P<rest>(?:is|are|was) .*)", re.DOTALL)


class NamingCommand(TyperCommand):
    """A command whose complaints about a value name the option that gave it."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse an empty value before it is taken for the current folder or for nothing at all."""
        for before, word in zip(["", *args], args, strict=False):
            option = before if word == "" else word[:-1] if word.startswith("--") and word.endswith("=") else None
            if option is not None:
                name = option if option.startswith("-") else "an argument"
                raise CaseError(f"{name}: found '', expected {wanted_of(self, option)}; leave it out where there is none")
        rest: list[str] = super().parse_args(ctx, args)
        return rest

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        check_interrupted()  # which the reading of its libraries may have swallowed
        try:
            return super().invoke(ctx)
        except CaseError as fault:
            told = by_option(str(fault), given_options(self, ctx))
            if told == str(fault):
                raise
            raise type(fault)(told) from None
        except OSError as fault:
            if fault.errno != errno.ENAMETOOLONG:
                raise
            raise CaseError("a path is longer than the system takes; give a shorter one") from None


def given_options(command: TyperCommand, ctx: Any) -> dict[str, str]:
    """Keys of a case file, without their units, to the options that were given on the command line for them."""
    made: dict[str, str] = {}
    for option in command.params:
        source = ctx.get_parameter_source(option.name)
        if option.param_type_name == "option" and source is not None and source.name == "COMMANDLINE":
            names = [*KEYS.get(str(option.name), (option.name,)), *(name[2:].replace("-", "_") for name in option.opts)]
            made |= {str(name): long_name(option) for name in names}
    return made


def by_option(message: str, options: Mapping[str, str]) -> str:
    """A complaint about a key of a case with the option in the key's place, where one gave the value.

    Examples
    --------
    >>> by_option("options [limits] clearance_min: found nan, expected a finite number", {"clearance_min": "--clearance-min"})
    '--clearance-min: found nan, expected a finite number'
    >>> by_option("smoothing_mm is -1, expected 0 to 10", {"smoothing": "--smoothing"})
    '--smoothing is -1, expected 0 to 10'
    >>> by_option("case.toml [limits] clearance_min: found nan, expected a finite number", {})
    'case.toml [limits] clearance_min: found nan, expected a finite number'
    """
    found = READER.fullmatch(message)
    if found is not None:
        option = options.get(UNIT.sub("", found["key"]))
        return message if option is None else f"{option}: {found['rest']}"
    found = SETTING.fullmatch(message)
    if found is not None:
        option = options.get(UNIT.sub("", found["key"]))
        return message if option is None else f"{option} {found['rest']}"
    return message.removeprefix("options: ")


def long_name(option: Any) -> str:
    """The names of an option that are words: ``--kappa / --curvature-max``."""
    return " / ".join(name for name in option.opts if name.startswith("--"))


def wanted_of(command: TyperCommand, name: str) -> str:
    """What an option is for, in the words of its help."""
    described = next((meaning(option) for option in command.params if name in option.opts), "")
    return f"a value ({described})" if described else "a value"


def meaning(option: Any) -> str:
    """The help of an option or argument as part of a sentence."""
    text = str(getattr(option, "help", None) or "").rstrip(".")
    return text[:1].lower() + text[1:] if text[1:2].islower() else text


def usage_words(fault: TyperException) -> str:
    """What a usage error of typer's says, in one sentence: what was found, and what was expected.

    typer keeps the classes of its own errors private, but not what they hold.
    """
    option = getattr(fault, "param", None)
    complaints: Sequence[Mapping[str, Any]] = getattr(fault.__cause__, "errors", list)()
    if option is not None and complaints:
        first = complaints[0]
        wanted = WANTED.get(first["type"], str(first["msg"])).format(**first.get("ctx", {}))
        name = long_name(option) or str(option.human_readable_name)
        return f"{name}: found {shown(first['input'])}, expected {wanted}{described(option)}"
    text = fault.format_message() if hasattr(fault, "format_message") else str(fault)
    if option is None:  # the parser knows the option by its name alone
        asked, told = getattr(getattr(fault, "ctx", None), "command", None), getattr(fault, "option_name", None)
        option = next((one for one in getattr(asked, "params", ()) if told in one.opts), None)
    return text.rstrip(".") + ("" if option is None else described(option))


def described(option: Any) -> str:
    """The help of an option in brackets, as the end of a sentence; nothing where it has none."""
    words = meaning(option)
    return f" ({words})" if words else ""


def shown(value: Any) -> str:
    """A value as a message shows it, a long one in part."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:60]}... ({len(text)} characters)"


def with_command(fault: TyperException, command: TyperCommand, name: str | None, parent: Any) -> None:
    """Let a usage error that does not know its command know it; the parser's own do not."""
    if getattr(fault, "ctx", None) is None:
        fault.__dict__["ctx"] = typer.Context(command, info_name=name, parent=parent)
