"""The gallery: every picture is there, small, made by the script, and shown somewhere."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_KB = 128  # a clone stays small


def test_pictures_are_those_of_the_script_and_all_are_shown() -> None:
    pictures = {path.stem: path for path in (ROOT / "docs" / "pictures").glob("*.png")}
    shown = set(re.findall(r"pictures/([\w-]+)\.png", (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")))
    made = set(re.findall(r'^    "([\w-]+)": Picture\(', (ROOT / "docs" / "make_pictures.py").read_text(encoding="utf-8"), re.M))
    assert shown == made == pictures.keys()
    assert {name: path.stat().st_size // 1024 for name, path in pictures.items() if path.stat().st_size > MOST_KB * 1024} == {}


def test_the_readmes_pictures_are_of_the_gallery() -> None:
    for place in re.findall(r"\((docs/[\w/-]+\.png)\)", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / place).exists(), place
