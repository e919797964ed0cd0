from __future__ import annotations

import hashlib
from pathlib import Path

import highdicom as hd
import numpy as np
import pydicom
import pytest
import SimpleITK as sitk
from pydicom.sr.codedict import codes

from segmentation.dicom import read_series, write_series
from segmentation.dicom.seg_reader import read_segments
from segmentation.errors import CaseError, SeriesError, VolumeError
from segmentation.label_file import onto_grid, read_mask, read_mask_file
from segmentation.volume import Volume


@pytest.fixture(scope="module")
def volume() -> Volume:
    """Oblique axes of different steps, so that no exchange of axes goes unseen."""
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array([1.5, 0.8, 0.7])
    matrix[:3, 3] = [12.0, -40.0, 7.0]
    return Volume(np.zeros((8, 9, 10), dtype=np.int16), matrix)


@pytest.fixture(scope="module")
def mask(volume: Volume) -> np.ndarray:
    return np.random.default_rng(4).random(volume.voxels.shape) < 0.3


def write(values: np.ndarray, index_to_lps: np.ndarray, path: Path) -> Path:
    image = sitk.GetImageFromArray(values)
    spacing = np.linalg.norm(index_to_lps[:3, :3], axis=0)
    image.SetSpacing(spacing[::-1].tolist())
    image.SetDirection((index_to_lps[:3, :3] / spacing)[:, ::-1].ravel().tolist())
    image.SetOrigin(index_to_lps[:3, 3].tolist())
    sitk.WriteImage(image, str(path))
    return path


@pytest.mark.parametrize("suffix", [".nii.gz", ".mha"])
def test_a_file_of_8_bits_comes_back_as_the_mask(volume: Volume, mask: np.ndarray, tmp_path: Path, suffix: str) -> None:
    path = write((mask * 3).astype(np.uint8), volume.index_to_lps, tmp_path / f"mask{suffix}")
    assert (read_mask(path, volume) == mask).all()
    assert (read_mask(path, volume, label=3) == mask).all()
    with pytest.raises(CaseError, match=r"the mask holds no voxel"):
        read_mask(path, volume, label=2)
    with pytest.raises(CaseError, match="label 'septum' is no number"):
        read_mask(path, volume, label="septum")


def test_order_direction_and_extent_of_the_axes_do_not_matter(volume: Volume, mask: np.ndarray) -> None:
    """A part of the grid, stored as [column, slice, row] with slices and rows reversed."""
    part = mask.copy()
    part[:2] = False
    part[:, :, 8:] = False
    matrix = np.eye(4)
    columns = volume.index_to_lps[:3, :3]
    matrix[:3, :3] = np.column_stack([columns[:, 2], -columns[:, 0], -columns[:, 1]])
    matrix[:3, 3] = volume.to_lps([7, 8, 0])
    stored = part[2:, :, :8][::-1, ::-1].transpose(2, 0, 1)
    assert (onto_grid(stored, matrix, volume, "mask") == part).all()


