"""Faulty series: each is refused with the sentence that names its fault."""

from __future__ import annotations

import copy
import math
import os
import re
from collections.abc import Callable

import numpy as np
import pytest
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import generate_uid

from segmentation.dicom import read_series, scan_folder
from segmentation.dicom.reader import admit, read_admitted
from segmentation.errors import SeriesError

Slices = list[Dataset]


def change(keyword: str, value: object, *, at: int | None = 3) -> Callable[[Slices], None]:
    """Set an attribute on one slice, or on all."""

    def apply(slices: Slices) -> None:
        for slice_ in slices if at is None else [slices[at]]:
            setattr(slice_, keyword, value)

    return apply


def remove(keyword: str, *, at: int | None = 3) -> Callable[[Slices], None]:
    def apply(slices: Slices) -> None:
        for slice_ in slices if at is None else [slices[at]]:
            delattr(slice_, keyword)

    return apply


def move(offset: tuple[float, float, float], *, at: int = 3) -> Callable[[Slices], None]:
    def apply(slices: Slices) -> None:
        position = np.array(slices[at].ImagePositionPatient, dtype=float) + offset
        slices[at].ImagePositionPatient = [round(value, 5) for value in position]

    return apply


def drop(*places: int) -> Callable[[Slices], None]:
    def apply(slices: Slices) -> None:
        for place in sorted(places, reverse=True):
            del slices[place]

    return apply


def double_slice(slices: Slices) -> None:
    twin = copy.deepcopy(slices[3])
    twin.SOPInstanceUID = generate_uid()
    slices.append(twin)


def reuse_uid(slices: Slices) -> None:
    slices[4].SOPInstanceUID = slices[3].SOPInstanceUID


def two_phases(slices: Slices) -> None:
    for slice_ in slices[1::2]:
        slice_.AcquisitionNumber = 2


def squeeze(slices: Slices) -> None:
    for number, slice_ in enumerate(slices):
        slice_.ImagePositionPatient = [-9.0, -8.0, 1.5 * number + (0.4 if number > 3 else 0.0) * (number - 3)]


def value_table(slices: Slices) -> None:
    table = Dataset()
    table.LUTDescriptor, table.LUTData = [2, 0, 16], b"\0\0\1\0"
    table["LUTDescriptor"].VR = "US"
    slices[0].ModalityLUTSequence = Sequence([table])


