"""A volume as a DICOM CT series: for generated data, never for a patient's."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

from segmentation.arrays import FloatArray
from segmentation.errors import SeriesError
from segmentation.volume import Volume

# PS3.5 annex B.2: a UID derived from a UUID needs no registered root.
UUID_ROOT = "2.25."
NAMESPACE = uuid.UUID("6f0d4f0e-5c1e-5c57-9d0b-2b8d7a5f3c11")
RESCALE_INTERCEPT = -1024


@dataclass(frozen=True, kw_only=True)
class SeriesWords:
    """The words of a generated series. None of them may come from a patient.

    Attributes
    ----------
    patient_name, patient_id : str
    study, series : str
        Descriptions.
    body_part, kernel : str
    kvp : float, kV
    window_center, window_width : float, HU
    """

    patient_name: str = "Phantom^Urography"
    patient_id: str = "PHANTOM"
    study: str = "CT urography (generated)"
    series: str = "Excretory phase (generated)"
    body_part: str = "ABDOMEN"
    kernel: str = "GENERATED"
    kvp: float = 120.0
    window_center: float = 60.0
    window_width: float = 500.0


def write_series(
    volume: Volume,
    folder: str | Path,
    *,
    seed: int = 0,
    words: SeriesWords | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Path, ...]:
    """Write one CT Image Storage file for each slice, explicit VR little endian, int16 as it is.

    The bytes depend on the voxels, the geometry, `seed` and `words` alone.

    Parameters
    ----------
    volume : Volume
        HU from -1024 on; slices perpendicular to rows and columns.
    folder : str or Path
        Made if it does not exist; must be empty.
    seed : int
        UIDs are derived from it and from the voxels' place.
    words : SeriesWords, optional
    progress : callable, optional
        Called with (slices done, all).

    Returns
    -------
    tuple of Path
        The files, first slice first.

    Raises
    ------
    SeriesError
        If the folder holds something or cannot be written to, the voxels do not fit, or the axes are not orthogonal.

    References
    ----------
    .. [1] DICOM PS3.3, A.3 CT Image IOD; C.7.6.2 Image Plane; C.8.2.1 CT Image.
    """
    folder = Path(folder)
    words = words or SeriesWords()
    axes = np.asarray(volume.index_to_lps[:3, :3]) / volume.spacing
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-6:
        raise SeriesError("the volume's axes are not at right angles; a CT series cannot hold it, resample it first")
    if int(volume.voxels.min()) < RESCALE_INTERCEPT:
        raise SeriesError(f"the least voxel is {int(volume.voxels.min())} HU, expected {RESCALE_INTERCEPT} or more")
    if int(volume.voxels.max()) - RESCALE_INTERCEPT > np.iinfo(np.int16).max:
        raise SeriesError(
            f"the largest voxel is {int(volume.voxels.max())} HU, more than 16 bits can store above {RESCALE_INTERCEPT}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise SeriesError(f"{folder.name}: the folder is not empty; give a new one")
    common = _common(volume, axes, seed, words)
    paths = []
    for number in range(volume.voxels.shape[0]):
        path = folder / f"slice_{number + 1:04d}.dcm"
        # Into memory first: what pydicom says of a disk that is full is none of the system's errors any more.
        content = BytesIO()
        _slice(volume, common, number, seed).save_as(content, enforce_file_format=True)
        try:
            path.write_bytes(content.getvalue())
        except OSError as fault:
            reason = (fault.strerror or "the system refuses").lower()
            raise SeriesError(
                f"{folder.name}: {path.name} cannot be written ({reason}); make room or choose another place"
            ) from None
        paths.append(path)
        if progress is not None:
            progress(number + 1, volume.voxels.shape[0])
    return tuple(paths)


def _uid(seed: int, what: str) -> str:
    return UUID_ROOT + str(uuid.uuid5(NAMESPACE, f"{seed}/{what}").int)


def _decimal(value: float) -> str:
    """A decimal string (VR DS) of at most 16 characters."""
    for digits in range(15, 5, -1):
        text = f"{value + 0.0:.{digits}g}"
        if len(text) <= 16:
            return text
    raise SeriesError(f"{value!r} does not fit a DICOM decimal string of 16 characters")


def _common(volume: Volume, axes: FloatArray, seed: int, words: SeriesWords) -> Dataset:
    """Attributes that all slices share: patient, study, series, frame of reference, equipment, plane and pixels."""
    d = Dataset()
    d.SpecificCharacterSet = "ISO_IR 192"
    d.ImageType = ["DERIVED", "SECONDARY", "AXIAL"]
    d.SOPClassUID = CTImageStorage
    d.StudyDate, d.StudyTime = "", ""
    d.AccessionNumber = ""
    d.Modality = "CT"
    d.Manufacturer = "tubeplan"
    d.ReferringPhysicianName = ""
    d.StudyDescription = words.study
    d.SeriesDescription = words.series
    d.ManufacturerModelName = "synthetic"
    d.PatientName = words.patient_name
    d.PatientID = words.patient_id
    d.PatientBirthDate = ""
    d.PatientSex = ""
    d.PatientIdentityRemoved = "YES"
    d.DeidentificationMethod = "Generated by calculation, no patient"
    d.ContrastBolusAgent = "simulated"
    d.BodyPartExamined = words.body_part
    d.SliceThickness = _decimal(float(volume.spacing[0]))
    d.KVP = _decimal(words.kvp)
    d.SoftwareVersions = "tubeplan"
    d.ConvolutionKernel = words.kernel
    d.PatientPosition = "HFS"
    d.StudyInstanceUID = _uid(seed, "study")
    d.SeriesInstanceUID = _uid(seed, "series")
    d.StudyID = "1"
    d.SeriesNumber = 1
    d.AcquisitionNumber = 1
    d.ImageOrientationPatient = [_decimal(float(x)) for x in (*axes[:, 2], *axes[:, 1])]
    d.FrameOfReferenceUID = _uid(seed, "frame of reference")
    d.PositionReferenceIndicator = ""
    d.SamplesPerPixel = 1
    d.PhotometricInterpretation = "MONOCHROME2"
    d.Rows, d.Columns = volume.voxels.shape[1:]
    d.PixelSpacing = [_decimal(float(x)) for x in volume.spacing[1:]]
    d.BitsAllocated, d.BitsStored, d.HighBit, d.PixelRepresentation = 16, 16, 15, 1
    d.WindowCenter, d.WindowWidth = _decimal(words.window_center), _decimal(words.window_width)
    d.RescaleIntercept, d.RescaleSlope, d.RescaleType = str(RESCALE_INTERCEPT), "1", "HU"
    return d


def _slice(volume: Volume, common: Dataset, number: int, seed: int) -> Dataset:
    d = Dataset()
    d.update(common)
    d.SOPInstanceUID = _uid(seed, f"slice {number}")
    d.InstanceNumber = number + 1
    position = volume.to_lps(np.array([number, 0, 0]))
    d.ImagePositionPatient = [_decimal(float(x)) for x in np.round(position, 6)]
    normal = volume.index_to_lps[:3, 0] / volume.spacing[0]
    d.SliceLocation = _decimal(float(np.round(position @ normal, 6)))
    d.PixelData = (volume.voxels[number].astype(np.int32) - RESCALE_INTERCEPT).astype("<i2").tobytes()
    d["PixelData"].VR = "OW"
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = CTImageStorage
    meta.MediaStorageSOPInstanceUID = d.SOPInstanceUID
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    meta.ImplementationClassUID = _uid(0, "implementation")
    meta.ImplementationVersionName = "TUBEPLAN"
    d.file_meta = meta
    return d
