"""The admission gate: what the headers of one series must agree on before any pixel is decoded.

Each rule yields its faults, so that `inspect` can list all of them and reading stops
at the first. Pixel-level rules are in `hounsfield` and `outliers`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from segmentation.dicom.headers import CT_CLASSES, SliceHeader
from segmentation.dicom.series import printable
from segmentation.errors import SeriesError

MAX_MATRIX = 4096
"""Most rows or columns; the largest clinical CT matrix is 2048."""
MAX_VOXELS = 1 << 30
"""Most voxels of a volume: 2 GiB as int16, 4096 slices of 512 x 512."""

_Attribute = Callable[[SliceHeader], object]

# What differs, how to read it, and whether its values may be printed.
_ONE_OF_EACH: tuple[tuple[str, _Attribute, bool], ...] = (
    ("patient", lambda slice_: slice_.patient, False),
    ("study", lambda slice_: slice_.study, False),
    ("frame of reference", lambda slice_: slice_.frame_of_reference, False),
    ("image class", lambda slice_: CT_CLASSES.get(slice_.sop_class, "not CT"), True),
    ("modality", lambda slice_: slice_.modality, True),
    ("reconstruction kernel", lambda slice_: slice_.kernel, True),
    ("phase", lambda slice_: "/".join(part for part in slice_.phase if part), True),
    ("tube voltage", lambda slice_: f"{slice_.kvp} kVp", True),
    ("matrix", lambda slice_: f"{slice_.columns} x {slice_.rows}", True),
    ("patient position", lambda slice_: slice_.patient_position, True),
    ("stored bits", lambda slice_: f"{slice_.bits_stored} {'signed' if slice_.signed else 'unsigned'}", True),
)


def header_faults(slices: Sequence[SliceHeader]) -> Iterator[str]:
    """What forbids reading the slices as one CT volume, geometry aside (see `geometry`).

    Parameters
    ----------
    slices : sequence of SliceHeader
        One series.

    Yields
    ------
    str
        A sentence without the folder's name.
    """
    yield from _class_faults(slices)
    yield from _mixture_faults(slices)
    yield from _pixel_faults(slices)
    yield from _rescale_faults(slices)


def order_faults(slices: Sequence[SliceHeader]) -> Iterator[str]:
    """What forbids reading once the order of the slices is known.

    Parameters
    ----------
    slices : sequence of SliceHeader
        One series, in order along the slice axis.
    """
    runs = _acquisition_runs(slices)
    if len(runs) > len(set(runs)):
        yield (
            f"slices of {len(set(runs))} acquisitions alternate along the slice axis ({len(runs) - 1} changes); "
            "two phases are mixed, separate them"
        )


def header_warnings(slices: Sequence[SliceHeader]) -> Iterator[str]:
    """What a reviewer should know although it does not forbid reading.

    Parameters
    ----------
    slices : sequence of SliceHeader
        One series, in order along the slice axis.
    """
    if any(slice_.lossy for slice_ in slices):
        yield "the images were compressed with loss at some time"
    if not slices[0].sop_class:
        yield "the headers name no image class; taken as CT by their modality"
    if len({slice_.image_type[:2] for slice_ in slices}) > 1:
        yield "original and derived images are mixed in the series"
    if len({slice_.rescale for slice_ in slices}) > 1:
        yield "slope and intercept change from slice to slice; each slice was rescaled by its own"
    tilts = [abs(slice_.tilt) for slice_ in slices if slice_.tilt is not None]
    if tilts and max(tilts) > 0.1:
        yield f"the headers name a gantry tilt of {max(tilts):.1f} degrees, but the slices stand straight; taken as resampled"
    promised = slices[0].images_in_acquisition
    if promised is not None and promised > len(slices):
        yield f"the headers speak of {promised} images in the acquisition, {len(slices)} are here"
    numbers = [slice_.instance_number for slice_ in slices]
    known = [number for number in numbers if number is not None]
    if len(known) == len(numbers) > 1:
        steps = {second - first for first, second in pairwise(known)}
        if len(steps) == 1 and abs(next(iter(steps))) > 1:
            yield f"the instance numbers go in steps of {abs(next(iter(steps)))}: only part of the slices may have been exported"
        elif len({step > 0 for step in steps}) > 1 or 0 in steps:
            yield "the instance numbers do not follow the slice positions; the positions were believed"
    runs = _acquisition_runs(slices)
    if len(runs) > 1:
        yield f"the series is put together from {len(runs)} acquisitions, one after the other along the slice axis"


def _acquisition_runs(slices: Sequence[SliceHeader]) -> list[int | None]:
    """Acquisition numbers along the slice axis, repeats in a row taken once."""
    numbers = [slice_.acquisition for slice_ in slices]
    return numbers[:1] + [second for first, second in pairwise(numbers) if first != second]


def _class_faults(slices: Sequence[SliceHeader]) -> Iterator[str]:
    for slice_ in slices:
        if slice_.modality != "CT":
            what = printable(slice_.modality) or "none"
            yield f"{slice_.name} has modality {what}, expected CT; name a CT series"
            return
        if slice_.frame is None and slice_.frames != 1:
            yield f"{slice_.name} holds {slice_.frames} frames without positions; export it as single slices or Enhanced CT"
            return


def _mixture_faults(slices: Sequence[SliceHeader]) -> Iterator[str]:
    for what, attribute, shown in _ONE_OF_EACH:
        values = [attribute(slice_) for slice_ in slices]
        kinds = sorted(set(values), key=values.count, reverse=True)
        if len(kinds) > 1:
            odd = slices[values.index(kinds[1])]
            words = " and ".join(printable(str(kind)) or "none" for kind in kinds[:2])
            detail = f" ({words})" if shown else ""
            yield f"slices of {len(kinds)} different values of {what} are mixed{detail}, {odd.name} differs; separate them"


def _pixel_faults(slices: Sequence[SliceHeader]) -> Iterator[str]:
    first = slices[0]
    rows, columns = first.rows or 0, first.columns or 0
    if not (3 <= rows <= MAX_MATRIX and 3 <= columns <= MAX_MATRIX):
        yield f"{first.name} declares {columns} columns and {rows} rows, expected 3 to {MAX_MATRIX}; the header is damaged"
        return
    if rows * columns * len(slices) > MAX_VOXELS:
        voxels = rows * columns * len(slices)
        yield f"the series has {voxels / 1e9:.1f} billion voxels, at most {MAX_VOXELS / 1e9:.1f} are read; crop it"
        return
    if first.samples != 1 or first.photometric not in ("MONOCHROME1", "MONOCHROME2"):
        kind = printable(first.photometric) or "none"
        yield f"{first.name} has {first.samples} values per pixel, photometric {kind}, expected one grey value; it is no CT"
    stored = first.bits_stored or 0
    if first.bits_allocated != 16 or not 8 <= stored <= 16 or first.high_bit != stored - 1:
        yield (
            f"{first.name} stores {first.bits_stored} of {first.bits_allocated} bits with high bit {first.high_bit}, "
            "expected 8 to 16 of 16 from bit 0; export it as 16-bit CT"
        )


def _rescale_faults(slices: Sequence[SliceHeader]) -> Iterator[str]:
    for slice_ in slices:
        if slice_.value_table:
            yield f"{slice_.name} maps its values through a table instead of slope and intercept; export it in HU"
            return
        try:
            slope, intercept = slice_.rescale
        except SeriesError as error:
            yield str(error)
            return
        if slope <= 0:
            yield f"{slice_.name} has rescale slope {slope:g} and intercept {intercept:g}, expected a slope above 0"
            return
        if slice_.rescale_type.upper() not in ("", "HU", "US", "HOUNSFIELD UNIT"):
            yield f"{slice_.name} is in units of {printable(slice_.rescale_type)}, expected HU; choose the HU reconstruction"
            return