@pytest.mark.parametrize(
    ("move", "message"),
    [
        (lambda m: m @ np.diag([1.0, 1.0, 1.2, 1.0]), "lies on another grid than the CT"),
        (lambda m: m + np.pad([[0.4], [0.0], [0.0]], ((0, 1), (3, 0))), "lies on another grid than the CT"),
        (lambda m: m + np.pad(m[:3, :1], ((0, 1), (3, 0))), "reaches out of the CT"),
    ],
)
def test_a_mask_of_another_frame_is_refused(volume: Volume, mask: np.ndarray, move, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        onto_grid(mask, move(volume.index_to_lps), volume, "mask")


def test_a_mask_of_another_shape_is_refused(volume: Volume) -> None:
    with pytest.raises(CaseError, match=r"reaches out of the CT \(9 x 9 x 10 voxels, the CT 8 x 9 x 10\)"):
        onto_grid(np.ones((9, 9, 10), dtype=bool), volume.index_to_lps, volume, "mask")


def test_a_dicom_seg_comes_back_by_number_and_label(tmp_path: Path) -> None:
    voxels = np.random.default_rng(5).integers(-1000, 1000, size=(6, 16, 18)).astype(np.int16)
    matrix = np.diag([2.0, 0.8, 0.8, 1.0])[[2, 1, 0, 3]]
    folder = tmp_path / "ct"
    write_series(Volume(voxels, matrix), folder)
    volume = read_series(folder).volume
    headers = sorted((pydicom.dcmread(path) for path in folder.rglob("*.dcm")), key=lambda d: float(d.ImagePositionPatient[2]))
    masks = np.zeros((*voxels.shape, 2), dtype=np.uint8)
    masks[2:4, 3:9, 4:12, 0] = 1  # empty slices need not be stored
    masks[1:5, 10:13, 5:7, 1] = 1
    described = [
        hd.seg.SegmentDescription(
            segment_number=k + 1, segment_label=label, segmented_property_category=codes.SCT.AnatomicalStructure,
            segmented_property_type=codes.SCT.Brain, algorithm_type=hd.seg.SegmentAlgorithmTypeValues.MANUAL,
        )
        for k, label in enumerate(("septum", "brain"))
    ]  # fmt: skip
    hd.seg.Segmentation(
        source_images=headers, pixel_array=masks, segmentation_type=hd.seg.SegmentationTypeValues.BINARY,
        segment_descriptions=described, series_instance_uid=hd.UID(), series_number=7, sop_instance_uid=hd.UID(),
        instance_number=1, manufacturer="test", manufacturer_model_name="test", software_versions="1",
        device_serial_number="1", omit_empty_frames=True,
    ).save_as(tmp_path / "labels.dcm")  # fmt: skip
    assert [(s.number, s.label) for s in read_segments(tmp_path / "labels.dcm")] == [(1, "septum"), (2, "brain")]
    for label, number in (("septum", 0), (2, 1), ("2", 1)):
        assert (read_mask(tmp_path / "labels.dcm", volume, label=label) == (masks[..., number] > 0)).all()
    with pytest.raises(CaseError, match=r"holds the segments 1 \(septum\), 2 \(brain\); one of them has to be named"):
        read_mask(tmp_path / "labels.dcm", volume)
    with pytest.raises(SeriesError, match=r"is no DICOM SEG object"):
        read_segments(next(folder.rglob("*.dcm")))


def test_a_missing_file_is_said_to_be_missing(volume: Volume, tmp_path: Path) -> None:
    for name, error in (("mask.nii", VolumeError), ("mask.dcm", SeriesError)):
        with pytest.raises(error, match=rf"{name}: there is no such file"):
            read_mask(tmp_path / name, volume)


def test_a_grid_may_miss_the_cts_by_the_digits_of_its_file_and_by_no_more(volume: Volume, mask: np.ndarray) -> None:
    step = volume.index_to_lps[:3, 0]
    near, far = volume.index_to_lps.copy(), volume.index_to_lps.copy()
    near[:3, 3] += 0.09 * step
    far[:3, 3] += 0.11 * step
    assert (onto_grid(mask, near, volume, "mask") == mask).all()
    with pytest.raises(CaseError, match="lies on another grid than the CT"):
        onto_grid(mask, far, volume, "mask")


def test_both_files_of_a_mask_with_a_header_of_its_own_are_named_with_their_digests(
    volume: Volume, mask: np.ndarray, tmp_path: Path
) -> None:
    path = write(mask.astype(np.uint8), volume.index_to_lps, tmp_path / "mask.mhd")
    read, files = read_mask_file(path, volume)
    assert (read == mask).all()
    named = [tmp_path / name for name, _ in files]
    assert {file.suffix for file in named} == {".mhd", ".raw"}
    assert [digest for _, digest in files] == [hashlib.sha256(file.read_bytes()).hexdigest() for file in named]
