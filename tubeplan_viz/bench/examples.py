"""Recorded examples: small cases on generated tubes, made again with one command.

``python -m tubeplan_viz.bench.examples datasets/recorded`` plans every example and keeps
its case.toml, result.json and light recording.rrd.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segmentation.mesh_files import write_ply
from tubeplan_viz.bench.models import Model, bent_cylinder_1, bent_cylinder_2, narrow_neck, y_junction
from tubeplan_viz.cases.tube import Case, make_case
from tubeplan_viz.pipeline import RunOptions, run_tube

KEPT = ("case.toml", "result.json", "recording.rrd")


@dataclass(frozen=True, eq=False, kw_only=True)
class Example:
    """A generated tube and what is planned in it.

    Attributes
    ----------
    build : callable
        Gives the model; start and goal are the ends of its axis.
    limits, tube : mapping
        Tables of the case file.
    method : str
        Of the tube planner.
    """

    build: Callable[[], Model]
    limits: Mapping[str, float]
    tube: Mapping[str, Any]
    method: str = "feature_iteration"


# Limits of table 1 of Dai et al. (2024), at the spacing of 0.8 mm that its point counts imply.
EXAMPLES: Mapping[str, Example] = {
    "cylinder_1": Example(
        build=bent_cylinder_1,
        limits={"curvature_max": 0.100, "clearance_min": 1.5},
        tube={"centerline_step_mm": 0.8},
    ),
    "cylinder_1_optimal": Example(
        build=bent_cylinder_1, limits={"curvature_max": 0.100, "clearance_min": 1.5}, tube={}, method="optimal"
    ),
    "cylinder_2": Example(
        build=bent_cylinder_2,
        limits={"curvature_max": 0.100, "clearance_min": 6.0},
        tube={"centerline_step_mm": 0.8},
    ),
    "narrow_neck": Example(build=narrow_neck, limits={"curvature_max": 0.125, "clearance_min": 1.5}, tube={}),
    "y_junction": Example(build=y_junction, limits={"curvature_max": 0.125, "clearance_min": 1.2}, tube={}),
}


def write_example_mesh(name: str, folder: Path) -> Model:
    """Write the example's mesh as NAME.ply into a folder; the recorded case file expects it beside its own folder."""
    model = EXAMPLES[name].build()
    write_ply(model.surface, folder / f"{name}.ply")
    return model


def example_case(name: str, folder: Path) -> Case:
    """The example's case, its mesh made in `folder`."""
    model, example = write_example_mesh(name, folder), EXAMPLES[name]
    return make_case(
        {
            "input": {"mesh": folder / f"{name}.ply", "case_id": name.replace("_", "-")},
            "limits": example.limits,
            "planner": {"method": example.method, "start": model.start.tolist(), "goal": model.goal.tolist()},
            "tube": example.tube,
        },
        name=name,
    )


def record(name: str, target: Path) -> None:
    """Plan one example and keep its files in the folder `target`/NAME."""
    with tempfile.TemporaryDirectory() as temporary:
        run = Path(temporary) / name
        run_tube(example_case(name, Path(temporary)), run, RunOptions(report=False, light=True))
        (target / name).mkdir(parents=True, exist_ok=True)
        for file in KEPT:
            shutil.copyfile(run / file, target / name / file)


def main(arguments: list[str]) -> None:
    """Record all examples into the folder named."""
    if len(arguments) != 1:
        raise SystemExit("usage: python -m tubeplan_viz.bench.examples FOLDER")
    for name in EXAMPLES:
        record(name, Path(arguments[0]))


if __name__ == "__main__":
    main(sys.argv[1:])
