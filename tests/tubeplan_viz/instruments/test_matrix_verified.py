"""`tubeplan verify` on instruments against targets: nothing of a finished matrix is altered unnoticed."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from segmentation.mesh_files import write_ply
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.verify import verify_run
from tubeplan_viz.verify.matrix import (
    Corners,
    Measured,
    check_advances,
    check_bends,
    check_cells,
    check_csv,
    check_impossible,
    check_paths,
    check_tally,
    lumen_of,
    measured,
    tip_clearance,
)
from tubeplan_viz.verify.mesh_file import read_mesh
from tubeplan_viz.verify.profile import OwnProfile, measure
from tubeplan_viz.verify.spline import BezierPath
from tubeplan_viz.verify.verification import Check
from tubeplan_viz.verify.wall import Lumen

NAMES = ("thin", "thick", "stiff", "long tip", "short")
# Diameter, least bend radius, rigid tip and working length, mm: holds, too narrow, a bend too sharp, flagged, too far.
FIGURES = (
    (1.0, 6.0, 3.0, 900.0),
    (20.0, 6.0, 0.0, 900.0),
    (1.9, 24.0, 0.0, 900.0),
    (1.2, 6.0, 25.0, 900.0),
    (1.0, 6.0, 0.0, 20.0),
)
KEYS = ("outer_diameter_mm", "bend_radius_min_mm", "rigid_tip_mm", "working_length_mm")


@pytest.fixture(scope="module")
def folder(fork: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("verified")
    write_ply(fork.surface, place / "fork.ply")
    rows = [
        f'[[instrument]]\nname = "{name}"\nkind = "test"\n' + "".join(f"{k} = {v}\n" for k, v in zip(KEYS, figures, strict=True))
        for name, figures in zip(NAMES, FIGURES, strict=True)
    ]
    (place / "mine.toml").write_text("".join(rows), encoding="utf-8")
    call = ["matrix", "--mesh", str(place / "fork.ply"), "--catalogue", str(place / "mine.toml"), "-q", "-o", str(place / "out")]
    assert status_of([*call, "--no-report", "--no-recording"]) == 3
    return place / "out"


def test_a_matrix_is_verified_by_its_folder(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = json.loads((folder / "matrix.json").read_text(encoding="utf-8"))
    verdicts = [row[0]["verdict"] for row in document["cells"]]
    assert verdicts == ["feasible", "impossible", "impossible", "flagged", "impossible"]
    capsys.readouterr()
    assert status_of(["verify", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["holds"] is True


def cell(number: int, **values: Any) -> Callable[[dict[str, Any]], None]:
    """A change of the first cell of an instrument."""
    return lambda document: document["cells"][number][0].update(values)


def verdict(number: int, new: str) -> Callable[[dict[str, Any]], None]:
    """Another verdict, with counts that agree."""

    def change(document: dict[str, Any]) -> None:
        one = document["cells"][number][0]
        document["counts"][one["verdict"]] -= 1
        document["counts"][new] += 1
        one["verdict"] = new

    return change


def control(document: dict[str, Any]) -> None:
    document["paths"][0][0]["spline"]["control_points_mm"][3][0] += 0.05


def thicker(document: dict[str, Any]) -> None:
    """An instrument that the cell's path does not carry, with margins that agree."""
    document["instruments"][0]["outer_diameter_mm"] = 4.4
    for one in document["cells"][0]:
        one.update(required_mm=2.2, margin_mm=one["available_mm"] - 2.2)


