"""A generator of small CT series whose every voxel tells where it lies, to be made faulty by the tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from segmentation.archive import unpack as unpack_archive

DATA = Path(__file__).parents[3].parent / "shared" / "data"

AXIAL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
# HU per mm along L, P, S: different for each axis, so that no swap or flip goes unseen.
FIELD = np.array([8.0, 13.0, 17.0])
FIELD_AT_ORIGIN = -100.0


def field_hu(points: np.ndarray) -> np.ndarray:
    """The value at (..., 3) LPS points, HU: a plane wave that is unique along every axis."""
    return points @ FIELD + FIELD_AT_ORIGIN


@dataclass(frozen=True)
class Maker:
    """Makes and saves series; `shape` is (slices, rows, columns), `spacing` mm along the same."""

    shape: tuple[int, int, int] = (8, 20, 26)
    spacing: tuple[float, float, float] = (1.5, 0.8, 0.7)

    def slices(
        self,
        *,
        orientation: Sequence[float] = AXIAL,
        shear: Sequence[float] = (0.0, 0.0, 0.0),
        depths: Sequence[float] | None = None,
        **attributes: object,
    ) -> list[FileDataset]:
        """Datasets along the normal (row x column), centred on the origin.

        `shear` moves each slice per mm of depth, `depths` (mm) replaces the even spacing,
        `attributes` are set on every slice.
        """
        row, column = np.array(orientation[:3]), np.array(orientation[3:])
        normal = np.cross(row, column)
        count, rows, columns = self.shape
        at = np.arange(count) * self.spacing[0] if depths is None else np.array(depths)
        corner = -0.5 * ((columns - 1) * self.spacing[2] * row + (rows - 1) * self.spacing[1] * column + at[-1] * normal)
        series, study, frame = generate_uid(), generate_uid(), generate_uid()
        made = []
        for number, depth in enumerate(at, start=1):
            position = np.round(corner + depth * (normal + np.array(shear)), 5)
            made.append(self._slice(number, position, (row, column), (series, study, frame)))
            for keyword, value in attributes.items():
                setattr(made[-1], keyword, value)
        return made

    def _slice(
        self, number: int, position: np.ndarray, axes: tuple[np.ndarray, np.ndarray], uids: tuple[str, str, str]
    ) -> FileDataset:
        _, rows, columns = self.shape
        j, i = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
        points = position + i[..., None] * self.spacing[2] * axes[0] + j[..., None] * self.spacing[1] * axes[1]
        meta = FileMetaDataset()
        meta.TransferSyntaxUID = ExplicitVRLittleEndian
        meta.MediaStorageSOPClassUID = CTImageStorage
        meta.MediaStorageSOPInstanceUID = generate_uid()
        slice_ = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
        slice_.SOPClassUID, slice_.SOPInstanceUID = CTImageStorage, meta.MediaStorageSOPInstanceUID
        slice_.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
        slice_.Modality, slice_.Manufacturer = "CT", "TESTER"
        slice_.PatientName, slice_.PatientID, slice_.PatientBirthDate = "Secret^Name", "SECRET-ID", "19700101"
        slice_.SeriesInstanceUID, slice_.StudyInstanceUID, slice_.FrameOfReferenceUID = uids
        slice_.SeriesNumber, slice_.InstanceNumber, slice_.AcquisitionNumber = 4, number, 1
        slice_.KVP, slice_.ConvolutionKernel, slice_.PatientPosition = 120, "B30f", "HFS"
        slice_.SliceThickness = 9.0  # never to be believed
        slice_.Rows, slice_.Columns, slice_.SamplesPerPixel = rows, columns, 1
        slice_.PhotometricInterpretation = "MONOCHROME2"
        slice_.BitsAllocated, slice_.BitsStored, slice_.HighBit, slice_.PixelRepresentation = 16, 16, 15, 1
        slice_.PixelSpacing = [self.spacing[1], self.spacing[2]]
        slice_.ImageOrientationPatient = [*axes[0].round(8), *axes[1].round(8)]
        slice_.ImagePositionPatient = list(position)
        slice_.RescaleSlope, slice_.RescaleIntercept = 1, -1024
        set_stored(slice_, np.rint(field_hu(points)) + 1024)
        return slice_

    def save(self, folder: Path, slices: Sequence[Dataset], *, names: Sequence[str] | None = None) -> Path:
        """Write the slices as files and return the folder."""
        folder.mkdir(parents=True, exist_ok=True)
        for k, slice_ in enumerate(slices):
            slice_.save_as(folder / (names[k] if names else f"IM{k:03d}.dcm"), enforce_file_format=True)
        return folder


def set_stored(slice_: Dataset, stored: np.ndarray) -> None:
    """Put stored values into a slice."""
    kind = "<i2" if slice_.PixelRepresentation else "<u2"
    slice_.PixelData = np.asarray(stored).astype(kind).tobytes()
    slice_["PixelData"].VR = "OW"


def get_stored(slice_: Dataset) -> np.ndarray:
    """Stored values of an uncompressed slice, writable."""
    kind = "<i2" if slice_.PixelRepresentation else "<u2"
    return np.frombuffer(slice_.PixelData, kind).reshape(slice_.Rows, slice_.Columns).copy()


@pytest.fixture
def maker() -> Maker:
    return Maker()


@pytest.fixture
def stored_values() -> tuple[Callable[[Dataset], np.ndarray], Callable[[Dataset, np.ndarray], None]]:
    """Reading and writing the stored values of a slice."""
    return get_stored, set_stored


@pytest.fixture
def lies_in_place() -> Callable[..., None]:
    """Asserts that every voxel of a volume holds the field's value at its LPS place."""

    def check(volume, tolerance: float = 0.5 + 0.02) -> None:
        # Rounding to whole HU is 0.5; the rest is for positions rounded to 1e-5 mm and axes to 1e-8.
        index = np.stack(np.meshgrid(*(np.arange(size) for size in volume.voxels.shape), indexing="ij"), axis=-1)
        error = np.abs(volume.voxels - field_hu(volume.to_lps(index)))
        assert error.max() <= tolerance

    return check


@pytest.fixture(scope="session")
def real_ct(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Gives the unpacked folder (or the file) of one of the shared real CTs."""
    unpacked: dict[str, Path] = {}

    def get(name: str) -> Path:
        if not DATA.is_dir():
            pytest.skip("the shared data are not beside the repository")
        case = DATA / name
        archives = list(case.glob("*.tar.xz"))
        if not archives:
            return case
        if name not in unpacked:
            unpacked[name] = tmp_path_factory.mktemp(name)
            unpack_archive(archives[0], unpacked[name])
        return unpacked[name]

    return get
