from __future__ import annotations

import hashlib

import highdicom
import numpy as np
import pydicom
import pytest
from scipy.spatial.transform import Rotation

from segmentation.dicom import read_series, write_series
from segmentation.errors import SeriesError
from segmentation.volume import Volume


def small_volume(turn: np.ndarray | None = None) -> Volume:
    rng = np.random.default_rng(7)
    _, y, x = np.meshgrid(np.arange(8), np.arange(20), np.arange(24), indexing="ij")
    voxels = np.where((x - 12) ** 2 + (y - 10) ** 2 < 60, 40, -1000) + rng.integers(-15, 15, (8, 20, 24))
    voxels = np.clip(voxels, -1024, 3071).astype(np.int16)
    matrix = np.eye(4)
    axes = np.column_stack([[0, 0, 1.25], [0, 0.7, 0], [0.8, 0, 0]])
    matrix[:3, :3] = (np.eye(3) if turn is None else turn) @ axes
    matrix[:3, 3] = [-31.4, 12.125, 905.5]
    return Volume(voxels, matrix)


def digests(folder) -> list[str]:
    return [hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())]


@pytest.mark.parametrize("turn", [None, Rotation.from_euler("xyz", [20, -10, 35], degrees=True).as_matrix()])
def test_a_written_series_is_read_back_voxel_for_voxel_in_place(tmp_path, turn):
    volume = small_volume(turn)
    write_series(volume, tmp_path / "series", seed=3)
    back = read_series(tmp_path / "series").volume
    order = np.argsort(back.to_lps(np.array([[0, 0, 0], [7, 0, 0]])) @ volume.index_to_lps[:3, 0])
    voxels = back.voxels if order[0] == 0 else back.voxels[::-1]
    np.testing.assert_array_equal(voxels, volume.voxels)
    corners = np.array([[i, j, k] for i in (0, 7) for j in (0, 19) for k in (0, 23)])
    there = corners if order[0] == 0 else np.abs(corners - [7, 0, 0])
    np.testing.assert_allclose(back.to_lps(there), volume.to_lps(corners), atol=1e-5)  # positions are written to 1e-6 mm


def test_every_slice_has_the_attributes_that_a_ct_image_must_have(tmp_path):
    paths = write_series(small_volume(), tmp_path / "series")
    slices = [pydicom.dcmread(path) for path in paths]
    # Type 1 attributes of the CT Image IOD, PS3.3 A.3; the UIDs first.
    required = [
        "SOPInstanceUID",
        "StudyInstanceUID",
        "SeriesInstanceUID",
        "FrameOfReferenceUID",
        "SOPClassUID",
        "Modality",
        "ImageType",
    ]
    required += [
        "PatientPosition",
        "SamplesPerPixel",
        "PhotometricInterpretation",
        "Rows",
        "Columns",
        "BitsAllocated",
        "BitsStored",
    ]
    required += ["HighBit", "PixelRepresentation", "PixelSpacing", "ImageOrientationPatient", "ImagePositionPatient"]
    required += ["RescaleIntercept", "RescaleSlope", "PixelData"]
    for image in slices:
        assert all(str(image[name].value) for name in required)
        assert image.file_meta.TransferSyntaxUID == pydicom.uid.ExplicitVRLittleEndian
        assert image.SOPClassUID == pydicom.uid.CTImageStorage == image.file_meta.MediaStorageSOPClassUID
        assert image.SOPInstanceUID == image.file_meta.MediaStorageSOPInstanceUID
        assert all(pydicom.uid.UID(image[name].value).is_valid for name in required[:4])
    assert len({image.SOPInstanceUID for image in slices}) == len(slices)
    assert len({image.SeriesInstanceUID for image in slices}) == 1
    geometry = highdicom.spatial.get_volume_positions(
        [image.ImagePositionPatient for image in slices], slices[0].ImageOrientationPatient, sort=True
    )
    assert geometry[0] == pytest.approx(1.25)


def test_nothing_in_a_generated_series_looks_like_a_patient(tmp_path):
    image = pydicom.dcmread(write_series(small_volume(), tmp_path / "series")[0])
    assert str(image.PatientName) == "Phantom^Urography"
    assert image.PatientIdentityRemoved == "YES"
    for name in ("PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "AccessionNumber", "ReferringPhysicianName"):
        assert str(image.get(name, "")) == ""


def test_the_bytes_depend_on_volume_and_seed_alone(tmp_path):
    for name, seed in [("one", 1), ("again", 1), ("other", 2)]:
        write_series(small_volume(), tmp_path / name, seed=seed)
    assert digests(tmp_path / "one") == digests(tmp_path / "again")
    assert not set(digests(tmp_path / "one")) & set(digests(tmp_path / "other"))


def test_progress_counts_every_slice(tmp_path):
    seen = []
    write_series(small_volume(), tmp_path / "series", progress=lambda done, total: seen.append((done, total)))
    assert seen == [(k + 1, 8) for k in range(8)]


def test_a_folder_with_something_in_it_is_refused(tmp_path):
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(SeriesError, match="is not empty"):
        write_series(small_volume(), tmp_path)


def test_oblique_axes_are_refused(tmp_path):
    matrix = small_volume().index_to_lps.copy()
    matrix[0, 0] = 0.3
    with pytest.raises(SeriesError, match="not at right angles"):
        write_series(Volume(small_volume().voxels, matrix), tmp_path / "series")


@pytest.mark.parametrize(("value", "words"), [(-1025, "expected -1024 or more"), (32000, "more than 16 bits")])
def test_values_that_do_not_fit_are_refused(tmp_path, value, words):
    voxels = small_volume().voxels.copy()
    voxels[0, 0, 0] = value
    with pytest.raises(SeriesError, match=words):
        write_series(Volume(voxels, small_volume().index_to_lps), tmp_path / "series")
    assert not (tmp_path / "series").exists()
