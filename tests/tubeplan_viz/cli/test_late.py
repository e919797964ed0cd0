"""Commands that are read when they are called: what the list says of them is theirs, and the list itself is quick."""

from __future__ import annotations

import inspect
import subprocess
import sys
from importlib import import_module

import pytest

from tubeplan_viz import __version__
from tubeplan_viz.cli.app import COMMANDS, PLANS, command_tree, status_of

LISTING = """
import sys
from tubeplan_viz.cli.app import status_of
status = status_of(sys.argv[1:])
heavy = {"numpy", "scipy", "pydicom", "rerun", "tubeplan_viz.planners"} & set(sys.modules)
sys.exit(f"{sorted(heavy)} were read for a list" if heavy else status)
"""


@pytest.mark.parametrize(("place", "summary"), [*COMMANDS.values(), *PLANS.values()], ids=[*COMMANDS, *PLANS])
def test_the_line_in_the_list_is_the_commands_own(place: str, summary: str) -> None:
    module, function = place.split(":")
    told = inspect.getdoc(getattr(import_module(f"tubeplan_viz.cli.{module}"), function))
    assert told is not None
    assert told.splitlines()[0] == summary


@pytest.mark.parametrize("words", [*([name] for name in COMMANDS), *(["plan", name] for name in PLANS)], ids=" ".join)
def test_every_command_can_be_quiet_and_has_an_example(words: list[str]) -> None:
    place, _ = (PLANS if words[0] == "plan" else COMMANDS)[words[-1]]
    module, function = place.split(":")
    command = getattr(import_module(f"tubeplan_viz.cli.{module}"), function)
    assert f"Example: tubeplan {' '.join(words)}" in " ".join((inspect.getdoc(command) or "").split())
    assert status_of([*words, "--quiet", "--help"]) == 0


def test_the_package_runs_as_a_module_too() -> None:
    done = subprocess.run([sys.executable, "-m", "tubeplan_viz", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, f"tubeplan {__version__}")


def test_every_command_is_in_the_tree_once() -> None:
    root = command_tree()
    assert list(root.commands) == [*COMMANDS, "plan"]
    assert list(root.commands["plan"].commands) == list(PLANS)


@pytest.mark.parametrize(("group", "commands"), [([], COMMANDS), (["plan"], PLANS)])
def test_a_list_shows_whole_sentences(
    group: list[str], commands: dict[str, tuple[str, str]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of([*group, "--help"]) == 0
    listed = " ".join(capsys.readouterr().out.split())
    assert all(f"{name} {summary}" in listed for name, (_, summary) in commands.items())


@pytest.mark.parametrize(
    ("arguments", "status"),
    [(["--help"], 0), (["--version"], 0), (["plan", "--help"], 0), (["bogus"], 2), (["plan", "tubee"], 2)],
)
def test_a_list_or_a_wrong_name_reads_no_planner(arguments: list[str], status: int) -> None:
    done = subprocess.run([sys.executable, "-c", LISTING, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
