"""DICOM folder to volume, fail closed: the only home of pydicom and highdicom."""

from segmentation.dicom.derived import DerivedWords
from segmentation.dicom.facts import PADDING, describe_orientation, geometry_facts, padding_facts
from segmentation.dicom.hounsfield import FILL_HU, require_hounsfield, settle_fill, to_hounsfield
from segmentation.dicom.inspection import inspect_folder
from segmentation.dicom.reader import DicomVolume, read_series
from segmentation.dicom.seg import write_segmentation
from segmentation.dicom.series import Progress, SeriesInfo, scan_folder
from segmentation.dicom.stl import write_encapsulated_stl
from segmentation.dicom.write import SeriesWords, write_series

__all__ = [
    "FILL_HU",
    "PADDING",
    "DerivedWords",
    "DicomVolume",
    "Progress",
    "SeriesInfo",
    "SeriesWords",
    "describe_orientation",
    "geometry_facts",
    "inspect_folder",
    "padding_facts",
    "read_series",
    "require_hounsfield",
    "scan_folder",
    "settle_fill",
    "to_hounsfield",
    "write_encapsulated_stl",
    "write_segmentation",
    "write_series",
]
