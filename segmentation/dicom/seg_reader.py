"""Segments of a DICOM SEG object as masks with their place in the patient."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import highdicom as hd
import numpy as np
from pydicom.errors import InvalidDicomError

from segmentation.arrays import BoolArray, FloatArray
from segmentation.dicom.files import quiet_parser
from segmentation.errors import SeriesError


@dataclass(frozen=True, eq=False)
class Segment:
    """One segment.

    Attributes
    ----------
    number : int
    label : str
    mask : (slices, rows, columns) bool array
        May cover fewer slices than the CT: empty ones need not be stored.
    index_to_lps : (4, 4) float array, mm
    """

    number: int
    label: str
    mask: BoolArray
    index_to_lps: FloatArray


def read_segments(path: Path) -> tuple[Segment, ...]:
    """All segments of a DICOM SEG file.

    Raises
    ------
    SeriesError
        If the file is missing, is no segmentation, or its frames make no regular stack.
    """
    if not path.is_file():
        raise SeriesError(f"{path.name}: there is no such file; check the path")
    with quiet_parser():
        try:
            stored = hd.seg.segread(path)
        except (InvalidDicomError, ValueError, AttributeError, KeyError, OSError) as error:
            raise SeriesError(f"{path.name}: is no DICOM SEG object that can be read; export the segmentation again") from error
        found = []
        for number in stored.segment_numbers:
            try:
                volume = stored.get_volume(segment_numbers=[number], combine_segments=True)
            except (ValueError, RuntimeError) as error:
                raise SeriesError(
                    f"{path.name}: segment {number} makes no regular stack of slices; export it on the CT's grid"
                ) from error
            label = str(stored.get_segment_description(number).segment_label)
            found.append(Segment(int(number), label, np.asarray(volume.array) > 0, np.asarray(volume.affine, dtype=float)))
    return tuple(found)
