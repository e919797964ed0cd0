"""The robot's way through the generated airway: tree and names, plan, run folder, verifier, bad input."""

from __future__ import annotations

import csv
import importlib.util
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from segmentation.errors import CaseError
from tubeplan_viz.bronchoscope import way as way_module
from tubeplan_viz.bronchoscope.guide import BEND_SHARE, make_guide
from tubeplan_viz.bronchoscope.kinematic import KinematicMover
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import PlannerSettings
from tubeplan_viz.bronchoscope.rrt import plan_plain
from tubeplan_viz.bronchoscope.target import branch_target, lesion_target, point_target
from tubeplan_viz.bronchoscope.way import make_simulator, plan_way
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.plan import NoPathError
from tubeplan_viz.reach_map import Verdict, reach_map
from tubeplan_viz.verify import verify_run

GOAL = "right apical segment"


def test_lobes_and_segments_get_their_true_names(made_airway: Any) -> None:
    # The end of each found branch is nearest to the end of the branch of the same name.
    truth = {branch.name: branch for branch in made_airway.truth.branches if branch.generation <= 3}
    found = {branch.name: branch for branch in made_airway.tree.branches if branch.generation <= 3}

    def right(name: str) -> bool:
        end = found[name].line.points[-1]
        return name in truth and min(truth, key=lambda other: np.linalg.norm(truth[other].points[-1] - end)) == name

    lobes = [name for name, branch in found.items() if branch.generation <= 2]
    assert len(lobes) == 7
    assert all(right(name) for name in lobes)
    # A tip that was not found leaves its segment to be drawn on into the other one beyond: at most one of eight.
    segments = [name for name, branch in found.items() if branch.generation == 3]
    assert len(segments) == 8
    assert sum(right(name) for name in segments) >= 7
    every = [branch.name for branch in made_airway.tree.branches]
    assert len(set(every)) == len(every)


def test_diameters_and_generations_are_the_true_ones(made_airway: Any) -> None:
    for branch in made_airway.tree.branches:
        if branch.generation <= 2:
            true = made_airway.truth.branches[made_airway.truth.number(branch.name)]
            assert branch.generation == true.generation
            # Inscribed spheres of the mesh are a little smaller than the tube; of a short branch the junctions count too.
            assert branch.median_radius == pytest.approx(true.radius, rel=0.04)


def test_the_route_is_the_true_one(made_airway: Any) -> None:
    tree, truth = made_airway.tree, made_airway.truth
    names = [tree.branches[k].name for k in tree.route_to(tree.named("Right Apical  segment"))]
    assert names == [truth.branches[k].name for k in truth.route(GOAL)]


def test_the_guide_bends_less_than_the_robot_and_keeps_its_room(made_airway: Any) -> None:
    robot, tree = Robot(), made_airway.tree
    number = tree.named("right anterior segment")
    guide = make_guide(tree.line_to(number), robot)
    assert guide.curvature.max() <= 1.05 * BEND_SHARE * robot.curvature_max
    # Up to 3 mm before the tip, whose closed end comes nearer than the robot's radius.
    inner = guide.points[guide.arc_length < guide.length - 3.0]
    assert tree.wall.clearance(inner).min() > robot.radius


@pytest.fixture(scope="module")
def planned(made_airway: Any) -> Any:
    robot, tree = Robot(), made_airway.tree
    target = branch_target(tree, GOAL, robot)
    return plan_way(tree, tree.entrance_for(robot), target, robot, PlannerSettings(), rng=np.random.default_rng(7)).plan


def test_the_texts_route_is_planned_without_touching_the_wall(planned: Any, made_airway: Any) -> None:
    assert planned.reached
    assert planned.tip_error < 1.0
    assert len(planned.stages) == 6  # as the text cuts it
    for step in planned.steps:
        assert step.body_clearance >= 0.0
        assert step.disc_clearance >= 0.0
        # The stated least clearances hold at places the planner did not look at.
        dense = np.concatenate([np.linspace(a, b, 5) for a, b in zip(step.body[:-1], step.body[1:], strict=True)])
        # A chord of 1 mm leaves an arc of radius 8.3 mm by 0.015 mm.
        assert made_airway.tree.wall.clearance(dense).min() >= Robot().radius - 0.02


