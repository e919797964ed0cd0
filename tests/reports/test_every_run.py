"""What runs of every planner show: pages before a browser and axe-core, and each number against the run's own document."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk
from jsonschema import Draft202012Validator
from rerun.chunk import RrdReader

from reports import derived_values
from segmentation.mesh_files import write_ply
from segmentation.synthetic import weibel_airway
from segmentation.synthetic.nasal import NasalPhantomSettings, nasal_phantom
from tubeplan_viz.bench.models import narrow_neck
from tubeplan_viz.cli.app import status_of

DOCUMENTS = ("result.json", "reach.json", "matrix.json", "compare.json")
TUBE = ["plan", "tube", "--mesh", "neck.ply", "--start", "E1", "--goal", "E2", "--curvature-max", "0.125"]
RIGID = ["plan", "rigid", "--ct", "head.nii.gz", "--lesion", "11.6,3,27", "--nodes", "0"]
COMPARED = [f"{name}{copy}" for copy in ("", "-2", "-3") for name in ("tube-holds", "tube-flagged")]
# Name (none that is also a word of a command), command and exit status; its files are made from CASES and generated anatomy.
RUNS: dict[str, tuple[list[str], int]] = {
    "tube-holds": ([*TUBE, "--method", "feature_iteration", "--clearance-min", "0.8"], 0),
    "tube-flagged": ([*TUBE, "--method", "feature_iteration", "--clearance-min", "1.5"], 3),
    # As many as may be: their columns are the narrowest.
    "comparison": (["compare", *COMPARED], 0),
    "needle2d": (["run", "needle2d.toml"], 0),
    "needle3d": (["run", "needle3d.toml"], 0),
    "needle-none": (["run", "needle-none.toml"], 4),
    "nose": ([*RIGID, "--side", "left"], 0),
    "nose-none": ([*RIGID, "--side", "right"], 4),
    "robot": (
        ["plan", "bronchoscope", "--mesh", "airway.ply", "--method", "kinematic", "--goal", "right upper lobe"],
        0,
    ),
    # A robot of 6 mm enters the lobes; of the segments it is proved that it does not: both verdicts, and little to search.
    "reach-map": (["reach", "--mesh", "airway.ply", "--diameter", "6"], 0),
    "instruments": (["matrix", "--mesh", "neck.ply", "--start", "E1", "--catalogue", "catalogue.toml", "--goals", "all"], 3),
}
CASES = {
    "needle3d.toml": """[planner]
name = "needle3d"
[needle3d]
target = [0, 0, 100]
safety_mm = 1.0
[[obstacles]]
kind = "sphere"
center = [0, 5, 40]
radius_mm = 5
""",
    "catalogue.toml": """[[instrument]]
