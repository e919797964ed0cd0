"""A surface as STL, plain and encapsulated in DICOM in the coordinates of its CT."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sr.codedict import codes
from pydicom.sr.coding import Code
from pydicom.uid import EncapsulatedSTLStorage, ExplicitVRLittleEndian

from segmentation.dicom.derived import (
    IDENTITY,
    SOFTWARE,
    SOFTWARE_VERSION,
    USE,
    DerivedWords,
    mark_identity,
    new_uid,
    source_headers,
)
from segmentation.mesh import Surface
from segmentation.mesh_exports import stl_bytes

SERIES_NUMBER = 9002
CONTENT = "Lumen surface from CT; LPS, mm"


def write_encapsulated_stl(surface: Surface, source: Path, path: Path, *, series: str | None, words: DerivedWords) -> None:
    """Write a surface as a DICOM Encapsulated STL object [1]_ in the CT's frame of reference.

    The vertices are LPS patient coordinates in mm, as the frame of reference has them. Binary STL
    holds single precision: within 0.00003 mm at 500 mm from the origin.

    Parameters
    ----------
    surface : Surface
        In LPS.
    source : Path
        The DICOM folder of the CT.
    path : Path
        File to write.
    series : str or None
        As for `read_series`.
    words : DerivedWords

    Raises
    ------
    SeriesError
        If the series cannot be read.

    References
    ----------
    .. [1] DICOM PS3.3, A.85.1 Encapsulated STL IOD; C.35.1 Manufacturing 3D Model.
    """
    headers, _ = source_headers(source, series, words)
    made = _common(headers[0], words)
    document = stl_bytes(surface)
    made.EncapsulatedDocumentLength = len(document)
    made.EncapsulatedDocument = document + b"\0" * (len(document) % 2)
    made.SourceInstanceSequence = [_reference(header, codes.DCM.SourceImage) for header in headers]
    series_item = Dataset()
    series_item.SeriesInstanceUID = headers[0].SeriesInstanceUID
    series_item.ReferencedInstanceSequence = [_reference(header) for header in headers]
    made.ReferencedSeriesSequence = [series_item]
    made.save_as(path, enforce_file_format=True)


def _common(header: Dataset, words: DerivedWords) -> Dataset:
    """Everything but the document and the references."""
    now = datetime.now(UTC)
    made = Dataset()
    made.SpecificCharacterSet = header.get("SpecificCharacterSet", "ISO_IR 192")
    made.SOPClassUID, made.SOPInstanceUID = EncapsulatedSTLStorage, new_uid()
    for keyword in IDENTITY:
        made[keyword] = header[keyword]
    mark_identity(made, words)
    made.StudyInstanceUID = header.StudyInstanceUID
    made.Modality = "M3D"
    made.SeriesInstanceUID, made.SeriesNumber = new_uid(), SERIES_NUMBER
    made.SeriesDescription = "Lumen, surface"
    made.FrameOfReferenceUID = header.FrameOfReferenceUID
    made.PositionReferenceIndicator = header.get("PositionReferenceIndicator", "")
    made.Manufacturer = made.ManufacturerModelName = SOFTWARE
    made.DeviceSerialNumber, made.SoftwareVersions = "none", SOFTWARE_VERSION
    made.InstanceNumber = 1
    made.ContentDate, made.ContentTime = now.strftime("%Y%m%d"), now.strftime("%H%M%S")
    made.AcquisitionDateTime = ""
    made.BurnedInAnnotation = "NO"
    made.RecognizableVisualFeatures = "YES"  # even a derived surface may show a face
    made.DocumentTitle = f"Lumen, {words.anatomy}; {USE.lower()}"
    made.ConceptNameCodeSequence = [_code(codes.LN.CT3DCAMModel)]
    made.MIMETypeOfEncapsulatedDocument = "model/stl"
    made.MeasurementUnitsCodeSequence = [_code(codes.UCUM.Millimeter)]
    made.ModelModification = "NO"
    made.ModelMirroring = "NO"
    made.ModelUsageCodeSequence = [_code(codes.DCM.PlanningIntent)]
    made.ContentDescription = CONTENT
    made.file_meta = FileMetaDataset()
    made.file_meta.MediaStorageSOPClassUID = EncapsulatedSTLStorage
    made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
    made.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    return made


def _reference(header: Dataset, purpose: Code | None = None) -> Dataset:
    item = Dataset()
    item.ReferencedSOPClassUID, item.ReferencedSOPInstanceUID = header.SOPClassUID, header.SOPInstanceUID
    if purpose is not None:
        item.PurposeOfReferenceCodeSequence = [_code(purpose)]
    return item


def _code(code: Code) -> Dataset:
    item = Dataset()
    item.CodeValue, item.CodingSchemeDesignator, item.CodeMeaning = code.value, code.scheme_designator, code.meaning
    return item
