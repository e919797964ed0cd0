"""What every DICOM instance made from a CT series says of its source: as much as places it, and no more."""

# Strategy: a derived instance must say of whom it is, to which study it belongs, in whose
# coordinates it lies and from which images it was made. The last three are unique numbers
# (UIDs) without which it would not lie on the CT, so they are copied; a UID tells who a patient
# is only to someone who has the archive. Everything else about the patient and the study
# (PS3.3 C.7.1.1, C.7.2.1) is type 2 there: it must be present and may be empty, and is empty
# unless the caller asks to keep it. Headers are built from an allow-list, never by copying one
# and taking things out.

from __future__ import annotations

import uuid
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sr.codedict import codes
from pydicom.sr.coding import Code

from segmentation.arrays import IntArray
from segmentation.dicom.files import quiet_parser, read_header
from segmentation.dicom.reader import admit
from segmentation.dicom.series import choose_series, scan_folder
from segmentation.dicom.write import UUID_ROOT
from segmentation.errors import SeriesError

SOFTWARE, SOFTWARE_VERSION = "tubeplan", version("tubeplan")
USE = "Research use, not for clinical decisions"
DEIDENTIFIED = "Only UIDs and geometry were copied"

# SNOMED CT as in DICOM's context group 7151 (anatomical structures that are segmented).
LUMEN_CODES = {
    "airway": codes.SCT.TracheaAndBronchus,
    "urinary": codes.SCT.UpperUrinaryTract,
    "vessel": codes.SCT.LumenOfBloodVessel,
}

# What places the images and names them; nothing here names a person.
GEOMETRY = (
    "SOPClassUID",
    "SOPInstanceUID",
    "StudyInstanceUID",
    "SeriesInstanceUID",
    "FrameOfReferenceUID",
    "PositionReferenceIndicator",
    "Modality",
    "ImageType",
    "ImagePositionPatient",
    "ImageOrientationPatient",
    "PixelSpacing",
    "SliceThickness",
    "Rows",
    "Columns",
    "SamplesPerPixel",
    "PhotometricInterpretation",
    "BitsAllocated",
    "BitsStored",
    "HighBit",
    "PixelRepresentation",
    "NumberOfFrames",
    "SharedFunctionalGroupsSequence",
    "PerFrameFunctionalGroupsSequence",
)
# Type 2 of the Patient and General Study modules: present, and empty unless kept.
IDENTITY = (
    "PatientName",
    "PatientID",
    "PatientBirthDate",
    "PatientSex",
    "AccessionNumber",
    "StudyID",
    "StudyDate",
    "StudyTime",
    "ReferringPhysicianName",
)


@dataclass(frozen=True, kw_only=True)
class DerivedWords:
    """What a derived instance says beside its content.

    Attributes
    ----------
    case_id : str
        Stands for the patient's name and number; no patient's own.
    anatomy : str
        What the lumen is: "airway", "urinary", "vessel", or anything else for a lumen without a name.
    keep_identifiers : bool
        Copy the patient's and the study's attributes, so that an archive files the instance with its CT.
    """

    case_id: str
    anatomy: str = "generic"
    keep_identifiers: bool = False

    @property
    def structure(self) -> Code:
        """Code of what the lumen is."""
        return LUMEN_CODES.get(self.anatomy, codes.SCT.Lumen)


def source_headers(source: Path, series: str | None, words: DerivedWords) -> tuple[list[Dataset], IntArray]:
    """Headers of the images of one series, reduced to what a derived instance needs.

    Returns
    -------
    headers : list of Dataset
        One for each file, in the order of the slices.
    frames : (slices,) int array
        For each slice of the volume its frame within its file, from 0.

    Raises
    ------
    SeriesError
        As for `read_series`.
    """
    source = source.resolve()
    chosen, _ = choose_series(scan_folder(source), series, source.name)
    try:
        slices = admit(chosen.headers).slices
        files = list(dict.fromkeys(slice_.file for slice_ in slices))
        if 1 < len(files) < len(slices):
            raise SeriesError("the series is spread over several multi-frame files; export it as one file or single slices")
        with quiet_parser():
            headers = [reduced(read_header(file), words) for file in files]
    except SeriesError as fault:
        raise SeriesError(f"{source.name}: {fault}") from fault
    return headers, np.array([slice_.frame or 0 for slice_ in slices], dtype=np.int64)


def reduced(header: Dataset, words: DerivedWords) -> Dataset:
    """An image's header by the allow-list, with the patient's and study's attributes as `words` says."""
    made = Dataset()
    for keyword in GEOMETRY:
        if keyword in header:
            made[keyword] = header[keyword]
    if words.keep_identifiers:
        for keyword in ("SpecificCharacterSet", *IDENTITY):
            if keyword in header:
                made[keyword] = header[keyword]
    else:
        # The caret says that a name of one component is meant.
        made.PatientName, made.PatientID = f"{words.case_id}^", words.case_id
    for keyword in IDENTITY:
        if keyword not in made:
            setattr(made, keyword, "")
    made.file_meta = FileMetaDataset()
    made.file_meta.TransferSyntaxUID = header.file_meta.TransferSyntaxUID
    return made


def mark_identity(made: Dataset, words: DerivedWords) -> None:
    """Say in an instance whether its patient's identity was left out (PS3.3 C.7.1.1)."""
    if not words.keep_identifiers:
        made.PatientIdentityRemoved = "YES"
        made.DeidentificationMethod = DEIDENTIFIED


def new_uid() -> str:
    """A UID of its own for a new instance or series (PS3.5, B.2)."""
    return UUID_ROOT + str(uuid.uuid4().int)
