"""Every export of a run: right, whole, on the CT, without a name, and number for number the run's."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import highdicom
import numpy as np
import pytest
import SimpleITK as sitk
from jsonschema import Draft202012Validator
from pydicom import dcmread

from segmentation.dicom import read_series
from segmentation.mesh_files import read_ply
from segmentation.mesh_parse import parse_mesh

Call = Callable[..., Any]


@pytest.fixture(scope="module")
def run(series: Path, process: Call, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flagged run on a DICOM series with an identity; the clearance asked for is met on a part of the path only."""
    folder = tmp_path_factory.mktemp("export")
    done = process(
        "plan", "tube", "--ct", series, "--anatomy", "generic", "--seed-point", "1,4,120", "--hu-min", "170",
        "--start", "E1", "--goal", "E2", "--clearance-min", "3.85", "--case-id", "case-7", "--no-recording", "--no-report",
        "--method", "feature_iteration", "-o", "run", cwd=folder,
    )  # fmt: skip
    assert done.status == 3, done.err
    return folder / "run"


@pytest.fixture(scope="module")
def exported(run: Path, process: Call) -> Path:
    done = process("export", "run", "--to", "slicer,seg,stl,gltf,csv", "-o", "export", cwd=run.parent)
    assert done.status == 0, done.err
    return run.parent / "export"


