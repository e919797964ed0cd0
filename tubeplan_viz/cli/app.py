"""The command tree, and how a command's end becomes an exit status."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, cast

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from segmentation.errors import TubeplanError
from segmentation.faults import fault_words
from tubeplan_viz import __version__
from tubeplan_viz.cli import INTERRUPTED
from tubeplan_viz.cli.late import PLAIN, add_late
from tubeplan_viz.cli.usage import usage_words

OK, FAULT, BAD_INPUT, NO_PATH = 0, 1, 2, 4

# By name: where the command is, and the first line of its help.
COMMANDS = {
    "demo": ("demo:demo", "Plan from the ureter to a calyx on a generated urography CT, from DICOM to report."),
    "init": ("init:init", "Write a commented case file: anatomy with its reason, end points with their labels, limits."),
    "run": ("run:run", "Plan one case from a case file; options given here take the place of the file's."),
    "inspect": ("inspect:inspect", "List what is in a DICOM folder, volume or mesh: series, geometry, faults."),
    "segment": ("segment:segment", "Grow the lumen of a CT and write its mask (NIfTI) and mesh (PLY)."),
    "endpoints": (
        "endpoints:endpoints",
        "List the tips of the lumen's tree, for --start and --goal; with an anatomy E1 is the way in and --goal takes names too.",
    ),
    "verify": ("verify:verify", "Check curvature, clearance, inside-ness, ends, frame and every printed number again."),
    "compare": (
        "compare:compare",
        "Lay planners, limits, instruments or dates side by side: one page, one recording, compare.json.",
    ),
    "view": ("view:view", "Open a run's recording in the rerun viewer."),
    "export": ("export:export", "Write a run for 3D Slicer, DICOM viewers, slides and spreadsheets, without planning again."),
    "schema": ("schema:schema", "List the keys of result.json with their types and meanings."),
    "matrix": ("matrix:matrix", "Judge every instrument of a catalogue for every target: holds, flagged, or proved impossible."),
    "reach": (
        "reach:reach",
        "Judge every branch of an airway: reached by the robot, too narrow (proved), or no way found and what stopped it.",
    ),
    "batch": ("batch:batch", "Run a cohort: many cases of any planner, side by side, on this machine or on a Dask cluster."),
    "bench": ("bench:bench", "Rebuild a comparison: case, figure, ours, reference, ratio, target, holds."),
}
PLANS = {
    "tube": ("plan:tube", "Plan a curvature- and clearance-constrained path inside a curved tube."),
    "needle2d": ("plan_needle:needle2d", "Plan a needle in the plane: lines and arcs, every form at its optimum."),
    "needle3d": ("plan_needle:needle3d", "Plan a flexible needle in space past obstacles, onto the target."),
    "rigid": ("plan_rigid:rigid", "Plan a coupled endoscope and shaver from the nostril to a lesion at the skull base."),
    "bronchoscope": (
        "plan_bronchoscope:bronchoscope",
        "Plan a bronchoscope robot of two bending sections along the airway, command by command.",
    ),
}

app = typer.Typer(
    name="tubeplan",
    help="From a CT or mesh of tubular anatomy to a proved instrument path, a recording and a report. "
    "Research use, not for clinical decisions.",
    no_args_is_help=True,
    **{**PLAIN, "add_completion": True},
)


def show_version(wanted: bool) -> None:
    """Print the version and end."""
    if wanted:
        typer.echo(f"tubeplan {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[bool, typer.Option("--version", callback=show_version, is_eager=True, help="Print the version.")] = False,
) -> None:
    """From a CT or mesh of tubular anatomy to a proved instrument path, a recording and a report.

    Research use, not for clinical decisions.

    Example: tubeplan demo -o demo
    """


def command_tree() -> TyperGroup:
    """`tubeplan` with all its commands."""
    root = cast(TyperGroup, typer.main.get_command(app))  # a group, since it has a callback
    add_late(root, COMMANDS)
    plans = TyperGroup(name="plan", help="Plan a path without a case file.", no_args_is_help=True, rich_markup_mode=None)
    add_late(plans, PLANS)
    root.add_command(plans)
    return root


def status_of(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status; errors are printed as one sentence."""
    try:
        given = None if arguments is None else list(arguments)
        outcome = command_tree().main(args=given, prog_name="tubeplan", standalone_mode=False)
        if outcome == INTERRUPTED:  # typer turns Ctrl-C into this status and says nothing
            complain("interrupted; nothing was written")
        return outcome if isinstance(outcome, int) else OK
    except TyperException as fault:
        usage_fault(fault)
        return BAD_INPUT
    except typer.Exit as end:
        return end.exit_code
    except (typer.Abort, KeyboardInterrupt):
        complain("interrupted; nothing was written")
        return INTERRUPTED
    except TubeplanError as fault:
        return told(fault)
    except Exception as fault:  # the outermost place: whatever it is, one sentence and status 1
        complain(fault_words(fault))
        return FAULT


def told(fault: TubeplanError) -> int:
    """Print an error that is meant for the user, and return its exit status."""
    # Imported here: they lie among the planners, which nobody waits for who asks for help or the version.
    from tubeplan_viz.cohort import CohortInterrupted
    from tubeplan_viz.plan import NoPathError

    no_path = isinstance(fault, NoPathError)
    complain(f"no path: {fault}" if no_path else str(fault))
    return NO_PATH if no_path else INTERRUPTED if isinstance(fault, CohortInterrupted) else BAD_INPUT


def usage_fault(fault: TyperException) -> None:
    """One sentence about a wrong option or argument; the help itself where no command was named."""
    text = usage_words(fault)
    context = getattr(fault, "ctx", None)
    command = context.command_path if context else "tubeplan"
    if text.startswith("Usage:"):
        typer.echo(text, err=True)
    else:
        complain(f"{text}; see `{command} --help`")


def complain(message: str) -> None:
    """One line on standard error."""
    typer.echo(f"tubeplan: {message}", err=True)
