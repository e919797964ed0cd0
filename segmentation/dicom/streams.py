"""Compressed pixel streams: what they say of themselves, read before a decoder sees them.

Decoders trust the stream's own size: a lying one costs gigabytes or comes back as a
partial picture. Here the size, the depth and the end marker are checked first.

References
----------
ITU-T T.81 annex B (JPEG markers), T.87 annex C (JPEG-LS), T.800 annex A (JPEG 2000 SIZ);
DICOM PS3.5 annex G (RLE).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from segmentation.errors import SeriesError

_STANDALONE = {0x01, *range(0xD0, 0xD9)}
_FRAME_HEADERS = {0xC0, 0xC1, 0xC2, 0xC3, 0xF7}


@dataclass(frozen=True)
class StreamSize:
    """Size, channels and bits per pixel a compressed stream declares."""

    rows: int
    columns: int
    channels: int
    bits: int


def check_stream(data: bytes, *, family: str, rows: int, columns: int) -> None:
    """Refuse a compressed frame that is cut or is not the picture its header promises.

    Parameters
    ----------
    data : bytes
        One frame, without encapsulation.
    family : {"jpeg", "jpeg2000", "rle"}
    rows, columns : int
        From the DICOM header.

    Raises
    ------
    SeriesError
        If size, channels, depth or end marker do not fit. The message lacks the file.
    """
    if family == "rle":
        _check_rle(data)
        return
    try:
        size = _jpeg2000_size(data) if family == "jpeg2000" else _jpeg_size(data)
    except (struct.error, IndexError) as error:
        raise SeriesError("has a compressed stream cut within its header; export it again") from error
    if (size.rows, size.columns) != (rows, columns):
        raise SeriesError(
            f"declares {columns} x {rows} pixels but its compressed stream has {size.columns} x {size.rows}; export it again"
        )
    if size.channels != 1 or not 8 <= size.bits <= 16:
        raise SeriesError(f"has a compressed stream of {size.channels} channels with {size.bits} bits, expected one with 8 to 16")
    # Frames are padded to even length with zeros, JPEG 2000 sometimes with FF.
    if not data.rstrip(b"\0").endswith(b"\xff\xd9") and not data.rstrip(b"\0\xff").endswith(b"\xff\xd9"):
        raise SeriesError("has a compressed stream without its end marker, so it is cut; export it again")


def _jpeg_size(data: bytes) -> StreamSize:
    if data[:2] != b"\xff\xd8":
        raise SeriesError("has a compressed stream that is no JPEG, unlike its transfer syntax says; export it again")
    at = 2
    while True:
        if data[at] != 0xFF:
            raise SeriesError("has a JPEG stream with a broken marker; export it again")
        marker = data[at + 1]
        if marker == 0xFF or marker in _STANDALONE:
            at += 1 if marker == 0xFF else 2
            continue
        (length,) = struct.unpack_from(">H", data, at + 2)
        if marker in _FRAME_HEADERS:
            bits, rows, columns, channels = struct.unpack_from(">BHHB", data, at + 4)
            return StreamSize(rows, columns, channels, bits)
        if marker == 0xDA or length < 2:
            raise SeriesError("has a JPEG stream without a frame header; export it again")
        at += 2 + length


def _jpeg2000_size(data: bytes) -> StreamSize:
    start = data.find(b"\xff\x4f\xff\x51", 0, 4096)  # a JP2 file header may stand before the code stream
    if start < 0:
        raise SeriesError("has a compressed stream that is no JPEG 2000, unlike its transfer syntax says; export it again")
    right, bottom, left, top = struct.unpack_from(">4I", data, start + 8)
    channels, depth = struct.unpack_from(">HB", data, start + 40)
    return StreamSize(bottom - top, right - left, channels, (depth & 0x7F) + 1)


def _check_rle(data: bytes) -> None:
    if len(data) < 64:
        raise SeriesError("has an RLE stream shorter than its own header; export it again")
    count, *offsets = struct.unpack_from("<16I", data)
    used = offsets[:count]
    if count != 2:
        raise SeriesError(f"has an RLE stream of {count} segments, expected 2 for 16 bits; export it again")
    if used[0] != 64 or not used[0] < used[1] < len(data):
        raise SeriesError("has an RLE stream with segments outside of it, so it is cut; export it again")
