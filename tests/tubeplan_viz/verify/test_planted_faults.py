"""Every fault planted in a run is found, named, and nothing else is."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from segmentation.mesh import Surface
from segmentation.mesh_files import read_ply, write_ply
from tubeplan_viz.plan import Limits, PlanStatus
from tubeplan_viz.result import RunFolderError, file_sha256, result_text, slicer_markups
from tubeplan_viz.verify import Verification, verify_run

Change = Callable[[dict[str, Any]], None]


def faults(folder: Path) -> set[str]:
    return {check.name for check in verify_run(folder).faults}


def text_of(verification: Verification, name: str) -> str:
    return next(check for check in verification.checks if check.name == name).text


def sign_again(folder: Path) -> None:
    """Make the digests those of the files as they are: a fault must be found by its own check."""
    result = json.loads((folder / "result.json").read_text())
    for entry in result["provenance"]["outputs"]:
        entry["sha256"] = file_sha256(folder / entry["name"])
    (folder / "result.json").write_text(result_text(result))


def lie(folder: Path, change: Change) -> None:
    """Change result.json, and the page, the markups and the table with it."""
    report = folder / "report.html"
    result = json.loads((folder / "result.json").read_text())
    outputs = result["provenance"].pop("outputs")
    before = copy.deepcopy(result)
    change(result)
    assert result != before
    page = report.read_text()
    head, mark, _ = page.partition('<script type="application/json" id="tubeplan-result">')
    for key, old, new in changed_numbers(before, result):
        head = head.replace(f'value="{json.dumps(old)}" data-key="{key}"', f'value="{json.dumps(new)}" data-key="{key}"')
    report.write_text(head + mark + json.dumps(result).replace("<", "\\u003c") + "</script>")
    (folder / "path.mrk.json").write_text(json.dumps(slicer_markups(result)))
    rows = [line.split(",") for line in (folder / "path.csv").read_text().splitlines()]
    path = result["path"]
    for row, s, point, curvature, clearance in zip(
        rows[1:], path["s_mm"], path["points_mm"], path["curvature_per_mm"], path["clearance_mm"], strict=True
    ):
        row[0:4], row[7], row[9] = [repr(s), *map(repr, point)], repr(curvature), repr(clearance)
    (folder / "path.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    result["provenance"]["outputs"] = outputs
    (folder / "result.json").write_text(result_text(result))
    sign_again(folder)


def changed_numbers(before: Any, after: Any, key: str = "") -> list[tuple[str, Any, Any]]:
    if isinstance(before, dict):
        return [
            row
            for name in before.keys() & after.keys()
            for row in changed_numbers(before[name], after[name], f"{key}.{name}".strip("."))
        ]
    return [(key, before, after)] if before != after else []


def test_clean_run_holds(clean_run: Path) -> None:
    verification = verify_run(clean_run)
    assert verification.faults == ()
    assert verification.holds
    assert len(verification.checks) > 30


def test_flagged_run_holds_since_its_flags_are_true(flagged_run: Path) -> None:
    verification = verify_run(flagged_run)
    assert verification.faults == ()
    flags = json.loads((flagged_run / "result.json").read_text())["flagged_intervals"]
    assert {flag["kind"] for flag in flags} == {"curvature", "clearance"}


def test_run_in_patient_axes_holds(bent_tube: Any, tmp_path: Path, writer: Any) -> None:
    writer(
        tmp_path / "run", bent_tube.plan(Limits(curvature_max=0.09, clearance_min=2.2)), replace(bent_tube.surface, frame="LPS")
    )
    assert verify_run(tmp_path / "run").faults == ()


def test_closed_ends_count_as_wall(bent_tube: Any, tmp_path: Path, writer: Any) -> None:
    plan = bent_tube.plan(Limits(curvature_max=0.09, clearance_min=2.2), closed_ends=True)
    assert plan.profile.clearance[0] == pytest.approx(0.0, abs=1e-9)  # the path begins on a cap
    writer(tmp_path / "run", plan, bent_tube.surface)
    assert verify_run(tmp_path / "run").faults == ()
    lie(tmp_path / "run", lambda result: result["details"].update(closed_ends=False))
    assert "path: clearance" in faults(tmp_path / "run")


def test_breach_of_a_tenth_of_a_mm_between_samples(bent_tube: Any, tmp_path: Path, writer: Any) -> None:
    # A needle of wall reaches to 0.02 mm from the path midway between two samples, which see it 0.125 mm away along the path.
    profile = bent_tube.plan(Limits(curvature_max=0.09, clearance_min=0.0)).profile
    k = len(profile.arc_length) // 2
    middle = bent_tube.curve(bent_tube.curve.parameter([0.5 * (profile.arc_length[k] + profile.arc_length[k + 1])]))[0]
    vertices = np.array(bent_tube.surface.vertices)
    wall = np.unique(bent_tube.surface.wall_faces)
    across = vertices[wall] - middle
    along = np.abs(across @ profile.tangents[k])
    nearest = wall[np.argmin(along)]
    away = vertices[nearest] - middle
    vertices[nearest] = middle + 0.02 * away / np.linalg.norm(away)
    spiked = replace(bent_tube.surface, vertices=vertices)
    tube = replace(bent_tube, surface=spiked)
    seen = tube.plan(Limits(curvature_max=0.09, clearance_min=0.0)).profile.clearance.min()
    assert seen > 0.12 - 0.02
    plan = tube.plan(Limits(curvature_max=0.09, clearance_min=float(seen)))
    blind = replace(
        plan,
        status=PlanStatus.OK,
        reason=None,
        flagged=(),
        certificate=replace(plan.certificate, holds=True, clearance_lower_bound=float(seen)),
        metrics={**plan.metrics, "clearance_min_mm": float(plan.profile.clearance.min())},
    )
    writer(tmp_path / "run", blind, spiked)
    found = verify_run(tmp_path / "run")
    assert {check.name for check in found.faults} == {
        "status",
        "metrics: clearance_min_mm",
        "flagged intervals: clearance",
        "certificate: bounds",
    }
    assert "BREAKS A LIMIT" in text_of(found, "status")
    least = next(check for check in found.checks if check.name == "metrics: clearance_min_mm").expected
    assert float(least.split()[0]) <= 0.02 + 1e-6


def test_two_percent_too_much_curvature(bent_tube: Any, tmp_path: Path, writer: Any) -> None:
    plan = bent_tube.plan(Limits(curvature_max=0.09, clearance_min=2.2))
    limit = plan.metrics["curvature_max_per_mm"] / 1.02
    writer(tmp_path / "run", plan, bent_tube.surface)

    def understate(result: dict[str, Any]) -> None:
        result["limits"]["curvature_max_per_mm"] = limit
        result["path"]["curvature_per_mm"] = [value / 1.02 for value in result["path"]["curvature_per_mm"]]
        for table, key in (("metrics", "curvature_max_per_mm"), ("metrics", "curvature_mean_per_mm")):
            result[table][key] /= 1.02
        result["certificate"]["curvature_upper_bound_per_mm"] = limit

    lie(tmp_path / "run", understate)
    assert faults(tmp_path / "run") >= {
        "status",
        "path: curvature",
        "metrics: curvature_max_per_mm",
        "flagged intervals: curvature",
        "certificate: bounds",
    }


def test_ok_with_a_broken_limit(flagged_run: Path) -> None:
    def praise(result: dict[str, Any]) -> None:
        result.update(status="ok", reason=None, flagged_intervals=[])

    lie(flagged_run, praise)
    found = verify_run(flagged_run)
    assert {"status", "flagged intervals: clearance", "flagged intervals: curvature"} <= {check.name for check in found.faults}
    assert text_of(found, "status").startswith("THE PATH BREAKS A LIMIT")


def test_flagged_without_a_broken_limit(clean_run: Path) -> None:
    def blame(result: dict[str, Any]) -> None:
        flag = {
            "kind": "clearance",
            "from_mm": 5.0,
            "to_mm": 6.0,
            "worst": result["path"]["clearance_mm"][22],
            "worst_at_mm": 5.5,
        }
        result.update(status="flagged", reason="a stretch breaks its limit", flagged_intervals=[flag])

    lie(clean_run, blame)
    assert {"status", "flagged intervals: clearance"} <= faults(clean_run)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda flags: flags.pop(0), "flagged intervals: clearance"),
        (lambda flags: flags.pop(1), "flagged intervals: curvature"),
        (lambda flags: flags[0].update(from_mm=flags[0]["from_mm"] + 0.1), "flagged intervals: clearance"),
        (lambda flags: flags[0].update(to_mm=flags[0]["to_mm"] + 0.1), "flagged intervals: clearance"),
        (lambda flags: flags[1].update(kind="clearance"), "flagged intervals: curvature"),
        (lambda flags: flags[0].update(worst=flags[0]["worst"] + 0.02), "flagged intervals: worst values"),
    ],
    ids=["clearance dropped", "curvature dropped", "begins 0.1 mm late", "ends 0.1 mm late", "other kind", "worst value better"],
)
def test_wrong_flags(flagged_run: Path, change: Callable[[list[dict[str, Any]]], object], expected: str) -> None:
    def mislabel(result: dict[str, Any]) -> None:
        change(result["flagged_intervals"])

    lie(flagged_run, mislabel)
    assert expected in faults(flagged_run)


def moved_mesh(folder: Path, change: Callable[[Surface], Surface]) -> None:
    write_ply(change(read_ply(folder / "mesh.ply")), folder / "mesh.ply")
    sign_again(folder)


def test_shifted_frame_of_the_mesh(clean_run: Path) -> None:
    moved_mesh(clean_run, lambda surface: replace(surface, vertices=np.array(surface.vertices) + np.array([0.0, 0.5, 0.0])))
    assert {"path: clearance", "metrics: clearance_min_mm"} <= faults(clean_run)


def test_mirrored_frame_of_the_path_is_outside(clean_run: Path) -> None:
    def to_ras(result: dict[str, Any]) -> None:
        for points in (result["path"]["points_mm"], result["spline"]["control_points_mm"], result["centerline"]["points_mm"]):
            points[:] = [[-x, -y, z] for x, y, z in points]
        for feature in result["feature_points"]:
            feature["point_mm"] = [-feature["point_mm"][0], -feature["point_mm"][1], feature["point_mm"][2]]

    lie(clean_run, to_ras)
    found = verify_run(clean_run)
    assert {"unit: path", "unit: spline", "path: inside the lumen", "ends: start", "ends: goal"} <= {
        check.name for check in found.faults
    }
    assert "another frame" in text_of(found, "unit: path")


def test_other_frame_tag(clean_run: Path) -> None:
    lie(clean_run, lambda result: result.update(frame="LPS"))
    assert faults(clean_run) == {"frame"}


def test_mesh_with_another_frame_comment(clean_run: Path) -> None:
    moved_mesh(clean_run, lambda surface: replace(surface, frame="LPS"))
    assert faults(clean_run) == {"frame"}


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "metres"), (0.1, "centimetres"), (1.0 / 25.4, "inches")])
def test_spline_in_another_unit_is_named(clean_run: Path, factor: float, unit: str) -> None:
    def rescale(result: dict[str, Any]) -> None:
        control = result["spline"]["control_points_mm"]
        control[:] = [[factor * value for value in point] for point in control]

    lie(clean_run, rescale)
    found = verify_run(clean_run)
    assert {"unit: spline", "path: on the spline", "metrics: length_mm"} <= {check.name for check in found.faults}
    assert unit in text_of(found, "unit: spline")


def test_spline_in_micrometres_is_not_sampled_for_ever(clean_run: Path) -> None:
    lie(
        clean_run,
        lambda result: result["spline"].update(
            control_points_mm=[[1e3 * v for v in p] for p in result["spline"]["control_points_mm"]]
        ),
    )
    found = verify_run(clean_run)
    assert {"unit: spline", "path: measured"} <= {check.name for check in found.faults}
    assert "micrometres" in text_of(found, "unit: spline")


def test_mesh_in_metres_is_named(clean_run: Path) -> None:
    moved_mesh(clean_run, lambda surface: replace(surface, vertices=np.array(surface.vertices) / 1000.0))
    found = verify_run(clean_run)
    size = next(check for check in found.faults if check.name == "unit: size of the mesh")
    assert "metres" in size.found


def test_swapped_mesh(clean_run: Path, bent_tube: Any) -> None:
    # The same tube, meshed with its wall 2 % wider: everything fits but the clearances.
    def widen(surface: Surface) -> Surface:
        middle = bent_tube.centerline.points
        nearest = np.argmin(np.linalg.norm(np.array(surface.vertices)[:, None] - middle[None], axis=2), axis=1)
        vertices = middle[nearest] + 1.02 * (np.array(surface.vertices) - middle[nearest])
        vertices[np.unique(surface.faces[surface.face_cap >= 0])] = surface.vertices[
            np.unique(surface.faces[surface.face_cap >= 0])
        ]
        return replace(surface, vertices=vertices)

    moved_mesh(clean_run, widen)
    assert {"path: clearance", "metrics: clearance_min_mm", "metrics: clearance_mean_mm"} <= faults(clean_run)


def test_open_mesh(clean_run: Path) -> None:
    surface = read_ply(clean_run / "mesh.ply")
    raw = (clean_run / "mesh.ply").read_bytes()
    faces = len(surface.faces)
    (clean_run / "mesh.ply").write_bytes(
        raw.replace(f"element face {faces}\n".encode(), f"element face {faces - 1}\n".encode())[:-13]
    )
    sign_again(clean_run)
    assert faults(clean_run) == {"mesh: closed", "mesh: caps", "surface: volume"}


def test_wall_declared_to_be_a_cap(clean_run: Path) -> None:
    def declare(result: dict[str, Any]) -> None:
        surface = result["details"]["surface"]
        surface["wall_faces"] -= 400
        surface["caps"][0]["first_face"] -= 400
        surface["caps"][0]["faces"] += 400

    lie(clean_run, declare)
    assert "mesh: caps" in faults(clean_run)


def test_wall_declared_to_be_a_flat_end_with_its_area(clean_run: Path) -> None:
    mesh = read_ply(clean_run / "mesh.ply")

    def declare(result: dict[str, Any]) -> None:
        surface = result["details"]["surface"]
        surface["wall_faces"] -= 10
        cap = surface["caps"][0]
        first = cap["first_face"] - 10
        cap.update(
            first_face=first, faces=cap["faces"] + 10, area_mm2=float(mesh.face_areas[first : first + cap["faces"] + 10].sum())
        )

    lie(clean_run, declare)
    found = verify_run(clean_run)
    assert "mesh: caps" in {check.name for check in found.faults}
    assert "off its plane" in next(check for check in found.faults if check.name == "mesh: caps").found


def test_limits_other_than_those_asked_for(clean_run: Path) -> None:
    case = (clean_run / "case.toml").read_text()
    (clean_run / "case.toml").write_text(case + "[limits]\ncurvature_max = 0.09\nclearance_min = 2.2\n")
    sign_again(clean_run)
    assert faults(clean_run) == set()
    lie(clean_run, lambda result: result["limits"].update(clearance_min_mm=2.1))
    found = verify_run(clean_run)
    assert "limits" in {check.name for check in found.faults}
    assert next(check for check in found.faults if check.name == "limits").expected == "2.2 in case.toml"


def test_path_that_leaves_the_lumen(bent_tube: Any, tmp_path: Path, writer: Any) -> None:
    # The wall is moved 4 mm down around the middle of the path: its flags are true, yet no instrument can go there.
    vertices = np.array(bent_tube.surface.vertices)
    middle = bent_tube.curve([0.5])[0]
    vertices[:, 2] -= 4.0 * np.exp(-(np.linalg.norm(vertices - middle, axis=1) ** 2) / 20.0)
    tube = replace(bent_tube, surface=replace(bent_tube.surface, vertices=vertices))
    tube = replace(tube, centerline=replace(tube.centerline, points=tube.centerline.points[:8], radii=tube.centerline.radii[:8]))
    plan = tube.plan(Limits(curvature_max=0.09, clearance_min=2.2))
    assert plan.profile.clearance.min() < -0.1
    writer(tmp_path / "flagged", plan, tube.surface)
    assert faults(tmp_path / "flagged") == {"path: inside the lumen"}
    writer(tmp_path / "none", replace(plan, status=PlanStatus.INFEASIBLE, reason="the lumen turns away"), tube.surface)
    assert faults(tmp_path / "none") == set()


def test_outcome_without_a_path(clean_run: Path) -> None:
    result = json.loads((clean_run / "result.json").read_text())
    nothing = dict.fromkeys(["path", "spline", "centerline", "feature_points", "certificate", "iterations"])
    result.update(nothing, status="infeasible", reason="the lumen is closed", metrics=dict.fromkeys(result["metrics"]))
    (clean_run / "result.json").write_text(result_text(result))
    found = verify_run(clean_run)
    assert found.holds
    assert [check.name for check in found.checks] == ["schema", "files: digests", "status"]


@pytest.mark.parametrize("name", ["rigid", "bronchoscope", "needle3d"])
def test_another_planner_than_the_cases(clean_run: Path, name: str) -> None:
    lie(clean_run, lambda result: result["planner"].update(name=name))
    assert faults(clean_run) == {"planner"}


def test_moved_start(clean_run: Path) -> None:
    case = (clean_run / "case.toml").read_text()
    start = json.loads(case.split("start = ")[1].split("\n")[0])
    (clean_run / "case.toml").write_text(case.replace(json.dumps(start), json.dumps([start[0] + 0.001, start[1], start[2]])))
    sign_again(clean_run)
    assert faults(clean_run) == {"ends: start", "settings"}


def test_goal_given_as_a_label(clean_run: Path) -> None:
    case = (clean_run / "case.toml").read_text()
    (clean_run / "case.toml").write_text(case.split("goal = ")[0] + "goal = 'E2'\n")

    def label(place: list[float]) -> Change:
        def change(result: dict[str, Any]) -> None:
            result["details"]["endpoints"] = [{"label": "E2", "point_mm": place}]
            result["provenance"]["settings"]["planner"]["goal"] = "E2"

        return change

    goal = json.loads((clean_run / "result.json").read_text())["path"]["points_mm"][-1]
    lie(clean_run, label(goal))
    assert faults(clean_run) == set()
    lie(clean_run, label([goal[0], goal[1] + 0.5, goal[2]]))
    assert faults(clean_run) == {"ends: goal"}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda r: r["path"]["points_mm"][40].__setitem__(0, r["path"]["points_mm"][40][0] + 1e-3), {"path: on the spline"}),
        (lambda r: r["path"]["curvature_per_mm"].__setitem__(60, r["path"]["curvature_per_mm"][60] + 1e-5), {"path: curvature"}),
        (lambda r: r["path"]["clearance_mm"].__setitem__(60, r["path"]["clearance_mm"][60] + 1e-5), {"path: clearance"}),
        (lambda r: r["metrics"].update(length_mm=r["metrics"]["length_mm"] + 0.01), {"metrics: length_mm"}),
        (lambda r: r["metrics"].update(clearance_min_mm=r["metrics"]["clearance_min_mm"] + 0.02), {"metrics: clearance_min_mm"}),
        (
            lambda r: r["metrics"].update(clearance_mean_mm=r["metrics"]["clearance_mean_mm"] + 0.05),
            {"metrics: clearance_mean_mm"},
        ),
        (lambda r: r["metrics"].update(curvature_mean_per_mm=0.03), {"metrics: curvature_mean_per_mm"}),
        (lambda r: r["metrics"].update(centerline_distance_mean_mm=0.1), {"metrics: centerline_distance_mean_mm"}),
        (lambda r: r["certificate"].update(holds=False), {"certificate: holds"}),
        (lambda r: r["certificate"].update(clearance_lower_bound_mm=2.6), {"certificate: bounds"}),
        (lambda r: r["feature_points"][1].update(s_mm=r["feature_points"][1]["s_mm"] + 0.1), {"feature points"}),
        (lambda r: r["centerline"]["points_mm"][5].__setitem__(2, 150.0), {"centerline: inside the lumen"}),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, set) else None,
)
def test_one_wrong_number(clean_run: Path, change: Change, expected: set[str]) -> None:
    lie(clean_run, change)
    found = faults(clean_run)
    assert expected <= found
    # What is derived from the number may differ too; the page and the table were changed along.
    assert not {"path.csv: same numbers", "path.mrk.json: curve", "report.html: embedded result", "files: digests"} & found


def test_edited_number_in_the_page(clean_run: Path) -> None:
    page = (clean_run / "report.html").read_text()
    for old, new, word in [
        (
            'data-key="metrics.clearance_min_mm">2.58<',
            'data-key="metrics.clearance_min_mm">2.59<',
            "printed as 2.59 instead of 2.58",
        ),
        (
            'value="2.2" data-key="limits.clearance_min_mm"',
            'value="2.1" data-key="limits.clearance_min_mm"',
            "2.1 instead of 2.2",
        ),
        ('data-key="spline.control_points_mm.0.1">\u2212', 'data-key="spline.control_points_mm.0.1">-', "no plain number"),
        ('data-key="derived:margin_mm"', 'data-key="derived:margins_mm"', "cannot be checked"),
        (
            'data-key="derived:bend_radius_mm">13',
            'data-key="derived:bend_radius_mm">14',
            "derived:bend_radius_mm is printed as 14",
        ),
    ]:
        assert old in page
        (clean_run / "report.html").write_text(page.replace(old, new))
        sign_again(clean_run)
        found = verify_run(clean_run)
        assert {check.name for check in found.faults} == {"report.html: numbers"}
        assert word in found.faults[0].found


def test_page_without_its_figures(clean_run: Path) -> None:
    page = (clean_run / "report.html").read_text()
    (clean_run / "report.html").write_text(page.replace('class="v"', 'class="w"'))
    sign_again(clean_run)
    assert faults(clean_run) == {"report.html: complete"}


def test_edited_embedded_result(clean_run: Path) -> None:
    page = (clean_run / "report.html").read_text()
    (clean_run / "report.html").write_text(page.replace('"status": "ok"', '"status": "OK"'))
    sign_again(clean_run)
    found = verify_run(clean_run)
    assert {check.name for check in found.faults} == {"report.html: embedded result"}
    assert "Found OK instead of ok at status; expected one, equal to result.json." in found.faults[0].sentence
    assert all(check.sentence == check.text for check in found.checks if check.ok)


@pytest.mark.parametrize(
    ("column", "expected"),
    [(3, "path.csv: same numbers"), (9, "path.csv: same numbers"), (4, "path.csv: tangents"), (8, "path.csv: torsion")],
)
def test_edited_table(clean_run: Path, column: int, expected: str) -> None:
    lines = (clean_run / "path.csv").read_text().splitlines()
    cells = lines[90].split(",")
    cells[column] = repr(float(cells[column]) + 1e-3)
    lines[90] = ",".join(cells)
    (clean_run / "path.csv").write_text("\n".join(lines) + "\n")
    sign_again(clean_run)
    assert faults(clean_run) == {expected}


def test_edited_markups(clean_run: Path) -> None:
    markups = json.loads((clean_run / "path.mrk.json").read_text())
    moved = copy.deepcopy(markups)
    moved["markups"][0]["controlPoints"][3]["position"][1] += 0.01
    (clean_run / "path.mrk.json").write_text(json.dumps(moved))
    sign_again(clean_run)
    assert faults(clean_run) == {"path.mrk.json: curve"}
    moved = copy.deepcopy(markups)
    del moved["markups"][1]["controlPoints"][1]
    (clean_run / "path.mrk.json").write_text(json.dumps(moved))
    sign_again(clean_run)
    assert faults(clean_run) == {"path.mrk.json: features"}
    moved = copy.deepcopy(markups)
    moved["markups"][0]["coordinateSystem"] = "RAS"
    (clean_run / "path.mrk.json").write_text(json.dumps(moved))
    sign_again(clean_run)
    assert faults(clean_run) == {"frame"}


@pytest.mark.parametrize("name", ["case.toml", "path.csv", "path.mrk.json", "mesh.ply", "report.html"])
def test_missing_damaged_or_changed_file(clean_run: Path, name: str) -> None:
    whole = (clean_run / name).read_bytes()
    (clean_run / name).write_bytes(whole + b"\n ")
    assert "files: digests" in faults(clean_run)
    (clean_run / name).write_bytes(b"\xff\xfe\x00 no such thing")
    assert {"files: digests"} < faults(clean_run)
    (clean_run / name).unlink()
    found = verify_run(clean_run)
    assert {"files: digests"} < {check.name for check in found.faults}
    assert any(name in check.name + check.text for check in found.faults if check.name != "files: digests")


def test_added_file(clean_run: Path) -> None:
    (clean_run / "notes.txt").write_text("seen")
    assert faults(clean_run) == {"files: digests"}


def test_run_without_report_holds(clean_run: Path) -> None:
    (clean_run / "report.html").unlink()
    result = json.loads((clean_run / "result.json").read_text())
    result["provenance"]["outputs"] = [entry for entry in result["provenance"]["outputs"] if entry["name"] != "report.html"]
    (clean_run / "result.json").write_text(result_text(result))
    assert faults(clean_run) == set()


def test_result_that_breaks_its_schema(clean_run: Path) -> None:
    result = json.loads((clean_run / "result.json").read_text())
    del result["limits"]["clearance_min_mm"]
    (clean_run / "result.json").write_text(result_text(result))
    found = verify_run(clean_run)
    assert [check.name for check in found.faults] == ["schema"]
    assert "clearance_min_mm" in found.faults[0].text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no result.json"),
        ("{", "no JSON"),
        ('{"a": NaN}', "NaN"),
        ('{"a": 1, "a": 2}', "stands twice"),
        ("[1]", "no table"),
    ],
)
def test_folder_that_is_no_run(tmp_path: Path, content: str | None, words: str) -> None:
    if content is not None:
        (tmp_path / "result.json").write_text(content)
    with pytest.raises(RunFolderError, match=words):
        verify_run(tmp_path)


def test_run_can_be_moved(clean_run: Path, tmp_path: Path) -> None:
    shutil.move(clean_run, tmp_path / "elsewhere")
    found = verify_run(tmp_path / "elsewhere")
    assert found.holds
    assert found.run == "elsewhere"
    rows = found.as_dict()["checks"]
    assert json.loads(json.dumps(rows)) == rows