def test_the_cost_is_what_is_left_to_the_sub_goals_where_stages_end(planned: Any) -> None:
    away = planned.subgoal_distances
    assert None not in away
    assert away[-1] == pytest.approx(planned.tip_error)
    for number, (stage, distance) in enumerate(zip(planned.stages[:-1], away[:-1], strict=True)):
        end = [step for step, at in zip(planned.steps, planned.step_stages, strict=True) if at <= number][-1]
        assert distance == pytest.approx(float(np.linalg.norm(end.tip[:3, 3] - stage.goal)))
        # A stage ends beside its sub-goal: within the sphere of samples, or at most a push's millimetre beyond it.
        assert distance < stage.radius + 1.0
    short = replace(planned, steps=planned.steps[:4], step_stages=planned.step_stages[:4])
    assert short.subgoal_distances[-1] is None


def test_the_same_seed_gives_the_same_plan(planned: Any, made_airway: Any) -> None:
    robot, tree = Robot(), made_airway.tree
    target = branch_target(tree, GOAL, robot)
    again = plan_way(tree, tree.entrance_for(robot), target, robot, PlannerSettings(), rng=np.random.default_rng(7)).plan
    assert [step.command for step in again.steps] == [step.command for step in planned.steps]


def test_plain_rrt_finds_nothing_with_ten_times_the_pushes(planned: Any, made_airway: Any) -> None:
    robot, tree = Robot(), made_airway.tree
    mover = KinematicMover(tree.wall, robot, tree.entrance_for(robot).pose)
    pushes = 10 * sum(tally.pushes for tally in planned.tallies)
    goal = np.asarray(branch_target(tree, GOAL, robot).point)
    outcome = plan_plain(
        mover, robot, tree.wall.surface.bounds, goal, pushes=min(pushes, 200), tolerance=2.5, rng=np.random.default_rng(0)
    )
    assert not outcome.reached
    assert outcome.poses > 20  # it does grow


def test_a_run_passes_its_verification(robot_run: Path) -> None:
    verification = verify_run(robot_run)
    assert [check.sentence for check in verification.faults] == []
    assert {"states: body to wall", "tips: from the commands", "disc: no collision at the end"} <= {
        check.name for check in verification.checks
    }


def test_the_run_folder_holds_the_actuation_and_the_states(robot_run: Path) -> None:
    result = json.loads((robot_run / "result.json").read_text())
    assert result["status"] == "ok"
    assert result["metrics"]["tip_error_mm"] < 1.0
    steps = result["details"]["steps"]
    rows = list(csv.DictReader((robot_run / "actuation.csv").read_text().splitlines()))
    assert len(rows) == len(steps)
    assert max(np.diff(result["path"]["s_mm"])) <= 0.25 + 1e-9
    page = (robot_run / "report.html").read_text()
    assert "Research use, not for clinical decisions" in page
    stages = json.loads((robot_run / "result.json").read_text())["details"]["stages"]
    assert page.count('src="data:image/jpeg;base64,') == len(stages) + 1  # what the tip sees: the start, each stage's end
    assert (robot_run / "recording.rrd").stat().st_size > 10_000