@pytest.fixture(scope="module")
def result(run: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((run / "result.json").read_text())
    return document


@pytest.mark.parametrize("name", ["lumen-seg.dcm", "lumen-stl.dcm"])
def test_dicom_files_pass_dciodvfy(exported: Path, name: str) -> None:
    if shutil.which("dciodvfy") is None:
        pytest.skip("dciodvfy (Debian: dicom3tools) is not installed")
    told = subprocess.run(["dciodvfy", "-new", exported / name], capture_output=True, text=True, check=False)
    said = (told.stdout + told.stderr).splitlines()
    assert {"Segmentation", "EncapsulatedSTL"} & set(said), said  # it knows what it looked at
    assert not [line for line in said if line.startswith("Error")]


def test_the_segmentation_lies_on_the_ct(exported: Path, run: Path, series: Path) -> None:
    source = [dcmread(file, stop_before_pixels=True) for file in series.iterdir()]
    made = highdicom.seg.segread(exported / "lumen-seg.dcm")
    assert {image.FrameOfReferenceUID for image in source} == {made.FrameOfReferenceUID}
    assert made.StudyInstanceUID == source[0].StudyInstanceUID
    placed = made.get_volume(combine_segments=True)
    ct = read_series(series).volume
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (np.array(ct.voxels.shape) - 1)
    np.testing.assert_allclose(placed.map_indices_to_reference(corners), ct.to_lps(corners), atol=1e-6)
    # Contrast medium has 300 HU and tissue 40: what the mask holds is bright, and its wall is the run's surface.
    assert ct.voxels[placed.array > 0].min() >= 170
    inside = ct.to_lps(np.argwhere(placed.array > 0))
    np.testing.assert_allclose(inside.mean(axis=0), surface_center(run), atol=0.1)
    referred = {item.ReferencedSOPInstanceUID for item in made.ReferencedSeriesSequence[0].ReferencedInstanceSequence}
    assert referred <= {image.SOPInstanceUID for image in source}


def surface_center(run: Path) -> np.ndarray:
    """Centre of gravity of the volume inside mesh.ply."""
    surface = read_ply(run / "mesh.ply")
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    six = np.einsum("ij,ij->i", a, np.cross(b, c))
    return np.asarray((six[:, None] * (a + b + c)).sum(axis=0) / (4.0 * six.sum()))


def test_the_encapsulated_stl_is_the_surface_in_the_frame_of_the_ct(
    exported: Path, run: Path, series: Path, tmp_path: Path
) -> None:
    made = dcmread(exported / "lumen-stl.dcm")
    source = dcmread(next(series.iterdir()), stop_before_pixels=True)
    assert made.FrameOfReferenceUID == source.FrameOfReferenceUID
    document = made.EncapsulatedDocument[: made.EncapsulatedDocumentLength]
    assert document == (exported / "lumen.stl").read_bytes()
    (tmp_path / "back.stl").write_bytes(document)
    surface = read_ply(run / "mesh.ply")
    back = parse_mesh(tmp_path / "back.stl").parts[0]
    # Single precision at 150 mm from the origin.
    np.testing.assert_allclose(back.vertices[back.faces], surface.vertices[surface.faces], atol=2e-5)


def test_the_segmentation_for_slicer_is_the_mask_of_the_dicom_one(exported: Path) -> None:
    image = sitk.ReadImage(str(exported / "lumen.seg.nrrd"))
    placed = highdicom.seg.segread(exported / "lumen-seg.dcm").get_volume(combine_segments=True)
    np.testing.assert_array_equal(sitk.GetArrayFromImage(image), placed.array)
    np.testing.assert_allclose(image.TransformContinuousIndexToPhysicalPoint([3.0, 5.0, 7.0]), placed.affine[:3] @ [7, 5, 3, 1])
    assert image.GetMetaData("Segment0_LabelValue") == "1"
    assert image.GetMetaData("Segmentation_ContainedRepresentationNames") == "Binary labelmap|"


@pytest.mark.parametrize("name", ["path.mrk.json", "flags.mrk.json"])
def test_markups_follow_slicers_fields_and_hold_numbers_of_the_run(
    exported: Path, result: dict[str, Any], slicer_schema: dict[str, Any], numbers_shown: Any, name: str
) -> None:
    document = json.loads((exported / name).read_text())
    Draft202012Validator(slicer_schema).validate(document)
    known = set(numbers_shown.numbers(result))
    for markup in document["markups"]:
        measured = markup["measurements"]
        assert measured or "features" in markup["name"]
        for one in measured:
            values = one.get("controlPointValues", [one.get("value")])
            assert set(values) <= known, one["name"]
            assert "value" in one or len(values) == len(markup["controlPoints"])
    if name == "flags.mrk.json":
        told = [(m["name"], len(m["controlPoints"])) for m in document["markups"]]
        kinds = [flag["kind"] for flag in result["flagged_intervals"]]
        assert told == [(f"flagged {kind}", kinds.count(kind)) for kind in dict.fromkeys(kinds)]
        for markup in document["markups"]:
            for control in markup["controlPoints"]:
                figures = [float(word) for word in re.findall(r"\d+\.\d+(?:e-?\d+)?", control["description"])]
                assert set(figures) <= known


def test_every_number_of_every_table_is_the_results(exported: Path, result: dict[str, Any], numbers_shown: Any) -> None:
    known = set(numbers_shown.numbers(result))
    counts = {}
    for file in sorted(exported.glob("*.csv")):
        head, *rows = csv.reader(file.read_text().splitlines())
        counts[file.name] = len(rows)
        for row in rows:
            for name, cell in zip(head, row, strict=True):
                # The path's tangents and torsion stand in path.csv alone.
                if cell and name not in ("tx", "ty", "tz", "torsion_per_mm") and re.fullmatch(r"-?\d[\d.e+-]*", cell):
                    assert float(cell) in known, (file.name, name, cell)
    assert counts["flags.csv"] == len(result["flagged_intervals"])
    assert counts["features.csv"] == len(result["feature_points"])
    assert counts["centerline.csv"] == len(result["centerline"]["points_mm"])
    assert counts["path.csv"] == len(result["path"]["s_mm"])
    assert counts["measures.csv"] == len(result["details"]["measures"]["items"])


def test_the_gltf_scene_holds_wall_path_flags_and_ends_in_place(exported: Path, run: Path, result: dict[str, Any]) -> None:
    parts = {part.name: part for part in parse_mesh(exported / "scene.glb").parts}
    flags = [f"flag {k + 1} {flag['kind']}" for k, flag in enumerate(result["flagged_intervals"])]
    assert set(parts) == {"wall", "path", "start", "goal", *flags}
    surface = read_ply(run / "mesh.ply")
    # Metres with +y up and +z to the front, from LPS mm.
    turned = np.column_stack([surface.vertices[:, 0], surface.vertices[:, 2], -surface.vertices[:, 1]]) / 1000.0
    np.testing.assert_allclose(parts["wall"].vertices, turned, atol=2e-8)
    start = np.array(result["path"]["points_mm"][0])
    np.testing.assert_allclose(parts["start"].vertices.mean(axis=0), [start[0] / 1e3, start[2] / 1e3, -start[1] / 1e3], atol=1e-7)


def test_no_export_names_the_patient_unless_asked_to(
    exported: Path, run: Path, identity: dict[str, str], tubeplan: Call, tmp_path: Path
) -> None:
    for file in exported.iterdir():
        content = file.read_bytes()
        assert not [value for value in identity.values() if value.encode() in content], file.name
    made = dcmread(exported / "lumen-seg.dcm")
    assert (made.PatientID, made.PatientIdentityRemoved) == ("case-7", "YES")
    kept = tubeplan("export", run, "--to", "seg,stl", "--keep-identifiers", "-o", tmp_path / "kept", "--quiet")
    assert kept.status == 0, kept.err
    for name in ("lumen-seg.dcm", "lumen-stl.dcm"):
        told = dcmread(tmp_path / "kept" / name)
        assert told.PatientID == identity["PatientID"]
        assert str(told.PatientName) == identity["PatientName"]
        assert "PatientIdentityRemoved" not in told
    assert json.loads((tmp_path / "kept" / "export.json").read_text())["identifiers_kept"] is True


def test_a_ct_that_is_gone_or_another_is_refused(run: Path, series: Path, tubeplan: Call, tmp_path: Path) -> None:
    away = series.with_name("away")
    series.rename(away)
    try:
        gone = tubeplan("export", run, "--to", "seg", "-o", tmp_path / "out", "--quiet")
    finally:
        away.rename(series)
    assert gone.status == 2
    assert "is not where case.toml says it was" in gone.err
    file = sorted(series.iterdir())[5]
    before = file.read_bytes()
    dataset = dcmread(file)
    dataset.SeriesDescription = "changed"
    dataset.save_as(file)
    try:
        other = tubeplan("export", run, "--to", "seg", "-o", tmp_path / "out", "--quiet")
    finally:
        file.write_bytes(before)
    assert other.status == 2
    assert "is not the one that the run was made from" in other.err
    assert not (tmp_path / "out").exists()


def test_a_run_from_a_mesh_exports_what_it_has_and_says_what_it_has_not(meshes: Path, tubeplan: Call, tmp_path: Path) -> None:
    run = tmp_path / "run"
    planned = tubeplan(
        "plan", "tube", "--mesh", meshes / "tube.ply", "--start", "E1", "--goal", "E2", "--no-recording", "--no-report",
        "-o", run, "--quiet",
    )  # fmt: skip
    assert planned.status == 0, planned.err
    everything = tubeplan("export", run, "-o", tmp_path / "all", "--json")
    assert everything.status == 0, everything.err
    told = everything.document
    assert {entry["name"] for entry in told["files"]} >= {"lumen.stl", "scene.glb", "path.csv", "path.mrk.json"}
    assert any("made from a mesh" in note for note in told["notes"])
    assert any("recording.rrd" in note for note in told["notes"])
    named = tubeplan("export", run, "--to", "seg", "-o", tmp_path / "seg", "--quiet")
    assert named.status == 2
    assert "made from a mesh" in named.err
    assert tubeplan("export", run, "--to", "vhs", "-o", tmp_path / "x", "--quiet").status == 2
    (run / "path.csv").write_text("s_mm\n")
    changed = tubeplan("export", run, "--to", "csv", "-o", tmp_path / "y", "--quiet")
    assert changed.status == 2
    assert "was changed after the run" in changed.err


def test_the_single_file_opens_from_disk_and_asks_no_host(meshes: Path, tubeplan: Call, tmp_path: Path, browser: Any) -> None:
    run = tmp_path / "run"
    planned = tubeplan(
        "plan", "tube", "--mesh", meshes / "tube.ply", "--start", "E1", "--goal", "E2", "--no-report", "-o", run, "--quiet"
    )  # fmt: skip
    assert planned.status == 0, planned.err
    assert tubeplan("export", run, "--to", "single-file", "-o", tmp_path / "one", "--quiet").status == 0
    file = tmp_path / "one" / "viewer.html"
    recording = (run / "recording.rrd").stat().st_size
    assert file.stat().st_size < 20e6 + 1.4 * recording  # base64 takes a third more
    assert file.stat().st_mode & 0o777 == 0o600  # a patient's anatomy is its owner's
    with file.open(encoding="utf-8") as page:  # a copy of the viewer carries its licence
        assert "Rerun Technologies AB" in page.read(1000)
    page = browser.new_page(viewport={"width": 1000, "height": 700})
    faults, asked = [], []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    page.wait_for_selector("body[data-started]", timeout=180_000)
    page.wait_for_timeout(3000)
    assert page.locator("#state").is_hidden()
    assert page.locator("header").inner_text().endswith("Research use, not for clinical decisions")
    page.close()
    assert asked == [file.as_uri()]
    # The viewer tries to reach its makers; the page's policy refuses before anything is sent, and its fetch fails.
    refused = ("Content Security Policy", "Failed to fetch")
    assert not [fault for fault in faults if not any(words in fault for words in refused)]


def test_the_schema_is_printed_whole_and_key_by_key(tubeplan: Call, result: dict[str, Any]) -> None:
    schema = json.loads(tubeplan("schema", "--json").out)
    Draft202012Validator(schema).validate(result)
    lines = tubeplan("schema").out.splitlines()
    listed = {line.split("  ")[0] for line in lines[1:]}
    assert set(result) <= listed
    assert {"metrics.length_mm", "flagged_intervals[].worst", "details.measures.items[].reason"} <= listed
    assert any(line.startswith("status  [ok | flagged | infeasible]") for line in lines)


def test_a_folder_that_is_no_run_is_named_even_when_it_is_the_one_stood_in(
    tubeplan: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "plain"
    folder.mkdir()
    monkeypatch.chdir(folder)
    outcome = tubeplan("export", ".", "-o", "out")
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert "plain is no tubeplan run" in outcome.err
