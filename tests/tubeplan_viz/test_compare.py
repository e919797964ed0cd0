"""Runs side by side: figures, marks, what may be overlaid, the page, the recording and the command."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports import derived_values, render_comparison, write_page
from reports.numbers import printed
from segmentation.mesh import Surface
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.recording import record_comparison
from tubeplan_viz.result import Comparison, RunFolderError, compare_runs, read_runs
from tubeplan_viz.result.comparison import better_of

DATA = re.compile(r'<data class="v" value="([^"]*)" data-key="([^"]*)">([^<]*)</data>')


@pytest.fixture(scope="module")
def comparison(made_runs: Path) -> Comparison:
    """Two runs of one path in one tube, held against generous and against tight limits."""
    return compare_runs(read_runs([made_runs / "clean", made_runs / "flagged"]))


@pytest.fixture(scope="module")
def moved_run(made_runs: Path, bent_tube: Any, writer: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in the same tube, moved by 5 mm: its mesh is another one."""
    from dataclasses import replace

    from tubeplan_viz.geometry import SplineCurve
    from tubeplan_viz.plan import Limits

    shift = np.array([5.0, 0.0, 0.0])
    old = bent_tube.surface
    surface = Surface(old.vertices + shift, old.faces, old.face_cap, old.caps, old.frame)
    curve = SplineCurve(3, bent_tube.curve.knots, bent_tube.curve.control_points + shift)
    tube = replace(bent_tube, surface=surface, curve=curve)
    folder = tmp_path_factory.mktemp("moved") / "moved"
    writer(folder, tube.plan(Limits(curvature_max=0.09, clearance_min=2.2)), surface)
    return folder


def at(document: Any, key: str) -> Any:
    run = re.fullmatch(r"runs\.(\d+)\.(derived:.*)", key)
    if run:
        return derived_values(document["runs"][int(run[1])])[run[2]]
    for name in key.split("."):
        document = document[int(name)] if isinstance(document, list) else document[name]
    return document


def test_every_marked_figure_stands_in_compare_json_and_is_printed_as_it_rounds(comparison: Comparison) -> None:
    found = DATA.findall(render_comparison(comparison))
    assert len(found) > 60
    for value, key, text in found:
        exact = at(comparison.document, key)
        assert json.loads(value) == exact, key
        digits = len(text.partition(".")[2])
        assert text.lstrip("+") == printed(exact, digits).lstrip("+"), key


def test_the_page_embeds_compare_json_and_refers_to_nothing_outside(comparison: Comparison) -> None:
    page = render_comparison(comparison)
    embedded = re.search(r'<script type="application/json" id="tubeplan-compare">(.*?)</script>', page)
    assert embedded is not None
    assert json.loads(embedded[1]) == comparison.document
    assert not re.search(r'(?:src|href)="(?!#|data:)', page)


def test_rows_follow_from_the_results(comparison: Comparison) -> None:
    rows = {row["key"]: row for row in comparison.document["rows"]}
    clean, flagged = (run.result for run in comparison.runs)
    margins = [run["metrics"]["clearance_min_mm"] - run["limits"]["clearance_min_mm"] for run in (clean, flagged)]
    assert rows["margin_mm"]["values"] == margins
    assert rows["margin_mm"]["best"] == [0]  # the limit is 0.55 mm less on the same path
    assert rows["margin_mm"]["difference"] == [0.0, margins[1] - margins[0]]
    # One path in one tube: what does not depend on the limits is equal, and nothing is marked.
    for key in ("metrics.clearance_min_mm", "metrics.curvature_max_per_mm", "metrics.length_mm"):
        assert rows[key]["best"] == []
    short = sum(f["to_mm"] - f["from_mm"] for f in flagged["flagged_intervals"] if f["kind"] == "clearance")
    assert rows["flagged_clearance_mm"]["values"] == [0.0, pytest.approx(short)]
    assert rows["flagged_clearance_mm"]["best"] == [0]


