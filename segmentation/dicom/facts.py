"""Printable facts of a series or volume: an allow-list, nothing that identifies a patient."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.dicom.headers import SliceHeader
from segmentation.dicom.hounsfield import FILL_HU
from segmentation.dicom.series import printable

# Where the facts of an image tell of voxels outside the scan.
PADDING = "Padding"
_AXES = ("sagittal", "coronal", "axial")
_ENTRY = {
    "HF": "head first",
    "FF": "feet first",
    "LF": "left first",
    "RF": "right first",
    "AF": "anterior first",
    "PF": "posterior first",
}
_LYING = {"S": "supine", "P": "prone", "DR": "lying on the right side", "DL": "lying on the left side"}


def series_facts(slices: Sequence[SliceHeader]) -> dict[str, str]:
    """What the headers say of the scan, label to printed value, in reading order."""
    first = slices[0]
    stated = {
        "Modality": printable(first.modality),
        "Manufacturer": printable(first.manufacturer),
        "Kernel": printable(first.kernel),
        "Tube voltage": f"{first.kvp:g} kVp" if first.kvp else "",
        "Slice thickness": f"{first.thickness:g} mm" if first.thickness is not None else "",
        "Contrast agent": "yes" if first.contrast else "not stated",
        "Patient position": describe_position(first.patient_position),
    }
    return {label: value for label, value in stated.items() if value}


def geometry_facts(index_to_lps: FloatArray, shape: tuple[int, ...]) -> dict[str, str]:
    """Spacing, matrix, slice count and orientation of a volume as printed values."""
    spacing = np.linalg.norm(index_to_lps[:3, :3], axis=0)
    return {
        "Spacing": f"{spacing[2]:.3f} x {spacing[1]:.3f} x {spacing[0]:.3f} mm (column, row, slice)",
        "Matrix": f"{shape[2]} x {shape[1]}",
        "Slices": str(shape[0]),
        "Orientation": describe_orientation(index_to_lps),
    }


def padding_facts(declared: int, filled: int) -> dict[str, str]:
    """Voxels outside what was scanned, by a declared value or by one far below air, as a printed value; empty without any."""
    told = [f"{declared} voxels outside the scan (declared value)"] if declared else []
    told += [f"{filled} voxels outside the scan (undeclared value far below air)"] if filled else []
    return {PADDING: f"{' and '.join(told)}, read as {FILL_HU} HU"} if told else {}


def describe_orientation(index_to_lps: FloatArray) -> str:
    """Slice plane in words, e.g. ``axial`` or ``oblique, 12.0 degrees from axial``."""
    normal = np.cross(index_to_lps[:3, 1], index_to_lps[:3, 2])
    cosines = np.abs(normal) / np.linalg.norm(normal)
    nearest = int(np.argmax(cosines))
    angle = math.degrees(math.acos(min(1.0, float(cosines[nearest]))))
    return _AXES[nearest] if angle < 0.5 else f"oblique, {angle:.1f} degrees from {_AXES[nearest]}"


def describe_position(code: str) -> str:
    """PatientPosition in words, e.g. ``FFS (feet first, supine)``; empty for an unknown code."""
    entry, lying = _ENTRY.get(code[:2]), _LYING.get(code[2:])
    return f"{code} ({entry}, {lying})" if entry and lying else ""