CHANGES: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "a verdict": (lambda d: d["cells"][3][0].update(verdict="feasible"), "verdicts: counted"),
    "a yes": (verdict(3, "feasible"), "cells: judged on their paths"),
    "a flag": (verdict(0, "flagged"), "cells: judged on their paths"),
    "a margin": (cell(0, margin_mm=0.5), "cells: judged on their paths"),
    "a clearance": (
        lambda d: d["paths"][0][0].update(clearance_min_mm=d["paths"][0][0]["clearance_min_mm"] + 0.05),
        "paths: measured",
    ),
    "a proof": (
        lambda d: d["paths"][0][0].update(clearance_lower_bound_mm=d["paths"][0][0]["clearance_min_mm"] + 1e-4),
        "paths: measured",
    ),
    "a curvature": (lambda d: d["paths"][0][0].update(curvature_upper_bound_per_mm=0.01), "paths: measured"),
    "a length": (lambda d: d["paths"][0][0].update(length_mm=d["paths"][0][0]["length_mm"] + 0.01), "paths: measured"),
    "a control point": (control, "paths: measured"),
    "a target": (lambda d: d["targets"][0]["point_mm"].__setitem__(0, d["targets"][0]["point_mm"][0] + 0.01), "paths: measured"),
    "a thicker instrument": (thicker, "cells: judged on their paths"),
    "a ceiling below a path": (lambda d: d["targets"][0].update(ceiling_mm=0.5), "cells: impossible"),
    "a place farther on": (
        lambda d: d["cells"][2][0].update(
            reached_mm=d["cells"][2][0]["reached_mm"] + 0.5, short_mm=d["cells"][2][0]["short_mm"] - 0.5
        ),
        "cells: how far",
    ),
    "what is left": (cell(4, short_mm=1.0), "cells: how far"),
    "a place of one that holds": (cell(0, reached_mm=1.0), "cells: how far"),
    "a longer instrument": (lambda d: d["instruments"][4].update(working_length_mm=300.0), "cells: impossible"),
    "a bend": (
        lambda d: d["bends"][0][0].update(clearance_upper_bound_mm=0.2),
        "cells: impossible",
    ),
    "a bend's limit": (lambda d: d["bends"][0][0].update(curvature_max_per_mm=0.2), "cells: bends"),
    "a figure of the table": (lambda d: d["cells"][1][0].update(bend_radius_mm=3.0), "matrix.csv"),
}


@pytest.fixture(scope="module")
def lumen(folder: Path) -> Lumen:
    return lumen_of(read_mesh(folder / "mesh.ply"), closed=False)


@pytest.fixture(scope="module")
def own(folder: Path, lumen: Lumen) -> list[list[OwnProfile]]:
    document = json.loads((folder / "matrix.json").read_text(encoding="utf-8"))
    return [[measured(path, lumen) for path in column] for column in document["paths"]]


@pytest.mark.parametrize("name", CHANGES)
def test_an_altered_number_is_found(name: str, folder: Path, lumen: Lumen, own: list[list[OwnProfile]]) -> None:
    document = json.loads((folder / "matrix.json").read_text(encoding="utf-8"))
    changed = copy.deepcopy(document)
    change, found_by = CHANGES[name]
    change(changed)
    assert changed != document
    paths = [
        [Measured(path, profile) for path, profile in zip(column, profiles, strict=True)]
        for column, profiles in zip(changed["paths"], own, strict=True)
    ]
    if change is control:
        path = changed["paths"][0][0]
        paths[0][0] = Measured(path, measured(path, lumen))
    checks: dict[str, Callable[[], Check]] = {
        "verdicts: counted": lambda: next(check_tally(changed)),
        "matrix.csv": lambda: next(check_csv(folder, changed)),
        "paths: measured": lambda: check_paths(changed, paths),
        "cells: judged on their paths": lambda: check_cells(changed, paths, lumen),
        "cells: how far": lambda: check_advances(changed, paths, lumen),
        "cells: impossible": lambda: check_impossible(changed, paths, lumen),
        "cells: bends": lambda: check_bends(changed, lumen),
    }
    check = checks[found_by]()
    assert (check.name, check.ok) == (found_by, False)


def test_a_folder_that_is_not_whole_is_told(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "copy")
    (tmp_path / "copy" / "mesh.ply").write_bytes(b"ply")
    assert [check.name for check in verify_run(tmp_path / "copy").faults] == ["mesh.ply"]
    (tmp_path / "copy" / "matrix.csv").unlink()
    assert [check.name for check in verify_run(tmp_path / "copy").faults] == ["matrix.csv", "mesh.ply"]


def test_a_rigid_tip_in_a_quarter_bend_has_the_clearance_of_its_sagitta(lumen: Lumen) -> None:
    # Along an arc of radius R the middle of a chord of length l lies R - sqrt(R^2 - l^2 / 4) nearer to the bend's axis, so that
    # the clearance of the middle line falls by that much. The fork's way bends so that the chord is cut to 0.05 mm by its step.
    angle = np.linspace(0.0, np.pi / 2.0, 40)
    radius, length = 12.0, 6.0
    points = np.column_stack([radius * (1.0 - np.cos(angle)), 0.0 * angle, 30.0 + radius * np.sin(angle)])
    knots = np.concatenate([np.zeros(4), np.linspace(0.0, 1.0, len(points) - 2)[1:-1], np.ones(4)])
    own = measure(BezierPath.from_spline(3, knots, points), lumen)
    sagitta = radius - np.sqrt(radius**2 - 0.25 * length**2)
    found = tip_clearance(own, length, Corners.of(lumen))
    assert found == pytest.approx(2.0 - sagitta, abs=0.08)  # the wall is marched on voxels of 0.6 mm