name = "thin"
kind = "test"
outer_diameter_mm = 1.0
bend_radius_min_mm = 6.0
rigid_tip_mm = 3.0
[[instrument]]
name = "far too thick"
kind = "test"
outer_diameter_mm = 20.0
bend_radius_min_mm = 6.0
""",
}
# Columns that no document holds: the frame of the path, the torsion, counters, and the robot's body in states.csv.
OWN_COLUMNS = {"tx", "ty", "tz", "torsion_per_mm", "step"}


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory, needle_past_a_circle: Callable[[float, float], str]) -> Callable[[str], Path]:
    """Makes a run when it is first asked for; small cases on generated anatomy."""
    folder = tmp_path_factory.mktemp("every")
    needles = {"needle2d.toml": needle_past_a_circle(40.0, 10.0), "needle-none.toml": needle_past_a_circle(50.0, 39.0)}
    for name, text in {**CASES, **needles}.items():
        (folder / name).write_text(text, encoding="utf-8")
    write_ply(narrow_neck().surface, folder / "neck.ply")
    write_ply(weibel_airway(generations=3, voxel=1.0).surface, folder / "airway.ply")
    head = nasal_phantom(NasalPhantomSettings(spacing=(2.0, 2.0, 2.0))).volume
    image = sitk.GetImageFromArray(np.array(head.voxels))
    image.SetSpacing(head.spacing[::-1].tolist())
    image.SetOrigin(head.index_to_lps[:3, 3].tolist())
    sitk.WriteImage(image, str(folder / "head.nii.gz"))

    def make(name: str) -> Path:
        run = folder / name
        if not run.exists():
            command, expected = RUNS[name]
            if name == "comparison":
                for each in COMPARED[:2]:
                    for copy in ("-2", "-3"):
                        shutil.copytree(make(each), folder / f"{each}{copy}")
            known = {path.name for path in folder.iterdir()}
            arguments = [str(folder / word) if word in known else word for word in command]
            assert status_of([*arguments, "-o", str(run), "-q"]) == expected
        return run

    return make


@pytest.fixture(params=RUNS)
def run(request: pytest.FixtureRequest, made: Callable[[str], Path]) -> Path:
    return made(request.param)


def document_of(run: Path) -> dict[str, Any]:
    """result.json, or what stands in its place."""
    return dict(json.loads(next(run / name for name in DOCUMENTS if (run / name).exists()).read_text(encoding="utf-8")))


def test_the_scene_of_a_needles_page_opens_at_the_tightest_place_and_turns(made: Callable[[str], Path], browser: Any) -> None:
    run = made("needle3d")
    path = document_of(run)["path"]
    tight = int(np.argmin(path["clearance_mm"]))
    context = browser.new_context(viewport={"width": 1440, "height": 900}, reduced_motion="reduce")
    page = context.new_page()
    page.goto((run / "report.html").as_uri())
    for _ in range(400):  # the page's policy lets no condition be waited for within it
        if page.evaluate("globalThis.tubeplanReady === true"):
            break
        page.wait_for_timeout(50)
    page.wait_for_timeout(250)
    assert page.locator("#labels b").all_text_contents() == ["Entry", "Target", f"{path['clearance_mm'][tight]:.2f} mm"]
    assert page.locator("#at").text_content() == f"{path['s_mm'][tight]:.1f}\u00a0mm"
    assert page.locator("#at-clearance").text_content() == f"{path['clearance_mm'][tight]:.2f}\u00a0mm"
    before = page.evaluate("tubeplanCursor()")
    page.locator("[data-view=side]").click()
    page.wait_for_timeout(250)
    assert np.linalg.norm(np.subtract(page.evaluate("tubeplanCursor()"), before)) > 1.0
    page.locator("#place").evaluate("(slider) => { slider.value = 0; slider.dispatchEvent(new Event('input')); }")
    page.wait_for_timeout(250)
    assert page.locator("#at").text_content() == "0.0\u00a0mm"
    context.close()


def test_the_scene_of_a_noses_page_opens_with_the_instrument_at_the_tightest_place_and_parts_can_be_hidden(
    made: Callable[[str], Path], browser: Any
) -> None:
    run = made("nose")
    document = document_of(run)
    worst, path = document["details"]["worst"], document["path"]
    context = browser.new_context(viewport={"width": 1440, "height": 900}, reduced_motion="reduce")
    page = context.new_page()
    page.goto((run / "report.html").as_uri())
    for _ in range(400):
        if page.evaluate("globalThis.tubeplanReady === true"):
            break
        page.wait_for_timeout(50)
    page.wait_for_timeout(250)
    nearest = worst["structure"].replace("_", " ")
    told = page.locator("#labels b").all_text_contents()
    assert told == ["Lesion", "Start", f"{worst['distance_mm']:.2f} mm to the {nearest}"]
    assert page.locator("#at").text_content() == f"{worst['s_mm']:.1f}\u00a0mm"
    assert page.locator("#at-clearance").text_content() == f"{min(path['clearance_mm']):.2f}\u00a0mm"
    assert page.locator("#at-part").text_content() == f"nearest: {nearest}"
    for name in ("tool", "structures", "spots"):
        # What is hidden was seen: the picture changes.
        before = page.locator("#scene canvas").screenshot()
        page.locator(f"[data-show={name}]").uncheck()
        page.wait_for_timeout(250)
        assert page.locator("#scene canvas").screenshot() != before
    context.close()


def all_known(run: Path, numbers_shown: Any) -> set[float]:
    """Every number of the run's document and those that follow from it by a documented formula."""
    document = document_of(run)
    known = set(numbers_shown.numbers(document))
    return known | set(derived_values(document).values()) if "timings_s" in document and "path" in document else known


