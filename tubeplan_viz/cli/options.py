"""Options that several commands share, each written once."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from segmentation.errors import CaseError
from tubeplan_viz.pipeline import Notify, RunOptions

Output = Annotated[Path, typer.Option("--output", "-o", help="Run folder to make.", show_default=True)]
Json = Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an earlier run of that name.")]
NoRecording = Annotated[bool, typer.Option("--no-recording", help="Leave recording.rrd out.")]
NoReport = Annotated[bool, typer.Option("--no-report", help="Leave report.html out.")]
Connect = Annotated[
    str | None,
    typer.Option("--connect", help="Feed a running rerun viewer while planning, e.g. rerun+http://127.0.0.1:9876/proxy."),
]

# Option name in the command line's parameters -> (table and key of the case file, type, declaration).
CASE_OPTIONS: dict[str, tuple[str, str, Any, Any]] = {
    "ct": ("input", "ct", Path, typer.Option("--ct", help="DICOM folder, .nii, .nii.gz or .mha file.")),
    "mesh": ("input", "mesh", Path, typer.Option("--mesh", help="STL, PLY, OBJ or GLB file.")),
    "series": ("input", "series", str, typer.Option("--series", help="Series of the folder, as `tubeplan inspect` lists them.")),
    "mesh_unit": ("input", "mesh_unit", str, typer.Option("--mesh-unit", help="Unit of the mesh file: um, mm, cm, m or in.")),
    "part": ("input", "part", str, typer.Option("--part", help="Part of a mesh scene.")),
    "case_id": ("input", "case_id", str, typer.Option("--case-id", help="Name of the case in all outputs; no patient's name.")),
    "anatomy": ("input", "anatomy", str, typer.Option("--anatomy", help="airway, urinary, vessel or generic: limits and seed.")),
    "seed_point": (
        "input",
        "seed_point",
        str,
        typer.Option("--seed-point", help="X,Y,Z in mm (LPS): where region growing begins."),
    ),
    "hu_min": ("input", "hu_min", str, typer.Option("--hu-min", help="Lower HU limit, or auto.")),
    "hu_max": ("input", "hu_max", str, typer.Option("--hu-max", help="Upper HU limit, or auto.")),
    "connectivity": ("input", "connectivity", int, typer.Option("--connectivity", help="6 or 26 neighbours.")),
    "smoothing": ("input", "smoothing_mm", float, typer.Option("--smoothing", help="Gaussian before growing, mm; 0 for none.")),
    "start": (
        "planner",
        "start",
        str,
        typer.Option("--start", help="X,Y,Z in mm, or a label or name from `tubeplan endpoints`."),
    ),
    "goal": ("planner", "goal", str, typer.Option("--goal", help="X,Y,Z in mm, or a label or name from `tubeplan endpoints`.")),
    "start_direction": (
        "tube",
        "start_direction",
        str,
        typer.Option("--start-direction", help="X,Y,Z: the way the path sets out, of any length, for --method optimal."),
    ),
    "goal_direction": (
        "tube",
        "goal_direction",
        str,
        typer.Option("--goal-direction", help="X,Y,Z: the way the path arrives, of any length, for --method optimal."),
    ),
    "method": (
        "planner",
        "method",
        str,
        typer.Option("--method", help="optimal (largest clearance, proved) or feature_iteration (Dai et al. 2024) [optimal]."),
    ),
    "curvature_max": ("limits", "curvature_max", float, typer.Option("--curvature-max", help="Largest curvature, 1/mm [0.125].")),
    "clearance_min": (
        "limits",
        "clearance_min",
        float,
        typer.Option("--clearance-min", help="Least distance to the wall, mm: the instrument's radius [1.2]."),
    ),
    "closed_ends": ("planner", "closed_ends", bool, typer.Option("--closed-ends", help="Count end caps as wall.")),
    "rng_seed": ("planner", "rng_seed", int, typer.Option("--rng-seed", help="Seed of all randomness.")),
    "time_budget": ("planner", "time_budget", float, typer.Option("--time-budget", help="No further round after this many s.")),
    "tolerance": (
        "planner",
        "tolerance",
        str,
        typer.Option(
            "--tolerance", help="MM,DEG or presets: chance that the path stays clear under such an error of pose, e.g. 2,2."
        ),
    ),
    "objective": (
        "tube",
        "objective",
        str,
        typer.Option("--objective", help="What is best for --method optimal: clearance, length or curvature [clearance]."),
    ),
    "scans": (
        "tube",
        "scans",
        str,
        typer.Option("--scans", help="Feature scans, comma-separated: nodes,extrema,segments,inflections,dense."),
    ),
    "max_rounds": ("tube", "max_rounds", int, typer.Option("--max-rounds", help="Rounds of the feature iteration at most.")),
    "stone": (
        "measures",
        "stones",
        str,
        typer.Option("--stone", help="X,Y,Z in mm (LPS) in a stone, several with ; between: volume, HU, scores."),
    ),
    "stone_mask": (
        "measures",
        "stone_masks",
        str,
        typer.Option("--stone-mask", help="Label volume of a stone on the CT's grid."),
    ),
    "structure": (
        "measures",
        "structures",
        str,
        typer.Option("--structure", help="NAME=FILE, label volume: distance of the path to it; several with commas between."),
    ),
    "centerline_step": (
        "tube",
        "centerline_step_mm",
        float,
        typer.Option("--centerline-step", help="Centerline spacing, mm [1]."),
    ),
}


# What makes the lumen from a CT, and from a CT or a mesh: for commands that plan nothing.
LUMEN_OF_CT = ("ct", "series", "anatomy", "seed_point", "hu_min", "hu_max", "connectivity", "smoothing")
LUMEN = ("ct", "mesh", "series", "mesh_unit", "part", *LUMEN_OF_CT[2:])


def case_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command all options of a case; it receives those that were set as tables, `given`."""
    return some_case_options(*CASE_OPTIONS)(command)


