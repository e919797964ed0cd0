"""The line of a key, found without a parser that knows lines, agrees with what the parser reads."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from segmentation.errors import CaseError
from tubeplan_viz.cases.fields import read_table
from tubeplan_viz.cases.lines import key_lines, naming_lines
from tubeplan_viz.cases.tube import make_case

VALUES = st.one_of(
    st.integers(-99, 99),
    st.floats(allow_nan=False, allow_infinity=False),
    st.booleans(),
    st.text(max_size=12),
    st.lists(st.text(max_size=6), max_size=4),
)
NAMES = st.text("abcdefgh_-", min_size=1, max_size=6)


@settings(deadline=None, derandomize=True)
@given(st.dictionaries(NAMES, st.dictionaries(NAMES, VALUES, max_size=4), max_size=4), st.booleans())
def test_every_key_is_found_on_the_line_whose_value_it_has(tables: dict[str, dict[str, Any]], multiline: bool) -> None:
    text = tomli_w.dumps(tables, multiline_strings=multiline)
    lines = key_lines(text)
    rows = text.splitlines()
    wanted = {(name,) for name in tables} | {(name, key) for name, table in tables.items() for key in table}
    assert set(lines) == wanted
    for name, *key in wanted:
        row = rows[lines[name, *key] - 1]
        assert row.startswith(f"{key[0]} =" if key else f"[{name}]")


def test_what_looks_like_a_key_inside_text_lists_and_comments_is_none() -> None:
    text = '[a]\nlong = """\n[b]\nkey = 1\n"""\nlist = [\n "x = 2", # y = ]\n]\n# z = 3\nlast = "[c]"\n'
    tomllib.loads(text)
    assert key_lines(text) == {("a",): 1, ("a", "long"): 2, ("a", "list"): 6, ("a", "last"): 10}


HEAD = '[input]\nmesh = "lumen.stl"\n\n'
FAULTS = {
    "type": (
        '[limits]\nclearance_min = "1.2"\n',
        "case.toml, line 5: [limits] clearance_min: found '1.2', expected a finite number",
    ),
    "range": ("[limits]\ncurvature_max = 50\n", "case.toml, line 5: [limits] curvature_max is 50 1/mm, expected 0.0001 to 10"),
    "unknown key": ("[planner]\n# where\nstrat = 'E1'\n", "case.toml, line 6: [planner]: unknown key 'strat'"),
    "unknown table": ("[limit]\nclearance_min = 1\n", "case.toml, line 4: unknown table 'limit'"),
    "end": ("[planner]\nstart = '12'\n", "case.toml, line 5: [planner] start: found '12'"),
    "value without its key": ("[planner]\nname = 'laser'\n", "case.toml, line 5: [planner] there is no planner 'laser' yet"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_value_is_named_with_file_line_table_and_key(fault: str, tmp_path: Path) -> None:
    text, message = FAULTS[fault]
    path = tmp_path / "case.toml"
    path.write_text(HEAD + text)
    with pytest.raises(CaseError) as caught, naming_lines(path):
        make_case(read_table(path), folder=tmp_path, name=path.name)
    assert str(caught.value).startswith(message)


def test_a_fault_of_an_option_is_not_blamed_on_the_file(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(HEAD + "[limits]\ncurvature_max = 0.1\n")
    given_here = {"limits": {"curvature_max": 50.0}}
    with pytest.raises(CaseError) as caught, naming_lines(path, given_here):
        make_case({**read_table(path), **given_here}, name=path.name)
    assert "line" not in str(caught.value)
