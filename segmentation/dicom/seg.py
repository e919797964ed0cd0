"""The mask of a lumen as a DICOM SEG object on its CT."""

from __future__ import annotations

from pathlib import Path

import highdicom as hd
import numpy as np
from pydicom.sr.codedict import codes

from segmentation.arrays import BoolArray
from segmentation.dicom.derived import SOFTWARE, SOFTWARE_VERSION, USE, DerivedWords, mark_identity, new_uid, source_headers
from segmentation.dicom.files import quiet_parser
from segmentation.errors import SeriesError

SERIES_NUMBER = 9001


def write_segmentation(mask: BoolArray, source: Path, path: Path, *, series: str | None, words: DerivedWords) -> None:
    """Write a mask in the grid of its CT as a DICOM SEG object [1]_.

    Parameters
    ----------
    mask : (slices, rows, columns) bool array
        On the volume that `read_series` gives for the same `source` and `series`.
    source : Path
        The DICOM folder.
    path : Path
        File to write.
    series : str or None
        As for `read_series`.
    words : DerivedWords

    Raises
    ------
    SeriesError
        If the series cannot be read, has another grid than the mask, or the mask is empty.

    References
    ----------
    .. [1] DICOM PS3.3, A.51 Segmentation IOD.
    """
    headers, frames = source_headers(source, series, words)
    grid = (len(frames), int(headers[0].Rows), int(headers[0].Columns))
    if mask.shape != grid:
        raise SeriesError(f"{source.name}: its grid is {grid}, that of the mask {mask.shape}; it is not the CT of this mask")
    if not mask.any():
        raise SeriesError(f"{source.name}: the mask is empty; there is no segmentation to write")
    # highdicom takes the frames of a multi-frame file in the file's own order.
    stored = mask if len(headers) > 1 else mask[np.argsort(frames)]
    segment = hd.seg.SegmentDescription(
        segment_number=1,
        segment_label=f"Lumen, {words.anatomy}",
        segmented_property_category=codes.SCT.AnatomicalStructure,
        segmented_property_type=words.structure,
        algorithm_type=hd.seg.SegmentAlgorithmTypeValues.AUTOMATIC,
        algorithm_identification=hd.AlgorithmIdentificationSequence(
            name="Region growing with leak control", family=codes.DCM.NeighborhoodAnalysis, version=SOFTWARE_VERSION
        ),
        tracking_uid=new_uid(),
        tracking_id="lumen",
    )
    with quiet_parser():  # highdicom quotes a kept name that it finds unusual
        made = hd.seg.Segmentation(
            source_images=headers,
            pixel_array=stored.astype(np.uint8),
            segmentation_type=hd.seg.SegmentationTypeValues.BINARY,
            segment_descriptions=[segment],
            series_instance_uid=new_uid(),
            series_number=SERIES_NUMBER,
            sop_instance_uid=new_uid(),
            instance_number=1,
            manufacturer=SOFTWARE,
            manufacturer_model_name=SOFTWARE,
            software_versions=SOFTWARE_VERSION,
            device_serial_number="none",
            content_label="LUMEN",
            content_description=USE,
            series_description="Lumen, mask",
        )
    mark_identity(made, words)
    made.save_as(path)