def test_a_page_asks_for_nothing_complains_of_nothing_and_can_be_read(
    run: Path, browser: Any, hard_to_read: Callable[[Any], list[str]], lost_in_print: Callable[[Any], list[str]]
) -> None:
    context = browser.new_context(viewport={"width": 1440, "height": 900}, color_scheme="light", reduced_motion="reduce")
    page = context.new_page()
    told: list[str] = []
    asked: list[str] = []
    # Software GL remarks on its own speed; that is the browser's, not the page's.
    page.on("console", lambda message: told.append(message.text) if "GL Driver Message" not in message.text else None)
    page.on("pageerror", lambda error: told.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto((run / "report.html").as_uri())
    for _ in range(400):  # wait_for_function would need eval, which the page's policy forbids
        if page.evaluate("globalThis.tubeplanReady === true"):
            break
        page.wait_for_timeout(50)
    assert "Research use, not for clinical decisions" in page.locator("header.bar").inner_text()
    check_first_screen(page, document_of(run))
    assert hard_to_read(page) == []
    page.evaluate("for (const one of document.querySelectorAll('.brand span, footer span')) one.textContent = 'name-'.repeat(40)")
    for width in (390, 1440):  # a long name breaks or ends early, and never makes the page scroll sideways
        page.set_viewport_size({"width": width, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth") == width
    page.locator("input[name=theme][value=light]").check(force=True)
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(246, 247, 249)"
    assert lost_in_print(page) == []
    assert told == []
    assert [url for url in asked if not url.startswith("data:")] == [(run / "report.html").as_uri()]
    context.close()


def check_first_screen(page: Any, document: dict[str, Any]) -> None:
    """The tightest place and the sharpest bend stand on the first screen with their depth, where the run has a path with both."""
    path = document.get("path")
    if not path or not path.get("clearance_mm") or document["planner"]["name"] == "rigid":
        return  # a page without them says what stands in the way in its first sentence; a rigid path has nodes
    for term, key in (("Worst margin", "derived:clearance_min_at_mm"), ("Sharpest bend", "derived:curvature_max_at_mm")):
        box = page.locator("#verdict dl.keys > div", has_text=term)
        place = box.bounding_box()
        assert place["y"] + place["height"] < 900
        keys = {element.get_attribute("data-key") for element in box.locator("data").all()}
        assert any(one == key or one.startswith("flagged_intervals") for one in keys), term


def test_every_figure_of_the_page_is_the_documents(run: Path, numbers_shown: Any) -> None:
    document = document_of(run)
    page = numbers_shown.Page((run / "report.html").read_text(encoding="utf-8"))
    assert len(page.found) >= 8
    derived = derived_values(document) if "timings_s" in document and "path" in document else {}
    runs = document.get("runs", [])
    # On the page of several runs each run's derived figures stand behind its place in the list.
    for index, each in enumerate(runs):
        derived |= {f"runs.{index}.{key}": value for key, value in derived_values(each).items()}
    own = [one for one in page.found if one[0] not in derived]
    assert numbers_shown.Page.faults(page, document, derived) == [], own[:3]


def test_every_figure_of_every_table_is_the_documents(run: Path, numbers_shown: Any) -> None:
    known = all_known(run, numbers_shown)
    for file in sorted(run.glob("*.csv")):
        if file.name == "states.csv":
            continue  # the robot's whole body at every step, which no other file holds
        head, *rows = csv.reader(file.read_text(encoding="utf-8").splitlines())
        assert rows
        for row in rows:
            for name, cell in zip(head, row, strict=True):
                if name not in OWN_COLUMNS and re.fullmatch(r"-?\d[\d.e+-]*", cell):
                    assert float(cell) in known, (file.name, name, cell)


def test_markups_are_slicers_and_hold_the_documents_numbers(run: Path, slicer_schema: Any, numbers_shown: Any) -> None:
    file = run / "path.mrk.json"
    document = document_of(run)
    assert file.exists() == ("planner" in document and document["path"] is not None)
    if not file.exists():
        return
    markups = json.loads(file.read_text(encoding="utf-8"))
    Draft202012Validator(slicer_schema).validate(markups)
    known = all_known(run, numbers_shown)
    path = {tuple(point) for point in document["path"]["points_mm"]}
    for markup in markups["markups"]:
        for one in markup["measurements"]:
            assert set(one.get("controlPointValues", [one.get("value")])) <= known, one["name"]
        if markup["type"] == "Curve":
            assert {tuple(point["position"]) for point in markup["controlPoints"]} <= path


def rows_of(run: Path) -> Iterator[tuple[str, str, str, list[int], list[Any]]]:
    """Every column of the recording: entity, its name, its timeline (the last one; empty where static), ticks and cells."""
    for chunk in RrdReader(run / "recording.rrd").stream():
        batch = chunk.to_record_batch()
        timeline = next((name for name in chunk.timeline_names if name in ("iteration", "arc_length", "share")), "")
        ticks = batch.column(timeline).cast("int64").to_pylist() if timeline else [0] * batch.num_rows
        for name in batch.schema.names:
            if name not in chunk.timeline_names:
                yield chunk.entity_path, name, timeline, ticks, batch.column(name).to_pylist()


def along(path: dict[str, Any], kind: str, places: Any) -> Any:
    """Clearance or curvature of a path between its samples."""
    return np.interp(places, path["s_mm"], path["clearance_mm" if kind == "clearance" else "curvature_per_mm"])


def expected_scalars(entity: str, timeline: str, ticks: Any, document: dict[str, Any]) -> Any:
    """What a plot must hold where it is drawn from the path: shares of the limit in the walk, values side by side; else None."""
    *_, place, name = entity.split("/")
    if entity.startswith("/profiles") and name != "limit":
        path = next(each for each in document["runs"] if each["label"] == name)["path"]
        return along(path, place, ticks / ticks.max() * path["s_mm"][-1]) if timeline == "share" else None
    if entity.startswith("/case/convergence") and timeline == "arc_length" and name in ("clearance", "curvature"):
        limit = document["limits"]["clearance_min_mm" if name == "clearance" else "curvature_max_per_mm"]
        return along(document["path"], name, ticks / 10.0) / limit
    return None


def test_every_plotted_value_of_the_recording_is_the_documents(run: Path, numbers_shown: Any) -> None:
    document = document_of(run)
    known = all_known(run, numbers_shown)
    tube = document.get("planner", {}).get("name") == "tube"
    if tube:  # its convergence is drawn as shares of the limits
        for state in document["iterations"]:
            known.add(state["curvature_max_per_mm"] / document["limits"]["curvature_max_per_mm"])
            known.add(state["clearance_min_mm"] / document["limits"]["clearance_min_mm"])
    told = 0
    for entity, name, timeline, ticks, cells in rows_of(run):
        if not name.endswith("Scalars:scalars"):
            continue
        values = np.array([cell[0] for cell in cells])
        wanted = expected_scalars(entity, timeline, np.array(ticks), document)
        if wanted is not None:
            np.testing.assert_allclose(values, wanted, rtol=1e-9, err_msg=entity)
        elif not (entity.startswith("/profiles") and timeline == "arc_length"):  # there the ticks are rounded to 0.1 mm
            assert set(values.tolist()) <= known, entity
        told += len(values)
    # Forms in the plane are all tried, nothing converges.
    assert told > 0 or document.get("path") is None or document["planner"]["name"] == "needle2d"


def test_every_figure_in_the_recordings_summary_is_the_documents(run: Path, numbers_shown: Any) -> None:
    known = np.array(sorted(abs(value) for value in all_known(run, numbers_shown)))
    texts = [cells[0][0] for _, name, timeline, _, cells in rows_of(run) if "TextDocument:text" in name and not timeline]
    for text in texts:
        for figure in re.findall(r"(?<![\w.])\d+\.\d+(?:e-?\d+)?", text):
            half = 0.5 * 10.0 ** -len(figure.partition(".")[2]) * (1 + 1e-9)
            assert np.abs(known - float(figure)).min() <= half, figure


def test_the_recording_draws_the_documents_path(run: Path) -> None:
    path = document_of(run).get("path")
    strips = [
        strip
        for entity, name, timeline, _, cells in rows_of(run)
        if entity == "/case/path/curve" and name == "LineStrips3D:strips" and timeline != "iteration"
        for cell in cells
        for strip in cell
    ]
    if document_of(run).get("planner", {}).get("name") in ("tube", "needle2d", "needle3d", "bronchoscope") and path:
        drawn, samples = np.array(strips[-1]), np.array(path["points_mm"])
        # Points are kept in single precision; a line may have fewer than the path, none of them off it.
        assert (
            np.linalg.norm(drawn[:, None] - samples[None], axis=2).min(axis=1).max() <= 1e-4 + 0.5 * np.diff(path["s_mm"]).max()
        )
        assert np.linalg.norm(drawn[[0, -1]] - samples[[0, -1]], axis=1).max() <= 1e-4


@pytest.mark.parametrize("name", ["needle2d", "needle3d"])
def test_the_bars_of_a_needles_recording_are_the_paths_and_end_at_the_limit(name: str, made: Callable[[str], Path]) -> None:
    run = made(name)
    document = document_of(run)
    bars = {
        (entity.rpartition("/")[0].rpartition("/")[2], entity.rpartition("/")[2], column.rpartition(":")[2]): cells[0][0]
        for entity, column, _, _, cells in rows_of(run)
        if entity.startswith("/case/profile") and column in ("BarChart:values", "BarChart:abscissa")
    }
    for kind, key, limit in (
        ("clearance", "clearance_mm", "clearance_min_mm"),
        ("curvature", "curvature_per_mm", "curvature_max_per_mm"),
    ):
        values, places = (np.asarray(bars[kind, "1_ok", column]["buffer"]) for column in ("values", "abscissa"))
        np.testing.assert_array_equal(values, document["path"][key])
        np.testing.assert_array_equal(places, document["path"]["s_mm"])
        assert np.asarray(bars[kind, "0_limit", "values"]["buffer"]).tolist() == [document["limits"][limit]]
        assert (kind, "2_flagged", "values") not in bars  # both runs hold
