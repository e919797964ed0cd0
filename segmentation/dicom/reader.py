"""One DICOM series to one volume in HU, fail closed.

Strategy: a header-only pass finds the series and puts it through the gate; only then
are voxels allocated. The second pass reads each file once, hashes it, checks that its
header is still the admitted one, decodes and rescales it straight into its place.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from segmentation.arrays import VoxelArray
from segmentation.dicom.decode import decode_slice, require_decoder
from segmentation.dicom.facts import geometry_facts, padding_facts, series_facts
from segmentation.dicom.files import DicomFile, head_of, parse, quiet_parser, read_bytes
from segmentation.dicom.gate import header_faults, header_warnings, order_faults
from segmentation.dicom.geometry import Stack, build_stack
from segmentation.dicom.headers import SliceHeader, slice_headers
from segmentation.dicom.hounsfield import Conversion, hounsfield_faults, settle_fill, to_hounsfield
from segmentation.dicom.outliers import judge_slices
from segmentation.dicom.series import Progress, choose_series, join_faults, scan_folder
from segmentation.errors import SeriesError
from segmentation.padding import Padding, together
from segmentation.volume import Volume

_WORKERS = min(4, os.cpu_count() or 1)


@dataclass(frozen=True, eq=False)
class DicomVolume:
    """A series read from DICOM.

    Attributes
    ----------
    volume : Volume
    facts : dict of str to str
        Label to printed value; nothing identifies a patient.
    warnings : tuple of str
        What a reviewer should know.
    digest : str
        SHA-256 over the sorted SHA-256 of the files, in hexadecimal.
    files : int
    padding : Padding
        Voxels outside the image, declared or told by their value.
    """

    volume: Volume
    facts: dict[str, str]
    warnings: tuple[str, ...]
    digest: str
    files: int
    padding: Padding


@dataclass(frozen=True, eq=False)
class Admitted:
    """A series that passed the gate.

    Attributes
    ----------
    slices : tuple of SliceHeader
        In order along the slice axis.
    stack : Stack
        Its `order` is that of `slices`.
    warnings : tuple of str
    """

    slices: tuple[SliceHeader, ...]
    stack: Stack
    warnings: tuple[str, ...]


def read_series(path: Path, *, series: str | None = None, progress: Progress | None = None) -> DicomVolume:
    """Read one CT series from a folder.

    Parameters
    ----------
    path : Path
        A folder with its subfolders, or one multi-frame file.
    series : str, optional
        Which series, see `choose_series`; needed where there are several.
    progress : callable, optional
        Called with the number of slices read and of all.

    Returns
    -------
    DicomVolume
        Voxels in int16 HU, clipped to that type's range; padding is -1024 HU. The slice
        axis is highdicom's: column direction x row direction.

    Raises
    ------
    SeriesError
        If the folder does not hold one trustworthy series of that name.
    """
    path = path.resolve()  # so that "." has a name
    chosen, left_out = choose_series(scan_folder(path), series, path.name)
    try:
        admitted = admit(chosen.headers)
        result = read_admitted(admitted.slices, admitted.stack, progress=progress)
    except SeriesError as error:
        raise SeriesError(f"{path.name}: {error}") from error
    return replace(result, warnings=(*left_out, *admitted.warnings, *result.warnings))


def read_admitted(slices: Sequence[SliceHeader], stack: Stack, *, progress: Progress | None = None) -> DicomVolume:
    """Read the pixels of slices that passed the gate, and check them.

    Parameters
    ----------
    slices : sequence of SliceHeader
        In order along the slice axis.
    stack : Stack
        Their geometry.

    Raises
    ------
    SeriesError
        If pixel data are damaged, a slice does not fit its neighbours, or the values are
        no HU. The message lacks the folder.
    """
    voxels, hashes, conversions = _read_voxels(slices, progress)
    declared = Padding(tuple(conversion.padding for conversion in conversions), *slices[0].matrix)
    filled = settle_fill(voxels)
    faults, doubts = judge_slices(voxels, [slice_.name for slice_ in slices])
    faults += hounsfield_faults(voxels)
    if faults:
        raise SeriesError(join_faults(faults))
    facts = {
        **series_facts(slices),
        **geometry_facts(stack.index_to_lps, voxels.shape),
        "HU range": f"{voxels.min()} to {voxels.max()} HU",
        **padding_facts(declared.count, filled.count),
    }
    digest = hashlib.sha256("".join(sorted(hashes)).encode()).hexdigest()
    warnings = (*_value_warnings(conversions), *doubts)
    volume = Volume(voxels, stack.index_to_lps)
    return DicomVolume(volume, facts, warnings, digest, len(hashes), together(declared, filled))


def admit(headers: Sequence[SliceHeader]) -> Admitted:
    """Put the headers of one series through the gate.

    Raises
    ------
    SeriesError
        With the first fault; the message lacks the folder.
    """
    slices, doubled = drop_identical(headers)
    faults = list(header_faults(slices))
    if faults:
        raise SeriesError(join_faults(faults))
    for syntax in sorted({slice_.syntax for slice_ in slices}):
        require_decoder(syntax)
    stack = build_stack(slices)
    ordered = tuple(slices[k] for k in stack.order)
    for fault in order_faults(ordered):
        raise SeriesError(fault)
    warnings = [f"{doubled} byte-identical copies of slices were left out"] if doubled else []
    return Admitted(ordered, stack, (*warnings, *header_warnings(ordered)))


def drop_identical(headers: Sequence[SliceHeader]) -> tuple[tuple[SliceHeader, ...], int]:
    """The slices without byte-identical copies, and how many were dropped.

    Raises
    ------
    SeriesError
        If two files share a SOPInstanceUID and differ.
    """
    by_instance: dict[tuple[str, int | None], list[SliceHeader]] = defaultdict(list)
    kept: list[SliceHeader] = []
    for header in headers:
        twins = by_instance[header.instance, header.frame] if header.instance else []
        if not twins:
            kept.append(header)
        elif read_bytes(twins[0].file) != read_bytes(header.file):
            raise SeriesError(
                f"{twins[0].name} and {header.name} bear the same SOPInstanceUID but differ; keep the right one of the two"
            )
        twins.append(header)
    return tuple(kept), len(headers) - len(kept)


def _read_voxels(slices: Sequence[SliceHeader], progress: Progress | None) -> tuple[VoxelArray, list[str], list[Conversion]]:
    """Voxels in HU, the hash of each file, and what happened to the values of each slice, in order of the slices."""
    places: dict[DicomFile, list[int]] = defaultdict(list)
    for k, slice_ in enumerate(slices):
        places[slice_.file].append(k)
    shape = (len(slices), *slices[0].matrix)
    try:
        voxels = np.empty(shape, dtype=np.int16)
    except MemoryError as error:
        raise SeriesError(f"there is no memory for {np.prod(shape) / 1e9:.1f} billion voxels; crop the series") from error

    def read(file: DicomFile) -> tuple[str, dict[int, Conversion]]:
        return _read_file(file, {k: slices[k] for k in places[file]}, voxels)

    hashes: list[str] = []
    conversions: dict[int, Conversion] = {}
    with quiet_parser(), ThreadPoolExecutor(_WORKERS) as pool:
        try:
            for digest, converted in pool.map(read, places):
                hashes.append(digest)
                conversions |= converted
                if progress is not None:
                    progress(len(conversions), len(slices))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return voxels, hashes, [conversions[k] for k in range(len(slices))]


def _read_file(file: DicomFile, wanted: dict[int, SliceHeader], voxels: VoxelArray) -> tuple[str, dict[int, Conversion]]:
    data = read_bytes(file)
    try:
        dataset = parse(io.BytesIO(data), pixels=True)
    except SeriesError as error:
        raise SeriesError(f"{file.name} {error}") from error
    marks = {slice_.head for slice_ in wanted.values()}
    same = all(head is not None and head_of(data, head[0]) == head for head in marks)
    now = {} if same else {header.frame: header for header in slice_headers(dataset, file)}
    conversions = {}
    for k, slice_ in wanted.items():
        if not same and now.get(slice_.frame) != slice_:
            raise SeriesError(f"{slice_.name} changed while the folder was read; wait until the export is complete")
        try:
            stored = decode_slice(dataset, slice_)
        except SeriesError as error:
            raise SeriesError(f"{slice_.name} {error}") from error
        slope, intercept = slice_.rescale
        conversions[k] = to_hounsfield(stored, voxels[k], slope=slope, intercept=intercept, padding=slice_.padding)
    return hashlib.sha256(data).hexdigest(), conversions


def _value_warnings(conversions: Sequence[Conversion]) -> list[str]:
    clipped = sum(conversion.clipped for conversion in conversions)
    kept = sum(conversion.kept_padding for conversion in conversions)
    warnings = []
    if kept:
        warnings.append(f"{kept} voxels hold a declared padding value that reads as tissue; they were left as they are")
    if clipped:
        warnings.append(f"{clipped} voxels beyond the range -32768 to 32767 HU were clipped to it")
    return warnings