def some_case_options(*names: str, unlisted: Collection[str] = ()) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The same with those options alone that say something to the command: one that did nothing would mislead.

    Those `unlisted` are taken too but stand in no help: the command refuses them and says what to give instead.
    """
    declared = {name: Annotated[CASE_OPTIONS[name][2] | None, CASE_OPTIONS[name][3]] for name in names}
    for name in unlisted:
        hidden = copy(CASE_OPTIONS[name][3])
        hidden.hidden = True
        declared[name] = Annotated[CASE_OPTIONS[name][2] | None, hidden]
    return lambda command: with_options(command, "given", declared, dict.fromkeys(declared), tables)


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Where the outputs go and what of them is written and printed; `connect` of planning commands alone."""

    output: Path
    force: bool
    no_recording: bool
    no_report: bool
    json: bool
    quiet: bool
    connect: str | None = None

    def written(self) -> dict[str, bool]:
        """What is written, as commands that make no plan take it."""
        return {"force": self.force, "recording": not self.no_recording, "report": not self.no_report}

    def run_options(self, notify: Notify, *, light: bool = False) -> RunOptions:
        """The same as the pipelines take it."""
        return RunOptions(**self.written(), light=light, connect=self.connect, notify=notify)


OUTPUT_OPTIONS: dict[str, tuple[Any, Any]] = {
    "output": (Output, Path("run")),
    "force": (Force, False),
    "no_recording": (NoRecording, False),
    "no_report": (NoReport, False),
    "json": (Json, False),
    "quiet": (Quiet, False),
}


def output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a planning command the options of its outputs; it receives them as `outputs`."""
    return _with_outputs(command, {**OUTPUT_OPTIONS, "connect": (Connect, None)})


def outputs_into(folder: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The same for a command that makes no plan, so that no viewer is fed: `folder` is where it writes unless told otherwise."""
    return lambda command: _with_outputs(command, {**OUTPUT_OPTIONS, "output": (Output, Path(folder))})


def _with_outputs(command: Callable[..., Any], options: Mapping[str, tuple[Any, Any]]) -> Callable[..., Any]:
    declared = {name: kind for name, (kind, _) in options.items()}
    defaults = {name: default for name, (_, default) in options.items()}
    return with_options(command, "outputs", declared, defaults, lambda values: Outputs(**values))


def with_options(
    command: Callable[..., Any],
    taken: str,
    declared: Mapping[str, Any],
    defaults: Mapping[str, Any],
    gather: Callable[[dict[str, Any]], Any],
) -> Callable[..., Any]:
    """A command whose parameter `taken` is made by `gather` from the options `declared`."""
    own = [p for p in inspect.signature(command, eval_str=True).parameters.values() if p.name != taken]

    def wrapper(**values: Any) -> Any:
        here = {name: values.pop(name) for name in declared}
        return command(**{taken: gather(here)}, **values)

    shared = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=defaults[name], annotation=kind)
        for name, kind in declared.items()
    ]
    parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + shared
    # typer reads the signature and the annotations of what it is given, not those of this wrapper.
    wrapper.__dict__["__signature__"] = inspect.Signature(parameters)
    wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
    wrapper.__name__, wrapper.__doc__ = command.__name__, command.__doc__
    return wrapper


def tables(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Options that were set, as tables of a case file."""
    made: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        if value is None:
            continue
        table, key, _, _ = CASE_OPTIONS[name]
        if name in ("hu_min", "hu_max"):
            value = hu_limit(name, value)
        elif name == "scans":
            value = [part.strip() for part in value.split(",") if part.strip()]
        made.setdefault(table, {})[key] = value
    return made


def hu_limit(name: str, value: str) -> float | str:
    """A HU limit as a number, or ``auto``."""
    if value.strip().lower() == "auto":
        return "auto"
    try:
        return float(value)
    except ValueError:
        raise CaseError(f"--{name.replace('_', '-')} is {value!r}, expected a number of HU or auto") from None


def merged(base: Mapping[str, Any], over: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Tables of a case file with options laid over them."""
    return {**base, **{name: {**base.get(name, {}), **over[name]} for name in over}}
