"""The command tree, and how a command's end becomes an exit status (spec 0.2)."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer
from typer.exceptions import TyperException

from segmentation.errors import TubeplanError
from tubeplan_viz import __version__
from tubeplan_viz.cli import (
    batch,
    bench,
    compare,
    demo,
    endpoints,
    export,
    init,
    inspect,
    matrix,
    plan,
    plan_bronchoscope,
    plan_needle,
    plan_rigid,
    reach,
    run,
    schema,
    segment,
    verify,
    view,
)
from tubeplan_viz.cohort import CohortInterrupted
from tubeplan_viz.plan import NoPathError

OK, FAULT, BAD_INPUT, NO_PATH, INTERRUPTED = 0, 1, 2, 4, 130

app = typer.Typer(
    name="tubeplan",
    help="From a CT or mesh of tubular anatomy to a proved instrument path, a recording and a report. "
    "Research use, not for clinical decisions.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=True,
)
plans = typer.Typer(help="Plan a path without a case file.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(plans, name="plan")
plans.command("tube")(plan.tube)
plans.command("needle2d")(plan_needle.needle2d)
plans.command("needle3d")(plan_needle.needle3d)
plans.command("rigid")(plan_rigid.rigid)
plans.command("bronchoscope")(plan_bronchoscope.bronchoscope)
for name, command in (
    ("demo", demo.demo),
    ("init", init.init),
    ("run", run.run),
    ("inspect", inspect.inspect),
    ("segment", segment.segment),
    ("endpoints", endpoints.endpoints),
    ("verify", verify.verify),
    ("compare", compare.compare),
    ("view", view.view),
    ("export", export.export),
    ("schema", schema.schema),
    ("matrix", matrix.matrix),
    ("reach", reach.reach),
    ("batch", batch.batch),
    ("bench", bench.bench),
):
    app.command(name)(command)


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


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with the status of spec 0.2."""
    sys.exit(status_of(arguments))


def status_of(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status; errors are printed as one sentence."""
    try:
        outcome = typer.main.get_command(app).main(
            args=None if arguments is None else list(arguments), prog_name="tubeplan", standalone_mode=False
        )
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
    except CohortInterrupted as fault:
        complain(str(fault))
        return INTERRUPTED
    except NoPathError as fault:
        complain(f"no path: {fault}")
        return NO_PATH
    except TubeplanError as fault:
        complain(str(fault))
        return BAD_INPUT
    except Exception as fault:
        import traceback

        frame = traceback.extract_tb(fault.__traceback__)[-1]
        complain(
            f"a fault of the program, please report it: {type(fault).__name__}: {fault} "
            f"(in {frame.name}, line {frame.lineno} of {frame.filename.rsplit('/', 1)[-1]})"
        )
        return FAULT


def usage_fault(fault: TyperException) -> None:
    """One sentence about a wrong option or argument; the help itself where no command was named."""
    # typer keeps the class of its own usage errors private, but not what they offer.
    text = fault.format_message() if hasattr(fault, "format_message") else str(fault)
    context = getattr(fault, "ctx", None)
    command = context.command_path if context else "tubeplan"
    if text.startswith("Usage:"):
        typer.echo(text, err=True)
    else:
        complain(f"{text.rstrip('.')}; see `{command} --help`")


def complain(message: str) -> None:
    """One line on standard error."""
    typer.echo(f"tubeplan: {message}", err=True)
