"""Every option of every command with values that it cannot use: one sentence by the option's name, and nothing written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import typer

from tubeplan_viz.cli.app import COMMANDS, PLANS

Call = Callable[..., Any]
PLACES = {
    **{name: place for name, (place, _) in COMMANDS.items()},
    **{f"plan {name}": place for name, (place, _) in PLANS.items()},
}
ENDS = ("--start", "E1", "--goal", "E2")
# What each command needs beside the option; its input is not there, so that nothing runs where the value is taken.
NEEDED: dict[str, tuple[str, ...]] = {
    "plan tube": ("--mesh", "gone.ply", *ENDS),
    "plan needle2d": ("--target", "0,90", "--output", "nowhere/run"),
    "plan needle3d": ("--target", "0,0,90", "--ct", "gone", "--hu-min", "180", "--monte-carlo", "5"),
    "plan rigid": ("--ct", "gone", "--side", "left"),
    "plan bronchoscope": ("--mesh", "gone.ply", "--goal", "x"),
    "run": ("case.toml",),
    "segment": ("--ct", "gone", "--anatomy", "airway"),
    "endpoints": ("gone.ply",),
    "matrix": ("--mesh", "gone.ply"),
    "reach": ("--mesh", "gone.ply"),
    "compare": ("gone", "gone"),
    "batch": ("gone.toml",),
    "bench": ("nothing",),
    **dict.fromkeys(("init", "inspect", "verify", "view", "export"), ("gone",)),
}
CASE = '[input]\nmesh = "gone.ply"\n[planner]\nstart = "E1"\ngoal = "E2"\n'
# Of options whose value is text: what is none for them, and where nothing says so before the input is read.
POINTS = (
    "seed_point",
    "lesion",
    "start_direction",
    "goal_direction",
    "stone",
    "target",
    "entry",
    "direction",
    "sphere",
    "circle",
)
CHOICES = ("anatomy", "method", "objective", "scans", "side", "to", "mesh_unit")
LATER = {("init", name) for name in (*POINTS, *CHOICES)} | {("bench", "method")}


def options_of(name: str) -> list[Any]:
    """The options of a command that take a value."""
    module, function = PLACES[name].split(":")
    single = typer.Typer()
    single.command()(getattr(import_module(f"tubeplan_viz.cli.{module}"), function))
    found = [one for one in typer.main.get_command(single).params if one.param_type_name == "option"]
    return [one for one in found if not one.is_flag and not getattr(one, "hidden", False) and one.name != "help"]


def wrong(name: str) -> Iterator[tuple[str, str, str]]:
    """Option, value and what must be said of it."""
    for option in options_of(name):
        word = max(option.opts, key=len)
        told = " / ".join(one for one in option.opts if one.startswith("--"))
        yield word, "", f"{word}: found '', expected a value"
        kind = str(option.type_descriptor.annotation)
        if "float" in kind or "int" in kind:
            wanted = "a number" if "float" in kind else "a whole number"
            yield word, "abc", f"{told}: found 'abc', expected {wanted} ("
            yield word, "1,5", f"{told}: found '1,5', expected {wanted} ("
        if "float" in kind and name not in ("init", "view"):
            # Beyond a range the sentence may have the thing's name in words: the centerline's step.
            yield word, "nan", told
            if option.name not in ("hu_min", "hu_max"):  # as low as one likes
                yield word, "-1e9", word[2:].partition("-")[0]
        if (name, option.name) not in LATER:
            if option.name in POINTS:
                yield word, "a,b,c", f"{word}: found 'a,b,c', expected "
            if option.name in CHOICES:
                yield word, "abc", "abc"
    # What the parser itself refuses names the command and, where it knows it, what the option is for.
    yield "--zzz", "1", f"No such option: --zzz; see `tubeplan {name} --help`"


@pytest.mark.parametrize("name", [name for name in PLACES if name in NEEDED])
def test_a_bad_value_is_told_by_its_option_with_what_was_found_and_expected(
    name: str, tubeplan: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(CASE, encoding="utf-8")
    tried = 0
    for option, value, told in wrong(name):
        done = tubeplan(*name.split(), *NEEDED[name], f"{option}={value}")
        said = f"{name} {option}={value!r}: {done.err}"
        assert done.status == 2, said
        assert done.err.count("\n") == 1, said
        assert told in done.err, said
        # Neither the words of a library nor those of a case file that nobody wrote.
        assert not any(words in done.err for words in ("Input should", "options [", "options:", "unable to parse")), said
        tried += 1
    assert tried > len(options_of(name))
    assert [entry.name for entry in tmp_path.iterdir()] == ["case.toml"]


def test_an_option_without_a_value_tells_what_it_is_for(tubeplan: Call) -> None:
    done = tubeplan("plan", "tube", "--clearance-min")
    assert done.err.startswith("tubeplan: Option '--clearance-min' requires an argument (least distance to the wall")
    assert done.err.endswith("; see `tubeplan plan tube --help`\n")
    assert "Missing option '--target' (where the tip should end" in tubeplan("plan", "needle2d").err


def test_a_value_of_the_case_file_keeps_its_line_and_one_of_the_options_its_option(
    tubeplan: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(CASE + "[limits]\nclearance_min = nan\n", encoding="utf-8")
    assert "case.toml, line 7: [limits] clearance_min: found nan" in tubeplan("run", "case.toml", "-o", "run").err
    given = tubeplan("run", "case.toml", "--clearance-min", "nan", "-o", "run").err
    assert given == "tubeplan: --clearance-min: found nan, expected a finite number\n"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--tip-noise", "1"), "--tip-noise is for simulated insertions, of which none was asked for; give --monte-carlo too"),
        (("--hu-max", "300"), "--hu-max is for an obstacle of the CT's voxels, which begins at --hu-min; give --hu-min too"),
        (("--sphere", "0,0,40,nan"), "--sphere 0,0,40,nan: radius_mm: found nan, expected a finite number"),
        (("--capsule", "0,0,40,5"), "--capsule: found '0,0,40,5', expected X,Y,Z of two points or more and the radius"),
        (("--events", "gone.toml"), "gone.toml: no such file of [[events]]"),
        (("--time-budget", "0"), "--time-budget: found 0 s, expected more than 0"),
    ],
)
def test_options_of_a_needle_that_lack_another_or_hold_one_more_thing(
    arguments: tuple[str, ...], told: str, tubeplan: Call, tmp_path: Path
) -> None:
    done = tubeplan("plan", "needle3d", "--target", "0,0,90", *arguments, "-o", tmp_path / "run")
    assert (done.status, done.err.count("\n")) == (2, 1)
    assert told in done.err
    assert list(tmp_path.iterdir()) == []