def test_the_better_mark_stands_beside_the_better_figure_on_the_page(comparison: Comparison) -> None:
    page = render_comparison(comparison)
    rows = comparison.document["rows"]
    marked = set(re.findall(r'<td class="num better">.*?data-key="(rows\.\d+\.values\.\d+)"', page))
    assert marked == {f"rows.{k}.values.{n}" for k, row in enumerate(rows) for n in row["best"]}
    assert page.count('<span class="unseen">better: </span>') == len(marked)


@given(
    values=st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=6),
    better=st.sampled_from(["higher", "lower"]),
    digits=st.integers(0, 4),
)
def test_the_marked_values_print_better_than_all_others(values: list[float], better: str, digits: int) -> None:
    best = better_of(values, better, digits)
    seen = [float(f"{value:.{digits}f}") for value in values]
    if not best:
        assert len(set(seen)) == 1
        return
    chosen, rest = [seen[k] for k in best], [seen[k] for k in range(len(seen)) if k not in best]
    assert len(set(chosen)) == 1
    assert rest
    assert all(chosen[0] > other if better == "higher" else chosen[0] < other for other in rest)
    # The other direction marks others, since both cannot be best.
    assert not set(best) & set(better_of(values, "lower" if better == "higher" else "higher", digits))


def test_a_run_without_the_figure_leaves_the_row_unmarked() -> None:
    assert better_of([1.0, None, 2.0], "higher", 2) == []
    assert better_of([1.0, 2.0], "", 2) == []


def test_differing_settings_and_limits_are_named(comparison: Comparison) -> None:
    assert any("different limits" in note for note in comparison.document["notes"])
    named = {row["key"]: row["values"] for row in comparison.document["differences"]}
    assert all(len(set(map(str, values))) > 1 for values in named.values())


def test_runs_of_one_mesh_are_overlaid_and_runs_of_two_are_not(comparison: Comparison, made_runs: Path, moved_run: Path) -> None:
    assert comparison.overlaid
    apart = compare_runs(read_runs([made_runs / "clean", moved_run]))
    assert not apart.overlaid
    assert apart.surface is None
    assert "different meshes" in apart.document["overlay"]["reason"]
    page = render_comparison(apart)
    assert "not drawn into one picture" in page
    assert 'id="scene"' not in page
    assert 'id="scene"' in render_comparison(comparison)
    # The numbers are compared all the same.
    assert len(apart.document["rows"]) == len(comparison.document["rows"])


def test_a_needle_among_no_obstacles_is_compared_without_clearance(comparison: Comparison, tmp_path: Path) -> None:
    from dataclasses import replace

    from rerun.chunk import RrdReader

    first, second = comparison.runs
    bare = {
        **second.result,
        "path": {**second.result["path"], "clearance_mm": None},
        "metrics": {**second.result["metrics"], "clearance_min_mm": None, "clearance_mean_mm": None},
        "certificate": None,
        "flagged_intervals": [],
        "status": "ok",
        "reason": None,
    }
    both = compare_runs([first, replace(second, result=bare)])
    rows = {row["key"]: row for row in both.document["rows"]}
    assert rows["metrics.clearance_min_mm"]["values"][1] is None
    assert rows["metrics.clearance_min_mm"]["best"] == []
    assert "–" in render_comparison(both)
    record_comparison(both, tmp_path / "recording.rrd")
    entities = {chunk.entity_path for chunk in RrdReader(tmp_path / "recording.rrd").stream()}
    assert "/profiles/clearance/A" in entities
    assert "/profiles/clearance/B" not in entities
    assert "/profiles/curvature/B" in entities


def test_a_run_without_a_path_is_compared_and_not_drawn(comparison: Comparison, tmp_path: Path) -> None:
    from dataclasses import replace

    first, second = comparison.runs
    none = {
        **second.result,
        "path": None,
        "spline": None,
        "metrics": dict.fromkeys(second.result["metrics"]),
        "certificate": None,
        "flagged_intervals": [],
        "status": "infeasible",
        "reason": "start and goal are not joined",
    }
    both = compare_runs([first, replace(second, result=none)])
    assert "B has no path" in " ".join(both.document["notes"])
    page = render_comparison(both)
    assert "A holds, B finds no path" in page
    assert 'data-at="0"' in page
    assert 'data-at="1"' not in page
    record_comparison(both, tmp_path / "recording.rrd")
    assert (tmp_path / "recording.rrd").exists()


