"""tubeplan bench: a published or measured comparison, rebuilt."""

from __future__ import annotations

import json as json_text
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from segmentation.errors import CaseError
from tubeplan_viz.bench import BENCHMARKS
from tubeplan_viz.cli.options import Json, Quiet
from tubeplan_viz.cli.show import progress
from tubeplan_viz.result import plain
from tubeplan_viz.tube import METHODS


def bench(
    name: Annotated[str, typer.Argument(help="Which comparison: " + ", ".join(BENCHMARKS) + ".")],
    json: Json = False,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer seeds and cases.")] = False,
    method: Annotated[
        str, typer.Option("--method", help="Of paper: feature_iteration (its tables), or optimal (as the benchmark optimal).")
    ] = "feature_iteration",
    quiet: Quiet = False,
) -> None:
    """Rebuild a comparison: case, figure, ours, reference, ratio, target, holds.

    Exit status 0 when all targets hold, 3 when not.

    Example: tubeplan bench paper --quick
    """
    if name not in BENCHMARKS:
        raise CaseError(f"there is no benchmark {name!r}, expected one of {', '.join(BENCHMARKS)}")
    if method not in METHODS:
        raise CaseError(f"there is no method {method!r}, expected {' or '.join(METHODS)}")
    if method == "optimal" and name not in ("paper", "optimal"):
        raise CaseError(f"the benchmark {name} has no --method optimal; it is for paper")
    name = "optimal" if method == "optimal" else name
    with progress(quiet or json) as notify:
        rows = BENCHMARKS[name](quick=quick, notify=notify)
    if json:
        typer.echo(json_text.dumps(plain([row.as_dict() for row in rows]), indent=1))
    else:
        table = Table(box=None, pad_edge=False)
        for heading in ("case", "figure", "ours", "reference", "source", "ratio", "target", "holds"):
            table.add_column(heading, justify="right" if heading in ("ours", "reference", "ratio") else "left")
        for row in rows:
            table.add_row(*row.cells())
        Console(width=150).print(table)
    raise typer.Exit(0 if all(row.holds is not False for row in rows) else 3)
