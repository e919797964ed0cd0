"""What the gate needs to know of one slice, taken out of a DICOM header once.

A value that is missing or malformed becomes ``None`` (numbers) or ``""`` (texts);
the gate decides what that means.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from pydicom.dataset import Dataset

from segmentation.dicom.files import UNREADABLE, DicomFile, Head
from segmentation.errors import SeriesError

CT_CLASSES = {
    "1.2.840.10008.5.1.4.1.1.2": "CT image",
    "1.2.840.10008.5.1.4.1.1.2.1": "Enhanced CT image",
    "1.2.840.10008.5.1.4.1.1.2.2": "Legacy converted enhanced CT image",
}
_PLAIN_CT = "1.2.840.10008.5.1.4.1.1.2"
_DIRECTORY = "1.2.840.10008.1.3.10"


@dataclass(frozen=True, kw_only=True)
class SliceHeader:
    """One slice: a single-frame file or one frame of a multi-frame file.

    Attributes
    ----------
    file : DicomFile
    frame : int or None
        Index of the frame in a multi-frame file.
    frames : int
        Number of frames in the file.
    spacing : (2,) floats or None, mm
        Between rows, between columns (PixelSpacing).
    orientation : (6,) floats or None
        Direction of increasing column index, then of increasing row index, LPS.
    position : (3,) floats or None, mm, LPS
        Centre of the first pixel.
    padding : (2,) ints or None
        Lowest and highest stored value that means "no image here".
    patient, study, series, instance : str
        Compared, never printed.
    head : (int, str) or None
        Mark of the file's header, see `files.read_head`: equal bytes need not be understood again.
    """

    file: DicomFile = field(repr=False)
    frame: int | None
    frames: int
    syntax: str
    sop_class: str
    instance: str = field(repr=False)
    modality: str
    image_type: tuple[str, ...]
    patient: tuple[str, ...] = field(repr=False)
    study: str = field(repr=False)
    series: str = field(repr=False)
    frame_of_reference: str = field(repr=False)
    series_number: int | None
    acquisition: int | None
    instance_number: int | None
    images_in_acquisition: int | None
    kernel: str
    phase: tuple[str, ...]
    kvp: float | None
    thickness: float | None
    manufacturer: str
    patient_position: str
    contrast: bool
    rows: int | None
    columns: int | None
    samples: int | None
    photometric: str
    bits_allocated: int | None
    bits_stored: int | None
    high_bit: int | None
    signed: bool
    spacing: tuple[float, ...] | None
    orientation: tuple[float, ...] | None
    position: tuple[float, ...] | None
    slope: float | None
    intercept: float | None
    rescale_type: str
    value_table: bool
    padding: tuple[int, int] | None
    tilt: float | None
    lossy: bool
    head: Head | None = field(default=None, repr=False, compare=False)

    @property
    def name(self) -> str:
        """How messages name the slice: its file, and the frame counted from 1."""
        return self.file.name if self.frame is None else f"{self.file.name} frame {self.frame + 1}"

    @property
    def matrix(self) -> tuple[int, int]:
        """Rows and columns.

        Raises
        ------
        SeriesError
            If the header lacks them.
        """
        if self.rows is None or self.columns is None:
            raise SeriesError(f"{self.name} has no usable Rows and Columns; export it again")
        return self.rows, self.columns

    @property
    def rescale(self) -> tuple[float, float]:
        """HU per stored value, and HU of stored value 0.

        Raises
        ------
        SeriesError
            If the header lacks them.
        """
        if self.slope is None or self.intercept is None:
            raise SeriesError(
                f"{self.name} has no usable rescale slope and intercept, so its values are no HU; export it with them"
            )
        return self.slope, self.intercept

    @property
    def is_ct(self) -> bool:
        """Whether the image class is CT; stripped headers without a class go by their modality."""
        return self.sop_class in CT_CLASSES or (not self.sop_class and self.modality == "CT")

    @property
    def is_localizer(self) -> bool:
        """Whether this is a scout view that only shares the folder."""
        return "LOCALIZER" in self.image_type


def slice_headers(dataset: Dataset, file: DicomFile, *, head: Head | None = None) -> tuple[SliceHeader, ...]:
    """The slices in one parsed file, with its mark: one, or one per frame; none for a directory record.

    Raises
    ------
    SeriesError
        If the header's own structure is broken.
    """
    try:
        return tuple(replace(header, head=head) for header in _headers(dataset, file))
    except UNREADABLE as error:
        raise SeriesError(f"{file.name} has a damaged header ({type(error).__name__}); export it again") from error


def _headers(dataset: Dataset, file: DicomFile) -> Iterator[SliceHeader]:
    meta = dataset.file_meta
    sop_class = _text(dataset, "SOPClassUID") or _text(meta, "MediaStorageSOPClassUID")
    if sop_class == _DIRECTORY:
        return
    count = _integer(dataset, "NumberOfFrames") or 1
    plain = _single(dataset, file, sop_class)
    if sop_class in CT_CLASSES and sop_class != _PLAIN_CT:
        shared = _item(dataset, "SharedFunctionalGroupsSequence")
        per_frame = dataset.get("PerFrameFunctionalGroupsSequence") or []
        if len(per_frame) != count:
            raise SeriesError(f"{file.name} describes {len(per_frame)} frames but declares {count}; export it again")
        for index, groups in enumerate(per_frame):
            yield _frame(plain, (groups, shared), index, count)
    else:
        yield replace(plain, frames=count)


def _single(dataset: Dataset, file: DicomFile, sop_class: str) -> SliceHeader:
    signed = _integer(dataset, "PixelRepresentation") == 1
    return SliceHeader(
        file=file,
        frame=None,
        frames=1,
        syntax=_text(dataset.file_meta, "TransferSyntaxUID"),
        sop_class=sop_class,
        instance=_text(dataset, "SOPInstanceUID"),
        modality=_text(dataset, "Modality"),
        image_type=_words(dataset, "ImageType"),
        patient=(_text(dataset, "PatientID"), _text(dataset, "PatientName"), _text(dataset, "PatientBirthDate")),
        study=_text(dataset, "StudyInstanceUID"),
        series=_text(dataset, "SeriesInstanceUID"),
        frame_of_reference=_text(dataset, "FrameOfReferenceUID"),
        series_number=_integer(dataset, "SeriesNumber"),
        acquisition=_integer(dataset, "AcquisitionNumber"),
        instance_number=_integer(dataset, "InstanceNumber"),
        images_in_acquisition=_integer(dataset, "ImagesInAcquisition"),
        kernel=_text(dataset, "ConvolutionKernel"),
        phase=(_text(dataset, "TemporalPositionIdentifier"), _text(dataset, "NominalPercentageOfCardiacPhase")),
        kvp=_number(dataset, "KVP"),
        thickness=_number(dataset, "SliceThickness"),
        manufacturer=_text(dataset, "Manufacturer"),
        patient_position=_text(dataset, "PatientPosition"),
        contrast=any(
            _text(dataset, keyword).upper() not in ("", "NONE", "NO", "0", "[]")
            for keyword in ("ContrastBolusAgent", "ContrastBolusRoute", "ContrastBolusAgentSequence")
        ),
        rows=_integer(dataset, "Rows"),
        columns=_integer(dataset, "Columns"),
        samples=_integer(dataset, "SamplesPerPixel"),
        photometric=_text(dataset, "PhotometricInterpretation"),
        bits_allocated=_integer(dataset, "BitsAllocated"),
        bits_stored=_integer(dataset, "BitsStored"),
        high_bit=_integer(dataset, "HighBit"),
        signed=signed,
        spacing=_numbers(dataset, "PixelSpacing", 2),
        orientation=_numbers(dataset, "ImageOrientationPatient", 6),
        position=_numbers(dataset, "ImagePositionPatient", 3),
        slope=_number(dataset, "RescaleSlope"),
        intercept=_number(dataset, "RescaleIntercept"),
        rescale_type=_text(dataset, "RescaleType"),
        value_table="ModalityLUTSequence" in dataset,
        padding=_padding(dataset, signed=signed),
        tilt=_number(dataset, "GantryDetectorTilt"),
        lossy=_text(dataset, "LossyImageCompression") == "01",
    )


def _frame(plain: SliceHeader, groups: tuple[Dataset, Dataset], index: int, count: int) -> SliceHeader:
    """The header of one frame; a group of its own goes before the one shared by all frames."""

    def group(keyword: str) -> Dataset:
        return next((_item(part, keyword) for part in groups if part.get(keyword)), Dataset())

    values = group("PixelValueTransformationSequence")
    measures = group("PixelMeasuresSequence")
    content = group("FrameContentSequence")
    rays = group("CTXRayDetailsSequence")
    return replace(
        plain,
        frame=index,
        frames=count,
        image_type=_words(group("CTImageFrameTypeSequence"), "FrameType") or plain.image_type,
        acquisition=_integer(content, "FrameAcquisitionNumber"),
        instance_number=_integer(content, "InStackPositionNumber"),
        images_in_acquisition=None,
        kernel=_text(group("CTReconstructionSequence"), "ConvolutionKernel") or plain.kernel,
        phase=(
            _text(content, "TemporalPositionIndex"),
            _text(content, "NominalPercentageOfCardiacPhase"),
            _text(content, "StackID"),
        ),
        kvp=_number(rays, "KVP") or plain.kvp,
        thickness=_number(measures, "SliceThickness"),
        spacing=_numbers(measures, "PixelSpacing", 2),
        orientation=_numbers(group("PlaneOrientationSequence"), "ImageOrientationPatient", 6),
        position=_numbers(group("PlanePositionSequence"), "ImagePositionPatient", 3),
        slope=_number(values, "RescaleSlope"),
        intercept=_number(values, "RescaleIntercept"),
        rescale_type=_text(values, "RescaleType"),
        tilt=_number(group("CTAcquisitionDetailsSequence"), "GantryDetectorTilt"),
    )


def _padding(dataset: Dataset, *, signed: bool) -> tuple[int, int] | None:
    value = _integer(dataset, "PixelPaddingValue")
    if value is None:
        return None
    limit = _integer(dataset, "PixelPaddingRangeLimit")
    # Written as US or SS at the writer's whim: fold both into the range of the stored values.
    ends = [(end & 0xFFFF) - (0x10000 if signed and end & 0x8000 else 0) for end in (value, value if limit is None else limit)]
    return min(ends), max(ends)


def _item(dataset: Dataset, keyword: str) -> Dataset:
    sequence = dataset.get(keyword)
    return sequence[0] if sequence else Dataset()


def _text(dataset: Dataset, keyword: str) -> str:
    value = dataset.get(keyword)
    if value is None:
        return ""
    if isinstance(value, (list, tuple)) or type(value).__name__ == "MultiValue":
        return "\\".join(str(part).strip() for part in value)
    return str(value).strip()


def _words(dataset: Dataset, keyword: str) -> tuple[str, ...]:
    return tuple(word for word in _text(dataset, keyword).upper().split("\\") if word)


def _numbers(dataset: Dataset, keyword: str, count: int) -> tuple[float, ...] | None:
    try:
        value = dataset.get(keyword)
        if value is None or value == "":
            return None
        numbers = tuple(float(part) for part in (value if count > 1 else [value]))
    except (ValueError, TypeError):
        return None
    return numbers if len(numbers) == count else None


def _number(dataset: Dataset, keyword: str) -> float | None:
    numbers = _numbers(dataset, keyword, 1)
    return numbers[0] if numbers and math.isfinite(numbers[0]) else None


def _integer(dataset: Dataset, keyword: str) -> int | None:
    number = _number(dataset, keyword)
    return int(number) if number is not None and abs(number) < 1 << 31 else None
