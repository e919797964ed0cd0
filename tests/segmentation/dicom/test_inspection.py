"""What `inspect` tells of a folder: every series, every fault, no identifier."""

from __future__ import annotations

import json

import numpy as np
import pytest

from segmentation.dicom import inspect_folder, read_series
from segmentation.dicom.facts import describe_orientation, describe_position


def test_a_sound_series_is_described_as_it_is_read(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices())
    report = inspect_folder(folder)
    assert report == json.loads(json.dumps(report))
    (series,) = report["series"]
    assert series["usable"]
    assert (series["number"], series["series_number"], series["images"], series["matrix"]) == (1, 4, 8, [26, 20])
    read = read_series(folder)
    assert np.allclose(series["geometry"]["index_to_lps"], read.volume.index_to_lps)
    assert series["facts"].items() <= read.facts.items()
    lowest, highest = series["geometry"]["bounds_lps_mm"]
    half = [0.5 * 25 * 0.7, 0.5 * 19 * 0.8, 0.5 * 7 * 1.5]  # the series is centred on the origin
    assert highest == pytest.approx(half, abs=1e-4)
    assert lowest == pytest.approx([-value for value in half], abs=1e-4)


def test_all_faults_are_listed_not_only_the_first(maker, tmp_path):
    slices = maker.slices()
    del slices[4]
    slices[3].ConvolutionKernel = "B70f"
    slices[5].RescaleSlope = 0
    folder = maker.save(tmp_path / "case", slices)
    (folder / "IM900.dcm").write_bytes(b"damaged")
    report = inspect_folder(folder)
    (series,) = report["series"]
    assert not series["usable"]
    found = " | ".join([*report["faults"], *series["faults"]])
    for part in ("IM900.dcm looks like DICOM", "kernel are mixed", "rescale slope 0", "a slice is missing"):
        assert part in found


def test_damaged_pixels_are_found_when_asked_for(maker, tmp_path, stored_values):
    _, set_stored = stored_values
    slices = maker.slices()
    set_stored(slices[3], np.zeros((20, 26)))
    folder = maker.save(tmp_path / "case", slices)
    assert inspect_folder(folder)["series"][0]["faults"] == []
    (fault,) = inspect_folder(folder, pixels=True)["series"][0]["faults"]
    assert fault.startswith("IM003.dcm is blank")


def test_no_identifier_is_in_the_report(maker, tmp_path):
    slices = maker.slices(SeriesDescription="Secret words", InstitutionName="Secret place", AccessionNumber="SECRET")
    slices[2].PatientID = "SECRET-TOO"
    report = json.dumps(inspect_folder(maker.save(tmp_path / "case", slices)))
    assert "secret" not in report.lower()
    assert "1970" not in report
    assert str(slices[0].SeriesInstanceUID) not in report
    assert str(tmp_path) not in report


def test_markup_in_free_text_is_taken_out(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices(Manufacturer="<script>alert(1)</script>"))
    assert read_series(folder).facts["Manufacturer"] == "scriptalert(1)/script"


def test_a_folder_without_dicom_says_so(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing here")
    report = inspect_folder(tmp_path)
    assert report["faults"] == ["holds no DICOM image"]
    assert report["ignored_files"] == 1
    assert report["series"] == []


@pytest.mark.parametrize(
    ("row", "column", "words"),
    [
        ((1, 0, 0), (0, 1, 0), "axial"),
        ((1, 0, 0), (0, 0, -1), "coronal"),
        ((0, 1, 0), (0, 0, -1), "sagittal"),
        ((1, 0, 0), (0, np.cos(np.radians(12)), np.sin(np.radians(12))), "oblique, 12.0 degrees from axial"),
    ],
)
def test_planes_are_named_in_words(row, column, words):
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = np.cross(column, row), column, row
    assert describe_orientation(matrix) == words


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("HFS", "HFS (head first, supine)"),
        ("FFP", "FFP (feet first, prone)"),
        ("HFDR", "HFDR (head first, lying on the right side)"),
        ("??", ""),
    ],
)
def test_positions_are_named_in_words(code, words):
    assert describe_position(code) == words
