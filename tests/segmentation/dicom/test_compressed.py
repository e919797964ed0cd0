"""Compressed codings: decoded by the named plugin, or refused before a decoder sees them."""

from __future__ import annotations

import dataclasses
import struct

import numpy as np
import pytest
from pydicom import dcmread
from pydicom.encaps import encapsulate, generate_frames
from pydicom.uid import JPEG2000Lossless, JPEGLosslessSV1, JPEGLSLossless, RLELossless

import segmentation.dicom.decode as decode
from segmentation.dicom import inspect_folder, read_series
from segmentation.dicom.streams import check_stream
from segmentation.errors import SeriesError

PLUGINS = {
    RLELossless: "pydicom",
    JPEG2000Lossless: "pylibjpeg",
    JPEGLSLossless: "pyjpegls",
    JPEGLosslessSV1: "gdcm",
}


@pytest.fixture
def compressed(maker, tmp_path, stored_values):
    """Saves a series in a transfer syntax and returns its folder."""
    get_stored, set_stored = stored_values
    # JPEG 2000 with its usual five levels needs at least 32 pixels along both sides.
    maker = dataclasses.replace(maker, shape=(6, 36, 40), spacing=(1.5, 0.45, 0.45))

    def make(syntax):
        for package in decode.SYNTAXES[syntax].modules:
            pytest.importorskip(package)
        # Unsigned 12 bits, as scanners store them.
        slices = maker.slices(PixelRepresentation=0, BitsStored=12, HighBit=11)
        for slice_ in slices:
            set_stored(slice_, get_stored(slice_))
        if syntax == JPEGLosslessSV1:
            folder = maker.save(tmp_path / "case", slices)
            for file in folder.iterdir():
                _encode_with_gdcm(file)
            return folder
        for slice_ in slices:
            slice_.compress(syntax, encoding_plugin=PLUGINS[syntax], generate_instance_uid=False)
        return maker.save(tmp_path / "case", slices)

    return make


def _encode_with_gdcm(file) -> None:
    import gdcm

    reader = gdcm.ImageReader()
    reader.SetFileName(str(file))
    assert reader.Read()
    change = gdcm.ImageChangeTransferSyntax()
    change.SetTransferSyntax(gdcm.TransferSyntax(gdcm.TransferSyntax.JPEGLosslessProcess14_1))
    change.SetInput(reader.GetImage())
    assert change.Change()
    writer = gdcm.ImageWriter()
    writer.SetFileName(str(file))
    writer.SetFile(reader.GetFile())
    writer.SetImage(change.GetOutput())
    assert writer.Write()


@pytest.mark.parametrize("syntax", PLUGINS, ids=lambda uid: uid.keyword)
def test_lossless_codings_give_the_same_volume(syntax, compressed, lies_in_place):
    folder = compressed(syntax)
    assert dcmread(folder / "IM003.dcm").file_meta.TransferSyntaxUID == syntax
    lies_in_place(read_series(folder).volume)
    described = inspect_folder(folder)["series"][0]["transfer_syntax"]
    assert described["compressed"]
    assert described["installed"]
    assert described["decoder"] == PLUGINS[syntax]


@pytest.mark.parametrize("syntax", [JPEG2000Lossless, JPEGLSLossless, JPEGLosslessSV1], ids=lambda uid: uid.keyword)
def test_a_missing_extra_is_named_with_the_command_that_brings_it(syntax, compressed, monkeypatch):
    folder = compressed(syntax)
    monkeypatch.setattr(decode, "find_module", lambda name: False)
    with pytest.raises(SeriesError, match=r"is not installed; pip install 'tubeplan\[compressed\]' brings it"):
        read_series(folder)
    series = inspect_folder(folder)["series"][0]
    assert not series["usable"]
    assert series["transfer_syntax"]["install"] == "pip install 'tubeplan[compressed]'"


