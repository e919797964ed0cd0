"""A first case file for an image or a mesh: what was found in it, each choice with its reason, ready to run."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tomli_w

from segmentation.anatomy.guess import guess_anatomy
from segmentation.errors import CaseError
from segmentation.images import read_ct
from tubeplan_viz.cases.inputs import InputCase
from tubeplan_viz.cases.tube import Case, case_table, make_case
from tubeplan_viz.centerline import Endpoint
from tubeplan_viz.instruments import Instrument, read_catalogue
from tubeplan_viz.pipeline import Lumen, Notify, Stopwatch, case_end_names, case_tree, find_end, load_lumen, silent
from tubeplan_viz.result import write_whole

LISTED = 30  # end points written down; an airway has hundreds
CONFIDENT = 0.5
# What a file gives beside what was found: keys that most people change, with their meaning.
MEANINGS = {
    "case_id": "name of the case in all outputs; no patient's name",
    "anatomy": "airway, urinary, vessel or generic: limits and seed of region growing",
    "connectivity": "6 or 26 neighbours of a voxel",
    "mesh_unit": "unit of the mesh file",
    "method": "optimal (largest clearance, proved) or feature_iteration (Dai et al. 2024)",
    "rng_seed": "seed of all randomness",
    "closed_ends": "true: end caps count as wall",
    "start": "a label or name of the list above, or [x, y, z] in mm",
    "goal": "a label or name of the list above, or [x, y, z] in mm",
    "curvature_max": "1/mm, the reciprocal of the least bend radius",
    "clearance_min": "mm from the path to the wall: the instrument's radius",
}


@dataclass(frozen=True, kw_only=True)
class InitialCase:
    """A case file to be written, as text, and what a reader is told of it.

    Attributes
    ----------
    text : str
        The TOML file with its comments.
    anatomy : str or None
        None for a mesh.
    anatomy_reason : str
    start, goal : Endpoint or None
        None where the user gave coordinates.
    endpoints : tuple of Endpoint
    limits_reason : str
    """

    text: str
    anatomy: str | None
    anatomy_reason: str
    start: Endpoint | None
    goal: Endpoint | None
    endpoints: tuple[Endpoint, ...]
    limits_reason: str


def initial_case(
    tables: Mapping[str, Mapping[str, Any]],
    folder: Path,
    *,
    instrument: str | None = None,
    catalogue: Path | None = None,
    notify: Notify = silent,
) -> InitialCase:
    """Look at an input and write down a case that plans in it.

    Parameters
    ----------
    tables : mapping
        Tables of a case file; ``input`` names a ``ct`` or a ``mesh``, whatever else is given is kept.
    folder : Path
        Where the file will lie: its input path starts from there.
    instrument : str, optional
        A name of the catalogue, or a part of one that fits no other, for the limits.
    catalogue : Path, optional
        A catalogue file; by default the one that ships with the package.
    notify : Notify

    Raises
    ------
    TubeplanError
        If the input cannot be read, holds no lumen that is found without help, or has fewer than two ends.
    """
    chosen = None if instrument is None else find_instrument(instrument, read_catalogue(catalogue))
    limits, limits_reason = _limits(tables.get("limits", {}), chosen)
    case = make_case({**tables, "limits": limits}, name="options")
    watch = Stopwatch(notify)
    given, reason = _with_anatomy(case.input, watch)
    case = replace(case, input=given)
    lumen = load_lumen(case.input, near=case.planner.start, watch=watch)
    with watch.stage("end points"):
        tree = case_tree(case, lumen)
        tips, names = tree.endpoints, case_end_names(case, lumen, tree)
    asked = {name: getattr(case.planner, name) for name in ("start", "goal")}
    labels = {name: find_end(name, end, tips, names).label for name, end in asked.items() if isinstance(end, str)}
    ends = {**asked, **labels}
    case = replace(case, planner=replace(case.planner, start=ends["start"], goal=ends["goal"]))
    start, goal = _ends(case, tips)
    by_label = {tip.label: tip for tip in tips}
    case = replace(case, planner=replace(case.planner, start=start, goal=goal))
    text = _text(case, folder, lumen, tips, names, anatomy_reason=reason, limits_reason=limits_reason)
    # What is written must be read again as the same case; a comment may have broken a line.
    if case_table(make_case(tomllib.loads(text), folder=folder)) != case_table(case):
        raise CaseError("the case that was written does not read back; please report it")
    return InitialCase(
        text=text,
        anatomy=case.input.anatomy,
        anatomy_reason=reason,
        start=by_label.get(start) if isinstance(start, str) else None,
        goal=by_label.get(goal) if isinstance(goal, str) else None,
        endpoints=tips,
        limits_reason=limits_reason,
    )


def find_instrument(name: str, instruments: Sequence[Instrument]) -> Instrument:
    """The instrument of that name, or the only one whose name holds the words.

    Raises
    ------
    CaseError
        If there is none, or more than one.
    """
    wanted = name.casefold().strip()
    exact = [each for each in instruments if each.name.casefold() == wanted]
    found = exact or [each for each in instruments if wanted in each.name.casefold()]
    if len(found) != 1:
        listed = "; ".join(each.name for each in (found or instruments))
        state = "fits more than one instrument" if found else "is no instrument of the catalogue"
        raise CaseError(f"{name!r} {state}; expected one of: {listed}")
    return found[0]


def _limits(given: Mapping[str, Any], instrument: Instrument | None) -> tuple[dict[str, Any], str]:
    """Limits by what was given, else by the instrument, else the defaults; and why."""
    if instrument is None:
        return dict(given), "as given" if given else (
            "defaults: a flexible ureteroscope of table 1 of Dai et al. (2024); "
            "`tubeplan init --instrument NAME` takes them from the catalogue"
        )
    own = {"curvature_max": instrument.limits.curvature_max, "clearance_min": instrument.limits.clearance_min}
    words = (
        f"{instrument.name} ({instrument.kind}): {instrument.outer_diameter_mm:g} mm wide, "
        f"least bend radius {instrument.bend_radius_min_mm:g} mm; {instrument.source}"
    )
    return {**own, **given}, words + (f"; {' and '.join(given)} as given" if given else "")


def _with_anatomy(given: InputCase, watch: Stopwatch) -> tuple[InputCase, str]:
    """The input with its anatomy, and the reason for it."""
    if given.mesh is not None:
        return given, "a mesh is its own wall, nothing is grown"
    if given.anatomy is not None or given.seed_point is not None:
        return given, "as given"
    assert given.ct is not None  # InputCase holds one of the two
    with watch.stage("guess anatomy") as progress:
        guess = guess_anatomy(read_ct(given.ct, series=given.series, progress=progress).volume)
    return replace(given, anatomy=guess.name), guess.reason


def _ends(case: Case, tips: Sequence[Endpoint]) -> tuple[Any, Any]:
    """Start and goal: as given, else the root of the tree and the end of its longest sure branch."""
    start, goal = case.planner.start, case.planner.goal
    taken = {end for end in (start, goal) if isinstance(end, str)}
    sure = sorted(tips[1:], key=lambda tip: (tip.confidence < CONFIDENT, -tip.branch_length))
    free = [tip.label for tip in (*tips[:1], *sure) if tip.label not in taken]
    missing = (start is None) + (goal is None)
    if len(free) < missing:
        raise CaseError(
            f"the lumen has {len(tips)} end point{'' if len(tips) == 1 else 's'}, expected at least two; "
            "give --start and --goal as X,Y,Z in mm"
        )
    if start is None:
        start = free.pop(0)
    return start, free[0] if goal is None else goal


def _text(
    case: Case,
    folder: Path,
    lumen: Lumen,
    tips: Sequence[Endpoint],
    names: Mapping[str, str],
    *,
    anatomy_reason: str,
    limits_reason: str,
) -> str:
    """The file: a table at a time, comments above and beside the keys."""
    table = case_table(case, folder=folder)
    frame = "LPS mm of the patient" if lumen.surface.frame == "LPS" else "mm in the mesh's own axes"
    lines = [
        "# tubeplan case, written by `tubeplan init`; run it with `tubeplan run` and this file's name.",
        "# Research use, not for clinical decisions.",
        f"# Points are {frame}; curvature is in 1/mm, HU limits in HU, times in s.",
        "",
    ]
    lines += [*_facts(lumen), "[input]"]
    for key, value in table["input"].items():
        words = anatomy_reason if key == "anatomy" else MEANINGS.get(key, "")
        lines.append(_pair(key, value, words))
    if "case_id" not in table["input"]:
        lines.append(f'# case_id = "case-1"  # {MEANINGS["case_id"]}')
    if case.input.ct is not None and "hu_min" not in table["input"] and "hu_max" not in table["input"]:
        grown = lumen.details
        lines.append(f"# hu_min, hu_max: chosen when the lumen is grown, here {grown['hu_min']:.0f} to {grown['hu_max']:.0f} HU")
    lines += ["", f"# Limits: {_one_line(limits_reason)}.", "[limits]"]
    lines += [_pair(key, value, MEANINGS[key]) for key, value in table["limits"].items()]
    lines += ["", *_listing(tips, names), "[planner]"]
    lines += [_pair(key, value, MEANINGS.get(key, "")) for key, value in table["planner"].items()]
    given = {key: value for key, value in table["tube"].items() if value != _default_tube().get(key)}
    lines += ["", "# [tube] holds the planner's own settings; case.toml of a run folder lists all of them.", "[tube]"]
    lines += [_pair(key, value, "") for key, value in given.items()]
    return "\n".join(lines) + "\n"


def _default_tube() -> dict[str, Any]:
    return case_table(make_case({"input": {"mesh": "any.ply"}}))["tube"]


def _facts(lumen: Lumen) -> list[str]:
    """What was found in the input, as comments."""
    facts = [f"# {term}: {value}" for term, value in lumen.facts.items()]
    return [_one_line(fact) for fact in facts] + [f"# Note: {_one_line(note)}" for note in lumen.warnings]


def _listing(tips: Sequence[Endpoint], names: Mapping[str, str]) -> list[str]:
    """End points as a table in comments."""
    shown = tips[:LISTED]
    lines = [
        f"# End points of the lumen ({len(shown)} of {len(tips)}; `tubeplan endpoints` lists all):"
        if len(shown) < len(tips)
        else "# End points of the lumen:",
        "#   label       x        y        z   radius  branch  sure",
    ]
    for tip in shown:
        x, y, z = tip.point
        more = (f"  {names[tip.label]}" if tip.label in names else "") + (f"  cap {tip.cap}" if tip.cap else "")
        figures = f"{x:8.1f} {y:8.1f} {z:8.1f} {tip.radius:8.2f} {tip.branch_length:7.1f} {tip.confidence:5.2f}"
        lines.append(f"#   {tip.label:<5} {figures}{more}")
    return lines


def _pair(key: str, value: Any, words: str) -> str:
    """One key with its value, on one line, and what it means."""
    if isinstance(value, (list, tuple)):
        shown = "[" + ", ".join(tomli_w.dumps({"v": each}).partition("=")[2].strip() for each in value) + "]"
    else:
        shown = tomli_w.dumps({"v": value}).partition("=")[2].strip()
    return f"{key} = {shown}" + (f"  # {_one_line(words)}" if words else "")


def _one_line(text: str) -> str:
    """Text for a comment: no control characters, which TOML forbids there, and no line end."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def write_case(text: str, path: Path, *, force: bool = False) -> None:
    """Write a case file, whole or not at all.

    Raises
    ------
    CaseError
        If it exists (without `force`), is no file, or cannot be written.
    """
    if path.is_dir():
        raise CaseError(f"{path.name} is a folder; name the case file to be written, for instance case.toml")
    if path.exists() and not force:
        raise CaseError(f"{path.name} exists already; choose another name with -o, or replace it with --force")
    try:
        write_whole(path, text.encode("utf-8"), replace=force)
    except FileExistsError:
        raise CaseError(f"{path.name} exists already; choose another name with -o, or replace it with --force") from None
    except OSError as fault:
        raise CaseError(
            f"{path.name}: cannot be written ({(fault.strerror or 'refused').lower()}); choose another place with -o"
        ) from None