def test_charts_share_one_scale_and_each_curve_ends_at_its_own_length(comparison: Comparison) -> None:
    from reports.overlay import Line, Overlay, overlay_chart
    from reports.svg import LEFT, RIGHT, WIDTHS

    arcs = (np.linspace(0.0, 50.0, 201), np.linspace(0.0, 100.0, 401))
    lines = [
        Line(number=k, label="AB"[k], arc=arc, values=np.full(len(arc), 2.0 + k), limit=1.0, worst=())
        for k, arc in enumerate(arcs)
    ]
    for axis, ends in (("mm", (0.5, 1.0)), ("share", (1.0, 1.0))):
        drawing = overlay_chart(Overlay(kind="clearance", axis=axis, lines=lines, words="two"), WIDTHS[0], room="plot")
        curves = re.findall(r'class="run-line run-\d" d="M([^"]*)"', drawing)
        inner = WIDTHS[0].plot - LEFT - RIGHT
        for curve, end in zip(curves, ends, strict=True):
            assert float(curve.split("L")[-1].split()[0]) == pytest.approx(LEFT + end * inner, abs=0.06)  # printed to 0.1


def test_refusals_name_the_folder(made_runs: Path, tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match=r"clean is named twice"):
        read_runs([made_runs / "clean", made_runs / "flagged" / ".." / "clean"])
    with pytest.raises(RunFolderError, match=r"1 run folder given, expected 2 to 6"):
        read_runs([made_runs / "clean"])
    with pytest.raises(RunFolderError, match=rf"{tmp_path.name} is no tubeplan run"):
        read_runs([made_runs / "clean", tmp_path])


def test_folders_of_one_name_are_told_apart(made_runs: Path, tmp_path: Path) -> None:
    other = tmp_path / "later" / "clean"
    shutil.copytree(made_runs / "clean", other)
    names = [run.name for run in read_runs([made_runs / "clean", other])]
    assert names == [f"{made_runs.name}/clean", "later/clean"]


