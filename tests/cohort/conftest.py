"""Small cases of four planners on generated data, and a cohort of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from segmentation.mesh_files import write_ply
from tubeplan_viz.bench.models import narrow_neck, variant_2

Needle = Callable[[float, float], str]
COHORT = """[defaults.limits]
curvature_max = 0.125

[defaults.needle2d]
degree_max = 1

[[cases]]
id = "neck"
[cases.input]
mesh = "meshes/neck.ply"
[cases.planner]
start = "E1"
goal = "E2"
method = "feature_iteration"
[cases.limits]
clearance_min = 1.5

[[cases]]
id = "flat"
case = "files/flat.toml"
limits.curvature_max = 0.02

[[cases]]
id = "none"
case = "files/flat.toml"
obstacles = [{ kind = "circle", center = [0, 50], radius_mm = 39 }]
limits.curvature_max = 0.02

[[cases]]
id = "space"
planner = { name = "needle3d", method = "rrt" }
needle3d = { target = [0, 0, 100] }
limits.curvature_max = 0.02

[[cases]]
id = "damaged"
[cases.input]
mesh = "meshes/damaged.ply"
[cases.planner]
start = "E1"
goal = "E2"
"""
STATUS = {"neck": "flagged", "flat": "ok", "none": "infeasible", "space": "ok", "damaged": "bad_input"}


@pytest.fixture
def cohort_files(tmp_path: Path, needle_past_a_circle: Needle) -> Path:
    """A folder with the manifest cohort.toml and what it names; for what plans nothing, so that no mesh is one."""
    return write_files(tmp_path, needle_past_a_circle, mesh=False)


@pytest.fixture(scope="session")
def make_cohort(needle_past_a_circle: Needle) -> Callable[[Path], Path]:
    """Writes the same with the real meshes into a folder."""
    return lambda folder: write_files(folder, needle_past_a_circle, mesh=True)


@pytest.fixture(scope="session")
def expected_status() -> dict[str, str]:
    """How each case of the cohort ends: a neck of 1 mm, an obstacle that cannot be passed, half a mesh."""
    return STATUS


def write_files(folder: Path, needle: Needle, *, mesh: bool) -> Path:
    (folder / "meshes").mkdir(parents=True)
    (folder / "files").mkdir()
    (folder / "cohort.toml").write_text(COHORT, encoding="utf-8")
    (folder / "files" / "flat.toml").write_text(needle(40.0, 10.0), encoding="utf-8")
    neck = folder / "meshes" / "neck.ply"
    if mesh:
        write_ply(narrow_neck().surface, neck)
        write_ply(variant_2().surface, folder / "meshes" / "bent.ply")
    else:
        neck.write_bytes(b"ply\n")
    (folder / "meshes" / "damaged.ply").write_bytes(neck.read_bytes()[: 40_000 if mesh else 2])
    return folder


@pytest.fixture(scope="session")
def plan_of() -> Callable[[Path], dict[str, Any]]:
    """The content of a run's result.json without times and dates."""

    def read(run: Path) -> dict[str, Any]:
        result: dict[str, Any] = json.loads((run / "result.json").read_text(encoding="utf-8"))
        del result["timings_s"], result["provenance"]["created_utc"], result["provenance"]["outputs"]
        return result

    return read