FAULTS: dict[str, tuple[Callable[[Slices], None], str]] = {
    "missing slice": (drop(4), "IM004.dcm and IM003.dcm are 3.00 mm apart, the others 1.50 mm; a slice is missing"),
    "two missing": (drop(3, 4), "4.50 mm apart, the others 1.50 mm; a slice is missing"),
    "doubled slice": (double_slice, "lie at the same place"),
    "uneven spacing": (squeeze, "gaps between slices vary from 1.50 to 1.90 mm"),
    "one slice off the line": (move((0, 0, 0.3)), "lies 0.30 mm from a uniform stack, expected at most 0.15 mm"),
    "one slice aside": (move((0.4, 0, 0)), "wander 0.40 mm sideways, most from IM004.dcm to IM003.dcm, expected at most 0.2 mm"),
    "two patients": (change("PatientID", "OTHER-SECRET"), "different values of patient are mixed, IM003.dcm differs"),
    "two studies": (change("StudyInstanceUID", generate_uid()), "values of study are mixed, IM003.dcm"),
    "two frames": (change("FrameOfReferenceUID", generate_uid()), "values of frame of reference are mixed"),
    "two kernels": (change("ConvolutionKernel", "B70f"), r"kernel are mixed \(B30f and B70f\), IM003.dcm differs"),
    "two matrices": (change("Rows", 18), r"matrix are mixed \(26 x 20 and 26 x 18\)"),
    "two phases": (change("TemporalPositionIdentifier", 2), "values of phase are mixed"),
    "two heart phases": (change("NominalPercentageOfCardiacPhase", 40.0), "values of phase are mixed"),
    "alternating acquisitions": (two_phases, "slices of 2 acquisitions alternate along the slice axis"),
    "two voltages": (change("KVP", 80), r"tube voltage are mixed \(120.0 kVp and 80.0 kVp\)"),
    "two depths": (change("BitsStored", 12), "stored bits are mixed"),
    "two ways of lying": (change("PatientPosition", "FFS"), r"patient position are mixed \(HFS and FFS\)"),
    "a PET slice": (change("SOPClassUID", "1.2.840.10008.5.1.4.1.1.128"), r"image class are mixed \(CT image and not CT\)"),
    "a PET modality": (change("Modality", "PT", at=None), "modality PT, expected CT"),
    "one uid, two pictures": (reuse_uid, "IM003.dcm and IM004.dcm bear the same SOPInstanceUID but differ"),
    "turned slice": (change("ImageOrientationPatient", [0, 1, 0, -1, 0, 0]), "IM003.dcm is turned against IM000.dcm"),
    "slanted axes": (change("ImageOrientationPatient", [1, 0, 0, 0.1, 0.995, 0], at=None), "not two perpendicular unit vectors"),
    "no orientation": (remove("ImageOrientationPatient"), "IM003.dcm has no usable ImageOrientationPatient"),
    "no position": (remove("ImagePositionPatient"), "IM003.dcm has no usable ImagePositionPatient"),
    "no spacing": (remove("PixelSpacing"), "IM003.dcm has no usable PixelSpacing"),
    "spacing of a metre": (change("PixelSpacing", [1000, 1000], at=None), "pixels of 1000 x 1000 mm, expected 0.05 to 5 mm"),
    "spacing of zero": (change("PixelSpacing", [0, 0], at=None), "pixels of 0 x 0 mm"),
    "two pixel spacings": (change("PixelSpacing", [0.8, 0.71]), "IM003.dcm has another pixel spacing than IM000.dcm"),
    "two slices": (drop(2, 3, 4, 5, 6, 7), "has 2 slices, expected at least 3"),
    "no rescale": (remove("RescaleIntercept"), "IM003.dcm has no usable rescale slope and intercept"),
    "no rescale at all": (remove("RescaleSlope", at=None), "IM000.dcm has no usable rescale slope and intercept"),
    "slope zero": (change("RescaleSlope", 0), "rescale slope 0 and intercept -1024, expected a slope above 0"),
    "slope negative": (change("RescaleSlope", -1), "rescale slope -1"),
    "not in HU": (change("RescaleType", "Z_EFF", at=None), "in units of Z_EFF, expected HU"),
    "value table": (value_table, "maps its values through a table"),
    "intercept missing its size": (
        change("RescaleIntercept", 0, at=None),
        "no tissue between -250 and 500 HU .* the rescale is wrong or missing",
    ),
    "intercept taken twice": (change("RescaleIntercept", -2448, at=None), "air is -1000; the rescale is wrong"),
    "eight bits": (change("BitsAllocated", 8, at=None), "stores 16 of 8 bits"),
    "high bit elsewhere": (change("HighBit", 14, at=None), "of 16 bits with high bit 14"),
    "a colour picture": (change("SamplesPerPixel", 3, at=None), "has 3 values per pixel"),
    "lying rows": (change("Rows", 40, at=None), "has 1040 bytes of pixels, expected 2080 for 1 x 40 rows x 26 columns"),
    "lying rows, fewer": (change("Rows", 18, at=None), "has 1040 bytes of pixels, expected 936 for 1 x 18 rows x 26 columns"),
    "absurd rows": (change("Rows", 65535, at=None), "declares 26 columns and 65535 rows, expected 3 to 4096"),
    "no rows": (remove("Rows", at=None), "declares 26 columns and 0 rows"),
    "no pixels": (remove("PixelData"), "IM003.dcm has no pixel data"),
    "cut pixels": (change("PixelData", b"\0" * 500), "IM003.dcm has 500 bytes of pixels, expected 1040"),
    "frames without places": (change("NumberOfFrames", 4, at=None), "holds 4 frames without positions"),
    "not CT at all": (change("SOPClassUID", "1.2.840.10008.5.1.4.1.1.4", at=None), "holds no CT image series"),
    "localizer only": (change("ImageType", ["ORIGINAL", "PRIMARY", "LOCALIZER"], at=None), "holds no CT image series"),
    "unknown coding": (
        lambda slices: [setattr(s.file_meta, "TransferSyntaxUID", "1.2.3.4") for s in slices] and None,
        "transfer syntax 1.2.3.4, which is no CT image coding",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_faulty_series_is_refused_by_name(name, maker, tmp_path):
    spoil, message = FAULTS[name]
    slices = maker.slices()
    spoil(slices)
    folder = maker.save(tmp_path / "case", slices)
    with pytest.raises(SeriesError, match=message) as caught:
        read_series(folder)
    sentence = str(caught.value)
    assert sentence.startswith("case: ")
    assert not re.search(r"(?i)secret|" + re.escape(str(tmp_path)), sentence), "identifiers and absolute paths are never printed"
    assert not re.search(r"\d+\.\d+\.\d+\.\d+\.\d+\.\d+\.\d+\.\d{8}", sentence), "unique identifiers are never printed"


@pytest.mark.parametrize("value", ["nan", "inf", "", "abc"])
@pytest.mark.parametrize("keyword", ["PixelSpacing", "ImagePositionPatient", "ImageOrientationPatient", "RescaleSlope"])
def test_numbers_that_are_none_are_refused(keyword, value, maker, tmp_path):
    slices = maker.slices()
    count = 1 if keyword == "RescaleSlope" else len(slices[3][keyword].value)
    folder = maker.save(tmp_path / "case", slices)
    # Written as bytes, since the writer checks what it writes.
    target = folder / "IM003.dcm"
    old = "\\".join(str(part) for part in (slices[3][keyword].value if count > 1 else [slices[3][keyword].value]))
    new = "\\".join([value] * count).ljust(len(old))
    raw = target.read_bytes()
    assert raw.count(old.encode()) == 1 or keyword == "RescaleSlope"
    if keyword == "RescaleSlope":
        tag = raw.index(b"\x28\x00\x53\x10DS")
        new_value = (value + " " * (len(value) % 2)).encode()
        raw = raw[: tag + 6] + len(new_value).to_bytes(2, "little") + new_value + raw[tag + 10 :]
    else:
        raw = raw.replace(old.encode(), new[: len(old)].encode())
    target.write_bytes(raw)
    with pytest.raises(SeriesError, match=r"IM003\.dcm has (no usable|another pixel)"):
        read_series(folder)


@pytest.mark.parametrize("angle", [5.0, 15.0, 30.0])
def test_gantry_tilt_is_refused_with_its_angle(angle, maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices(shear=(0.0, math.tan(math.radians(angle)), 0.0)))
    with pytest.raises(SeriesError, match=rf"stacked at {angle:.1f} degrees to their normal \(gantry tilt\)"):
        read_series(folder)


def test_a_slice_cut_at_any_length_is_refused(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices())
    target = folder / "IM003.dcm"
    whole = target.read_bytes()
    for length in [0, 1, 100, 131, 132, 140, *range(150, len(whole), 97), len(whole) - 1]:
        target.write_bytes(whole[:length])
        with pytest.raises(SeriesError, match=r"^case: "):
            read_series(folder)


def test_damaged_bytes_never_crash_and_never_move_a_slice(maker, tmp_path, lies_in_place):
    folder = maker.save(tmp_path / "case", maker.slices())
    target = folder / "IM003.dcm"
    whole = target.read_bytes()
    header = len(whole) - 1040
    rng = np.random.default_rng(7)
    refused = 0
    for _ in range(60):
        damaged = bytearray(whole)
        for place in rng.integers(132, header, size=rng.integers(1, 4)):
            damaged[place] = rng.integers(256)
        target.write_bytes(damaged)
        try:
            volume = read_series(folder).volume
        except SeriesError:
            refused += 1
        else:
            matrix = volume.index_to_lps
            # One slice is damaged: the place of the stack comes from the others, within the gate's tolerances.
            assert np.abs(np.abs(matrix[:3, :3]).max(axis=0) - (1.5, 0.8, 0.7)).max() < 0.02
    assert refused > 10


def test_a_link_is_refused(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices())
    (folder / "IM003.dcm").rename(tmp_path / "elsewhere.dcm")
    (folder / "IM003.dcm").symlink_to(tmp_path / "elsewhere.dcm")
    with pytest.raises(SeriesError, match=r"IM003\.dcm is a symbolic link; only regular files are read"):
        read_series(folder)


def test_a_linked_folder_is_refused(maker, tmp_path):
    maker.save(tmp_path / "other", maker.slices())
    folder = maker.save(tmp_path / "case", maker.slices())
    (folder / "more").symlink_to(tmp_path / "other")
    with pytest.raises(SeriesError, match="more is a symbolic link"):
        read_series(folder)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")
def test_a_pipe_is_refused_and_not_waited_for(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices())
    os.mkfifo(folder / "IM100.dcm")
    with pytest.raises(SeriesError, match=r"IM100\.dcm is no regular file"):
        read_series(folder)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("IM100.dcm", b"<html>not found</html>"),
        ("IM100.dcm", b""),
        ("IM100.dcm", bytes(4000)),
        ("IM100", b"\x08\x00\x05\x00\x0a\x00\x00\x00ISO_IR 100"),
        ("IM100.dcm", bytes(128) + b"DICM"),
        ("IM100", bytes(128) + b"DICM" + bytes(range(256)) * 4),
    ],
    ids=["html", "empty", "zeros", "no preamble", "nothing behind the preamble", "garbage behind the preamble"],
)
def test_what_looks_like_dicom_and_cannot_be_read_is_refused(name, content, maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices())
    (folder / name).write_bytes(content)
    with pytest.raises(SeriesError, match=f"{re.escape(name)} looks like DICOM but"):
        read_series(folder)


def test_a_zeroed_slice_without_suffix_is_refused_among_its_like(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices(), names=[f"IM{k}" for k in range(8)])
    (folder / "IM7").write_bytes(bytes((folder / "IM7").stat().st_size))
    with pytest.raises(SeriesError, match="IM7 looks like DICOM but has no DICOM preamble"):
        read_series(folder)


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(SeriesError, match=r"holds no DICOM image \(0 other files\)"):
        scan_folder(tmp_path)


def test_several_faults_are_counted(maker, tmp_path):
    slices = maker.slices()
    slices[3].ConvolutionKernel = "B70f"
    slices[3].KVP = 80
    slices[5].RescaleSlope = 0
    with pytest.raises(SeriesError, match=r"kernel are mixed.*\(2 more faults: tubeplan inspect lists all\)"):
        read_series(maker.save(tmp_path / "case", slices))


def test_a_file_that_changes_between_the_passes_is_refused(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices())
    admitted = admit(scan_folder(folder)[0].headers)
    maker.save(folder, maker.slices(ConvolutionKernel="B31f"))
    with pytest.raises(SeriesError, match="changed while the folder was read; wait until the export is complete"):
        read_admitted(admitted.slices, admitted.stack)