def test_run_length_coding_needs_no_extra(compressed, monkeypatch, lies_in_place):
    folder = compressed(RLELossless)
    monkeypatch.setattr(decode, "find_module", lambda name: False)
    lies_in_place(read_series(folder).volume)


@pytest.mark.parametrize("syntax", PLUGINS, ids=lambda uid: uid.keyword)
@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_a_cut_stream_is_refused(syntax, part, compressed):
    folder = compressed(syntax)
    slice_ = dcmread(folder / "IM003.dcm")
    (frame,) = generate_frames(slice_.PixelData, number_of_frames=1)
    slice_.PixelData = encapsulate([frame[: int(len(frame) * part)]])
    slice_.save_as(folder / "IM003.dcm")
    with pytest.raises(SeriesError, match=r"IM003\.dcm has"):
        read_series(folder)


@pytest.mark.parametrize("syntax", PLUGINS, ids=lambda uid: uid.keyword)
def test_a_header_that_lies_about_the_size_is_refused(syntax, compressed):
    folder = compressed(syntax)
    for file in folder.iterdir():
        slice_ = dcmread(file)
        slice_.Rows = 4000
        slice_.save_as(file)
    message = "do not decode" if syntax == RLELossless else "declares 40 x 4000 pixels but its compressed stream has 40 x 36"
    with pytest.raises(SeriesError, match=message):
        read_series(folder)


def test_a_stream_that_lies_about_its_size_is_refused_before_decoding(compressed, monkeypatch):
    folder = compressed(JPEG2000Lossless)
    slice_ = dcmread(folder / "IM003.dcm")
    (frame,) = generate_frames(slice_.PixelData, number_of_frames=1)
    huge = frame.replace(struct.pack(">II", 40, 36), struct.pack(">II", 60000, 60000), 1)
    assert huge != frame
    slice_.PixelData = encapsulate([huge])
    slice_.save_as(folder / "IM003.dcm")
    with pytest.raises(SeriesError, match=r"IM003\.dcm declares 40 x 36 pixels but its compressed stream has 60000 x 60000"):
        read_series(folder)


def test_another_coding_than_declared_is_refused(compressed):
    folder = compressed(JPEGLSLossless)
    slice_ = dcmread(folder / "IM003.dcm")
    slice_.file_meta.TransferSyntaxUID = JPEG2000Lossless
    slice_.save_as(folder / "IM003.dcm")
    with pytest.raises(SeriesError, match=r"IM003\.dcm has a compressed stream that is no JPEG 2000"):
        read_series(folder)


def test_damaged_streams_never_crash(compressed):
    folder = compressed(JPEG2000Lossless)
    file = folder / "IM003.dcm"
    whole = file.read_bytes()
    start = whole.index(b"\xff\x4f\xff\x51")
    rng = np.random.default_rng(5)
    refused = 0
    for _ in range(25):
        damaged = bytearray(whole)
        damaged[rng.integers(start, start + 80)] = rng.integers(256)
        file.write_bytes(damaged)
        try:
            read_series(folder)
        except SeriesError:
            refused += 1
    assert refused > 5


@pytest.mark.parametrize(
    ("family", "data", "message"),
    [
        ("jpeg", b"", "no JPEG"),
        ("jpeg", b"\xff\xd8", "cut within its header"),
        ("jpeg", b"\xff\xd8\x00\x00", "broken marker"),
        ("jpeg", b"\xff\xd8\xff\xda\x00\x02", "without a frame header"),
        ("jpeg2000", b"\xff\x4f\xff\x51\x00\x2f", "cut within its header"),
        ("rle", bytes(10), "shorter than its own header"),
        ("rle", struct.pack("<16I", 3, 64, 70, 80, *[0] * 12) + bytes(100), "3 segments, expected 2"),
        ("rle", struct.pack("<16I", 2, 64, 900, *[0] * 13) + bytes(100), "segments outside of it"),
    ],
)
def test_broken_stream_headers_are_told_apart(family, data, message):
    with pytest.raises(SeriesError, match=message):
        check_stream(data, family=family, rows=20, columns=26)
