"""README, guide and the examples in every `--help`: the command lines there are ones that tubeplan takes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.cli.app import COMMANDS, PLANS, command_tree

ROOT = Path(__file__).parents[3]
DOCUMENTS = ("README.md", "docs/guide.md", "datasets/README.md")
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.DOTALL | re.MULTILINE)


def command_of(words: list[str]) -> tuple[Any, list[str]]:
    """The command that a line names, and what it gives to it."""
    root: Any = command_tree()
    group, depth = (root.commands["plan"], 2) if words[1] == "plan" else (root, 1)
    return group.commands[words[depth]], words[depth + 1 :]


def lines_of(document: str) -> list[str]:
    blocks = BLOCK.findall((ROOT / document).read_text(encoding="utf-8"))
    return [line.partition("#")[0].strip() for block in blocks for line in block.splitlines() if line.startswith("tubeplan ")]


def examples_of(words: list[str]) -> list[str]:
    """Examples of a command's help, which wraps them."""
    command, _ = command_of(["tubeplan", *words])
    told = command.make_context(words[-1], [], resilient_parsing=True).command.help
    return [" ".join(part.split()) for part in re.findall(r"Example: (tubeplan .*?)(?=\n\n|\Z)", told, re.DOTALL)]


LINES = [line for document in DOCUMENTS for line in lines_of(document)]
NAMED = [*([name] for name in COMMANDS), *(["plan", name] for name in PLANS)]
EXAMPLES = [line for words in NAMED for line in examples_of(words)]


@pytest.mark.parametrize("line", dict.fromkeys([*LINES, *EXAMPLES]))
def test_a_command_line_that_is_shown_is_one_that_is_taken(line: str) -> None:
    command, given = command_of(shlex.split(line.partition(" > ")[0]))
    assert command.make_context(command.name, given).args == []


def test_the_documents_show_every_command() -> None:
    assert len(LINES) > len(COMMANDS)
    assert len(EXAMPLES) >= len(NAMED)
    text = "".join((ROOT / document).read_text(encoding="utf-8") for document in DOCUMENTS)
    for words in NAMED:
        assert re.search(rf"`?tubeplan {' '.join(words)}\b|`{' '.join(words)}\b|, `{words[-1]}`", text), words


@pytest.mark.parametrize("document", [*DOCUMENTS, "docs/gallery.md"])
def test_links_lead_somewhere(document: str) -> None:
    place = ROOT / document
    text = place.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)]+)\)", text):
        if link.startswith("https://"):
            continue
        file, _, heading = link.partition("#")
        there = place if not file else place.parent / file
        assert there.exists(), link
        if heading:
            titles = re.findall(r"^#+ (.+)$", there.read_text(encoding="utf-8"), re.MULTILINE)
            assert heading in [re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles], link