def test_planted_faults_are_found(robot_run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(robot_run, folder)
    result = json.loads((folder / "result.json").read_text())
    steps = result["details"]["steps"]
    steps[-3]["command"]["phi_proximal_deg"] -= 4.0
    steps[-2]["disc_clearance_mm"] += 0.2
    result["details"]["robot"]["bend_max_deg"] = 30.0
    result["metrics"]["tip_error_mm"] *= 0.5
    result["details"]["stages"][1]["subgoal_distance_mm"] += 0.01
    (folder / "result.json").write_text(json.dumps(result))
    rows = (folder / "states.csv").read_text().splitlines()
    last = rows[-8].split(",")  # a place of the last state is moved out of the lumen
    rows[-8] = ",".join([last[0], str(float(last[1]) + 6.0), *last[2:]])
    (folder / "states.csv").write_text("\n".join(rows) + "\n")
    expected = {
        "tips: from the commands",
        "actuation.csv",
        "disc: clearance",
        "actuation: bends",
        "tip: at the target",
        "stages: distances to the sub-goals",
        "states: whole",
        "states: body to wall",
        "files: digests",
    }
    assert expected <= {check.name for check in verify_run(folder).faults}


def test_case_toml_gives_the_same_run(robot_run: Path, tmp_path: Path) -> None:
    assert (
        status_of(["run", str(robot_run / "case.toml"), "-o", str(tmp_path / "again"), "-q", "--no-report", "--no-recording"])
        == 0
    )
    one, two = (json.loads((folder / "result.json").read_text()) for folder in (robot_run, tmp_path / "again"))
    for key in ("path", "metrics", "limits"):
        assert one[key] == two[key]
    assert one["details"]["steps"] == two["details"]["steps"]


def test_reach_refuses_only_with_a_proof(made_airway: Any) -> None:
    # A robot of 6 mm enters the lobes of 8.3 mm but no segment of 5.6 mm, and that is proved.
    tree = made_airway.tree
    robot = Robot(diameter=6.0)
    found = reach_map(tree, tree.entrance_for(robot), robot, PlannerSettings(time_budget=3.0))
    for branch, judged in zip(tree.branches, found, strict=True):
        if branch.generation <= 1:
            assert judged.verdict is Verdict.REACHED, branch.name
        if branch.generation >= 3:
            assert judged.verdict is Verdict.DIAMETER, branch.name
            assert judged.bound is not None
            assert judged.bound < robot.radius


def test_a_target_outside_the_airway_is_refused_with_an_offer(made_airway: Any) -> None:
    tree, robot = made_airway.tree, Robot()
    inside = branch_target(tree, GOAL, robot).point
    outside = inside + np.array([0.0, 12.0, 0.0])
    with pytest.raises(CaseError, match=r"lies \d+\.\d mm outside the airway; the nearest reachable place is .* in right"):
        point_target(tree, outside, robot)
    lesion = lesion_target(tree, outside, robot)
    assert np.linalg.norm(lesion.point - outside) <= 12.0 + 1e-6
    assert lesion.note is not None


def test_an_unknown_branch_is_refused_with_a_list(made_airway: Any) -> None:
    with pytest.raises(CaseError, match="no branch or end point 'E99'; it has trachea"):
        branch_target(made_airway.tree, "E99", Robot())


def test_a_robot_wider_than_a_branch_is_no_path(made_airway: Any) -> None:
    with pytest.raises(NoPathError, match="the nearest reachable place is"):
        branch_target(made_airway.tree, GOAL, Robot(diameter=7.0))


def test_an_airway_narrower_than_the_robot_at_the_entrance_is_refused(made_airway: Any) -> None:
    with pytest.raises(CaseError, match="does not fit straight into the airway at E1, which is at most 18"):
        made_airway.tree.entrance_for(Robot(diameter=19.0))


def test_the_command_ends_with_one_sentence(made_airway: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = ["plan", "bronchoscope", "--mesh", str(made_airway.file), "-o", str(tmp_path / "x"), "-q", "--method", "kinematic"]
    assert status_of([*common, "--goal", "nowhere"]) == 2
    assert status_of(common) == 2
    assert status_of([*common, "--goal", GOAL, "--diameter", "7"]) == 4
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 3
    assert "exactly one of them" in said[1]
    assert not (tmp_path / "x").exists()


def test_without_mujoco_the_dynamic_method_says_what_to_install(made_airway: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(way_module, "find_spec", lambda name: None if name == "mujoco" else real(name))
    with pytest.raises(CaseError, match=r'pip install "tubeplan\[dynamics\]"'):
        make_simulator(made_airway.tree, made_airway.tree.entrance_for(Robot()), Robot())
