"""The search on a calculated head, against brute force and its own laws, and the way through to a verified run folder."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk

from segmentation.anatomy.nasal import shrink
from segmentation.arrays import BoolArray
from segmentation.errors import CaseError
from segmentation.synthetic.nasal import NasalPhantom, NasalPhantomSettings, nasal_phantom
from segmentation.volume import Volume
from tubeplan_viz.cases.rigid import make_rigid_case, rigid_case_table
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.rigid import (
    CoupledInstrument,
    Problem,
    RigidPath,
    SearchSettings,
    Weights,
    make_problem,
    path_goals,
    plan_rigid,
    refined,
    reliefs,
    search,
)
from tubeplan_viz.verify import verify_run

LESION = "11.6,3,27"


@pytest.fixture(scope="module")
def phantom() -> NasalPhantom:
    return nasal_phantom(NasalPhantomSettings(spacing=(2.0, 2.0, 2.0)))


@pytest.fixture(scope="module")
def problem(phantom: NasalPhantom) -> Problem:
    scene = shrink(phantom.scene, 1.0, "left").scene
    return make_problem(scene, "left", phantom.lesions["left"], instrument=CoupledInstrument())


def test_every_path_found_is_free_by_the_exact_test(problem: Problem) -> None:
    some = problem.starts[::4]
    found = search(problem.judge(), some, problem.goal, SearchSettings(rolls=1, nodes=1))
    assert found.feasible.any()
    assert not found.feasible.all()
    assert sum(len(path.nodes) == 3 for path in found.paths) > 20
    judge = problem.judge(exact=True)
    for path in found.paths:
        label, _ = judge.push(path.nodes[:-1], path.nodes[1:], np.full(len(path.nodes) - 1, path.roll))
        assert (label < 0).all()
        assert path.nodes[0] == pytest.approx(some[path.start])
        assert path.nodes[-1] == pytest.approx(problem.goal)
    # Every start without a path has been refused by something.
    assert np.all(found.refused[~found.feasible].sum(axis=1) > 0)


def test_neither_roll_nor_shrinkage_makes_a_feasible_start_infeasible(phantom: NasalPhantom) -> None:
    straight = SearchSettings(rolls=1, nodes=0)
    feasible: list[BoolArray] = []
    known: tuple[RigidPath, ...] = ()
    for amount in (0.0, 0.5, 1.0):
        scene = shrink(phantom.scene, amount, "left").scene
        made = make_problem(scene, "left", phantom.lesions["left"], instrument=CoupledInstrument())
        alone = search(made.judge(), made.starts, made.goal, straight)
        rolled = search(made.judge(), made.starts, made.goal, SearchSettings(rolls=3, nodes=0))
        carried = search(made.judge(), made.starts, made.goal, straight, known=known)
        assert np.all(rolled.feasible >= alone.feasible)
        # Less tissue frees more pushes by itself; nothing has to be carried over for that.
        assert np.array_equal(carried.feasible, alone.feasible)
        feasible.append(alone.feasible)
        known = alone.paths
    assert np.all(feasible[1] >= feasible[0])
    assert np.all(feasible[2] >= feasible[1])


def test_a_thinner_instrument_loses_no_straight_start(problem: Problem, phantom: NasalPhantom) -> None:
    settings = SearchSettings(rolls=1, nodes=0)
    thick = search(problem.judge(), problem.starts, problem.goal, settings)
    thin_one = CoupledInstrument(scope_diameter=2.7, shaver_diameter=2.5)
    made = make_problem(problem.scene, "left", problem.goal, instrument=thin_one)
    # Another instrument has a ring of another width; the walls it adds are farther out than this one reaches.
    thin = search(made.judge(), made.starts, made.goal, settings)
    assert np.all(thin.feasible >= thick.feasible)


def test_the_reliefs_name_what_opens_a_way_for_an_instrument_too_thick(problem: Problem) -> None:
    thick = CoupledInstrument(scope_diameter=6.0, shaver_diameter=5.0, offset=6.5)
    blocked = replace(problem, instrument=thick)
    assert not search(blocked.judge(), blocked.starts, blocked.goal, SearchSettings(rolls=1, nodes=0)).feasible.any()
    tried = list(reliefs(blocked, np.zeros(1), CoupledInstrument(offset=6.5)))
    as_planned, thinner = tried[0], tried[1]
    assert as_planned.change == ""
    assert as_planned.free == as_planned.starts == 0
    # Every direction of the coarse grid is blocked by something, and told by what.
    assert sum(as_planned.against.values()) == as_planned.directions
    assert "thinnest instruments (4 and 2.9 mm)" in thinner.change
    assert thinner.free > 0
    assert thinner.starts > 0
    # What is set aside is in nobody's way any more; brain and orbits never are.
    without = next(relief for relief in tried if relief.change == "the inferior turbinate set aside")
    assert "turbinate_left" not in without.against
    assert all("brain" not in relief.change and "orbit" not in relief.change for relief in tried)


def test_refined_paths_are_no_worse_than_the_best_before_and_free(problem: Problem) -> None:
    found = search(problem.judge(), problem.starts, problem.goal, SearchSettings(rolls=1, nodes=0))
    goals = path_goals(problem, found.paths)
    paths, better = refined(problem, found.paths, goals, Weights())
    assert paths[: len(found.paths)] == found.paths
    assert better[:, 0].max() >= goals[:, 0].max()
    assert better[:, 4].min() <= goals[:, 4].min()
    assert better[:, 5].min() <= goals[:, 5].min()
    for path in paths[len(found.paths) :]:
        label, _ = problem.judge(exact=True).push(path.nodes[:-1], path.nodes[1:], np.full(len(path.nodes) - 1, path.roll))
        assert (label < 0).all()


def test_a_side_that_is_missing_is_named(phantom: NasalPhantom) -> None:
    with pytest.raises(CaseError, match="expected left or right"):
        make_problem(phantom.scene, "middle", phantom.lesions["left"], instrument=CoupledInstrument())


def write(volume: Volume, path: Path) -> None:
    image = sitk.GetImageFromArray(np.array(volume.voxels))
    image.SetSpacing([float(v) for v in volume.spacing[::-1]])
    image.SetOrigin([float(v) for v in volume.index_to_lps[:3, 3]])
    sitk.WriteImage(image, str(path))


@pytest.fixture(scope="module")
def run(phantom: NasalPhantom, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rigid")
    write(phantom.volume, folder / "head.nii.gz")
    own = ["plan", "rigid", "--ct", str(folder / "head.nii.gz"), "--side", "left", "--lesion", LESION, "--nodes", "0"]
    assert status_of([*own, "-o", str(folder / "run"), "--quiet"]) == 0
    return folder / "run"


def result_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


def test_a_run_holds_its_candidates_refusals_and_choices_and_the_verifier_agrees(run: Path) -> None:
    names = {entry.name for entry in run.iterdir()}
    assert names == {"case.toml", "path.csv", "path.mrk.json", "recording.rrd", "report.html", "result.json"}
    result = result_of(run)
    details = result["details"]
    assert result["status"] == "ok"
    assert set(details["best"]) == {"overall", "brain", "length", "tissue"}
    assert any(row["pareto"] for row in details["candidates"])
    assert len(details["entry"]["refused"]) == len(details["entry"]["points_mm"]) == details["entry"]["counts"]["starts"]
    assert [row["amount"] for row in details["shrinkage"]] == [0.0, 0.5, 1.0]
    verification = verify_run(run)
    assert [check.name for check in verification.faults] == []
    assert any(check.name == "sweep: brain" for check in verification.checks)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--side", "left", "--lesion", "0,-150,0"], "lies outside of the image"),
        (["--side", "left", "--lesion", "5,-5,20"], "lies in air"),
        (["--lesion", LESION], "no side was given"),
        (["--side", "up", "--lesion", LESION], "expected left or right"),
        (["--side", "left", "--lesion", LESION, "--shaver", "Drill"], "there is no shaver 'Drill'"),
        (["--side", "left", "--lesion", LESION, "--offset", "2"], "both radii together"),
        (["--side", "left", "--lesion", LESION, "--mask", "liver=x.nii"], "unknown structure 'liver'"),
    ],
)
def test_bad_input_is_one_sentence_with_status_2(
    run: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    ct = str(run.parent / "head.nii.gz")
    assert status_of(["plan", "rigid", "--ct", ct, *options, "-o", str(run.parent / "bad"), "--quiet"]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert len(told.strip().splitlines()) == 1
    assert not (run.parent / "bad").exists()


def test_a_case_and_its_table_are_the_same() -> None:
    table = {
        "input": {"ct": "head.nii"},
        "planner": {"name": "rigid"},
        "rigid": {"side": "left", "lesion": [1.0, 2.0, 3.0], "shrinkage_percent": 50.0, "seeds": {"septum": [0.0, 1.0, 2.0]}},
    }
    case = make_rigid_case(table)
    again = make_rigid_case(rigid_case_table(case, folder=Path.cwd()))
    assert rigid_case_table(again) == rigid_case_table(case)
    assert again.search == case.search


def test_where_nothing_can_stand_at_the_lesion_with_all_shrinkage_less_is_not_searched_and_has_no_path(
    phantom: NasalPhantom,
) -> None:
    thick = CoupledInstrument(scope_diameter=6.0, shaver_diameter=5.0, offset=6.5)
    settings = SearchSettings(rolls=1, nodes=1)
    problems = {
        amount: make_problem(shrink(phantom.scene, amount, "left").scene, "left", phantom.lesions["left"], instrument=thick)
        for amount in (0.0, 1.0)
    }
    found = plan_rigid(problems, settings, Weights(), amount=1.0).searches
    assert list(found) == [0.0, 1.0]
    # Alone, with all bends allowed, less shrinkage has no path either, and the same blocks its straight pushes.
    alone = search(problems[0.0].judge(), problems[0.0].starts, problems[0.0].goal, settings)
    assert not alone.feasible.any()
    assert not found[0.0].feasible.any()
    assert np.array_equal(found[0.0].blocked_by, alone.blocked_by)
    assert found[0.0].evaluations < 0.5 * alone.evaluations