@pytest.fixture(scope="module")
def recorded(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("compared") / "recording.rrd"
    record_comparison(comparison, path)
    return path


def test_the_recording_holds_every_path_and_profile(recorded: Path, comparison: Comparison) -> None:
    from rerun.chunk import RrdReader

    reader = RrdReader(recorded)
    batches: dict[str, list[Any]] = {}
    timelines = set()
    for chunk in reader.stream():
        timelines |= set(chunk.timeline_names)
        batches.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
    assert timelines == {"arc_length", "share"}
    assert "/runs/wall" in batches
    for run in comparison.runs:
        path = run.result["path"]
        strips = batches[f"/runs/{run.label}/path"][0].column("LineStrips3D:strips").to_pylist()[0][0]
        # Drawn every 0.5 mm in single precision, with both ends.
        assert np.allclose([strips[0], strips[-1]], [path["points_mm"][0], path["points_mm"][-1]], atol=1e-4)
        for batch in batches[f"/profiles/clearance/{run.label}"]:
            if "arc_length" not in batch.schema.names:
                continue
            ticks = np.array(batch.column("arc_length").cast("int64").to_pylist()) / 10.0
            values = np.array([value[0] for value in batch.column("Scalars:scalars").to_pylist()])
            want = np.interp(ticks, path["s_mm"], path["clearance_mm"])
            # The last tick is rounded down to a tenth of a millimetre.
            assert np.allclose(values[:-1], want[:-1], atol=1e-9)
            assert values[-1] == path["clearance_mm"][-1]
            break
        else:
            raise AssertionError("no profile on the arc_length timeline")


def test_runs_of_two_meshes_have_a_wall_each_in_the_recording(made_runs: Path, moved_run: Path, tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    record_comparison(compare_runs(read_runs([made_runs / "clean", moved_run])), tmp_path / "recording.rrd")
    entities = {chunk.entity_path for chunk in RrdReader(tmp_path / "recording.rrd").stream()}
    assert {"/runs/A/wall", "/runs/B/wall"} <= entities
    assert "/runs/wall" not in entities


def test_the_command_writes_a_whole_folder_once(
    made_runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], comparison: Comparison
) -> None:
    target = tmp_path / "both"
    command = ["compare", str(made_runs / "clean"), str(made_runs / "flagged"), "-o", str(target)]
    assert status_of([*command, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["files"] == ["compare.json", "recording.rrd", "report.html"]
    assert [run["status"] for run in told["runs"]] == ["ok", "flagged"]
    document = json.loads((target / "compare.json").read_text())
    assert document["rows"] == comparison.document["rows"]
    assert [each["name"] for each in document["provenance"]["outputs"]] == ["report.html", "recording.rrd"]
    assert str(made_runs) not in (target / "compare.json").read_text() + (target / "report.html").read_text()
    assert status_of(command) == 2
    assert "exists already" in capsys.readouterr().err
    assert status_of([*command, "--force", "--no-recording"]) == 0
    shown = capsys.readouterr().out
    assert "Worst margin" in shown
    assert sorted(entry.name for entry in target.iterdir()) == ["compare.json", "report.html"]


def test_a_folder_that_is_no_run_leaves_nothing(made_runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert status_of(["compare", str(made_runs / "clean"), str(tmp_path / "empty"), "-o", str(tmp_path / "out"), "-q"]) == 2
    assert "empty is no tubeplan run" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["empty"]


@pytest.fixture(scope="module")
def opened(
    comparison: Comparison, browser: Any, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Any, list[str], list[str]]]:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_page(render_comparison(comparison), path)
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    faults: list[str] = []
    asked: list[str] = []
    page.on("console", lambda line: faults.append(line.text) if "GL Driver Message" not in line.text else None)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    for _ in range(200):
        if page.evaluate("globalThis.tubeplanReady === true"):
            break
        page.wait_for_timeout(50)
    page.wait_for_timeout(300)
    yield page, faults, asked
    page.close()


def test_the_page_opens_without_a_fault_or_a_request_and_draws_the_scene(opened: tuple[Any, list[str], list[str]]) -> None:
    from PIL import Image

    page, faults, asked = opened
    assert faults == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    with Image.open(io.BytesIO(page.locator("#scene canvas").screenshot())) as picture:
        pixels = np.asarray(picture.convert("RGB"), float)
    assert pixels.std() > 5.0


def test_hovering_a_chart_moves_the_readings_of_all_runs(
    opened: tuple[Any, list[str], list[str]], comparison: Comparison
) -> None:
    page, _, _ = opened
    chart = page.locator('svg[data-axis="mm"][data-chart="clearance"]:visible').first
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    left, right, wide = 40, 12, 740
    share = 0.25
    page.mouse.move(box["x"] + box["width"] * (left + share * (wide - left - right)) / wide, box["y"] + box["height"] / 2)
    page.wait_for_timeout(200)
    for k, run in enumerate(comparison.runs):
        path = run.result["path"]
        s = share * path["s_mm"][-1]
        told = page.locator(f'[data-at="{k}"] td').all_text_contents()
        assert float(told[0].split()[0]) == pytest.approx(s, abs=0.15)  # half a pixel and the figure's own rounding
        want = np.interp(s, path["s_mm"], path["clearance_mm"])
        assert float(told[1].split()[0]) == pytest.approx(want, abs=0.03)


@pytest.mark.parametrize("width", [390, 1440])
def test_nothing_sticks_out_sideways(opened: tuple[Any, list[str], list[str]], width: int) -> None:
    page, _, _ = opened
    page.set_viewport_size({"width": width, "height": 844})
    page.wait_for_timeout(200)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
