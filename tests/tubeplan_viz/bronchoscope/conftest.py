"""A small generated airway, its tree, and runs of the robot in it, made once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from segmentation.mesh_files import write_ply
from segmentation.synthetic import Airway, weibel_airway
from tubeplan_viz.bronchoscope.airway import AirwayTree, airway_tree
from tubeplan_viz.pipeline import RunOptions, grow_tree
from tubeplan_viz.planners import make_case, run_case

GOAL = "right apical segment"


@dataclass(frozen=True)
class MadeAirway:
    """The generated airway of four generations, its tree as found, and its mesh file."""

    truth: Airway
    tree: AirwayTree
    file: Path

    def case(self, goal: str = GOAL, **planner: Any) -> Any:
        """A kinematic case in it."""
        table = {
            "input": {"mesh": str(self.file)},
            "planner": {"name": "bronchoscope", "method": "kinematic", "goal": goal, **planner},
        }
        return make_case(table, name="options")


@pytest.fixture(scope="session")
def made_airway(tmp_path_factory: pytest.TempPathFactory) -> MadeAirway:
    truth = weibel_airway(generations=4, voxel=0.8)
    file = tmp_path_factory.mktemp("airway") / "airway.ply"
    write_ply(truth.surface, file)
    found = grow_tree(truth.surface)
    return MadeAirway(truth, airway_tree(found.graph, found.wall, found.endpoints, frame="mesh"), file)


@pytest.fixture(scope="session")
def robot_run(made_airway: MadeAirway, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder of the text's route, all files."""
    target = tmp_path_factory.mktemp("robot") / "run"
    run_case(made_airway.case(), target, RunOptions(light=True))
    return target
